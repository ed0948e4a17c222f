"""The base class of readers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, NamedTuple, cast

from pc2scan.errors import RecordingError
from pc2scan.files.compression import allowed_bytes

from .loading import merge_by_time

if TYPE_CHECKING:
    from collections.abc import Collection, Generator, Iterable, Iterator, Sequence
    from pathlib import Path
    from tempfile import TemporaryDirectory

    from pc2scan.model import Attachment, ChunkRule, Connection, Metadata, RawMessage, Summary
    from pc2scan.progress import Meter
    from pc2scan.threads import Threads

    from .damage import Damage, DamageLog
    from .loading import Chunk


#: Connections of a recording: nearly as many as MCAP has numbers for. One takes up to 3 kB of memory in a conversion.
MAX_CONNECTIONS = 65_000


class Wanted(NamedTuple):
    """What is wanted of a recording.

    Attributes
    ----------
    connections
        Only messages of these; None means all. Parts of the file without any are not listed.
    start_ns, stop_ns
        Only messages with ``start_ns <= log_time_ns < stop_ns``.
    rule
        Which chunks may be loaded as a whole; None means none.
    """

    connections: Collection[Connection] | None = None
    start_ns: int | None = None
    stop_ns: int | None = None
    rule: ChunkRule | None = None


class Reader(ABC):
    """Reads an open recording, chunk by chunk.

    Attributes
    ----------
    path
        The recording.
    connections
        All connections, in the container's order.
    summary
        The summary, made without reading messages.
    has_chunks
        Whether messages of several topics are stored together, so that reading one topic reads others, too.
    """

    path: Path
    connections: Sequence[Connection]
    summary: Summary
    has_chunks: bool = False
    _log: DamageLog
    _temporary: TemporaryDirectory[str] | None = None

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage in the parts that were read."""
        return self._log.found

    @property
    def remarks(self) -> Sequence[str]:
        """What was noticed about the recording and the messages that were read, for users."""
        return ()

    @abstractmethod
    def chunks(self, wanted: Wanted) -> Iterable[Chunk]:
        """Return the chunks of the recording that have what is wanted, by start."""

    @abstractmethod
    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count messages without reading them, as far as the index allows.

        Parameters
        ----------
        connections
            Only messages of these.
        start_ns, stop_ns
            Only messages with ``start_ns <= log_time_ns < stop_ns``.

        Returns
        -------
        dict[int, int]
            By connection id. A missing connection can only be counted by reading its messages.
        """

    def stored_bytes(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> int:
        """Return about how many bytes of the file are read for these messages, for progress; see `chunks`."""
        if self.has_chunks:
            return sum(chunk.stored for chunk in self.chunks(Wanted(connections, start_ns, stop_ns)))
        # To list the rows of a database is to read them.
        messages = sum(self.counts(connections, start_ns, stop_ns).values())
        return self.summary.size_bytes * messages // max(1, self.summary.message_count or 0)

    def close(self) -> None:
        """Release the files. Messages that were handed out stay valid."""
        if self._temporary is not None:
            self._temporary.cleanup()

    def stand_for(self, path: Path, copy: TemporaryDirectory[str], damage: DamageLog) -> None:
        """Read a file that is compressed as a whole, from its copy in a folder that `close` removes.

        ``damage`` has what of it could not be decompressed.
        """
        self.path, self._temporary = path, copy
        self._log.stand_for(path, damage)
        self.summary = self.summary._replace(
            compression=tuple(sorted({"zstd", *self.summary.compression} - {"none"})), size_bytes=path.stat().st_size
        )

    def messages(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        threads: Threads | None = None,
        meter: Meter | None = None,
    ) -> Generator[RawMessage]:
        """Yield messages in the order of log time; those of one log time in the order of the file.

        Parameters
        ----------
        connections
            Only messages of these; None means all.
        start_ns, stop_ns
            Only messages with ``start_ns <= log_time_ns < stop_ns``.
        threads, meter
            See `pc2scan.bags.loading.merge_by_time`.

        Yields
        ------
        RawMessage
            ``data`` may be a view into a decompressed chunk, which it keeps in memory.

        Raises
        ------
        RecordingError
            If the file cannot be read.
        DamageError
            If the file is damaged, and damage is an error.
        """
        chunks = self.chunks(Wanted(connections, start_ns, stop_ns))
        return cast("Generator[RawMessage]", merge_by_time(chunks, threads=threads, path=self.path, meter=meter))

    def attachments(self) -> Iterator[Attachment]:
        """Yield MCAP attachments; other containers have none."""
        return iter(())

    def metadata(self) -> Iterator[Metadata]:
        """Yield MCAP metadata records; other containers have none."""
        return iter(())


class ConnectionLimit:
    """Counts the connections of a recording and their descriptions as they are found, and refuses too many.

    Everything that collects connections asks it: readers with or without an index, and readers of several files or
    parts.

    Parameters
    ----------
    path
        The recording.
    size
        Its bytes.
    """

    def __init__(self, path: Path, size: int = 0) -> None:
        self._path = path
        self._size = size
        self._count = self._bytes = 0

    def add(self, described: int = 0, *, count: int = 1, most: int | None = None) -> None:
        """Count connections that take so many bytes to describe, with their definitions.

        Raises
        ------
        RecordingError
            If there are more than ``most`` (`MAX_CONNECTIONS`), or their descriptions are larger than `allowed_bytes`.
        """
        self._count += count
        self._bytes += described
        most = MAX_CONNECTIONS if most is None else most
        if self._count > most:
            raise RecordingError(
                f"has more than {most:,} connections (one for each publisher of a topic), the largest number that is "
                "read",
                path=self._path,
            )
        if self._bytes > (allowed := allowed_bytes(self._size)):
            raise RecordingError(
                f"describes its connections in more than {allowed:,} bytes, the largest size for a recording of "
                f"{self._size:,} bytes",
                path=self._path,
            )

    def add_file(self, connections: Sequence[Connection], size: int) -> None:
        """Count the connections of a file of ``size`` bytes among those of several.

        Those that files share count in each, because each reader keeps its own; so files of any size may repeat them, a
        kilobyte for each. Definitions that connections share count once.
        """
        self._size += size
        definitions = {id(own.definition.data): own.definition.data for own in connections}
        described = sum(map(len, definitions.values())) + sum(len(own.qos) for own in connections)
        self.add(described, count=len(connections), most=MAX_CONNECTIONS + self._size // 1000)
