"""The operating system: reading at an offset, locks, folders, removing, the disk, temporary copies."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from threading import Lock
from typing import TYPE_CHECKING

from pc2scan.errors import RecordingError
from pc2scan.text import size

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from tempfile import TemporaryDirectory

#: Windows would translate line ends in files that are opened without it.
BINARY = getattr(os, "O_BINARY", 0)

#: Maximum number of bytes per call: Linux returns at most 2 GiB, and macOS refuses to return more.
_MOST_AT_ONCE = 1 << 30

#: The error numbers of a disk, or a quota, that has no room; and SQLite's text, the same in all of its versions.
_FULL = {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)}
_FULL_IN_SQLITE = "database or disk is full"

#: The folder for temporary copies; None: the system's.
scratch: ContextVar[Path | None] = ContextVar("scratch", default=None)


@contextmanager
def copying_to(folder: Path | None) -> Iterator[None]:
    """Use a folder for temporary copies in the body; None: the one that is used already."""
    before = scratch.set(folder or scratch.get())
    try:
        yield
    finally:
        scratch.reset(before)


_turn = Lock()


def read_at(descriptor: int, length: int, offset: int) -> bytes:
    """Read at most ``length`` bytes of an open file, on any thread."""
    length = min(length, _MOST_AT_ONCE)
    if hasattr(os, "pread"):
        return os.pread(descriptor, length, offset)
    # All threads share the descriptor's position.
    with _turn:
        os.lseek(descriptor, offset, os.SEEK_SET)
        return os.read(descriptor, length)


def lock_descriptor(descriptor: int) -> None:
    """Lock an open file; the system releases it when the process ends.

    Raises
    ------
    BlockingIOError
        If another process has locked it.
    OSError
        If the file system cannot lock files, as some network file systems.
    """
    with suppress(ImportError):
        import fcntl  # noqa: PLC0415  # not on Windows

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    with suppress(ImportError):
        import msvcrt  # noqa: PLC0415  # only there

        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        except PermissionError as err:
            raise BlockingIOError(err.errno, "is locked") from err


def sync_directory(path: Path) -> None:
    """Wait until a directory's entries are on the disk, if the system can do so."""
    if os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_full(err: BaseException | None) -> bool:
    """Whether an error, or what caused it, is that a disk or a quota has no room."""
    while err is not None:
        if (isinstance(err, OSError) and err.errno in _FULL) or str(err) == _FULL_IN_SQLITE:
            return True
        err = err.__cause__
    return False


def remove(path: Path) -> None:
    """Delete a file or a directory if it exists; a symbolic link, not its target."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif os.path.lexists(path):
        path.unlink()


def files_below(folder: Path, below: str = "") -> Iterator[str]:
    """Yield everything in a folder that is not a folder itself, and folders that are empty, as relative paths."""
    with os.scandir(folder) as entries:
        listed = list(entries)
    if not listed and below:
        yield below
    for entry in listed:
        name = f"{below}/{entry.name}" if below else entry.name
        if entry.is_dir(follow_symlinks=False):
            yield from files_below(folder / entry.name, name)
        else:
            yield name


# --- Temporary copies ---

TEMPORARY_HINT = "free space there, or set the environment variable TMPDIR to another folder"


def refuse_without_room(needed: int, path: Path | None, hint: str = TEMPORARY_HINT) -> None:
    """Raise if so many bytes have no room in the folder for temporary copies."""
    folder = scratch.get() or tempfile.gettempdir()
    # If there is no such folder, making the copy raises.
    with suppress(OSError):
        if needed > (free := shutil.disk_usage(folder).free):
            message = f"no space for temporary copies: they take {size(needed)}, and {folder} has room for {size(free)}"
            raise RecordingError(message, path=path, hint=hint)


def private_folder(path: Path) -> TemporaryDirectory[str]:
    """Make a folder for a copy of ``path`` that only this user can enter; ``cleanup`` removes it.

    Raises
    ------
    RecordingError
        If the system has no folder for temporary files.
    """
    with copy_errors(path):
        return tempfile.TemporaryDirectory(prefix="pc2scan-", dir=scratch.get())


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
