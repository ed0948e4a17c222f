"""Writes a destination under a temporary name beside it and renames it at the end, so that it is complete or absent."""

from __future__ import annotations

import os
import stat
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError

from .ownership import LOCK, OLD, PARTIAL, check_existing
from .system import files_below, lock_descriptor, private_folder, remove, sync_directory
from .urls import UrlPath, is_dir, upload

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from .ownership import FolderRecord


@contextmanager
def staged_output(
    dst: Path, *, overwrite: bool, record_in: FolderRecord | None = None, beginning: bytes | None = None
) -> Iterator[Path]:
    """Yield a path to write to; what is there at the end gets the name of the destination.

    Parameters
    ----------
    dst
        The file or directory to write. Neither it nor one of its `working_names` may be an input.
    overwrite, record_in, beginning
        What may be replaced: see `check_existing`. What is there stays unchanged until the new one is complete.

    Yields
    ------
    Path
        ``<dst>.pc2scan-partial``, which does not exist; at a URL, a path in a folder of its own. After an error, what
        was written there is removed.

    Raises
    ------
    DestinationError
        If ``dst`` exists and may not be replaced (checked first, and again at the end), has no parent directory, or is
        being written by another run.
    OutputError
        If its directory or the result cannot be written.
    """
    check_place(dst)
    check = partial(check_existing, overwrite=overwrite, record_in=record_in, beginning=beginning)
    if isinstance(dst, UrlPath):
        check(dst)
        with private_folder(dst) as folder:
            local = Path(folder, dst.name)
            yield local
            if local.exists():
                check(UrlPath(dst.url))
                upload(local, dst)
        return
    unfinished = dst.with_name(dst.name + PARTIAL)
    with only_run(dst):
        # A partial file that exists now was left by a run that died, because a running one would hold the lock.
        _recover(dst)
        check(dst)
        try:
            yield unfinished
            if unfinished.exists():
                _commit(unfinished, dst, check)
        except OutputError as err:
            # The error names the final path: the user knows it, and the temporary one is gone.
            if err.path is not None and Path(err.path).is_relative_to(unfinished):
                err.path = dst / Path(err.path).relative_to(unfinished)
            raise
        finally:
            with suppress(OSError):
                remove(unfinished)


@contextmanager
def files_output(
    paths: Sequence[Path], *, overwrite: bool, beginning: bytes | None = None
) -> Iterator[Callable[[Sequence[str | bytes | Sequence[bytes]]], None]]:
    """Check that small files can be written, and yield the function that writes them; see `staged_output`.

    A file is a text, bytes, or pieces of bytes. No file gets its final name before all are complete. Then they get
    their names in the given order. Without a call of the function there are none.
    """
    for path in paths:
        check_destination(path, overwrite=overwrite, beginning=beginning)
    with ExitStack() as stack:
        places = [
            stack.enter_context(staged_output(path, overwrite=overwrite, beginning=beginning))
            for path in reversed(paths)
        ]

        def write(contents: Sequence[str | bytes | Sequence[bytes]]) -> None:
            for path, place, content in zip(paths, reversed(places), contents, strict=True):
                whole = content.encode() if isinstance(content, str) else content
                try:
                    with place.open("wb") as file:
                        file.writelines([whole] if isinstance(whole, bytes) else whole)
                except OSError as err:
                    raise OutputError(f"cannot be written: {err.strerror}", path=path) from err

        yield write


def check_destination(
    dst: Path,
    *,
    overwrite: bool,
    record_in: FolderRecord | None = None,
    beginning: bytes | None = None,
    folder: Path | None = None,
) -> None:
    """Raise what `staged_output` would raise at its beginning, as far as that is known without writing anything.

    ``folder`` is the folder of ``dst``, if it will be made; see `output_folder`.
    """
    if folder is not None and not isinstance(dst, UrlPath) and not folder.is_dir():
        check_new_folder(folder)
    else:
        check_place(dst)
        check_existing(dst, overwrite=overwrite, record_in=record_in, beginning=beginning)


def _recover(dst: Path) -> None:
    """Undo or complete what a killed run left; the caller holds the destination's lock."""
    aside = dst.with_name(dst.name + OLD)
    try:
        remove(dst.with_name(dst.name + PARTIAL))
        if os.path.lexists(dst):
            # The new output is in place; only the old one was still to be removed.
            remove(aside)
        elif os.path.lexists(aside):
            aside.rename(dst)
    except OSError as err:
        raise OutputError(f"the files of an interrupted run cannot be removed: {err.strerror}", path=dst) from err


def _commit(unfinished: Path, dst: Path, check: Callable[..., None]) -> None:
    """Rename what is complete at a temporary path to the destination."""
    is_folder = unfinished.is_dir()
    try:
        sync(unfinished)
        # Something may have been added since the beginning.
        check(dst, written=set(files_below(unfinished)) if is_folder else ())
        if os.path.lexists(dst) and (is_folder or (dst.is_dir() and not dst.is_symlink())):
            _exchange(unfinished, dst)
        else:
            unfinished.replace(dst)
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


def _exchange(unfinished: Path, dst: Path) -> None:
    """Replace the old output by the new one, where one is a folder; if that fails, restore the old one."""
    aside = dst.with_name(dst.name + OLD)
    dst.rename(aside)
    try:
        unfinished.rename(dst)
    except BaseException:
        # Not if the interruption came after the renaming.
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
        steps: list[Callable[[], None]] = [lock.unlink, lambda: os.close(descriptor)]
        # Windows removes only files that no process has open.
        for step in reversed(steps) if os.name == "nt" else steps:
            with suppress(OSError):
                step()


def _acquire(lock: Path) -> int:
    """Open a lock file and lock it; BlockingIOError if another process has locked it."""
    while True:
        with suppress(FileNotFoundError):
            status = lock.lstat()
            if not stat.S_ISREG(status.st_mode) or status.st_size:
                message = "has the name of the run's lock, but is not one: it is a link, or not empty"
                raise DestinationError(message, path=lock, hint="move it away")
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            lock_descriptor(descriptor)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), lock.lstat()):
                    return descriptor
        except BaseException as err:
            if isinstance(err, OSError) and not isinstance(err, BlockingIOError):
                # Some network file systems cannot lock files. Writing goes on without a lock.
                return descriptor
            os.close(descriptor)
            raise
        # The run that held the lock has removed the file between opening and locking it here.
        os.close(descriptor)


# --- Where a destination can be written ---


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
