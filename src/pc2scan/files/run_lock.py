"""The lock of a run: a destination is written by one run at a time."""

from __future__ import annotations

import os
import stat
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError

from . import system
from .places import LOCK

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


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
        # Windows removes only files that no process has open.
        removed = _remove_lock(lock)
        with suppress(OSError):
            os.close(descriptor)
        if not removed:
            _remove_lock(lock)


def _remove_lock(lock: Path) -> bool:
    try:
        lock.unlink()
    except OSError:
        return False
    return True


def _acquire(lock: Path) -> int:
    """Open a lock file and lock it; BlockingIOError if another process has locked it."""
    while True:
        descriptor = _open_lock(lock)
        try:
            try:
                system.lock(descriptor)
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
