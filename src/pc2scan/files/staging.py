"""A destination appears whole or not at all: written beside its place, then renamed into it."""

from __future__ import annotations

import os
import stat
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    #: Says what a directory has in it beside a recording; empty for nothing.
    _Beside = Callable[[Path], str]

__all__ = ["LEFTOVERS", "made_folder", "prepared", "staged", "sync_directory", "sync_file", "working_names"]

_PARTIAL = ".pc2scan-partial"
_OLD = ".pc2scan-old"
_LOCK = f"{_PARTIAL}.lock"

#: Endings of what a run that was killed leaves beside its destination.
LEFTOVERS = (_PARTIAL, _OLD)


def working_names(dst: Path) -> tuple[Path, ...]:
    """Return the paths beside a destination that a run creates, renames and removes while it writes it.

    What is read must have none of them: see `pc2scan.files.overlap`.
    """
    return tuple(dst.with_name(dst.name + ending) for ending in (_PARTIAL, _OLD, _LOCK)) if dst.name else ()


@contextmanager
def staged(dst: Path, *, overwrite: bool, beside_recording: _Beside | None = None) -> Iterator[Path]:
    """Give a path to write to, and make it the destination at the end.

    Parameters
    ----------
    dst
        The file or directory that is to appear. Neither it nor one of its `working_names` is something that is read.
    overwrite
        Whether a file, or a directory that holds a rosbag2 recording and nothing else, may be replaced if it is there.
        It stays untouched until the new one is complete.
    beside_recording
        Says what a directory has in it beside a recording, if anything. Without it no directory is replaced.

    Yields
    ------
    Path
        ``<dst>.pc2scan-partial``, where nothing is. The body creates a file or a directory there. If it
        raises anything, that is removed and the error goes on.

    Raises
    ------
    DestinationError
        If ``dst`` exists and ``overwrite`` is false (checked first, and again by the final step), cannot be replaced,
        has no parent directory, or is being written by another run.
    OutputError
        If its directory or the result cannot be written.
    """

    def check() -> bool:
        with _cleaning_up(dst):
            _restore(dst)
        _check_existing(dst, overwrite=overwrite, beside_recording=beside_recording)
        return overwrite

    with prepared(dst, check, beside_recording) as (partial, commit):
        yield partial
        commit()


@contextmanager
def prepared(
    dst: Path, check: Callable[[], bool], beside_recording: _Beside | None = None
) -> Iterator[tuple[Path, Callable[[], None]]]:
    """Give a path to write to, and a function that makes it the destination.

    Parameters
    ----------
    dst
        See `staged`.
    check
        Raises if ``dst`` may not be written, and returns whether what is there may be replaced. Called once, at the
        beginning; what appears later is replaced only if it returned true.
    beside_recording
        See `staged`.

    Yields
    ------
    path, function
        Where nothing is; and what to call once it is complete. Without that call it is removed.

    Raises
    ------
    DestinationError, OutputError
        See `staged`.
    """
    _check_parent(dst)
    partial = dst.with_name(dst.name + _PARTIAL)
    with _only_run(dst):
        # What is here now was left by a run that died: a living one holds the lock.
        with _cleaning_up(dst):
            _remove(partial)
        overwrite = check()
        try:
            yield partial, lambda: _commit(partial, dst, overwrite=overwrite, beside_recording=beside_recording)
        finally:
            with suppress(OSError):
                _remove(partial)


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder to write into, if it does not exist; it disappears again if the body fails and leaves it empty.

    Raises
    ------
    DestinationError
        If it is something else, or the folder that it is to be in does not exist.
    OutputError
        If it cannot be made.
    """
    if folder.is_dir():
        yield
        return
    if os.path.lexists(folder):
        raise DestinationError("is not a folder", path=folder, hint="choose another name")
    _check_parent(folder)
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


def sync_file(path: Path) -> None:
    """Wait until a file's content is on the disk."""
    # Not read-only: Windows flushes only what it may write.
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def sync_directory(path: Path) -> None:
    """Wait until a directory's entries are on the disk, where the system can do so."""
    if os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _check_parent(dst: Path) -> None:
    if dst.name in {"", ".."}:
        raise DestinationError("is not a name that a recording can have", path=dst)
    parent = dst.parent
    try:
        exists = parent.exists()
    except OSError as err:
        raise DestinationError(f"its directory cannot be there: {err.strerror}", path=dst) from err
    if not exists:
        raise DestinationError("its directory does not exist", path=dst, hint=f"create it: mkdir -p {parent}")
    _check_length(dst)
    if not parent.is_dir():
        raise DestinationError(f"{parent} is not a directory", path=dst)
    # Even a link there is not to be replaced: /dev/stdout is one.
    place = os.path.realpath(parent)
    if place == "/dev" or place.startswith(("/proc/", "/sys/")):
        raise DestinationError(f"{parent} holds devices, not files", path=dst, hint="name a file in another directory")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError("its directory is not writable", path=dst)


def _check_length(dst: Path) -> None:
    """Raise if the file system cannot hold the name, or those of the files beside it while it is written."""
    limit = 255
    # Not on every system, nor known of every file system.
    with suppress(OSError, ValueError, AttributeError):
        limit = os.pathconf(dst.parent, "PC_NAME_MAX")
    allowed = limit - len(_LOCK)
    if (length := len(os.fsencode(dst.name))) > allowed:
        raise DestinationError(
            f"its name has {length} bytes, at most {allowed} are possible", path=dst, hint="choose a shorter name"
        )


@contextmanager
def _cleaning_up(dst: Path) -> Iterator[None]:
    try:
        yield
    except OSError as err:
        raise OutputError(f"what an interrupted run left cannot be removed: {err.strerror}", path=dst) from err


def _restore(dst: Path) -> None:
    """Undo or complete the replacing of a directory, if a run died between its two steps."""
    aside = dst.with_name(dst.name + _OLD)
    if os.path.lexists(dst):
        # The new one was in its place; all that was left was to remove the old.
        _remove(aside)
    elif os.path.lexists(aside):
        aside.rename(dst)


def _check_existing(dst: Path, *, overwrite: bool, beside_recording: _Beside | None) -> None:
    if not os.path.lexists(dst):
        return
    if not overwrite:
        raise _exists(dst)
    # Of a link only the link is replaced; but a device behind it is what was meant.
    if dst.exists() and not dst.is_file() and not dst.is_dir():
        raise DestinationError("is neither a file nor a directory, and cannot be overwritten", path=dst)
    if dst.is_symlink() or dst.is_file():
        return
    _refuse_other_directory(dst, beside_recording)


def _refuse_other_directory(dst: Path, beside_recording: _Beside | None) -> None:
    """Raise if a directory has anything to lose but a recording."""
    reason = beside_recording(dst) if beside_recording else "it is not looked into"
    if reason:
        raise DestinationError(
            f"is a directory with more than a rosbag2 recording in it ({reason}), and is not overwritten",
            path=dst,
            hint="choose another name, or delete it yourself",
        )


def _exists(dst: Path) -> DestinationError:
    return DestinationError("exists already", path=dst, hint="`overwrite=True` replaces it")


@contextmanager
def _only_run(dst: Path) -> Iterator[None]:
    """Hold the lock that tells a living run from a dead one; the kernel releases it when the process ends."""
    lock = dst.with_name(dst.name + _LOCK)
    try:
        descriptor = _locked(lock)
    except BlockingIOError as err:
        raise DestinationError("is being written by another run of pc2scan", path=dst) from err
    except OSError as err:
        raise OutputError(f"cannot be written: {err.strerror}", path=dst) from err
    try:
        yield
    finally:
        # Removed before it is released: who gets the lock on a removed file notices, in _locked.
        with suppress(OSError):
            lock.unlink()
        with suppress(OSError):
            os.close(descriptor)


def _locked(lock: Path) -> int:
    """Open a lock file and lock it; BlockingIOError if another process has."""
    try:
        import fcntl  # noqa: PLC0415  (not on Windows)
    except ImportError:
        return _opened(lock)
    while True:
        descriptor = _opened(lock)
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise
            except OSError:
                # Some network file systems cannot lock. That is no reason not to write there.
                return descriptor
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), lock.lstat()):
                    return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        # The run that held it ended, and removed it, between our opening and our locking it.
        os.close(descriptor)


def _opened(lock: Path) -> int:
    """Open a lock file, or create it; never through a link, and never a file that has a content to lose."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOFOLLOW", 0)
    try:
        descriptor = os.open(lock, flags, 0o644)
    except OSError as err:
        if lock.is_symlink():
            raise _no_lock(lock, "a symbolic link") from err
        raise
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_size:
        os.close(descriptor)
        raise _no_lock(lock, "no lock of pc2scan: it has a content")
    return descriptor


def _no_lock(lock: Path, what: str) -> DestinationError:
    return DestinationError(f"is where the run's lock would be, and is {what}", path=lock, hint="move it away")


def _commit(partial: Path, dst: Path, *, overwrite: bool, beside_recording: _Beside | None) -> None:
    try:
        _sync(partial)
        if overwrite and os.path.lexists(dst):
            _replace(partial, dst, beside_recording)
        elif partial.is_dir():
            _rename_directory(partial, dst)
        else:
            _rename_file(partial, dst)
        sync_directory(dst.parent)
    except OSError as err:
        raise OutputError(f"cannot be put in its place: {err.strerror}", path=dst) from err


def _sync(path: Path) -> None:
    if not path.is_dir():
        sync_file(path)
        return
    for entry in path.iterdir():
        _sync(entry)
    sync_directory(path)


def _rename_file(partial: Path, dst: Path) -> None:
    """Rename, but never over what appeared meanwhile: a link, unlike a rename, refuses to."""
    try:
        os.link(partial, dst)
    except FileExistsError as err:
        raise _exists(dst) from err
    except OSError:
        # FAT, and some network file systems, have no links.
        if os.path.lexists(dst):
            raise _exists(dst) from None
        partial.replace(dst)
    else:
        partial.unlink()


def _rename_directory(partial: Path, dst: Path) -> None:
    """Rename; the system itself refuses unless the name is free or that of an empty directory."""
    if os.path.lexists(dst):
        raise _exists(dst)
    try:
        partial.rename(dst)
    except OSError as err:
        if os.path.lexists(dst):
            raise _exists(dst) from err
        raise


def _replace(partial: Path, dst: Path, beside_recording: _Beside | None) -> None:
    """Put the new in the place of the old, which comes back if that fails."""
    if not partial.is_dir() and (dst.is_symlink() or not dst.is_dir()):
        partial.replace(dst)
        return
    if dst.is_dir() and not dst.is_symlink():
        # Something may have been put there since the beginning.
        _refuse_other_directory(dst, beside_recording)
    aside = dst.with_name(dst.name + _OLD)
    dst.rename(aside)
    try:
        partial.rename(dst)
    except BaseException:
        if not os.path.lexists(dst):
            aside.rename(dst)
        raise
    # The new one is on the disk before the old one goes.
    sync_directory(dst.parent)
    _remove(aside)


def _remove(path: Path) -> None:
    """Delete a file or a directory, if it is there; of a symbolic link only the link."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if stat.S_ISDIR(mode):
        import shutil  # noqa: PLC0415  # it loads the compression modules

        shutil.rmtree(path)
    else:
        path.unlink()
