"""Writes a destination under a temporary name beside it and renames it at the end, so that it is complete or absent."""

from __future__ import annotations

import os
import stat
from collections import deque
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError

from .ownership import check_existing, existing_error, file_ids, refuse_others
from .places import LEFTOVERS, LOCK, OLD, PARTIAL, check_new_folder, check_place, working_names
from .records import files_below
from .system import REFUSES_LINKS, lock_descriptor, remove, sync_directory
from .transfers import upload
from .urls import UrlPath

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from .ownership import FileId
    from .records import FolderRecord

#: The beginning of the names of a run's internal files.
_PRIVATE = ".pc2scan-"

#: Destinations that were about to be renamed, each with its device and inode, which a file keeps when it is renamed.
#: Bounded, for long-lived processes.
_renamed: deque[tuple[Path, list[FileId]]] = deque(maxlen=1000)


def written_paths() -> list[Path]:
    """Return the destinations that this process wrote and that are still in place, in the order of writing.

    An interruption may come between renaming and noting it, so device and inode of the existing files are compared.
    """
    named = [(dst, identity) for dst, identity in _renamed if not dst.name.startswith(_PRIVATE)]
    return list(dict.fromkeys(dst for dst, identity in named if identity and identity == file_ids(dst)[:1]))


def note_renaming(partial: Path, dst: Path) -> None:
    """Note that a complete file or directory is about to get its name."""
    _renamed.append((dst, file_ids(partial)[:1]))


def note_written(dst: Path) -> None:
    """Note a destination that another process has written for this one."""
    _renamed.append((dst, file_ids(dst)[:1]))


@contextmanager
def staged_output(
    dst: Path, *, overwrite: bool, owned: Collection[str] | None = None, record_in: FolderRecord | None = None
) -> Iterator[Path]:
    """Yield a path to write to, and rename it to the destination at the end.

    Parameters
    ----------
    dst
        The file or directory to write. Neither it nor one of its `working_names` may be an input.
    overwrite
        Whether an existing file, or a directory of which a record accounts for everything, may be replaced.
        It stays unchanged until the new one is complete.
    owned
        What earlier runs wrote into the folder of ``dst``: that may be replaced without ``overwrite``, too.
    record_in
        Reads the record of what is in a directory. Without it no directory is replaced.

    Yields
    ------
    Path
        ``<dst>.pc2scan-partial``, which does not exist. The body creates a file or a directory there. If the body
        raises, that is removed.

    Raises
    ------
    DestinationError
        If ``dst`` exists and may not be replaced (checked first, and again by the final step), has no parent
        directory, or is being written by another run.
    OutputError
        If its directory or the result cannot be written.
    """
    if isinstance(dst, UrlPath):
        check_destination(dst, overwrite=overwrite, owned=owned)
        with upload(dst, overwrite=overwrite, owned=owned) as (local, finish):
            yield local
            finish()
        return

    def check_again(partial: Path) -> None:
        # Other files may have been added since the beginning.
        refuse_others(dst, record_in, set(files_below(partial)) if partial.is_dir() else ())

    with temporary_path(dst) as partial:
        check_existing(dst, overwrite=overwrite, owned=owned, record_in=record_in)
        yield partial
        commit(partial, dst, check_again, overwrite=overwrite or owned is not None)


def check_destination(
    dst: Path,
    *,
    overwrite: bool,
    owned: Collection[str] | None = None,
    record_in: FolderRecord | None = None,
    folder: Path | None = None,
) -> None:
    """Raise what `staged_output` would raise at its beginning, as far as that is known without writing anything.

    Parameters
    ----------
    dst, overwrite, owned, record_in
        See `staged_output`.
    folder
        The folder of `dst`, if it will be made.

    Raises
    ------
    DestinationError, OutputError
        See `staged_output` and `output_folder`.
    """
    if folder is not None and not isinstance(dst, UrlPath) and not folder.is_dir():
        check_new_folder(folder)
        return
    check_place(dst)
    if not overwrite and not isinstance(dst, UrlPath) and os.path.lexists(dst.with_name(dst.name + OLD)):
        # An interrupted run has set the old output aside. It would be restored first, and then exist.
        raise existing_error(dst)
    check_existing(dst, overwrite=overwrite, owned=owned, record_in=record_in)


@contextmanager
def temporary_path(dst: Path) -> Iterator[Path]:
    """Yield a path beside a local destination, which does not exist; if `commit` does not rename it, it is removed.

    What a killed run left is undone or completed before, so the caller checks then whether it may write ``dst``.

    Raises
    ------
    DestinationError, OutputError
        See `staged_output`.
    """
    check_place(dst)
    partial = dst.with_name(dst.name + PARTIAL)
    with only_run(dst):
        # A partial file that exists now was left by a run that died, because a running one would hold the lock.
        _recover(dst)
        try:
            yield partial
        except OutputError as err:
            # The error names the final path: the user knows it, and the temporary one is gone.
            if err.path is not None and Path(err.path).is_relative_to(partial):
                err.path = dst / Path(err.path).relative_to(partial)
            raise
        finally:
            with suppress(OSError):
                remove(partial)


def clean_up(dst: Path) -> bool:
    """Remove the files that a killed run left beside a destination, and restore those that it had set aside.

    Returns whether nothing of any run is left there.

    Nothing is done for a destination that another run is writing.

    Raises
    ------
    OutputError
        If something cannot be removed.
    """
    if isinstance(dst, UrlPath) or not any(map(os.path.lexists, working_names(dst))):
        return True
    with suppress(DestinationError), only_run(dst):
        _recover(dst)
    return not any(map(os.path.lexists, working_names(dst)))


def _recover(dst: Path) -> None:
    """Undo or complete what a killed run left; the caller holds the destination's lock.

    Raises
    ------
    OutputError
        If something cannot be removed or renamed.
    """
    partial, aside = (dst.with_name(dst.name + ending) for ending in LEFTOVERS)
    try:
        remove(partial)
        if os.path.lexists(dst):
            # The new output is in place; only the old one was still to be removed.
            remove(aside)
        elif os.path.lexists(aside):
            aside.rename(dst)
    except OSError as err:
        raise OutputError(f"the files of an interrupted run cannot be removed: {err.strerror}", path=dst) from err


def commit(partial: Path, dst: Path, check_again: Callable[[Path], None] | None = None, *, overwrite: bool) -> None:
    """Rename what is complete at a temporary path to the destination.

    Parameters
    ----------
    partial, dst
        See `temporary_path`.
    check_again
        Called with the new directory before it replaces a directory; raises if it may not.
    overwrite
        Whether what has the destination's name now may be replaced.
    """
    try:
        sync(partial)
        note_renaming(partial, dst)
        if overwrite and os.path.lexists(dst):
            _replace(partial, dst, check_again)
        elif partial.is_dir():
            _rename_directory(partial, dst)
        else:
            rename_file(partial, dst)
        sync_directory(dst.parent)
    except OSError as err:
        raise OutputError(f"cannot be renamed to its final name: {err.strerror}", path=dst) from err


def sync(path: Path) -> None:
    """Wait until a file, or a directory with everything in it, is on the disk."""
    if path.is_dir():
        for entry in path.iterdir():
            sync(entry)
        sync_directory(path)
    else:
        # Not read-only: Windows flushes only files that are open for writing.
        with path.open("rb+") as file:
            os.fsync(file.fileno())


def rename_file(partial: Path, dst: Path) -> None:
    """Rename a file by a link, which unlike renaming fails if another file has appeared under the name meanwhile."""
    try:
        os.link(partial, dst)
    except FileExistsError as err:
        raise existing_error(dst) from err
    except OSError:
        # FAT and some network file systems have no links.
        if os.path.lexists(dst):
            raise existing_error(dst) from None
        partial.replace(dst)
    else:
        partial.unlink()


def _rename_directory(partial: Path, dst: Path) -> None:
    """Rename a directory; the system refuses if the name exists and is not an empty directory."""
    if os.path.lexists(dst):
        raise existing_error(dst)
    try:
        partial.rename(dst)
    except OSError as err:
        if os.path.lexists(dst):
            raise existing_error(dst) from err
        raise


def _replace(partial: Path, dst: Path, check_again: Callable[[Path], None] | None) -> None:
    """Replace the old output by the new one; if that fails, restore the old one."""
    if not partial.is_dir() and (dst.is_symlink() or not dst.is_dir()):
        partial.replace(dst)
        return
    if dst.is_dir() and not dst.is_symlink():
        if check_again is None:
            raise existing_error(dst)
        check_again(partial)
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


# --- The lock of a run: a destination is written by one run at a time ---


@contextmanager
def only_run(dst: Path) -> Iterator[int]:
    """Hold the lock of a running run; yields its descriptor.

    The kernel releases it when this process and all processes that have inherited the descriptor have ended.
    """
    lock = dst.with_name(dst.name + LOCK)
    try:
        descriptor = _acquire(lock)
    except BlockingIOError as err:
        raise DestinationError("is being written by another run of pc2scan", path=dst) from err
    except OSError as err:
        raise OutputError(f"cannot be written: {err.strerror}", path=dst) from err
    try:
        yield descriptor
    finally:
        # Removed before it is released: a run that locks the removed file notices, in _acquire.
        is_there = True
        with suppress(OSError):
            lock.unlink()
            is_there = False
        with suppress(OSError):
            os.close(descriptor)
        # Windows removes only files that no process has open.
        with suppress(OSError):
            if is_there:
                lock.unlink()


def _acquire(lock: Path) -> int:
    """Open a lock file and lock it; BlockingIOError if another process has locked it."""
    while True:
        descriptor = _open_lock(lock)
        try:
            try:
                lock_descriptor(descriptor)
            except BlockingIOError:
                raise
            except OSError:
                # Some network file systems cannot lock files. Writing goes on without a lock.
                return descriptor
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), lock.lstat()):
                    return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        # The run that held the lock has removed the file between opening and locking it here.
        os.close(descriptor)


def _open_lock(lock: Path) -> int:
    """Open a lock file, or create it; never through a link, and never a file that is not empty."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | REFUSES_LINKS
    if not REFUSES_LINKS and lock.is_symlink():
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
