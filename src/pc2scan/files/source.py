"""The file of a recording: read at given places, or written from start to end."""

from __future__ import annotations

import errno
import os
import stat
from contextlib import suppress
from typing import TYPE_CHECKING, TypeVar

from pc2scan.errors import OutputError, RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from io import TextIOWrapper
    from pathlib import Path
    from typing import BinaryIO

    from pc2scan.model import Buffer

    from ._map import Map

__all__ = ["FreeIds", "NewFile", "SourceFile", "file_beside", "opened_bytes", "opened_text", "state_of"]

_Result = TypeVar("_Result")

#: Fewer bytes are copied in less time than it takes to fetch their pages and to give them back, and more would count as
#: memory beside what is made of them.
_BORROWED_BYTES = range(1 << 18, 1 << 24)

#: What SQLite keeps beside a database that is written to.
_LOGS = ("-wal", "-journal")


def state_of(path: Path) -> tuple[tuple[str, int, int, int, int], ...]:
    """What shows whether a recording was changed: of each file the name, inode, size and both times of change.

    Anyone can set a file's modification time back (``cp -p``, ``rsync -t``, ``touch -r``), but not its ctime. The logs
    beside a database belong to it: a recorder that is still running may write to nothing else.
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


def file_beside(path: Path, suffix: str) -> Path | None:
    """Return the file whose name is that of another and ``suffix``, if it is there; with it a name may be too long."""
    side = path.with_name(path.name + suffix)
    with suppress(OSError):
        return side if side.is_file() else None
    return None


def opened_bytes(path: Path) -> BinaryIO:
    """Open a file to read it, if it is one: a FIFO would wait for a writer, and a device has no end.

    Raises
    ------
    OSError
        If it is not there or may not be read, or is neither a file nor a directory.
    """
    return open(path, "rb", opener=_opened)


def opened_text(path: Path) -> TextIOWrapper:
    """Open a file of UTF-8 text as `opened_bytes` does."""
    return open(path, encoding="utf-8", opener=_opened)


def _opened(path: str, flags: int) -> int:
    # Looked at before it is opened, which alone acts upon some devices, and after: it may have been replaced.
    _refuse_special(os.stat(path), path)  # noqa: PTH116  # an opener's paths are text
    descriptor = os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
    try:
        _refuse_special(os.fstat(descriptor), path)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _refuse_special(found: os.stat_result, path: str) -> None:
    """Raise if this is no file. Of a directory, opening it does."""
    kinds = {stat.S_ISFIFO: "FIFO", stat.S_ISSOCK: "socket", stat.S_ISCHR: "device", stat.S_ISBLK: "device"}
    for is_kind, name in kinds.items():
        if is_kind(found.st_mode):
            raise OSError(errno.EINVAL, f"it is a {name}, not a file; save it as a file first", path)


class SourceFile:
    """A file's bytes by their place: what is not there is an error, never a short answer.

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
        self._descriptor = -1
        self._map: Map | None = None
        try:
            self._descriptor = _opened(str(path), os.O_RDONLY | getattr(os, "O_CLOEXEC", 0))
            self.size = os.fstat(self._descriptor).st_size
        except OSError as err:
            self.close()
            raise self.error(f"cannot be opened: {err.strerror}") from err
        if self.size >= _BORROWED_BYTES.start:
            self._map = _map_of(self._descriptor, self.size)

    def expect(self, offset: int, length: int) -> None:
        """Let the system begin to read what is needed soon; where it cannot, nothing changes."""
        # What is there already would be looked for page by page: the last byte tells.
        with suppress(OSError, AttributeError):
            if os.preadv(self._descriptor, [bytearray(1)], offset + length - 1, os.RWF_NOWAIT):
                return
        with suppress(OSError, AttributeError):
            os.posix_fadvise(self._descriptor, offset, length, os.POSIX_FADV_WILLNEED)

    def close(self) -> None:
        """Release the file; reading afterwards is an error."""
        self._map = None
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def error(self, message: str, hint: str | None = None) -> RecordingError:
        """Make an error that names this file."""
        return RecordingError(message, path=self.path, hint=hint)

    def damage(self, message: str) -> Exception:
        """Make the error for bytes that are not there or not what they must be; formats say it in their own way."""
        return self.error(message)

    def read(self, offset: int, length: int) -> bytes:
        """Read exactly ``length`` bytes."""
        if offset + length > self.size:
            raise self.damage(f"{length} bytes are declared from byte {offset} on, but the file has {self.size} bytes")
        try:
            data = os.pread(self._descriptor, length, offset)
            # One call returns 2 GiB at most.
            while len(data) < length and (more := os.pread(self._descriptor, length - len(data), offset + len(data))):
                data += more
        except OSError as err:
            raise self.error(f"cannot be read at byte {offset}: {err.strerror}") from err
        except MemoryError as err:
            raise self.error(f"{length} bytes from byte {offset} on do not fit into memory") from err
        if len(data) < length:
            raise self.error(
                f"ended at byte {offset + len(data)} while it was read; it had {self.size} bytes when opened",
                "wait until the recording is complete",
            )
        return data

    def borrow(self, offset: int, length: int, callback: Callable[[memoryview], _Result]) -> _Result:
        """Call ``callback`` with exactly these bytes, where the system has them in memory: many are not copied.

        Parameters
        ----------
        offset, length
            The bytes' place.
        callback
            Keeps none of the bytes, unless they are those of a ``bytes`` (see `pc2scan.model.own`). If the file
            turns out to have become shorter, its result is dropped, and it is called again with what can be read.
        """
        mapped = self._map
        if mapped is not None and length in _BORROWED_BYTES and offset + length <= self.size:
            mapped.fetch(offset, length)
            try:
                result = callback(memoryview(mapped)[offset : offset + length])
            except Exception:
                if self._was_there(mapped, offset + length):
                    raise
            else:
                if self._was_there(mapped, offset + length):
                    return result
            finally:
                mapped.forget(offset, length)
        return callback(memoryview(self.read(offset, length)))

    def _was_there(self, mapped: Map, stop: int) -> bool:
        """Whether nothing up to this byte was missed; of a page that has become shorter nothing else tells."""
        try:
            return not mapped.missed and os.fstat(self._descriptor).st_size >= stop
        except OSError:
            return False


def _map_of(descriptor: int, size: int) -> Map | None:
    """A map of a file; None if there can be none: not compiled, another system or file system, or too many."""
    try:
        import resource  # noqa: PLC0415  # not on every system

        from ._map import Map  # noqa: PLC0415  # only large files need it

        # A map takes addresses.
        limited = resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
        return None if limited else Map(descriptor, size)
    except (ImportError, OSError, OverflowError):
        return None


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
        #: Where the next bytes come to lie.
        self.position = 0
        self._file = path.open("xb")

    def put(self, *parts: Buffer) -> int:
        """Write at the end; returns where that was."""
        start = self.position
        try:
            self._file.writelines(parts)
        except OSError as err:
            raise self._failed(err) from err
        self.position += sum(map(len, parts))
        return start

    def replace(self, offset: int, data: Buffer) -> None:
        """Write over what was written; nothing is put after that."""
        try:
            self._file.seek(offset)
            self._file.write(data)
        except OSError as err:
            raise self._failed(err) from err

    def finish(self) -> None:
        """Put everything on the disk."""
        try:
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
        except OSError as err:
            raise self._failed(err) from err

    def abort(self) -> None:
        """Release the file; what was written is left for the caller to remove."""
        # Closing writes what is buffered, and there may be no room for it: the reason for aborting.
        with suppress(OSError):
            self._file.close()

    def _failed(self, err: OSError) -> OutputError:
        return OutputError(f"cannot be written: {err.strerror}", path=self._path)


class FreeIds:
    """Ids for what is declared in a file: some are kept, all others are handed out from the first one on.

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
        """Hand these out to nobody but those who ask for them."""
        self._kept.update(ids)

    def take(self, wanted: int) -> int:
        """Return ``wanted`` if it is kept and nobody has it, else the next one that is neither kept nor taken."""
        if wanted in self._kept and wanted not in self._taken:
            self._taken.add(wanted)
            return wanted
        while self._next in self._kept:
            self._next += 1
        self._next += 1
        return self._next - 1
