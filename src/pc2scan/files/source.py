"""Reads the file of a recording at given places, and writes a new file from start to end."""

from __future__ import annotations

import errno
import os
import stat
from contextlib import suppress
from typing import TYPE_CHECKING
from weakref import WeakValueDictionary

from pc2scan.errors import OutputError, RecordingError

from .buffers import BorrowedBuffer, BorrowedBytes, BufferPool
from .system import BINARY, read_at

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from io import TextIOWrapper
    from pathlib import Path
    from typing import BinaryIO

    from pc2scan.model import Buffer

#: Sizes that are read into a reused buffer. Memory for fewer bytes costs no page faults, and a larger buffer would take
#: too much memory beside the results.
_BORROWED_BYTES = range(1 << 18, 1 << 24)

#: Endings of the files that SQLite keeps beside a database while it is written.
_LOGS = ("-wal", "-journal")

#: Functions that fetch the bytes of stand-ins, by path. They are called with the offset and length before each read.
on_demand: dict[Path, Callable[[int, int], None]] = {}

#: Bytes of a stand-in that are fetched when it is opened: the beginning identifies its format.
_HEAD_BYTES = 1 << 17


def state_of(path: Path) -> tuple[tuple[str, int, int, int, int], ...]:
    """Return the name, inode, size and both times of change of each file of a recording, to detect changes.

    The ctime is included because ``cp -p``, ``rsync -t`` and ``touch -r`` set a modification time back. Logs beside a
    database are included: a recorder that is still running may write only to these.
    """
    try:
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
    return RecordingError(
        "was changed while it was read", path=path, hint="wait until the recording is complete, or copy it"
    )


def file_beside(path: Path, suffix: str) -> Path | None:
    """Return the file with another file's name and ``suffix``; None if it does not exist or the name is too long."""
    side = path.with_name(path.name + suffix)
    with suppress(OSError):
        return side if side.is_file() else None
    return None


def open_bytes(path: Path) -> BinaryIO:
    """Open a file for reading; special files are refused, as a FIFO would wait for a writer and a device has no end.

    Raises
    ------
    OSError
        If it does not exist, may not be read, or is neither a file nor a directory.
    """
    if on_demand and (fetch := on_demand.get(path)) is not None:
        fetch(0, _HEAD_BYTES)
    return open(path, "rb", opener=_open_regular)


def open_text(path: Path) -> TextIOWrapper:
    """Open a file of UTF-8 text as `open_bytes` does."""
    return open(path, encoding="utf-8", opener=_open_regular)


def _open_regular(path: str, flags: int) -> int:
    # Checked before, because merely opening some devices has an effect; and after, because the file may be replaced.
    _refuse_special(os.stat(path), path)  # noqa: PTH116  # an opener's paths are text
    descriptor = os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
    try:
        _refuse_special(os.fstat(descriptor), path)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _refuse_special(found: os.stat_result, path: str) -> None:
    """Raise if this is a special file. For a directory, opening raises."""
    kinds = {stat.S_ISFIFO: "FIFO", stat.S_ISSOCK: "socket", stat.S_ISCHR: "device", stat.S_ISBLK: "device"}
    for is_kind, name in kinds.items():
        if is_kind(found.st_mode):
            raise OSError(errno.EINVAL, f"it is a {name}, not a file; save it as a file first", path)


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
        self._fetch = on_demand.get(path)
        self._descriptor = -1
        self._buffers = _shared.setdefault("", BufferPool())
        try:
            self._descriptor = _open_regular(str(path), os.O_RDONLY | BINARY | getattr(os, "O_CLOEXEC", 0))
            self.size = os.fstat(self._descriptor).st_size
        except OSError as err:
            self.close()
            raise self.error(f"cannot be opened: {err.strerror}") from err

    def end_at(self, size: int) -> None:
        """End the recording after this many bytes, where another one begins."""
        self.size = size

    def expect(self, offset: int, length: int) -> None:
        """Tell the system to read these bytes ahead, if it can."""
        # If the last byte is cached already, the call is skipped: it would look up each page.
        with suppress(OSError, AttributeError):
            if os.preadv(self._descriptor, [bytearray(1)], offset + length - 1, os.RWF_NOWAIT):
                return
        with suppress(OSError, AttributeError):
            os.posix_fadvise(self._descriptor, offset, length, os.POSIX_FADV_WILLNEED)

    def close(self) -> None:
        """Release the file; reading afterwards is an error."""
        self._buffers = BufferPool()
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def error(self, message: str, hint: str | None = None) -> RecordingError:
        """Return an error that names this file."""
        return RecordingError(message, path=self.path, hint=hint)

    def damage(self, message: str) -> Exception:
        """Return the error for missing or wrong bytes; formats override it."""
        return self.error(message)

    def read(self, offset: int, length: int) -> bytes:
        """Read exactly ``length`` bytes."""
        self._expect_inside(offset, length)
        if self._fetch is not None:
            self._fetch(offset, length)
        try:
            data = read_at(self._descriptor, length, offset)
            # A call may return fewer bytes than requested.
            while len(data) < length and (more := read_at(self._descriptor, length - len(data), offset + len(data))):
                data += more
        except OSError as err:
            raise self._unreadable(offset, err) from err
        except MemoryError as err:
            raise self._too_large(offset, length) from err
        if len(data) < length:
            raise self._truncation_error(offset + len(data))
        return data

    def borrow(self, offset: int, length: int) -> BorrowedBytes:
        """Read exactly these bytes; many bytes are read into a reused buffer.

        Parameters
        ----------
        offset, length
            The bytes' place.

        Returns
        -------
        BorrowedBytes
            Whoever keeps bytes for longer than this object copies them (`pc2scan.model.own_data`), because the buffer
            is overwritten afterwards; or keeps the buffer (`pc2scan.files.buffers.retain`).
        """
        if length not in _BORROWED_BYTES or not hasattr(os, "preadv"):
            return BorrowedBytes(memoryview(self.read(offset, length)), None)
        self._expect_inside(offset, length)
        try:
            borrowed = BorrowedBuffer(self._buffers, length)
        except MemoryError as err:
            raise self._too_large(offset, length) from err
        view = memoryview(borrowed.buffer)[:length]
        self._fill(view, offset)
        return BorrowedBytes(view.toreadonly(), borrowed)

    def _expect_inside(self, offset: int, length: int) -> None:
        if offset + length > self.size:
            raise self.damage(f"{length} bytes are declared from byte {offset} on, but the file has {self.size} bytes")

    def _fill(self, view: memoryview, offset: int) -> None:
        """Fill ``view`` with the bytes at a place of the file."""
        if self._fetch is not None:
            self._fetch(offset, len(view))
        done = 0
        try:
            while done < len(view) and (more := os.preadv(self._descriptor, [view[done:]], offset + done)):
                done += more
        except OSError as err:
            raise self._unreadable(offset, err) from err
        if done < len(view):
            raise self._truncation_error(offset + done)

    def _unreadable(self, offset: int, err: OSError) -> RecordingError:
        return self.error(f"cannot be read at byte {offset}: {err.strerror}")

    def _too_large(self, offset: int, length: int) -> RecordingError:
        return self.error(f"{length} bytes from byte {offset} on do not fit into memory")

    def _truncation_error(self, offset: int) -> RecordingError:
        return self.error(
            f"ended at byte {offset} while it was read; it had {self.size} bytes when opened",
            "wait until the recording is complete",
        )


#: The buffers. They are freed when no file is open any more.
_shared: WeakValueDictionary[str, BufferPool] = WeakValueDictionary()


class NewFile:
    """A file being written; every method that fails raises an `OutputError`.

    Parameters
    ----------
    path
        Must not exist.

    Raises
    ------
    OSError
        If it cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        #: The offset at which the next bytes are written.
        self.position = 0
        self._file = path.open("xb")

    def put(self, *parts: Buffer) -> int:
        """Write at the end, and return the offset."""
        start = self.position
        try:
            self._file.writelines(parts)
        except OSError as err:
            raise self._write_error(err) from err
        self.position += sum(map(len, parts))
        return start

    def replace(self, offset: int, data: Buffer) -> None:
        """Overwrite bytes; `put` may not be called after that."""
        try:
            self._file.seek(offset)
            self._file.write(data)
        except OSError as err:
            raise self._write_error(err) from err

    def finish(self) -> None:
        """Write everything to the disk."""
        try:
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
        except OSError as err:
            raise self._write_error(err) from err

    def abort(self) -> None:
        """Close the file; the caller removes it."""
        # Closing writes the buffered bytes, which may fail for the same reason as the run.
        with suppress(OSError):
            self._file.close()

    def _write_error(self, err: OSError) -> OutputError:
        return OutputError(f"cannot be written: {err.strerror}", path=self._path)


class FreeIds:
    """Assigns ids to the declarations of a file: reserved ones on request, and others counted from the first one on.

    Parameters
    ----------
    first
        The smallest id.
    """

    def __init__(self, first: int) -> None:
        self._next = first
        self._kept: set[int] = set()
        self._taken: set[int] = set()

    def keep(self, ids: Collection[int]) -> None:
        """Reserve these ids for callers that ask for them."""
        self._kept.update(ids)

    def take(self, wanted: int) -> int:
        """Return ``wanted`` if it is reserved and not taken, else the next id that is neither."""
        if wanted in self._kept and wanted not in self._taken:
            self._taken.add(wanted)
            return wanted
        while self._next in self._kept:
            self._next += 1
        self._next += 1
        return self._next - 1
