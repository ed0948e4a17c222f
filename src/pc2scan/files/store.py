"""What is in stores: sizes and versions of files, their bytes by ranges, uploads, and errors in one line.

The stores' libraries only notice silence. A server that sends a byte now and then is never silent and never done, so
each transfer has a pace: in every minute 64 KiB arrive, or all that was asked for.
"""

from __future__ import annotations

import errno
import os
import secrets
from contextlib import contextmanager, suppress
from io import BufferedReader, RawIOBase
from tempfile import TemporaryFile
from threading import Condition, Lock
from time import monotonic
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, cast
from weakref import WeakValueDictionary, finalize

from pc2scan.errors import MissingError, OutputError, Pc2ScanError, RecordingError, UsageError

from .system import read_at, scratch, write_at

if TYPE_CHECKING:
    from asyncio import AbstractEventLoop
    from collections.abc import Callable, Coroutine, Iterator
    from pathlib import Path


#: The slowest transfer: so many bytes, or all that are left, arrive in so many seconds.
LEAST_BYTES = 1 << 16
SLOWEST_SECONDS = 60.0

#: The share of these seconds that a request should take.
_USUAL_SHARE = 0.25


#: Bytes are fetched in blocks of this size. Their transfer takes little time compared with the request itself.
_BLOCK = LEAST_BYTES

#: Maximum number of blocks in a request.
_MOST_BLOCKS = 1 << 9

#: What a block is: missing, there, or fetched by a thread.
_MISSING, _THERE, _COMING = 0, 1, 2


class NoRangesError(Exception):
    """A server does not send parts of files."""


class TooSlowError(Exception):
    """A transfer is too slow; the place that is read makes an error for users of it."""

    def __init__(self) -> None:
        super().__init__(f"fewer than {LEAST_BYTES:,} bytes arrived in {SLOWEST_SECONDS:g} seconds")


class Pace:
    """The time until which the next `LEAST_BYTES` of a transfer must have arrived.

    Parameters
    ----------
    clock
        Returns the time, seconds.
    """

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._clock = clock
        self._counted = 0
        self._deadline = clock() + SLOWEST_SECONDS

    def note_arrival(self, total: int) -> None:
        """Note how many bytes have arrived since the beginning."""
        if total - self._counted >= LEAST_BYTES:
            self._counted = total
            self._deadline = self._clock() + SLOWEST_SECONDS

    def seconds_left(self) -> float:
        """Return the seconds that are left.

        Raises
        ------
        TooSlowError
            If there are none.
        """
        left = self._deadline - self._clock()
        if left <= 0:
            raise TooSlowError
        return left


def request_size(size: int, seconds: float) -> int:
    """Return how many bytes a request may ask for, given how long one of this size took.

    >>> request_size(65_536, 0.1), request_size(65_536, 30)
    (9830400, 32768)
    """
    return int(size * _USUAL_SHARE * SLOWEST_SECONDS / max(seconds, 1e-6))


def call_in_time(fs: Any, name: str, *args: object, pace: Pace, **options: Any) -> Any:
    """Call a method of a file system, and return its result; see `wait_in_time`.

    File systems without a network take the time that they take.
    """
    if not fs.async_impl:
        return getattr(fs, name)(*args, **options)
    return wait_in_time(getattr(fs, f"_{name}")(*args, **options), fs.loop, pace)


def wait_in_time(work: Coroutine[Any, Any, Any], loop: AbstractEventLoop, pace: Pace) -> Any:
    """Run a coroutine in a loop of another thread, and return its result.

    Raises
    ------
    TooSlowError
        If it does not keep the pace; it is cancelled then.
    """
    # fsspec has loaded both.
    from asyncio import run_coroutine_threadsafe  # noqa: PLC0415
    from concurrent.futures import wait  # noqa: PLC0415

    future = run_coroutine_threadsafe(work, loop)
    try:
        while not future.done():
            # An interruption by the user waits for as long.
            wait([future], timeout=min(1, pace.seconds_left()))
        return future.result()
    finally:
        future.cancel()


#: Attributes that distinguish versions of an object, the best first. Stores differ in which of these they have.
_VERSION = (
    *("ETag", "etag", "md5Hash", "generation", "mtime", "LastModified", "last_modified", "Last-Modified"),
    *("Content-MD5", "created"),
)

#: Stores in which an unfinished upload is visible. There, files get their names when they are complete.
_GRADUAL = ("memory",)

#: Timeouts in seconds: for a connection, and for the next bytes.
_CONNECT_SECONDS, _READ_SECONDS = 10, 20

_DENIED = (401, 403)
_NOT_FOUND = 404
_SERVER_ERROR = 500

#: Names of the stores' libraries' errors for transfers that have ended too early.
_CUT = ("ClientPayloadError", "IncompleteRead", "ResponseStreamingError", "ServerDisconnected", "ConnectionClosedError")
#: Names of their errors for hosts that do not answer.
_UNREACHABLE = ("ClientConnector", "EndpointConnectionError", "ConnectTimeout", "ConnectionRefused", "gaierror")

_NO_RIGHTS = (
    "check the permissions, and the credentials that the store's own tools use (environment, configuration files)"
)
_AGAIN = "try again; if it fails again, check the network and the store"
_NO_ANSWER = "check the network, the host's name and, for your own store, its endpoint"


class StoredObject(NamedTuple):
    """A file or a folder of a store.

    Attributes
    ----------
    size
        Its bytes; -1 if the server does not report them.
    version
        Text that changes if the file does; empty if the store has none.
    is_folder
        Whether it is a folder.
    """

    size: int
    version: str
    is_folder: bool = False


class RemotePath:
    """The place of a file or a folder in a store.

    Parameters
    ----------
    url, shown
        The URL, and the URL without secrets.
    library
        The library that fsspec needs for its scheme.

    Raises
    ------
    UsageError
        If a library is not installed.
    """

    def __init__(self, url: str, shown: str, library: str) -> None:
        self.url = url
        self.scheme = url.partition(":")[0]
        self.shown = shown
        try:
            from fsspec.core import url_to_fs  # noqa: PLC0415  # only an extra
        except ImportError as err:
            raise UsageError(
                "a URL needs the library fsspec, which is not installed",
                path=shown,
                hint=f'pip install "pc2scan[remote]"{f" {library}" * bool(library)}',
            ) from err
        try:
            with self.translate_errors():
                # A listing that is cached by one thread lacks what another one writes meanwhile.
                self._fs, self.key = url_to_fs(url, use_listings_cache=False, **_patience(self.scheme))
        except ImportError as err:
            raise UsageError(
                f"{self.scheme}:// needs the library {library}, which is not installed",
                path=shown,
                hint=f"pip install {library}",
            ) from err

    def entry(self) -> StoredObject:
        """Return what is there now."""
        try:
            found = _object(self._call("info"))
        except MissingError:
            if not self._has_bucket():
                raise MissingError("there is no such bucket", path=self.shown, hint=_NO_RIGHTS) from None
            raise
        if found.size < 0:
            raise RecordingError(
                "the server does not report its size", path=self.shown, hint="download it, and convert the copy"
            )
        return found

    def children(self) -> dict[str, StoredObject]:
        """Return the files and folders in a folder, by name."""
        with self.translate_errors():
            entries = self._fs.ls(self.key, detail=True)
        found = {str(entry["name"]).rstrip("/").rpartition("/")[2]: _object(entry) for entry in entries}
        own = self.key.strip("/").rpartition("/")[2]
        # Some stores list the folder itself, as an empty file.
        return {name: found[name] for name in sorted(found) if name and (found[name].size or name != own)}

    def below(self) -> dict[str, StoredObject]:
        """Return all files below a folder, by their paths relative to it; empty if there are none."""
        with self.translate_errors():
            try:
                found = self._fs.find(self.key, detail=True)
            except FileNotFoundError:
                if self._has_bucket():
                    return {}
                raise
        if not found and not self._has_bucket():
            raise MissingError("there is no such bucket", path=self.shown, hint=_NO_RIGHTS)
        start = self.key.strip("/")
        objects = {}
        for key, entry in found.items():
            below = str(key).strip("/").removeprefix(start).lstrip("/")
            if below and not str(key).endswith("/") and entry.get("type") == "file":
                objects[below] = _object(entry)
        return objects

    def matches(self, folder: str) -> dict[str, StoredObject]:
        """Return what the key matches as a pattern, by paths relative to a folder; without hidden names."""
        with self.translate_errors():
            found = self._fs.glob(self.key, detail=True)
        start = folder.strip("/")
        below = {str(key).strip("/").removeprefix(start).lstrip("/"): _object(entry) for key, entry in found.items()}
        return {
            name: entry for name, entry in below.items() if not any(part.startswith(".") for part in name.split("/"))
        }

    def _has_bucket(self) -> bool:
        """Return whether the bucket exists; True for stores without buckets."""
        if self.scheme in {*_GRADUAL, "http", "https"}:
            return True
        with self.translate_errors():
            return bool(call_in_time(self._fs, "exists", self.key.strip("/").partition("/")[0], pace=Pace()))

    def _call(self, name: str, **options: Any) -> Any:
        with self.translate_errors():
            return call_in_time(self._fs, name, self.key, pace=Pace(), **options)

    def read(self) -> bytes:
        """Return the content of a small file."""
        return bytes(self._call("cat_file"))

    def write(self, data: bytes) -> None:
        """Write a small file."""
        with self.translate_errors(writes=True):
            self._makedirs()
            self._fs.pipe_file(self.key, data)

    def delete(self) -> None:
        """Remove a file if it exists."""
        with self.translate_errors(writes=True), suppress(FileNotFoundError):
            self._fs.rm_file(self.key)

    def upload(self, source: Path) -> None:
        """Upload a file. It is visible only when it is complete."""
        with self.translate_errors(writes=True):
            self._makedirs()
            if self.scheme not in _GRADUAL:
                self._fs.put_file(str(source), self.key)
                return
            # This store shows unfinished uploads, so the file has a temporary name until it is complete.
            folder, _, name = self.key.rpartition("/")
            partial = f"{folder}/.pc2scan-{secrets.token_hex(4)}-{name}"
            try:
                self._fs.put_file(str(source), partial)
                self._fs.mv(partial, self.key)
            finally:
                with suppress(Exception):
                    self._fs.rm_file(partial)

    def _makedirs(self) -> None:
        """Make the folder of a file, where folders are not only a part of names."""
        if self.scheme in _GRADUAL:
            self._fs.makedirs(self.key.rpartition("/")[0], exist_ok=True)

    def ranges(self) -> RangeFile:
        """Return the bytes of the file; all who read it at a time share them."""
        with _open_lock:
            found = _open_files.get(self.url)
            if found is None:
                found = _open_files[self.url] = RangeFile(self, self.entry())
        return found

    def bytes_at(self, start: int, stop: int) -> bytes | None:
        """Read a range of bytes; None if it is longer than `LEAST_BYTES`, and the transfer too slow for it.

        Raises
        ------
        NoRangesError
            If the server sends only the whole file.
        """
        with self.translate_errors():
            try:
                if self.scheme in {"http", "https"}:
                    data = self._web_bytes_at(start, stop)
                else:
                    data = bytes(call_in_time(self._fs, "cat_file", self.key, start=start, end=stop, pace=Pace()))
            except TooSlowError:
                if stop - start > LEAST_BYTES:
                    return None
                raise
        if len(data) != stop - start:
            raise RecordingError(
                f"the server sent {len(data)} bytes instead of {stop - start}: it does not serve ranges, or the file "
                "changed",
                path=self.shown,
                hint="download it, and convert the copy",
            )
        return data

    def _web_bytes_at(self, start: int, stop: int) -> bytes:
        # Unlike `cat_file`, it does not read the whole file from a server that knows no ranges.
        file = self._fs.open(self.key, size=stop)
        try:
            return bytes(wait_in_time(file.async_fetch_range(start, stop), self._fs.loop, Pace()))
        except ValueError as err:
            raise NoRangesError from err

    def download(self, target: BinaryIO) -> None:
        """Write the whole file of a web server into another file."""
        pace = Pace()
        with self.translate_errors():
            call_in_time(self._fs, "get_file", self.key, target, pace=pace, callback=_callback(pace.note_arrival))

    @contextmanager
    def translate_errors(self, *, writes: bool = False) -> Iterator[None]:
        """Turn errors of fsspec and the stores' libraries into our own: one line, without secrets."""
        kind = OutputError if writes else RecordingError
        try:
            yield
        except (Pc2ScanError, NoRangesError, ImportError):
            raise
        except FileNotFoundError as err:
            # fsspec raises this for every error status of a web server, not only for 404.
            if err.__cause__ is not None and getattr(err.__cause__, "status", 0) != _NOT_FOUND:
                raise self._error(err.__cause__, kind, writes=writes) from None
            if writes:
                raise OutputError("there is no such bucket or folder", path=self.shown, hint=_NO_RIGHTS) from None
            if "bucket does not exist" in str(err):
                raise MissingError("there is no such bucket", path=self.shown, hint=_NO_RIGHTS) from None
            hint = "check its spelling (case matters); some stores also answer this if permissions are missing"
            raise MissingError("does not exist", path=self.shown, hint=hint) from None
        except Exception as err:  # noqa: BLE001  # each store's library has errors of its own
            raise self._error(err, kind, writes=writes) from None

    def _error(self, err: BaseException, kind: type[Pc2ScanError], *, writes: bool) -> Pc2ScanError:
        """Return our error for one of a store's library.

        The text of that error is not shown, because it may have the URL with its signature.
        """
        name, status = type(err).__name__, _status(err)
        if isinstance(err, FileNotFoundError):
            return kind("does not exist", path=self.shown)
        if "NoSuchBucket" in name:
            return (kind if writes else MissingError)("there is no such bucket", path=self.shown, hint=_NO_RIGHTS)
        if isinstance(err, PermissionError) or status in _DENIED or "Credential" in name:
            return kind(f"access is refused ({status or 403}, or no credentials)", path=self.shown, hint=_NO_RIGHTS)
        if isinstance(err, OSError) and err.errno == errno.ENOSPC:
            return kind("no space for its local copy", path=self.shown, hint="give another disk's folder as `scratch`")
        if name.startswith(_UNREACHABLE):
            return kind(f"the host cannot be reached ({name})", path=self.shown, hint=_NO_ANSWER)
        if isinstance(err, TooSlowError):
            return kind(f"the transfer is too slow to finish: {err}", path=self.shown, hint=_AGAIN)
        if "Timeout" in name:
            return kind(f"the store does not answer in time ({name})", path=self.shown, hint=_NO_ANSWER)
        does = "upload" if writes else "download"
        if name.startswith(_CUT):
            return kind(f"the {does} was cut off ({name})", path=self.shown, hint=_AGAIN)
        if status is not None and status >= _SERVER_ERROR:
            return kind(f"the store reports an internal error (status {status})", path=self.shown, hint=_AGAIN)
        does = "written" if writes else "read"
        return kind(f"cannot be {does}: {f'status {status}' if status else name}", path=self.shown, hint=_NO_ANSWER)


def _object(entry: dict[str, Any]) -> StoredObject:
    version = next((str(entry[name]) for name in _VERSION if entry.get(name) is not None), "")
    is_folder = entry.get("type") == "directory"
    size = 0 if is_folder else -1 if entry.get("size") is None else int(entry["size"])
    return StoredObject(size, version.strip('"'), is_folder)


def _patience(scheme: str) -> dict[str, Any]:
    """Return options with timeouts for a store, unless the user has configured them.

    By default S3 takes minutes to give up, and a web server's file may not take longer than five minutes.
    """
    from fsspec.config import conf  # noqa: PLC0415  # only an extra

    if conf.get(scheme):
        return {}
    if scheme in {"s3", "s3a"}:
        # No retries of the S3 library: s3fs itself tries five times.
        config = {"connect_timeout": _CONNECT_SECONDS, "read_timeout": _READ_SECONDS, "retries": {"max_attempts": 0}}
        return {"config_kwargs": config}
    if scheme in {"http", "https"}:
        with suppress(ImportError):
            from aiohttp import ClientTimeout  # noqa: PLC0415  # only where it is needed

            timeout = ClientTimeout(total=None, sock_connect=_CONNECT_SECONDS, sock_read=_READ_SECONDS)
            return {"client_kwargs": {"timeout": timeout}}
    return {}


def _status(err: BaseException) -> int | None:
    """Return the HTTP status that an error reports; None if it has none."""
    status = getattr(err, "status", None)
    if status is None:
        response = getattr(err.__cause__, "response", None)
        status = response.get("ResponseMetadata", {}).get("HTTPStatusCode") if isinstance(response, dict) else None
    return status if isinstance(status, int) else None


def _callback(arrived: Callable[[int], None]) -> Any:
    """Return what lets fsspec call a function while it copies, with the number of bytes."""
    from fsspec.callbacks import Callback  # noqa: PLC0415  # only an extra

    class ArrivalCallback(Callback):  # type: ignore[misc, unused-ignore]
        def call(self, *_names: object, **_values: object) -> None:
            arrived(self.value)

    return ArrivalCallback()


class RangeFile:
    """The bytes of a file at a URL, in a temporary file of the same size: each is fetched when it is first read.

    Any thread may read. The temporary file has no name (on POSIX), so nothing of it is left after a crash.

    Parameters
    ----------
    place
        The file.
    found
        Its size and version.

    Attributes
    ----------
    size
        Bytes of the file.
    step
        The number of bytes of which multiples are fetched: a multiple of the block. It is large while the file is read
        ahead, so that the thread that needs bytes does not run before the threads that read ahead, in small steps.
    """

    def __init__(self, place: RemotePath, found: StoredObject) -> None:
        if found.is_folder:
            raise RecordingError("is a folder, not a file", path=place.shown)
        self._place = place
        self.size = found.size
        self.step = _BLOCK
        self._state = bytearray(-(-found.size // _BLOCK))
        self._changed = Condition()
        self._download_lock = Lock()
        self._is_downloaded = False
        self._failure: Pc2ScanError | None = None
        #: Blocks in the next request.
        self._most = _MOST_BLOCKS
        try:
            self._file = TemporaryFile(prefix="pc2scan-", dir=scratch.get())  # noqa: SIM115  # closed with this object
            finalize(self, self._file.close)
            self._file.truncate(found.size)
        except OSError as err:
            raise self._no_copy(err) from err

    def _download(self) -> None:
        """Fetch the file as a whole, once."""
        with self._download_lock:
            if self._failure is not None:
                # Another thread has just tried it.
                raise self._failure
            if not self._is_downloaded:
                try:
                    self._file.seek(0)
                    self._place.download(self._file)
                    self._file.flush()
                    if (arrived := self._file.tell()) != self.size:
                        raise RecordingError(
                            f"the download was cut off: {arrived:,} of {self.size:,} bytes arrived",
                            path=self._place.shown,
                            hint=_AGAIN,
                        )
                except Pc2ScanError as err:
                    self._failure = err
                    raise
                self._is_downloaded = True
        with self._changed:
            self._state[:] = bytes([_THERE]) * len(self._state)
            self._changed.notify_all()

    def _no_copy(self, err: OSError) -> RecordingError:
        hint = "set the environment variable TMPDIR to a folder with enough space, or give one as `scratch`"
        return RecordingError(f"no local copy can be written: {err.strerror}", path=self._place.shown, hint=hint)

    def descriptor(self) -> int:
        """Return a descriptor of the temporary file, which the caller closes. What is read must be fetched before."""
        return os.dup(self._file.fileno())

    def open(self) -> BinaryIO:
        """Return the file opened for reading."""
        return cast("BinaryIO", BufferedReader(_RangeReader(self), _BLOCK))

    def fetch(self, offset: int, length: int) -> None:
        """Fetch those of these bytes that are missing, and wait for those that another thread fetches."""
        first = offset // self.step * self.step // _BLOCK
        last = min(-(-(offset + length) // self.step) * self.step // _BLOCK, len(self._state))
        while (run := self._claim(first, last)) is not None:
            try:
                self._request(*run)
            finally:
                with self._changed:
                    # What has not arrived, because of an error or a slow network, is missing again.
                    self._state[run[0] : run[1]] = self._state[run[0] : run[1]].replace(b"\2", b"\0")
                    self._changed.notify_all()

    def _claim(self, block: int, last: int) -> tuple[int, int] | None:
        """Return the next missing blocks, which this thread fetches; None if all are there."""
        with self._changed:
            while True:
                first = self._state.find(_MISSING, block, last)
                if first >= 0:
                    stop = next((n for n in range(first, last) if self._state[n] != _MISSING), last)
                    stop = min(stop, first + self._most)
                    self._state[first:stop] = bytes([_COMING]) * (stop - first)
                    return first, stop
                if self._state.find(_COMING, block, last) < 0:
                    return None
                # Without a timeout, Ctrl-C would wait on Windows.
                self._changed.wait(1)

    def _request(self, first: int, stop: int) -> None:
        began = monotonic()
        try:
            data = self._place.bytes_at(first * _BLOCK, min(stop * _BLOCK, self.size))
        except NoRangesError:
            self._download()
            return
        if data is None:
            self._most = 1
            return
        self._most = max(1, min(request_size(len(data), monotonic() - began) // _BLOCK, _MOST_BLOCKS))
        try:
            write_at(self._file.fileno(), data, first * _BLOCK)
        except OSError as err:
            raise self._no_copy(err) from err
        with self._changed:
            self._state[first:stop] = bytes([_THERE]) * (stop - first)


class _RangeReader(RawIOBase):
    """Reads a `RangeFile` from any position on."""

    def __init__(self, file: RangeFile) -> None:
        self._file = file
        self._position = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = 0) -> int:
        self._position = max(0, offset + (0, self._position, self._file.size)[whence])
        return self._position

    def tell(self) -> int:
        return self._position

    def readinto(self, buffer: Any) -> int:
        length = max(0, min(len(buffer), self._file.size - self._position))
        self._file.fetch(self._position, length)
        data = read_at(self._file._file.fileno(), length, self._position)  # noqa: SLF001
        buffer[: len(data)] = data
        self._position += len(data)
        return len(data)


#: Files at URLs that are open, by URL.
_open_files: WeakValueDictionary[str, RangeFile] = WeakValueDictionary()
_open_lock = Lock()
