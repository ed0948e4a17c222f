"""Undoes or completes what a killed run left: unfinished outputs, and old ones that it had set aside.

Numbered files get their names one by one. So before the first gets its name, a journal lists the new files and those
that are set aside. The first file appears last: if it is in place, all are, and the old ones are removed; otherwise the
new ones are removed, and the old ones get their names again. Nothing is touched that the journal does not name.
"""

from __future__ import annotations

import json
import os
import stat
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import OutputError

from .places import JOURNAL, OLD, PARTIAL, parts_among
from .records import FileState, Record, is_unchanged
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

    new: Mapping[str, FileState]
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
            new = {str(name): FileState(int(size), int(time)) for name, (size, time) in noted["new"].items()}
            return cls(new, tuple(map(str, noted["aside"])))
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            return None


def remove_old_parts(dst: Path) -> None:
    """Remove the old files that the journal of numbered files names."""
    journal = _read_journal(dst)
    for name in () if journal is None else journal.aside:
        remove(dst.with_name(name + OLD))


def restore_old_parts(dst: Path) -> None:
    """Remove the new numbered files that have their names, and give the old ones theirs again, by the journal."""
    journal = _read_journal(dst)
    if journal is None:
        return
    partial = dst.with_name(dst.name + PARTIAL)
    for name, left in journal.new.items():
        path = dst.with_name(name)
        # A file that is also in the directory is the new one only if the run died between link and unlink.
        if is_unchanged(path, left) and (not (partial / name).exists() or path.samefile(partial / name)):
            path.unlink()
    for name in journal.aside:
        path, old = dst.with_name(name), dst.with_name(name + OLD)
        if os.path.lexists(old) and not os.path.lexists(path):
            old.rename(path)


def _read_journal(dst: Path) -> Journal | None:
    """Return the journal of a destination; None if there is none, or if it names anything but parts of it."""
    journal = Journal.read(dst.with_name(dst.name + PARTIAL))
    if journal is None:
        return None
    names = {*journal.new, *journal.aside}
    return journal if journal.new and len(parts_among(names, dst.name)) == len(names) else None


def completed_parts(dst: Path) -> Record | None:
    """Return the record of numbered files that all have their names; None if no journal says so."""
    journal = _read_journal(dst)
    if journal is None:
        return None
    # The first one has its name if it is not in the directory any more, or in both after a link and before an unlink.
    first = next(iter(journal.new))
    path, unfinished = dst.with_name(first), dst.with_name(dst.name + PARTIAL) / first
    is_placed = not os.path.lexists(unfinished) or (path.exists() and path.samefile(unfinished))
    return Record(dict(journal.new), JOURNAL) if is_placed else None


def recover(dst: Path, *, keep_journal: bool = False) -> Record | None:
    """Undo or complete what a run left that died while it wrote a destination; the caller holds the destination's lock.

    Parameters
    ----------
    dst
        The destination.
    keep_journal
        Whether the journal of numbered files that are all in place stays.

    Returns
    -------
    Record or None
        The numbered files that the run had completed.

    Raises
    ------
    OutputError
        If something cannot be removed or renamed.
    """
    try:
        done = _recover_parts(dst)
        if done is None or not keep_journal:
            remove(dst.with_name(dst.name + PARTIAL))
        _recover_one(dst)
    except OSError as err:
        raise OutputError(f"the files of an interrupted run cannot be removed: {err.strerror}", path=dst) from err
    return done


def _recover_parts(dst: Path) -> Record | None:
    """Undo or complete the replacement of numbered files; return the new ones if they are complete."""
    if not os.path.lexists(dst.with_name(dst.name + PARTIAL) / JOURNAL):
        return None
    done = completed_parts(dst)
    if done is not None:
        remove_old_parts(dst)
    else:
        restore_old_parts(dst)
    return done


def _recover_one(dst: Path) -> None:
    """Undo or complete the replacement of a file or a directory, if a run died between the two steps."""
    aside = dst.with_name(dst.name + OLD)
    if os.path.lexists(dst):
        # The new output is in place; only the old one was still to be removed.
        remove(aside)
    elif os.path.lexists(aside):
        aside.rename(dst)
