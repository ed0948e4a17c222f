"""Folders for local copies: how large they may become, and how they are removed, also after a run that was killed."""

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

__all__ = ["Limit", "Room", "ScratchError", "scratch_folder"]

#: Seconds between two looks at the size of a folder.
_LOOK_SECONDS = 0.1


class ScratchError(OutputError):
    """A result, and the copies of its sources, take more room than there may be."""


@contextmanager
def scratch_folder(scratch: Path | None) -> Iterator[Path]:
    """Make a folder for local copies that is removed at the end; those of killed runs on this machine are removed, too.

    Its name has that of the machine, as machines may share a disk, and the process.

    Raises
    ------
    UsageError
        If it cannot be made.
    """
    parent = Path(gettempdir()) if scratch is None else scratch
    prefix = f"pc2scan-{re.sub(r'[^A-Za-z0-9]', '_', socket.gethostname())}-"
    _remove_left(parent, prefix)
    try:
        folder = TemporaryDirectory(prefix=f"{prefix}{os.getpid()}-", dir=scratch)
    except OSError as err:
        where = "temporary files" if scratch is None else str(scratch)
        raise UsageError(f"`scratch`: {where} cannot be written: {err.strerror}") from err
    with folder as name:
        yield Path(name).resolve()


def _remove_left(parent: Path, prefix: str) -> None:
    """Remove what killed runs of this user have left: their processes are not there any more."""
    if os.name == "nt":
        # There, asking for a process ends it.
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


class Room:
    """How many bytes of local copies there may be, shared by all that copy.

    Parameters
    ----------
    folder
        Where they are.
    most
        How many bytes; None: as many as are free.

    Attributes
    ----------
    listeners
        Called when bytes were given back.
    """

    def __init__(self, folder: Path, most: int | None) -> None:
        free = shutil.disk_usage(folder).free
        self.total = free if most is None else min(most, free)
        self.is_limited = most is not None and most <= free
        self.listeners: list[Callable[[], None]] = []
        self._reserved = 0
        self._lock = Lock()

    def reserve(self, size: int) -> bool:
        """Set bytes aside; False if there are not so many now. More than all is never there."""
        with self._lock:
            if self._reserved + size > self.total:
                return False
            self._reserved += size
            return True

    def release(self, size: int) -> None:
        """Give bytes back."""
        with self._lock:
            self._reserved -= size
        for listener in list(self.listeners):
            listener()

    def refusal(self, size: int, folder: Path) -> UsageError:
        """Return the error for copies for which there is never enough."""
        hint = "a larger `scratch_size`, or a part of the recordings"
        return UsageError(
            f"local copies of the sources take {size:,} bytes, there may be {self.total:,} in {folder}",
            hint=hint if self.is_limited else "`scratch` names a folder with more room",
        )


class Limit:
    """Ends a conversion when a folder becomes too large.

    Parameters
    ----------
    folder
        With the copies of the sources, and the result.
    most
        How many bytes may be in it.
    """

    def __init__(self, folder: Path, most: int) -> None:
        self._folder = folder
        self._most = most
        self._next = 0.0

    def watching(self, progress: Progress | None) -> Progress:
        """Return a function that looks, now and then, and tells of the progress."""

        def called(done: int, total: int, messages: int) -> None:
            began = time.monotonic()
            if began >= self._next:
                self.check()
                # Of very many files, looking takes a while.
                self._next = time.monotonic() + max(_LOOK_SECONDS, 20 * (time.monotonic() - began))
            if progress is not None:
                progress(done, total, messages)

        return called

    def check(self) -> None:
        """Raise ScratchError if it is too large."""
        size = 0
        for place, _, names in os.walk(self._folder):
            for name in names:
                with suppress(OSError):
                    size += os.lstat(os.path.join(place, name)).st_size  # noqa: PTH118  # very many, perhaps
        if size > self._most:
            raise ScratchError(
                f"the result, with the local copies of its sources, takes more than {self._most:,} bytes",
                hint="a larger `scratch_size`, or another folder for `scratch`",
            )
