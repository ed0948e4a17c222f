"""Where a destination and temporary copies can be written, the names of the files beside it, and similar names.

A run has temporary files while it writes.
"""

from __future__ import annotations

import os
import tempfile
from contextlib import contextmanager, suppress
from shlex import quote
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError, RecordingError
from pc2scan.text import nearest

from . import system
from .urls import UrlPath, is_dir

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from tempfile import TemporaryDirectory

PARTIAL = ".pc2scan-partial"
OLD = ".pc2scan-old"
LOCK = f"{PARTIAL}.lock"

#: Endings of the files that a killed run leaves beside its destination.
LEFTOVERS = (PARTIAL, OLD)


def working_names(dst: Path) -> tuple[Path, ...]:
    """Return the paths beside a destination that a run creates, renames and removes while it writes it.

    No input may have one of them: see `pc2scan.files.ownership`.
    """
    return tuple(dst.with_name(dst.name + ending) for ending in (PARTIAL, OLD, LOCK)) if dst.name else ()


def check_place(dst: Path) -> None:
    """Raise if no file with this name can be written."""
    if str(dst) == "-":
        raise DestinationError("it is not written to standard output", hint="choose a name: `-` would be a file's name")
    if isinstance(dst, UrlPath):
        if dst.is_read_only:
            hint = f"give a destination: `destination={dst.name}`"
            raise DestinationError(f"{dst.scheme}:// can only be read", path=dst, hint=hint)
        return
    if dst.name in {"", ".."}:
        raise DestinationError("is not a name that a recording can have", path=dst)
    parent = dst.parent
    if not os.path.lexists(parent):
        hint = f"create it: mkdir -p {quote(str(parent))}"
        raise DestinationError("its directory does not exist", path=dst, hint=hint)
    if not is_dir(parent):
        raise DestinationError(f"{parent} is not a directory", path=dst)
    # Links there are not replaced either: /dev/stdout is one.
    place = os.path.realpath(parent)
    if place == "/dev" or place.startswith(("/proc/", "/sys/")):
        raise DestinationError(f"{parent} holds devices, not files", path=dst, hint="give a path in another directory")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(
            "its directory is not writable", path=dst, hint="write to another one, or change its permissions"
        )


@contextmanager
def output_folder(folder: Path) -> Iterator[None]:
    """Make a folder to write into, if it does not exist; it is removed again if the body fails and leaves it empty.

    Raises
    ------
    DestinationError
        If it is not a folder, or the folder above it does not exist.
    OutputError
        If it cannot be made.
    """
    # In a store, folders are only a part of names.
    if isinstance(folder, UrlPath) or folder.is_dir():
        yield
        return
    check_new_folder(folder)
    try:
        folder.mkdir()
    except OSError as err:
        raise OutputError(f"cannot be made: {err.strerror}", path=folder) from err
    try:
        yield
    except BaseException:
        with suppress(OSError):
            folder.rmdir()
        raise


def check_new_folder(folder: Path) -> None:
    """Raise if no folder of this name can be made."""
    if os.path.lexists(folder):
        raise DestinationError("is not a folder", path=folder, hint="choose another name")
    check_place(folder)


# --- Temporary copies ---

TEMPORARY_HINT = "free space there, or set the environment variable TMPDIR to another folder"


def private_folder(path: Path) -> TemporaryDirectory[str]:
    """Make a folder for a copy of ``path`` that only this user can enter; ``cleanup`` removes it.

    Raises
    ------
    RecordingError
        If the system has no folder for temporary files.
    """
    with copy_errors(path):
        return tempfile.TemporaryDirectory(prefix="pc2scan-", dir=system.scratch.get())


@contextmanager
def copy_errors(path: Path, folder: Path | None = None) -> Iterator[None]:
    """Wrap errors of copying ``path`` to a private folder; they name the folder.

    Raises
    ------
    RecordingError
        If the body cannot read or write.
    """
    try:
        yield
    except OSError as err:
        place = "" if folder is None else f" in {folder.parent}"
        message = f"cannot be copied to a temporary file{place}: {err.strerror}"
        raise RecordingError(message, path=path, hint=TEMPORARY_HINT) from err


# --- Paths that do not exist ---


def missing_hint(path: Path) -> str | None:
    """Return a hint for a path that does not exist: the target of a broken link, or a similar name; else None."""
    if str(path) == "-":
        return "recordings cannot be read from a pipe; save it as a file first"
    # Not Path.is_symlink: the name may be too long.
    if os.path.islink(path):  # noqa: PTH114
        return f"it is a link to {path.readlink()}, which does not exist"
    try:
        names = sorted(name for name in os.listdir(path.parent) if not name.startswith("."))  # noqa: PTH208  # faster
    except OSError:
        return None
    # The name without its suffix, or the partial file of an interrupted run.
    similar = next((name for name in names if name.startswith(f"{path.name}.")), None) or nearest(path.name, names)
    return None if similar is None else f"did you mean {path.parent / similar}?"
