"""Reads a recording that is compressed as a whole."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.files.places import private_folder

from . import zstd
from .damage import DamageLog
from .reader import Reader

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence

    from pc2scan.model import Attachment, ChunkRule, Connection, Metadata, Summary

    from .damage import Damage
    from .formats import Format, ReadOptions
    from .units import Unit


class ZstdReader(Reader):
    """Reads a file that is compressed as a whole from a temporary copy.

    Parameters
    ----------
    path
        The compressed file.
    inner
        The format of the decompressed file.
    options
        Options for reading that.
    """

    def __init__(self, path: Path, inner: Format, options: ReadOptions) -> None:
        self._path = path
        self._log = DamageLog(strict=options.strict)
        self._temporary = private_folder(path)
        try:
            unpacked = zstd.decompress_file(path, Path(self._temporary.name), self._log)
            self._inner = inner.open_reader(unpacked, options)
        except BaseException:
            self._temporary.cleanup()
            raise
        summary = self._inner.summary
        self._inner_size = summary.size_bytes
        self._summary = summary._replace(
            compression=zstd.compressions(summary.compression),
            size_bytes=path.stat().st_size,
        )

    @property
    def path(self) -> Path:
        """The compressed file."""
        return self._path

    @property
    def has_chunks(self) -> bool:
        """Whether the recording in it has chunks."""
        return self._inner.has_chunks

    @property
    def connections(self) -> Sequence[Connection]:
        """All connections, in the container's order."""
        return self._inner.connections

    @property
    def summary(self) -> Summary:
        """The summary, made without reading messages; the size is that of the compressed file."""
        return self._summary

    @property
    def bytes_read(self) -> int:
        """The share of the compressed file that was read so far."""
        return self._inner.bytes_read * self._summary.size_bytes // max(1, self._inner_size)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage: that of the compression first, then that of the recording in it."""
        return (*self._log.found, *(place._replace(path=self._path) for place in self._inner.damage))

    def units(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> Iterable[Unit]:
        """See `pc2scan.bags.reader.Reader`."""
        return self._inner.units(connections, start_ns, stop_ns, rule)

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """See `pc2scan.bags.reader.Reader`."""
        return self._inner.counts(connections, start_ns, stop_ns)

    def attachments(self) -> Iterator[Attachment]:
        """Return the attachments of the recording in it."""
        return self._inner.attachments()

    def metadata(self) -> Iterator[Metadata]:
        """Return the metadata records of the recording in it."""
        return self._inner.metadata()

    def close(self) -> None:
        """Close the temporary copy and remove it."""
        self._inner.close()
        self._temporary.cleanup()
