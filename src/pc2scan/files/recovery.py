"""Undoes or completes what a killed run left: unfinished outputs, and old ones that it had set aside."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from pc2scan.errors import OutputError

from .places import JOURNAL, OLD, PARTIAL
from .system import remove

if TYPE_CHECKING:
    from pathlib import Path

    from .records import Record


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
    from . import journal  # noqa: PLC0415  # most recordings are one file

    done = journal.finished(dst)
    if done is not None:
        journal.complete(dst)
    else:
        journal.undo(dst)
    return done


def _recover_one(dst: Path) -> None:
    """Undo or complete the replacement of a file or a directory, if a run died between the two steps."""
    aside = dst.with_name(dst.name + OLD)
    if os.path.lexists(dst):
        # The new output is in place; only the old one was still to be removed.
        remove(aside)
    elif os.path.lexists(aside):
        aside.rename(dst)
