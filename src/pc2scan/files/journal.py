"""The journal of a run that renames numbered files: by it the next run undoes or completes what a killed one left.

Numbered files get their names one by one. So before the first gets its name, the journal lists the new files and those
that are set aside. The first file appears last: if it is in place, all are, and the old ones are removed; otherwise the
new ones are removed, and the old ones get their names again. Nothing is touched that the journal does not name.
"""

from __future__ import annotations

import json
import os
import stat
from typing import TYPE_CHECKING, NamedTuple

from .numbered import parts_among
from .places import JOURNAL, OLD, PARTIAL
from .records import Left, Record, is_as_left
from .system import remove

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


class Journal(NamedTuple):
    """The files that a run is about to rename, and those that it replaces.

    Attributes
    ----------
    new
        The new files by name, as they were written; the first one of the recording first.
    aside
        The names of old files that are set aside, and removed at the end.
    """

    new: Mapping[str, Left]
    aside: tuple[str, ...]

    def as_json(self) -> str:
        """Return it as text."""
        return json.dumps({"new": {name: list(left[:2]) for name, left in self.new.items()}, "aside": self.aside})

    @classmethod
    def read(cls, partial: Path) -> Journal | None:
        """Return the journal in a temporary directory; None if there is no complete one."""
        try:
            if not stat.S_ISDIR(partial.lstat().st_mode) or not stat.S_ISREG((partial / JOURNAL).lstat().st_mode):
                return None
            noted = json.loads((partial / JOURNAL).read_bytes())
            new = {str(name): Left(int(size), int(time)) for name, (size, time) in noted["new"].items()}
            return cls(new, tuple(map(str, noted["aside"])))
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            return None


def complete(dst: Path) -> None:
    """Remove the old files that the journal of numbered files names."""
    journal = _journal_of(dst)
    for name in () if journal is None else journal.aside:
        remove(dst.with_name(name + OLD))


def undo(dst: Path) -> None:
    """Remove the new numbered files that have their names, and give the old ones theirs again, by the journal."""
    journal = _journal_of(dst)
    if journal is None:
        return
    partial = dst.with_name(dst.name + PARTIAL)
    for name, left in journal.new.items():
        path = dst.with_name(name)
        # A file that is also in the directory is the new one only if the run died between link and unlink.
        if is_as_left(path, left) and (not (partial / name).exists() or path.samefile(partial / name)):
            path.unlink()
    for name in journal.aside:
        path, old = dst.with_name(name), dst.with_name(name + OLD)
        if os.path.lexists(old) and not os.path.lexists(path):
            old.rename(path)


def _journal_of(dst: Path) -> Journal | None:
    """Return the journal of a destination; None if there is none, or if it names anything but parts of it."""
    journal = Journal.read(dst.with_name(dst.name + PARTIAL))
    if journal is None:
        return None
    names = {*journal.new, *journal.aside}
    return journal if journal.new and len(parts_among(names, dst.name)) == len(names) else None


def finished(dst: Path) -> Record | None:
    """Return the record of numbered files that all have their names; None if no journal says so."""
    journal = _journal_of(dst)
    if journal is None:
        return None
    # The first one has its name if it is not in the directory any more, or in both after a link and before an unlink.
    first = next(iter(journal.new))
    path, unfinished = dst.with_name(first), dst.with_name(dst.name + PARTIAL) / first
    is_placed = not os.path.lexists(unfinished) or (path.exists() and path.samefile(unfinished))
    return Record(dict(journal.new), JOURNAL) if is_placed else None
