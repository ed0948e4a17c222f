"""Writes a destination under a temporary name beside it and renames it at the end, so that it is complete or absent."""

from __future__ import annotations

import os
import stat
from collections import deque
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError

from .places import OLD, PARTIAL, check_new_folder, check_place, working_names
from .run_lock import only_run
from .system import sync_directory, sync_file

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    #: Returns what a directory has besides a recording; empty for nothing.
    _Beside = Callable[[Path], str]

__all__ = [
    "check_destination",
    "check_existing",
    "clean_up",
    "cleaning_up",
    "exists_already",
    "note_renaming",
    "note_written",
    "prepared",
    "remove",
    "rename_file",
    "staged",
    "sync",
    "written",
]

#: The beginning of the names of a run's internal files.
_PRIVATE = ".pc2scan-"

#: Destinations that were about to be renamed, each with its device and inode. Bounded, for long-lived processes.
_renamed: deque[tuple[Path, tuple[int, int] | None]] = deque(maxlen=1000)


def written() -> list[Path]:
    """Return the destinations that this process wrote and that are still in place, in the order of writing.

    An interruption may come between renaming and noting it, so device and inode of the existing files are compared.
    """
    named = [(dst, identity) for dst, identity in _renamed if not dst.name.startswith(_PRIVATE)]
    return list(dict.fromkeys(dst for dst, identity in named if identity and _device_and_inode(dst) == identity))


def note_renaming(partial: Path, dst: Path) -> None:
    """Note that a complete file or directory is about to get its name."""
    _renamed.append((dst, _device_and_inode(partial)))


def note_written(dst: Path) -> None:
    """Note a destination that another process has written for this one."""
    _renamed.append((dst, _device_and_inode(dst)))


def _device_and_inode(path: Path) -> tuple[int, int] | None:
    """Return device and inode, which a file keeps when it is renamed; None if it does not exist."""
    try:
        status = path.lstat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


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
        Returns what a directory has besides a recording, if anything. Without it no directory is replaced.

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
        with cleaning_up(dst):
            _restore(dst)
        check_existing(dst, overwrite=overwrite, beside_recording=beside_recording)
        return overwrite

    with prepared(dst, check, beside_recording) as (partial, commit):
        yield partial
        commit()


def check_destination(
    dst: Path, *, overwrite: bool, beside_recording: _Beside | None = None, folder: Path | None = None
) -> None:
    """Raise what `staged` would raise at its beginning, as far as that is known without writing anything.

    Parameters
    ----------
    dst, overwrite, beside_recording
        See `staged`.
    folder
        The folder of `dst`, if it will be made.

    Raises
    ------
    DestinationError, OutputError
        See `staged` and `made_folder`.
    """
    if folder is not None and not folder.is_dir():
        check_new_folder(folder)
        return
    check_place(dst)
    if not overwrite and os.path.lexists(dst.with_name(dst.name + OLD)):
        # An interrupted run has set the old output aside. It would be restored first, and then exist.
        raise exists_already(dst)
    check_existing(dst, overwrite=overwrite, beside_recording=beside_recording)


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
    partial = dst.with_name(dst.name + PARTIAL)
    with only_run(dst):
        # A partial file that exists now was left by a run that died, because a running one would hold the lock.
        with cleaning_up(dst):
            remove(partial)
        overwrite = check()
        try:
            yield partial, lambda: _commit(partial, dst, overwrite=overwrite, beside_recording=beside_recording)
        finally:
            with suppress(OSError):
                remove(partial)


@contextmanager
def cleaning_up(dst: Path) -> Iterator[None]:
    """Raise an `OutputError` if what an interrupted run left cannot be removed."""
    try:
        yield
    except OSError as err:
        raise OutputError(f"the files of an interrupted run cannot be removed: {err.strerror}", path=dst) from err


def _restore(dst: Path) -> None:
    """Undo or complete the replacement of a directory, if a run died between the two steps."""
    aside = dst.with_name(dst.name + OLD)
    if os.path.lexists(dst):
        # The new output is in place; only the old one was still to be removed.
        remove(aside)
    elif os.path.lexists(aside):
        aside.rename(dst)


def check_existing(dst: Path, *, overwrite: bool, beside_recording: _Beside | None) -> None:
    """Raise if there is something at the destination that may not be replaced."""
    if not os.path.lexists(dst):
        return
    if not overwrite:
        raise exists_already(dst)
    # A link itself is replaced, not its target; but a link to a device means the device.
    if dst.exists() and not dst.is_file() and not dst.is_dir():
        raise DestinationError("is neither a file nor a directory, and cannot be overwritten", path=dst)
    if dst.is_symlink() or dst.is_file():
        return
    _refuse_other_directory(dst, beside_recording)


def _refuse_other_directory(dst: Path, beside_recording: _Beside | None) -> None:
    """Raise if a directory has anything besides a recording."""
    reason = beside_recording(dst) if beside_recording else "its content is not checked"
    if reason:
        raise DestinationError(
            f"is a directory with more than a rosbag2 recording ({reason}), and is not overwritten",
            path=dst,
            hint="choose another name, or delete it yourself",
        )


def exists_already(dst: Path) -> DestinationError:
    """Return the error of a destination that may not be replaced."""
    return DestinationError("exists already", path=dst, hint="`overwrite=True` replaces it")


def clean_up(dst: Path) -> None:
    """Remove the files that a killed run left beside a destination, and restore those that it had set aside.

    Nothing is done for a destination that another run is writing.

    Raises
    ------
    OutputError
        If something cannot be removed.
    """
    if not any(map(os.path.lexists, working_names(dst))):
        return
    with suppress(DestinationError), only_run(dst), cleaning_up(dst):
        remove(dst.with_name(dst.name + PARTIAL))
        _restore(dst)


def _commit(partial: Path, dst: Path, *, overwrite: bool, beside_recording: _Beside | None) -> None:
    try:
        sync(partial)
        note_renaming(partial, dst)
        if overwrite and os.path.lexists(dst):
            _replace(partial, dst, beside_recording)
        elif partial.is_dir():
            _rename_directory(partial, dst)
        else:
            rename_file(partial, dst)
        sync_directory(dst.parent)
    except OSError as err:
        raise OutputError(f"cannot be renamed to its final name: {err.strerror}", path=dst) from err


def sync(path: Path) -> None:
    """Wait until a file, or a directory with everything in it, is on the disk."""
    if not path.is_dir():
        sync_file(path)
        return
    for entry in path.iterdir():
        sync(entry)
    sync_directory(path)


def rename_file(partial: Path, dst: Path) -> None:
    """Rename a file by a link, which unlike renaming fails if another file has appeared under the name meanwhile."""
    try:
        os.link(partial, dst)
    except FileExistsError as err:
        raise exists_already(dst) from err
    except OSError:
        # FAT and some network file systems have no links.
        if os.path.lexists(dst):
            raise exists_already(dst) from None
        partial.replace(dst)
    else:
        partial.unlink()


def _rename_directory(partial: Path, dst: Path) -> None:
    """Rename a directory; the system refuses if the name exists and is not an empty directory."""
    if os.path.lexists(dst):
        raise exists_already(dst)
    try:
        partial.rename(dst)
    except OSError as err:
        if os.path.lexists(dst):
            raise exists_already(dst) from err
        raise


def _replace(partial: Path, dst: Path, beside_recording: _Beside | None) -> None:
    """Replace the old output by the new one; if that fails, restore the old one."""
    if not partial.is_dir() and (dst.is_symlink() or not dst.is_dir()):
        partial.replace(dst)
        return
    if dst.is_dir() and not dst.is_symlink():
        # Other files may have been added since the beginning.
        _refuse_other_directory(dst, beside_recording)
    aside = dst.with_name(dst.name + OLD)
    dst.rename(aside)
    try:
        partial.rename(dst)
    except BaseException:
        if not os.path.lexists(dst):
            aside.rename(dst)
        raise
    # The new output must be on the disk before the old one is removed.
    sync_directory(dst.parent)
    remove(aside)


def remove(path: Path) -> None:
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
