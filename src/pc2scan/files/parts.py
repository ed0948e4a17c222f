"""Writes the parts of a recording in a temporary directory and renames them together: all appear, or none."""

from __future__ import annotations

import os
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError, name_list

from .ownership import check_existing, existing_error, ruling
from .places import JOURNAL, OLD, PARTIAL, check_length, check_place, part_number, parts_beside
from .records import Record, file_state, is_unchanged
from .recovery import Journal, restore_old_parts
from .staging import note_renaming, only_run, recover_output, rename_file, sync
from .system import remove, sync_directory
from .urls import UrlPath

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path


def check_parts(dst: Path, *, overwrite: bool, owned: Record | None = None) -> None:
    """Raise what `staged_parts` would raise at its beginning, as far as that is known without writing anything.

    Raises
    ------
    DestinationError, OutputError
        See `staged_parts`.
    """
    check_place(dst)
    if not isinstance(dst, UrlPath):
        check_length(dst.with_name(f"{dst.stem}_00000{dst.suffix}"))
    names = {} if owned is None else owned.files
    for part in parts_beside(dst):
        # Beside files of earlier runs there may be others, which this run may not write: only its end shows that.
        if overwrite or not names or part.name in names:
            check_existing(part, overwrite=overwrite, owned=owned)


def unrecorded_warning(name: str, kept: Sequence[str]) -> list[str]:
    """Return the warning about files with names of parts of the recording ``name`` that are none of its parts."""
    if not kept:
        return []
    text = (
        f"{name_list(kept, 5)}: named like a part of {name}, but no record says that pc2scan wrote it; it stays, and "
        "programs may read it as a part: remove or rename what you do not need"
    )
    return [text]


@contextmanager
def staged_parts(
    dst: Path, *, overwrite: bool, owned: Record | None = None, warn: Callable[[str], None]
) -> Iterator[Path]:
    """Yield a new directory to write the parts of a recording in, and move them to the destination's folder at the end.

    All of them appear, or none. The first one in the order of their numbers appears last: if it exists, all do.

    Parameters
    ----------
    dst
        The name from which those of the parts are made: ``drive_0.bag`` and so on from ``drive.bag``.
    overwrite
        Whether existing files that the new parts have the names of may be replaced.
    owned
        What earlier runs wrote into the folder: it may be replaced without ``overwrite``, and is removed if the new
        parts are fewer. If it is given, a journal of the new parts stays until the caller has recorded them: see
        `pc2scan.files.staging.clean_up`.
    warn
        Called with a warning about other files that have names of parts. They stay.

    Yields
    ------
    Path
        ``<dst>.pc2scan-partial``. If the body raises, it is removed.

    Raises
    ------
    DestinationError
        If there are files with names of parts that may not be replaced.
    OutputError
        If the parts cannot be written.
    """
    if isinstance(dst, UrlPath):
        from .transfers import upload  # noqa: PLC0415  # loads fsspec

        check_parts(dst, overwrite=overwrite, owned=owned)
        with upload(dst, overwrite=overwrite, owned=owned, is_numbered=True) as (partial, commit):
            partial.mkdir()
            yield partial
            kept = commit()
        for text in unrecorded_warning(dst.name, kept):
            warn(text)
        return
    check_place(dst)
    partial = dst.with_name(dst.name + PARTIAL)
    with only_run(dst):
        earlier = recover_output(dst)
        known = None if owned is None else owned | earlier
        check_parts(dst, overwrite=overwrite, owned=known)
        journal_stays = False
        try:
            try:
                partial.mkdir()
            except OSError as err:
                raise OutputError(f"cannot be written: {err.strerror}", path=dst) from err
            yield partial
            try:
                kept = _commit(partial, dst, known, overwrite=overwrite)
            except OSError as err:
                message = f"its parts cannot be renamed to their final names: {err.strerror}"
                raise OutputError(message, path=dst) from err
            journal_stays = owned is not None
            for text in unrecorded_warning(dst.name, kept):
                warn(text)
        finally:
            if not journal_stays:
                with suppress(OSError):
                    remove(partial)


def _commit(partial: Path, dst: Path, owned: Record | None, *, overwrite: bool) -> list[str]:
    """Move the parts to their places, the first one last; if that fails, restore the old ones. Return what stays."""
    sync(partial)
    new = sorted((entry.name for entry in partial.iterdir()), key=part_number)
    found = ruling(
        [path.name for path in parts_beside(dst)],
        new,
        owned,
        overwrite=overwrite,
        is_unchanged=lambda name, left: is_unchanged(dst.with_name(name), left),
    )
    if found.refused:
        raise existing_error(dst.with_name(found.refused[0]))
    for name in found.replaced:
        check_existing(dst.with_name(name), overwrite=True)
    aside = sorted((*found.replaced, *found.removed), key=part_number)
    for name in aside:
        if os.path.lexists(dst.with_name(name + OLD)):
            raise DestinationError(
                f"{name} cannot be set aside: this name is needed for it",
                path=dst.with_name(name + OLD),
                hint="an interrupted run may have left it; move it away",
            )
    _note(partial, Journal({name: file_state(partial / name) for name in new}, tuple(aside)))
    try:
        # Old and new parts are both moved with the first one last: what a killed run leaves shows how far it came.
        for name in reversed(aside):
            dst.with_name(name).rename(dst.with_name(name + OLD))
        for name in reversed(new):
            note_renaming(partial / name, dst.with_name(name))
            rename_file(partial / name, dst.with_name(name))
        sync_directory(dst.parent)
    except BaseException:
        restore_old_parts(dst)
        raise
    for name in aside:
        remove(dst.with_name(name + OLD))
    return found.kept


def _note(partial: Path, journal: Journal) -> None:
    """Write the journal, and wait until it is on the disk."""
    (partial / JOURNAL).write_text(journal.as_json(), encoding="utf-8")
    sync(partial)
