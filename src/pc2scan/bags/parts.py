"""Recordings that follow each other in one file, as ``cat a.bag b.bag`` makes them: they are read as one.

Each has ids and places of its own, so that each has a reader of its own, to which its part looks like the whole file.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

from pc2scan.errors import DamageError, RecordingError

from .damage import RECOVER, DamageLog
from .merged import MergedReader
from .reader import Reader

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pc2scan.files.source import SourceFile

    from .damage import Damage

__all__ = ["AnotherBeginsError", "PartReader", "note_next", "opened_parts"]

#: Each part takes a file descriptor.
MAX_PARTS = 64


class AnotherBeginsError(Exception):
    """Another recording begins at this place of the file; it never leaves the readers."""

    def __init__(self, offset: int) -> None:
        super().__init__(offset)
        self.offset = offset


class PartReader(Reader):
    """A reader of one part."""

    @property
    @abstractmethod
    def next_start(self) -> int | None:
        """Where in the file another recording begins, behind this one; None if none does."""


def note_next(file: SourceFile, log: DamageLog) -> None:
    """Take note of the recording that begins where this part of the file ends, if one does."""
    if file.next_start is not None:
        log.note(
            DamageError(
                f"another recording begins at byte {file.next_start}, behind the end of the one in front of it",
                path=file.path,
                hint=RECOVER,
            ),
            offset=file.size,
            key="next",
            messages_lost=0,
        )


def opened_parts(open_part: Callable[[int], PartReader]) -> Reader:
    """Open the recordings of a file, given how to open the one that begins at a place.

    Raises
    ------
    RecordingError
        If the first one cannot be read.
    """
    first = open_part(0)
    log = DamageLog()
    parts = [first]
    try:
        while (start := parts[-1].next_start) is not None:
            if len(parts) == MAX_PARTS:
                error = f"more than {MAX_PARTS} recordings follow each other, those from byte {start} on are skipped"
                log.note(DamageError(error, path=first.path), offset=start)
                break
            try:
                parts.append(open_part(start))
            except RecordingError as err:
                log.note(DamageError(err.message, path=first.path), offset=start)
                break
    except BaseException:
        for part in parts:
            part.close()
        raise
    return first if len(parts) == 1 and not log.found else _PartsReader(parts, log)


class _PartsReader(MergedReader):
    """All recordings of a file as one."""

    def __init__(self, readers: Sequence[Reader], log: DamageLog) -> None:
        super().__init__(readers)
        self._log = log

    @staticmethod
    def _refuse(readers: Sequence[Reader]) -> None:
        """Accept readers of one file, and of both ROS versions."""

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What is damaged in the parts, and between them."""
        return (*super().damage, *self._log.found)
