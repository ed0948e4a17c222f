"""Folders for temporary copies, and the errors if there is not enough space."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from tempfile import TemporaryDirectory

_HINT = "free space there, or set the environment variable TMPDIR to another folder"


def private_folder(path: Path) -> TemporaryDirectory[str]:
    """Make a folder for a copy of ``path`` that only this user can enter; ``cleanup`` removes it.

    Raises
    ------
    RecordingError
        If the system has no folder for temporary files.
    """
    import tempfile  # noqa: PLC0415  (it loads the compression modules)

    try:
        return tempfile.TemporaryDirectory(prefix="pc2scan-")
    except OSError as err:
        raise _no_copy(err, path, None) from err


@contextmanager
def copy_errors(path: Path, folder: Path) -> Iterator[None]:
    """Wrap errors of copying ``path`` to a private folder; they name the folder.

    Raises
    ------
    RecordingError
        If the body cannot read or write.
    """
    try:
        yield
    except OSError as err:
        raise _no_copy(err, path, folder.parent) from err


def _no_copy(err: OSError, path: Path, folder: Path | None) -> RecordingError:
    place = "" if folder is None else f" in {folder}"
    return RecordingError(f"cannot be copied to a temporary file{place}: {err.strerror}", path=path, hint=_HINT)


def sqlite_is_full(path: Path) -> RecordingError:
    """Return the error for SQLite's own temporary files, whose folder is not Python's."""
    named = (os.environ.get("SQLITE_TMPDIR"), os.environ.get("TMPDIR"), "/var/tmp", "/usr/tmp", "/tmp")  # noqa: S108
    usable = (place for place in named if place and Path(place).is_dir() and os.access(place, os.W_OK | os.X_OK))
    place = next(usable, ".")
    return RecordingError(f"cannot be sorted: SQLite's temporary files do not fit in {place}", path=path, hint=_HINT)
