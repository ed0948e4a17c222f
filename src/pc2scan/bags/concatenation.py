"""Finds recordings that follow each other in one file, as ``cat a.bag b.bag`` makes them.

Each has its own ids and offsets, and therefore its own reader, which treats its part as a whole file.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

from pc2scan.errors import DamageError, RecordingError
from pc2scan.files.limits import ConnectionLimit

from .damage import RECOVER, DamageLog
from .reader import Reader

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.files.source import SourceFile

#: Each part takes a file descriptor.
MAX_PARTS = 64


class NextRecordingError(Exception):
    """Another recording begins at this offset of the file; readers raise and catch it."""

    def __init__(self, offset: int) -> None:
        super().__init__(offset)
        self.offset = offset


class PartReader(Reader):
    """A reader of one part."""

    @property
    @abstractmethod
    def next_start(self) -> int | None:
        """Offset of the recording that follows this one in the file; None if none does."""


def note_next(file: SourceFile, log: DamageLog) -> None:
    """Note the recording that follows this part of the file, if there is one."""
    if file.next_start is not None:
        log.note(
            DamageError(
                f"another recording begins at byte {file.next_start}, after the end of the one before it",
                path=file.path,
                hint=RECOVER,
            ),
            offset=file.size,
            key="next",
            messages_lost=0,
        )


def open_parts(open_part: Callable[[int], PartReader]) -> Reader:
    """Open all recordings of a file; ``open_part`` opens the one that begins at an offset.

    Raises
    ------
    RecordingError
        If the first one cannot be read, or all of them have too many connections.
    """
    first = open_part(0)
    if first.next_start is None:
        return first
    log, limit = DamageLog(), ConnectionLimit(first.path)
    parts = [first]
    try:
        limit.add_file(first.connections, first.summary.size_bytes)
        while (start := parts[-1].next_start) is not None:
            if len(parts) == MAX_PARTS:
                error = f"more than {MAX_PARTS} recordings follow each other, those from byte {start} on are skipped"
                log.note(DamageError(error, path=first.path), offset=start)
                break
            try:
                part = open_part(start)
            except RecordingError as err:
                log.note(DamageError(err.message, path=first.path), offset=start)
                break
            parts.append(part)
            limit.add_file(part.connections, part.summary.size_bytes)
        from .merged import ConcatenatedReader  # noqa: PLC0415  # most files are one recording

        return ConcatenatedReader(parts, log)
    except BaseException:
        for part in parts:
            part.close()
        raise
