"""The base class of readers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, cast

from .units import merge_by_time

if TYPE_CHECKING:
    from collections.abc import Collection, Generator, Iterable, Iterator, Sequence
    from pathlib import Path

    from pc2scan.model import Attachment, ChunkRule, Connection, Metadata, RawMessage, Summary

    from .damage import Damage, DamageLog
    from .units import Unit


class Reader(ABC):
    """Reads an open recording, unit by unit.

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
    remarks
        What was noticed about the messages that were read, for users.
    """

    path: Path
    connections: Sequence[Connection]
    summary: Summary
    has_chunks: bool = False
    remarks: Sequence[str] = ()
    _log: DamageLog
    _bytes_read: int = 0

    @property
    def bytes_read(self) -> int:
        """Bytes of ``summary.size_bytes`` consumed so far, for progress."""
        return min(self._bytes_read, self.summary.size_bytes)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage in the parts that were read."""
        return self._log.found

    @abstractmethod
    def units(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> Iterable[Unit]:
        """Return the units of the recording, by start.

        Parameters
        ----------
        connections
            Only messages of these; None means all. Parts of the file without any are not listed.
        start_ns, stop_ns
            Only messages with ``start_ns <= log_time_ns < stop_ns``.
        rule
            Which chunks may be loaded as a whole; None means none.
        """

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

    @abstractmethod
    def close(self) -> None:
        """Release the files."""

    def messages(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Generator[RawMessage]:
        """Yield messages in the order of log time; those of one log time in the order of the file.

        Parameters
        ----------
        connections
            Only messages of these; None means all.
        start_ns, stop_ns
            Only messages with ``start_ns <= log_time_ns < stop_ns``.

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
        units = self.units(connections, start_ns, stop_ns)
        return cast("Generator[RawMessage]", merge_by_time(units, path=self.path))

    def attachments(self) -> Iterator[Attachment]:
        """Yield MCAP attachments; other containers have none."""
        return iter(())

    def metadata(self) -> Iterator[Metadata]:
        """Yield MCAP metadata records; other containers have none."""
        return iter(())
