"""An open recording."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, cast

from .units import in_time_order

if TYPE_CHECKING:
    from collections.abc import Collection, Generator, Iterable, Iterator, Sequence
    from pathlib import Path

    from pc2scan.model import Attachment, ChunkRule, Connection, Metadata, RawMessage, Summary

    from .damage import Damage
    from .units import Unit

__all__ = ["Reader"]


class Reader(ABC):
    """An open recording, read unit by unit."""

    @property
    @abstractmethod
    def path(self) -> Path:
        """Where it was opened."""

    @property
    @abstractmethod
    def connections(self) -> Sequence[Connection]:
        """Every connection, in the container's order."""

    @property
    @abstractmethod
    def summary(self) -> Summary:
        """What is known without reading messages."""

    @property
    @abstractmethod
    def bytes_read(self) -> int:
        """Bytes of ``summary.size_bytes`` consumed so far, for progress."""

    @property
    @abstractmethod
    def damage(self) -> Sequence[Damage]:
        """What is damaged and was read around, as far as the recording was read."""

    @abstractmethod
    def units(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> Iterable[Unit]:
        """What can be loaded, by start; their messages in the order of log time are those of the recording.

        Parameters
        ----------
        connections
            Only messages of these; None means all. Stretches of the file without any are not listed.
        start_ns, stop_ns
            Only messages with ``start_ns <= log_time_ns < stop_ns``.
        rule
            Which chunks may be loaded as a whole; None means none.
        """

    @abstractmethod
    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count messages without reading them, as far as an index allows it.

        Parameters
        ----------
        connections
            Only messages of these.
        start_ns, stop_ns
            Only messages with ``start_ns <= log_time_ns < stop_ns``.

        Returns
        -------
        dict[int, int]
            By connection id. A connection that is missing can only be counted by reading its messages.
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
        """Messages in the order of log time; those of one log time in the order of the file.

        Parameters
        ----------
        connections
            Only messages of these; None means all.
        start_ns, stop_ns
            Only messages with ``start_ns <= log_time_ns < stop_ns``.

        Yields
        ------
        RawMessage
            ``data`` may be a view into a decompressed chunk, and keeps it alive.

        Raises
        ------
        RecordingError
            If the system refuses to read.
        DamageError
            If what is read is damaged, and damage is an error.
        """
        units = self.units(connections, start_ns, stop_ns)
        return cast("Generator[RawMessage]", in_time_order(units, path=self.path))

    def attachments(self) -> Iterator[Attachment]:
        """MCAP attachments; none in other containers."""
        return iter(())

    def metadata(self) -> Iterator[Metadata]:
        """MCAP metadata records; none in other containers."""
        return iter(())
