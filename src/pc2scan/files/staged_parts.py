"""Writes the parts of a recording in a temporary directory and renames them together: all appear, or none."""

from __future__ import annotations

import re
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pc2scan.errors import OutputError

from .places import OLD, check_length, check_place
from .staging import check_existing, cleaning_up, exists_already, note_renaming, prepared, remove, rename_file, sync
from .system import sync_directory

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

__all__ = ["check_parts", "parts_beside", "staged_parts"]


def parts_beside(dst: Path) -> list[Path]:
    """Return the files beside a destination that are named as parts of it: ``drive_0.bag`` of ``drive.bag``."""
    return sorted(_parts_named(dst))


def check_parts(dst: Path, *, overwrite: bool) -> None:
    """Raise what `staged_parts` would raise at its beginning, as far as that is known without writing anything.

    Raises
    ------
    DestinationError, OutputError
        See `staged_parts`.
    """
    check_place(dst)
    check_length(dst.with_name(f"{dst.stem}_00000{dst.suffix}"))
    for part in parts_beside(dst):
        check_existing(part, overwrite=overwrite, beside_recording=None)


@contextmanager
def staged_parts(dst: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a new directory to write the parts of a recording in, and move them to the destination's folder at the end.

    All of them appear, or none. The first one in the order of their numbers appears last: if it exists, all do.

    Parameters
    ----------
    dst
        The name from which those of the parts are made: ``drive_0.bag`` and so on from ``drive.bag``.
    overwrite
        Whether existing parts of that name may be replaced: all of them, also if the new ones are fewer.

    Yields
    ------
    Path
        ``<dst>.pc2scan-partial``. If the body raises, it is removed.

    Raises
    ------
    DestinationError
        If there are parts of that name and ``overwrite`` is false, or one of them is no file.
    OutputError
        If the parts cannot be written.
    """

    def check() -> bool:
        with cleaning_up(dst):
            _restore_parts(dst)
        check_parts(dst, overwrite=overwrite)
        return overwrite

    with prepared(dst, check) as (partial, _):
        try:
            partial.mkdir()
        except OSError as err:
            raise OutputError(f"cannot be written: {err.strerror}", path=dst) from err
        yield partial
        try:
            _commit_parts(partial, dst, overwrite=overwrite)
        except OSError as err:
            raise OutputError(f"its parts cannot be renamed to their final names: {err.strerror}", path=dst) from err


def _commit_parts(partial: Path, dst: Path, *, overwrite: bool) -> None:
    """Move the parts to their places, the first one last; if that fails, restore the old ones."""
    sync(partial)
    old = parts_beside(dst)
    if old and not overwrite:
        raise exists_already(old[0])
    aside, placed = [], []
    try:
        # Old and new parts are both moved with the first one last: what a killed run leaves shows how far it came.
        for path in reversed(_sorted_by_number(old)):
            path.rename(path.with_name(path.name + OLD))
            aside.append(path)
        for part in reversed(_sorted_by_number(partial.iterdir())):
            final = dst.with_name(part.name)
            note_renaming(part, final)
            rename_file(part, final)
            placed.append(final)
        sync_directory(dst.parent)
    except BaseException:
        for path in placed:
            path.unlink()
        for path in reversed(aside):
            path.with_name(path.name + OLD).rename(path)
        raise
    for path in aside:
        remove(path.with_name(path.name + OLD))


def _restore_parts(dst: Path) -> None:
    """Undo or complete the replacement of parts, if a run died in the middle of it."""
    aside = _sorted_by_number(_parts_named(dst, OLD))
    if not aside:
        return
    places = [path.with_name(path.name.removesuffix(OLD)) for path in aside]
    present = _sorted_by_number(parts_beside(dst))
    if present and present[0] == places[0]:
        # The first new part appears last, so all new ones are in place.
        for path in aside:
            remove(path)
        return
    if not present or _part_number(places[0]) < _part_number(present[0]):
        # All old parts are set aside, so those in place were written by the run that died.
        for path in present:
            remove(path)
    for path, place in zip(aside, places, strict=True):
        path.rename(place)


def _parts_named(dst: Path, ending: str = "") -> list[Path]:
    named = re.compile(rf"{re.escape(dst.stem)}_\d+{re.escape(dst.suffix)}{re.escape(ending)}")
    try:
        return [entry for entry in dst.parent.iterdir() if named.fullmatch(entry.name)]
    except OSError:
        return []


def _sorted_by_number(parts: Iterable[Path]) -> list[Path]:
    """Return parts in the order of their numbers."""
    return sorted(parts, key=_part_number)


def _part_number(part: Path) -> int:
    return int(re.findall(r"_(\d+)", part.name)[-1])
