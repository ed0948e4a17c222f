"""Writes a destination under a temporary name beside it and renames it at the end, so that it is complete or absent."""

from __future__ import annotations

import os
import re
import stat
from collections import deque
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError

from . import system

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    #: Returns what a directory has in it beside a recording; empty for nothing.
    _Beside = Callable[[Path], str]

__all__ = [
    "LEFTOVERS",
    "check_destination",
    "check_parts",
    "check_place",
    "clean_up",
    "made_folder",
    "note_written",
    "only_run",
    "parts_beside",
    "prepared",
    "staged",
    "staged_parts",
    "sync_directory",
    "sync_file",
    "working_names",
    "written",
]

_PARTIAL = ".pc2scan-partial"
_OLD = ".pc2scan-old"
_LOCK = f"{_PARTIAL}.lock"

#: The beginning of the names of a run's internal files.
_PRIVATE = ".pc2scan-"

#: Endings of the files that a killed run leaves beside its destination.
LEFTOVERS = (_PARTIAL, _OLD)

#: Destinations that were about to get their name, each with its device and inode. Bounded, for long-lived processes.
_renamed: deque[tuple[Path, tuple[int, int] | None]] = deque(maxlen=1000)


def written() -> list[Path]:
    """Return the destinations that this process wrote and that are still in place, in the order of writing.

    An interruption may come between a renaming and anything that notes it, so the files themselves are asked.
    """
    named = [(dst, identity) for dst, identity in _renamed if not dst.name.startswith(_PRIVATE)]
    return list(dict.fromkeys(dst for dst, identity in named if identity and _identity(dst) == identity))


def note_written(dst: Path) -> None:
    """Note a destination that another process has written for this one."""
    _renamed.append((dst, _identity(dst)))


def _identity(path: Path) -> tuple[int, int] | None:
    """Device and inode, which a file keeps when it is renamed; None for a file that is not there."""
    try:
        status = path.lstat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


def working_names(dst: Path) -> tuple[Path, ...]:
    """Return the paths beside a destination that a run creates, renames and removes while it writes it.

    No input may have one of them: see `pc2scan.files.overlap`.
    """
    return tuple(dst.with_name(dst.name + ending) for ending in (_PARTIAL, _OLD, _LOCK)) if dst.name else ()


@contextmanager
def staged(dst: Path, *, overwrite: bool, beside_recording: _Beside | None = None) -> Iterator[Path]:
    """Yield a path to write to, and rename it to the destination at the end.

    Parameters
    ----------
    dst
        The file or directory to write. Neither it nor one of its `working_names` may be an input.
    overwrite
        Whether an existing file, or a directory with a rosbag2 recording and nothing else, may be replaced.
        It stays unchanged until the new one is complete.
    beside_recording
        Returns what a directory has in it beside a recording, if anything. Without it no directory is replaced.

    Yields
    ------
    Path
        ``<dst>.pc2scan-partial``, which does not exist. The body creates a file or a directory there. If the body
        raises, that is removed.

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
    _check_length(dst.with_name(f"{dst.stem}_00000{dst.suffix}"))
    for part in parts_beside(dst):
        _check_existing(part, overwrite=overwrite, beside_recording=None)


@contextmanager
def staged_parts(dst: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a new directory to write the parts of a recording in, and move them beside each other at the end.

    All of them appear, or none. The first one in the order of their numbers appears last: where it is, all are.

    Parameters
    ----------
    dst
        What the parts are named after: ``drive_0.bag`` and so on of ``drive.bag``.
    overwrite
        Whether existing parts of that name may be replaced: all of them, however many the new ones are.

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
        with _cleaning_up(dst):
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
    """Move the parts to their places, the first one last; if that fails, everything is as it was."""
    _sync(partial)
    old = parts_beside(dst)
    if old and not overwrite:
        raise _exists(old[0])
    aside, placed = [], []
    try:
        # The first one last, and of the new ones too: what a killed run leaves says how far it came.
        for path in reversed(_in_order(old)):
            path.rename(path.with_name(path.name + _OLD))
            aside.append(path)
        for part in reversed(_in_order(partial.iterdir())):
            final = dst.with_name(part.name)
            _renamed.append((final, _identity(part)))
            _rename_file(part, final)
            placed.append(final)
        sync_directory(dst.parent)
    except BaseException:
        for path in placed:
            path.unlink()
        for path in reversed(aside):
            path.with_name(path.name + _OLD).rename(path)
        raise
    for path in aside:
        _remove(path.with_name(path.name + _OLD))


def _restore_parts(dst: Path) -> None:
    """Undo or complete the replacement of parts, if a run died in the middle of it."""
    aside = _in_order(_parts_named(dst, _OLD))
    if not aside:
        return
    places = [path.with_name(path.name.removesuffix(_OLD)) for path in aside]
    present = _in_order(parts_beside(dst))
    if present and present[0] == places[0]:
        # The first new one appears last: they are complete.
        for path in aside:
            _remove(path)
        return
    if not present or _number(places[0]) < _number(present[0]):
        # All old ones are aside, and what is in place is of the run that died.
        for path in present:
            _remove(path)
    for path, place in zip(aside, places, strict=True):
        path.rename(place)


def _parts_named(dst: Path, ending: str = "") -> list[Path]:
    named = re.compile(rf"{re.escape(dst.stem)}_\d+{re.escape(dst.suffix)}{re.escape(ending)}")
    try:
        return [entry for entry in dst.parent.iterdir() if named.fullmatch(entry.name)]
    except OSError:
        return []


def _in_order(parts: Iterable[Path]) -> list[Path]:
    """Return parts in the order of their numbers."""
    return sorted(parts, key=_number)


def _number(part: Path) -> int:
    return int(re.findall(r"_(\d+)", part.name)[-1])


def check_destination(
    dst: Path, *, overwrite: bool, beside_recording: _Beside | None = None, folder: Path | None = None
) -> None:
    """Raise what `staged` would raise at its beginning, as far as that is known without writing anything.

    Parameters
    ----------
    dst, overwrite, beside_recording
        See `staged`.
    folder
        The folder that `dst` is in, if it is made for it.

    Raises
    ------
    DestinationError, OutputError
        See `staged` and `made_folder`.
    """
    if folder is not None and not folder.is_dir():
        _check_new_folder(folder)
        return
    check_place(dst)
    if not overwrite and os.path.lexists(dst.with_name(dst.name + _OLD)):
        # An interrupted run has set it aside, and it would be restored first.
        raise _exists(dst)
    _check_existing(dst, overwrite=overwrite, beside_recording=beside_recording)


@contextmanager
def prepared(
    dst: Path, check: Callable[[], bool], beside_recording: _Beside | None = None
) -> Iterator[tuple[Path, Callable[[], None]]]:
    """Yield a path to write to, and a function that renames it to the destination.

    Parameters
    ----------
    dst
        See `staged`.
    check
        Raises if ``dst`` may not be written, and returns whether an existing ``dst`` may be replaced. Called once, at
        the beginning; a file that appears later is replaced only if the result was true.
    beside_recording
        See `staged`.

    Yields
    ------
    path, function
        A path that does not exist, and the function to call when it is complete. Without the call it is removed.

    Raises
    ------
    DestinationError, OutputError
        See `staged`.
    """
    check_place(dst)
    partial = dst.with_name(dst.name + _PARTIAL)
    with only_run(dst):
        # A partial file that exists now is of a run that died: a running one holds the lock.
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
    """Make a folder to write into, if it does not exist; it is removed again if the body fails and leaves it empty.

    Raises
    ------
    DestinationError
        If it is not a folder, or the folder above it does not exist.
    OutputError
        If it cannot be made.
    """
    if folder.is_dir():
        yield
        return
    _check_new_folder(folder)
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


def _check_new_folder(folder: Path) -> None:
    if os.path.lexists(folder):
        raise DestinationError("is not a folder", path=folder, hint="choose another name")
    check_place(folder)


def sync_file(path: Path) -> None:
    """Wait until a file's content is on the disk."""
    # Not read-only: Windows flushes only files that are open for writing.
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def sync_directory(path: Path) -> None:
    """Wait until a directory's entries are on the disk, if the system can do so."""
    if os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_place(dst: Path) -> None:
    """Raise if nothing of this name can be written."""
    if dst.name in {"", ".."}:
        raise DestinationError("is not a name that a recording can have", path=dst)
    if reason := system.unusable_name(dst.name):
        raise DestinationError(f"cannot be written: the name {reason}", path=dst, hint="choose another name")
    parent = dst.parent
    try:
        exists = parent.exists()
    except OSError as err:
        raise DestinationError(f"its directory cannot be there: {err.strerror}", path=dst) from err
    if not exists:
        from shlex import quote  # noqa: PLC0415  # few destinations are wrong

        hint = f"create it: mkdir -p {quote(str(parent))}"
        raise DestinationError("its directory does not exist", path=dst, hint=hint)
    _check_length(dst)
    if not parent.is_dir():
        raise DestinationError(f"{parent} is not a directory", path=dst)
    # Even links there are not replaced: /dev/stdout is one.
    place = os.path.realpath(parent)
    if place == "/dev" or place.startswith(("/proc/", "/sys/")):
        raise DestinationError(f"{parent} holds devices, not files", path=dst, hint="name a file in another directory")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(
            "its directory is not writable", path=dst, hint="write into another one, or change its rights"
        )


def _check_length(dst: Path) -> None:
    """Raise if the file system cannot hold the name, or one of its `working_names`."""
    limit = 255
    # Not every system and file system can tell.
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
        raise OutputError(f"the files of an interrupted run cannot be removed: {err.strerror}", path=dst) from err


def _restore(dst: Path) -> None:
    """Undo or complete the replacement of a directory, if a run died between the two steps."""
    aside = dst.with_name(dst.name + _OLD)
    if os.path.lexists(dst):
        # The new one was renamed already; only the old one had to be removed.
        _remove(aside)
    elif os.path.lexists(aside):
        aside.rename(dst)


def _check_existing(dst: Path, *, overwrite: bool, beside_recording: _Beside | None) -> None:
    if not os.path.lexists(dst):
        return
    if not overwrite:
        raise _exists(dst)
    # A link itself is replaced, not its target; but a link to a device means the device.
    if dst.exists() and not dst.is_file() and not dst.is_dir():
        raise DestinationError("is neither a file nor a directory, and cannot be overwritten", path=dst)
    if dst.is_symlink() or dst.is_file():
        return
    _refuse_other_directory(dst, beside_recording)


def _refuse_other_directory(dst: Path, beside_recording: _Beside | None) -> None:
    """Raise if a directory has anything but a recording in it."""
    reason = beside_recording(dst) if beside_recording else "it is not looked into"
    if reason:
        raise DestinationError(
            f"is a directory with more than a rosbag2 recording in it ({reason}), and is not overwritten",
            path=dst,
            hint="choose another name, or delete it yourself",
        )


def _exists(dst: Path) -> DestinationError:
    return DestinationError("exists already", path=dst, hint="`overwrite=True` replaces it")


def clean_up(dst: Path) -> None:
    """Remove what a killed run left beside a destination, and put back what it had set aside.

    A destination that another run is writing is left alone.

    Raises
    ------
    OutputError
        If something cannot be removed.
    """
    if not any(map(os.path.lexists, working_names(dst))):
        return
    with suppress(DestinationError), only_run(dst), _cleaning_up(dst):
        _remove(dst.with_name(dst.name + _PARTIAL))
        _restore(dst)


@contextmanager
def only_run(dst: Path) -> Iterator[int]:
    """Hold the lock of a running run; yields its descriptor.

    The kernel releases it when the process ends, and the processes that have inherited the descriptor.
    """
    lock = dst.with_name(dst.name + _LOCK)
    try:
        descriptor = _locked(lock)
    except BlockingIOError as err:
        raise DestinationError("is being written by another run of pc2scan", path=dst) from err
    except OSError as err:
        raise OutputError(f"cannot be written: {err.strerror}", path=dst) from err
    try:
        yield descriptor
    finally:
        # Removed before it is released: a run that locks the removed file notices, in _locked.
        # Windows removes only files that no process has open.
        removed = _unlinked(lock)
        with suppress(OSError):
            os.close(descriptor)
        if not removed:
            _unlinked(lock)


def _unlinked(lock: Path) -> bool:
    try:
        lock.unlink()
    except OSError:
        return False
    return True


def _locked(lock: Path) -> int:
    """Open a lock file and lock it; BlockingIOError if another process has locked it."""
    while True:
        descriptor = _open_lock(lock)
        try:
            try:
                system.lock(descriptor)
            except BlockingIOError:
                raise
            except OSError:
                # Some network file systems cannot lock files, but can be written.
                return descriptor
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), lock.lstat()):
                    return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        # The run that held the lock ended, and removed it, between opening and locking it here.
        os.close(descriptor)


def _open_lock(lock: Path) -> int:
    """Open a lock file, or create it; never through a link, and never a file that is not empty."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | system.REFUSES_LINKS
    if not system.REFUSES_LINKS and lock.is_symlink():
        raise _no_lock(lock, "a symbolic link")
    try:
        descriptor = os.open(lock, flags, 0o644)
    except OSError as err:
        if lock.is_symlink():
            raise _no_lock(lock, "a symbolic link") from err
        raise
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_size:
        os.close(descriptor)
        raise _no_lock(lock, "not a lock of pc2scan: it is not empty")
    return descriptor


def _no_lock(lock: Path, what: str) -> DestinationError:
    return DestinationError(f"has the name of the run's lock, but is {what}", path=lock, hint="move it away")


def _commit(partial: Path, dst: Path, *, overwrite: bool, beside_recording: _Beside | None) -> None:
    try:
        _sync(partial)
        _renamed.append((dst, _identity(partial)))
        if overwrite and os.path.lexists(dst):
            _replace(partial, dst, beside_recording)
        elif partial.is_dir():
            _rename_directory(partial, dst)
        else:
            _rename_file(partial, dst)
        sync_directory(dst.parent)
    except OSError as err:
        raise OutputError(f"cannot be renamed to its final name: {err.strerror}", path=dst) from err


def _sync(path: Path) -> None:
    if not path.is_dir():
        sync_file(path)
        return
    for entry in path.iterdir():
        _sync(entry)
    sync_directory(path)


def _rename_file(partial: Path, dst: Path) -> None:
    """Rename, but never over a file that appeared meanwhile: unlike a rename, a link fails then."""
    try:
        os.link(partial, dst)
    except FileExistsError as err:
        raise _exists(dst) from err
    except OSError:
        # FAT and some network file systems have no links.
        if os.path.lexists(dst):
            raise _exists(dst) from None
        partial.replace(dst)
    else:
        partial.unlink()


def _rename_directory(partial: Path, dst: Path) -> None:
    """Rename a directory; the system refuses if the name exists and is not an empty directory."""
    if os.path.lexists(dst):
        raise _exists(dst)
    try:
        partial.rename(dst)
    except OSError as err:
        if os.path.lexists(dst):
            raise _exists(dst) from err
        raise


def _replace(partial: Path, dst: Path, beside_recording: _Beside | None) -> None:
    """Replace the old by the new one; if that fails, the old one is restored."""
    if not partial.is_dir() and (dst.is_symlink() or not dst.is_dir()):
        partial.replace(dst)
        return
    if dst.is_dir() and not dst.is_symlink():
        # Other files may have been added since the beginning.
        _refuse_other_directory(dst, beside_recording)
    aside = dst.with_name(dst.name + _OLD)
    dst.rename(aside)
    try:
        partial.rename(dst)
    except BaseException:
        if not os.path.lexists(dst):
            aside.rename(dst)
        raise
    # The new one is on the disk before the old one is removed.
    sync_directory(dst.parent)
    _remove(aside)


def _remove(path: Path) -> None:
    """Delete a file or a directory if it exists; a symbolic link, not its target."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if stat.S_ISDIR(mode):
        import shutil  # noqa: PLC0415  # it loads the compression modules

        shutil.rmtree(path)
    else:
        path.unlink()
