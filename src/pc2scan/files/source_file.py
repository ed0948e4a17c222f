"""Reads the file of a recording at given offsets: into new bytes, or into buffers that are used again."""

from __future__ import annotations

import errno
import os
import stat
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from io import TextIOWrapper
from typing import TYPE_CHECKING, TypeVar
from weakref import ref

from pc2scan.errors import RecordingError, UsageError
from pc2scan.text import nearest

from .system import BINARY, read_at
from .urls import UrlPath, fetched

if TYPE_CHECKING:
    from collections.abc import Callable
    from io import BufferedReader
    from pathlib import Path

#: Sizes that are read into a reused buffer. Memory for fewer bytes costs no page faults, and a larger buffer would take
#: too much memory beside the results.
_BORROWED_BYTES = range(1 << 18, 1 << 24)

#: The first bytes of the file that Git LFS has in place of one that was not fetched; and what to type.
LFS_POINTER = b"version https://"
LFS_HINT = "git lfs pull fetches it"

#: Endings of the files that SQLite keeps beside a database while it is written.
_LOGS = ("-wal", "-journal")


def state_of(path: Path) -> tuple[tuple[str, int, int, int, int], ...]:
    """Return the name, inode, size and both times of change of each file of a recording, to detect changes.

    The ctime is included because ``cp -p``, ``rsync -t`` and ``touch -r`` set a modification time back. Logs beside a
    database are included: a recorder that is still running may write only to these. What is at a URL is fetched before
    it is read, and has no state.
    """
    try:
        if isinstance(path, UrlPath):
            return ()
        if path.is_dir():
            files = sorted(path.iterdir())
        else:
            files = [path, *(side for suffix in _LOGS if (side := file_beside(path, suffix)))]
        states = [(file.name, file.stat()) for file in files]
    except OSError:
        return ()
    return tuple((name, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns) for name, state in states)


def changed_while_read(path: Path | str) -> RecordingError:
    """Return the error for a recording that was changed while it was read."""
    hint = "wait until the recording is complete, or copy it"
    return RecordingError("was changed while it was read", path=path, hint=hint)


def file_beside(path: Path, suffix: str) -> Path | None:
    """Return the file with another file's name and ``suffix``; None if it does not exist or the name is too long."""
    side = path.with_name(path.name + suffix)
    # Not Path.is_file: the name may be too long.
    return side if os.path.isfile(side) else None  # noqa: PTH113


def open_bytes(path: Path) -> BufferedReader:
    """Open a file for reading; special files are refused, as a FIFO would wait for a writer and a device has no end.

    Raises
    ------
    OSError
        If it does not exist, may not be read, or is neither a file nor a directory.
    """
    if isinstance(path, UrlPath):
        with fetched([path]) as (copy,):
            return open_bytes(copy)
    return open(path, "rb", opener=_open_regular)


def open_text(path: Path) -> TextIOWrapper:
    """Open a text file in UTF-8 as `open_bytes` does; a pointer of Git LFS in its place is an error."""
    file = open_bytes(path)
    if file.peek(len(LFS_POINTER)).startswith(LFS_POINTER):
        file.close()
        raise UsageError("is a Git LFS pointer, not the file itself", path=path, hint=LFS_HINT)
    return TextIOWrapper(file, encoding="utf-8")


def _open_regular(path: str, flags: int) -> int:
    """Open a file; a special file is not even opened, which may have an effect. For a directory, opening raises."""
    mode = os.stat(path).st_mode  # noqa: PTH116  # an opener's paths are text
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.EINVAL, "it is a FIFO, a socket or a device, not a file; save it as a file first", path)
    return os.open(path, flags)


#: Buffers have multiples of this size, so that one serves chunks of different sizes.
_ROUNDED_TO = 1 << 16

#: Buffers that are used again: of stored bytes, and of decompressed ones, which are larger.
STORED: deque[bytearray] = deque(maxlen=8)
UNPACKED: deque[bytearray] = deque(maxlen=8)


def lend(size: int, pool: deque[bytearray] = UNPACKED) -> memoryview:
    """Return writable memory for so many bytes; that of less than 16 MiB is used again.

    That is when nothing refers to it any more: no view, no array, no message.
    """
    if size >= _BORROWED_BYTES.stop:
        return memoryview(bytearray(size))
    buffer = _free_one(size, pool)
    if buffer is None:
        buffer = bytearray(-(-size // _ROUNDED_TO) * _ROUNDED_TO)
    view = memoryview(buffer)[:size]
    # The oldest one leaves a full pool: its views keep it.
    pool.append(buffer)
    return view


def _free_one(size: int, pool: deque[bytearray]) -> bytearray | None:
    """Take a buffer that nothing refers to out of a pool; other threads do not see it meanwhile.

    The newest one is taken, so that a pool grows no further than to what is in use. Those that are too small leave it.
    """
    with suppress(IndexError):
        for _ in range(len(pool)):
            buffer = pool.pop()
            try:
                # Its size cannot change while there are views of it.
                buffer.append(buffer.pop())
            except BufferError:
                pool.appendleft(buffer)
            else:
                if len(buffer) >= size:
                    return buffer
    return None


_Opened = TypeVar("_Opened")

#: What was opened last. The rest is closed as soon as nothing reads it, and opened again when it is read: a recording
#: may have more parts than a process may have open files.
_recent: deque[object] = deque(maxlen=32)


def keep_open(opened: _Opened) -> ref[_Opened]:
    """Keep something open until many others were opened, or nobody uses it any more; it closes when it is deleted."""
    _recent.append(opened)
    return ref(opened)


@dataclass(eq=False)
class _Descriptor:
    """A descriptor of an open file, which is closed with this object."""

    number: int

    def close(self) -> None:
        """Close it; reading is an error from now on."""
        number, self.number = self.number, -1
        if number >= 0:
            os.close(number)

    __del__ = close


class SourceFile:
    """Reads a file's bytes at given places; too few bytes are an error, never a short result.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    RecordingError
        If it cannot be opened; while reading, if the system refuses or the file has become shorter.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._opened: Callable[[], _Descriptor | None]
        # The working directory may change before it is opened again.
        self._place = os.fspath(path.absolute())
        descriptor, self._status = self._open()
        self._opened, self.size = keep_open(descriptor), self._status.st_size

    def _open(self) -> tuple[_Descriptor, os.stat_result]:
        try:
            descriptor = _Descriptor(_open_regular(self._place, os.O_RDONLY | BINARY | getattr(os, "O_CLOEXEC", 0)))
            return descriptor, os.fstat(descriptor.number)
        except OSError as err:
            raise self.error(f"cannot be opened: {err.strerror}") from err

    def _file(self) -> _Descriptor:
        """Return the open file; it is opened again if it was closed for others."""
        descriptor = self._opened()
        if descriptor is None:
            descriptor, status = self._open()
            if not os.path.samestat(status, self._status):
                raise changed_while_read(self.path)
            self._opened = keep_open(descriptor)
        return descriptor

    def expect(self, offset: int, length: int) -> None:
        """Tell the system to read these bytes ahead, if it can."""
        descriptor = self._file().number
        with suppress(OSError, AttributeError):
            os.posix_fadvise(descriptor, offset, length, os.POSIX_FADV_WILLNEED)

    def close(self) -> None:
        """Release the file; reading afterwards is an error."""
        if (descriptor := self._opened()) is not None:
            descriptor.close()

    def error(self, message: str, hint: str | None = None) -> RecordingError:
        """Return an error that names this file."""
        return RecordingError(message, path=self.path, hint=hint)

    def damage(self, message: str) -> Exception:
        """Return the error for missing or wrong bytes; formats override it."""
        return self.error(message)

    def read(self, offset: int, length: int) -> bytes:
        """Read exactly ``length`` bytes."""
        pieces: list[bytes] = []

        def read(descriptor: int, done: int) -> int:
            pieces.append(read_at(descriptor, length - done, offset + done))
            return len(pieces[-1])

        self._read_all(offset, length, read)
        return b"".join(pieces)

    def borrow(self, offset: int, length: int) -> memoryview:
        """Read exactly these bytes; many bytes are read into a buffer that is used again: see `lend`."""
        if length not in _BORROWED_BYTES or not hasattr(os, "preadv"):
            return memoryview(self.read(offset, length))
        view = lend(length, STORED)
        self._read_all(offset, length, lambda descriptor, done: os.preadv(descriptor, [view[done:]], offset + done))
        return view.toreadonly()

    def _read_all(self, offset: int, length: int, read: Callable[[int, int], int]) -> None:
        """Call ``read`` with a descriptor and the number of bytes that were read, until it has read all."""
        if offset + length > self.size:
            raise self.damage(f"{length} bytes are declared from byte {offset} on, but the file has {self.size} bytes")
        file, done = self._file(), 0
        try:
            # A call may read fewer bytes than requested.
            while done < length and (more := read(file.number, done)):
                done += more
        except OSError as err:
            raise self.error(f"cannot be read at byte {offset}: {err.strerror}") from err
        if done < length:
            message = f"ended at byte {offset + done} while it was read; it had {self.size} bytes when opened"
            raise self.error(message, "wait until the recording is complete")


# --- Paths that do not exist ---


def missing_hint(path: Path) -> str | None:
    """Return a hint for a path that does not exist: the target of a broken link, or a similar name; else None."""
    if str(path) == "-":
        return "recordings cannot be read from a pipe; save it as a file first"
    # Not Path.is_symlink: the name may be too long.
    if os.path.islink(path):  # noqa: PTH114
        return f"it is a link to {path.readlink()}, which does not exist"
    try:
        names = sorted(name for name in os.listdir(path.parent) if not name.startswith("."))  # noqa: PTH208  # faster
    except OSError:
        return None
    # The name without its suffix, or the partial file of an interrupted run.
    similar = next((name for name in names if name.startswith(f"{path.name}.")), None) or nearest(path.name, names)
    return None if similar is None else f"did you mean {path.parent / similar}?"
