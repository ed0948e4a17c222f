"""Folders for local copies: limits their size, and removes them, also those of killed runs."""

from __future__ import annotations

import os
import re
import shutil
import socket
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from threading import Lock
from typing import TYPE_CHECKING

from pc2scan.errors import OutputError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Progress = Callable[[int, int, int], None]

#: Seconds between two measurements of a folder's size.
_MEASURE_SECONDS = 0.1


class ScratchError(OutputError):
    """A result and the copies of its sources take more space than allowed."""


@contextmanager
def scratch_folder(scratch: Path | None) -> Iterator[Path]:
    """Make a folder for local copies, which is removed at the end. Also removes folders of killed runs on this machine.

    Its name has the machine's name, since machines may share a disk, and the id of the process.

    Raises
    ------
    UsageError
        If the folder cannot be made.
    """
    parent = Path(gettempdir()) if scratch is None else scratch
    prefix = f"pc2scan-{re.sub(r'[^A-Za-z0-9]', '_', socket.gethostname())}-"
    _remove_killed(parent, prefix)
    try:
        folder = TemporaryDirectory(prefix=f"{prefix}{os.getpid()}-", dir=scratch)
    except OSError as err:
        where = "temporary files" if scratch is None else str(scratch)
        raise UsageError(f"`scratch`: {where} cannot be written: {err.strerror}") from err
    with folder as name:
        yield Path(name).resolve()


def _remove_killed(parent: Path, prefix: str) -> None:
    """Remove folders of this user's killed runs: those whose processes do not exist any more."""
    if os.name == "nt":
        # On Windows, os.kill would end the process instead of only looking it up.
        return
    with suppress(OSError):
        for folder in list(parent.iterdir()):
            found = re.fullmatch(rf"{prefix}(\d+)-\w+", folder.name)
            if found is None or folder.is_symlink() or not folder.is_dir() or folder.stat().st_uid != os.getuid():
                continue
            try:
                os.kill(int(found[1]), 0)
            except ProcessLookupError:
                shutil.rmtree(folder, ignore_errors=True)
            except OSError:
                continue


class ScratchSpace:
    """The space for local copies, shared by all threads that copy.

    Parameters
    ----------
    folder
        The folder for the copies.
    most
        Number of bytes; None: all free space of the disk.

    Attributes
    ----------
    listeners
        Called when reserved bytes were released.
    """

    def __init__(self, folder: Path, most: int | None) -> None:
        free = shutil.disk_usage(folder).free
        self.total = free if most is None else min(most, free)
        self.is_limited = most is not None and most <= free
        self.listeners: list[Callable[[], None]] = []
        self._reserved = 0
        self._lock = Lock()

    def reserve(self, size: int) -> bool:
        """Reserve bytes; False if that much is not available now, or never will be."""
        with self._lock:
            if self._reserved + size > self.total:
                return False
            self._reserved += size
            return True

    def release(self, size: int) -> None:
        """Release reserved bytes."""
        with self._lock:
            self._reserved -= size
        for listener in list(self.listeners):
            listener()

    def refusal(self, size: int, folder: Path) -> UsageError:
        """Return the error for copies that can never fit."""
        hint = "give a larger `scratch_size`, or fewer recordings"
        return UsageError(
            f"local copies of the sources take {size:,} bytes, {folder} may have {self.total:,}",
            hint=hint if self.is_limited else "give a folder with more space as `scratch`",
        )


class SizeLimit:
    """Ends a conversion when a folder becomes too large.

    Parameters
    ----------
    folder
        The folder with the copies of the sources, and the result.
    most
        How many bytes it may have.
    """

    def __init__(self, folder: Path, most: int) -> None:
        self._folder = folder
        self._most = most
        self._next = 0.0

    def watching(self, progress: Progress | None) -> Progress:
        """Return a progress function that also checks the size from time to time."""

        def called(done: int, total: int, messages: int) -> None:
            began = time.monotonic()
            if began >= self._next:
                self.check()
                # Measuring takes long if there are very many files, so it is done for a twentieth of the time at most.
                self._next = time.monotonic() + max(_MEASURE_SECONDS, 20 * (time.monotonic() - began))
            if progress is not None:
                progress(done, total, messages)

        return called

    def check(self) -> None:
        """Raise ScratchError if the folder is too large."""
        size = 0
        for place, _, names in os.walk(self._folder):
            for name in names:
                with suppress(OSError):
                    size += os.lstat(os.path.join(place, name)).st_size  # noqa: PTH118  # very many, perhaps
        if size > self._most:
            raise ScratchError(
                f"the result and the local copies of its sources take more than {self._most:,} bytes",
                hint="give a larger `scratch_size`, or another folder as `scratch`",
            )
