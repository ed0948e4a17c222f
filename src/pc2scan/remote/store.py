"""Files and folders at URLs: their sizes and versions, reading and writing them, and errors in one line.

The stores' libraries only notice silence. A server that sends a byte now and then is never silent and never done, so
each transfer has a pace: in every minute 64 KiB arrive, or all that was asked for.
"""

from __future__ import annotations

import errno
import posixpath
import secrets
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import DestinationError, MissingError, OutputError, Pc2ScanError, RecordingError, UsageError
from pc2scan.files.source import changed_while_read

from .urls import LIBRARIES, shown_url, url_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: The slowest transfer: so many bytes, or all that are left, arrive in so many seconds.
LEAST_BYTES = 1 << 16
SLOWEST_SECONDS = 60.0

#: The share of these seconds that a request should take.
_USUAL_SHARE = 0.25


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
    """Call a method of a file system, and return its result.

    Raises
    ------
    TooSlowError
        If it does not keep the pace; it is cancelled then. File systems without a network take the time that they take.
    """
    if not fs.async_impl:
        return getattr(fs, name)(*args, **options)
    # fsspec has loaded both.
    from asyncio import run_coroutine_threadsafe  # noqa: PLC0415
    from concurrent.futures import wait  # noqa: PLC0415

    future = run_coroutine_threadsafe(getattr(fs, f"_{name}")(*args, **options), fs.loop)
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

#: Stores whose libraries show blocks of up to 32 MB only, so that the pace of a whole file cannot be judged.
_IN_BLOCKS = ("az", "abfs", "abfss")

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
_OTHER_NAME = "choose another name, or remove it with the store's own tools"
_AGAIN = "try again; if it fails again, check the network and the store"
_NO_ANSWER = "check the network, the host's name and, for your own store, its endpoint"


class StoredObject(NamedTuple):
    """A file of a store: its size, and its version, which changes if the file does; empty if the store has none."""

    size: int
    version: str


class RemotePath:
    """A file or a directory at a URL.

    Parameters
    ----------
    path
        A path for which `is_url` is true.

    Raises
    ------
    UsageError
        If a library is not installed.
    """

    def __init__(self, path: Path) -> None:
        self._url = url_of(path)
        self.scheme = self._url.partition(":")[0]
        #: The URL without secrets.
        self.shown = shown_url(self._url)
        try:
            from fsspec.core import url_to_fs  # noqa: PLC0415  # only an extra
        except ImportError as err:
            raise UsageError(
                "a URL needs the library fsspec, which is not installed",
                path=self.shown,
                hint=f"pip install 'pc2scan[remote]'{f' {self._library}' * bool(self._library)}",
            ) from err
        try:
            with self.translate_errors():
                # A listing that is cached by one thread lacks what another one writes meanwhile.
                self._fs, self.key = url_to_fs(self._url, use_listings_cache=False, **_patience(self.scheme))
        except ImportError as err:
            raise UsageError(
                f"{self.scheme}:// needs the library {self._library}, which is not installed",
                path=self.shown,
                hint=f"pip install {self._library}",
            ) from err

    @property
    def _library(self) -> str:
        return LIBRARIES[self.scheme]

    @property
    def name(self) -> str:
        """The last part of the path."""
        return PurePosixPath(self.shown).name

    @property
    def parent(self) -> str:
        """The URL of the folder, without secrets."""
        return self.shown.rstrip("/").rpartition("/")[0]

    @property
    def identity(self) -> tuple[object, str]:
        """What is equal for URLs of one object: the store, whatever its scheme is called, and the key."""
        return type(self._fs), posixpath.normpath(self.key)

    @property
    def folder(self) -> tuple[object, str]:
        """The `identity` of the folder."""
        return type(self._fs), posixpath.dirname(posixpath.normpath(self.key))

    @property
    def is_read_only(self) -> bool:
        """Whether files there can only be read."""
        return self.scheme in {"http", "https"}

    def stat(self) -> StoredObject:
        """Return the size of the file, and its version."""
        found = self._info(self.key)
        if found.get("size") is None:
            raise RecordingError(
                "the server does not report its size", path=self.shown, hint="download it, and convert the copy"
            )
        return _object(found)

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

    def _has_bucket(self) -> bool:
        """Return whether the bucket exists; True for stores without buckets."""
        if self.scheme in _GRADUAL:
            return True
        with self.translate_errors():
            return bool(call_in_time(self._fs, "exists", self.key.strip("/").partition("/")[0], pace=Pace()))

    def is_folder(self) -> bool:
        """Whether it is a folder: other keys begin with this one. True for the root of a store."""
        with self.translate_errors():
            return not call_in_time(self._fs, "isfile", self.key, pace=Pace())

    def child(self, below: str) -> RemotePath:
        """Return the place at a path relative to this folder."""
        return self._at(f"{self.key.rstrip('/')}/{below}", f"{self.shown.rstrip('/')}/{below}")

    def read(self) -> bytes | None:
        """Return the content of a small file; None if it does not exist."""
        with self.translate_errors():
            try:
                return bytes(self._fs.cat_file(self.key))
            except FileNotFoundError:
                return None

    def write(self, data: bytes, *, is_new: bool = False) -> bool:
        """Write a small file. With ``is_new``, return False if it exists already."""
        with self.translate_errors(writes=True):
            self._makedirs(self.key.rpartition("/")[0])
            try:
                self._fs.pipe_file(self.key, data, mode="create" if is_new else "overwrite")
            except FileExistsError:
                return False
            except OSError as err:
                # S3's answer if the file exists: the condition of the request is not fulfilled.
                if is_new and ("PreconditionFailed" in str(err) or "At least one of the pre-conditions" in str(err)):
                    return False
                raise
        return True

    def delete(self) -> None:
        """Remove a file if it exists."""
        with self.translate_errors(writes=True), suppress(FileNotFoundError):
            self._fs.rm_file(self.key)

    def _exists(self, key: str) -> bool:
        with self.translate_errors():
            return bool(call_in_time(self._fs, "exists", key, pace=Pace()))

    def _info(self, key: str) -> dict[str, Any]:
        with self.translate_errors():
            found: dict[str, Any] = call_in_time(self._fs, "info", key, pace=Pace())
        return found

    def files(self) -> dict[str, RemotePath] | None:
        """Return the files of a directory by name; None for a file."""
        if self._info(self.key).get("type") != "directory":
            return None
        with self.translate_errors():
            entries = self._fs.ls(self.key, detail=True)
        held = (entry for entry in entries if entry["type"] == "file")
        names = (str(entry["name"]) for entry in held)
        found = {name.rpartition("/")[2]: self._sibling(name) for name in sorted(names)}
        found.pop("", None)
        return found

    def _sibling(self, key: str) -> RemotePath:
        return self._at(key, f"{self.shown.rstrip('/')}/{key.rpartition('/')[2]}")

    def _at(self, key: str, shown: str) -> RemotePath:
        other: RemotePath = object.__new__(RemotePath)
        other.__dict__.update(self.__dict__, key=key, shown=shown)
        return other

    def bytes_at(self, start: int, stop: int) -> bytes | None:
        """Read a range of bytes; None if it is longer than `LEAST_BYTES`, and the transfer too slow for it."""
        with self.translate_errors():
            try:
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

    def download(self, target: Path, check: Callable[[], None] | None = None) -> StoredObject:
        """Download the file, and return its size and version; raises if it changes meanwhile, or arrives incomplete.

        ``check`` is called from time to time. If it raises, the download ends.
        """
        before = self.stat()
        pace = Pace()
        with self.translate_errors():
            if self.scheme in _IN_BLOCKS:
                self._fs.get_file(self.key, str(target), **_callback_options(check))
            else:
                options = _callback_options(check, pace.note_arrival)
                call_in_time(self._fs, "get_file", self.key, str(target), pace=pace, **options)
        if self.stat() != before:
            raise self.change_error()
        arrived = target.stat().st_size
        if arrived != before.size:
            raise RecordingError(
                f"the download was cut off: {arrived:,} of {before.size:,} bytes arrived",
                path=self.shown,
                hint=_AGAIN,
            )
        return before

    def change_error(self) -> RecordingError:
        """Return the error for a source that has changed."""
        return changed_while_read(self.shown)

    def upload(self, source: Path, name: str, check: Callable[[], None] | None = None) -> None:
        """Upload a directory into this folder, under a new name.

        Its metadata.yaml is uploaded last. Without this file readers do not take it for a recording, so an unfinished
        upload is never read.
        """
        key = f"{self.key.rstrip('/')}/{name}"
        files = sorted(
            (path for path in source.rglob("*") if path.is_file()),
            key=lambda file: (file.name == "metadata.yaml", file),
        )
        done: list[str] = []
        try:
            for file in files:
                done.append(f"{key}/{file.relative_to(source).as_posix()}")
                self._makedirs(done[-1].rpartition("/")[0])
                self._put(file, done[-1], check)
        except BaseException:
            self.remove(done)
            raise

    def upload_file(self, source: Path, name: str, check: Callable[[], None] | None = None) -> str:
        """Upload a file into this folder and return its key. It is visible only when it is complete."""
        key = f"{self.key.rstrip('/')}/{name}"
        self._makedirs(self.key)
        self._put(source, key, check)
        return key

    def refuse_existing(self, name: str, *, overwrite: bool) -> None:
        """Raise if this name exists in the folder and may not be replaced. Folders are never replaced."""
        key = f"{self.key.rstrip('/')}/{name}"
        shown = f"{self.shown.rstrip('/')}/{name}"
        if not self._exists(key):
            return
        with self.translate_errors():
            is_folder = call_in_time(self._fs, "isdir", key, pace=Pace())
        if is_folder:
            raise DestinationError("is a folder; folders in a store are never replaced", path=shown, hint=_OTHER_NAME)
        if not overwrite:
            raise DestinationError("exists already", path=shown, hint="`overwrite=True` replaces it")

    def remove(self, keys: list[str]) -> None:
        """Remove the files of a failed upload, as far as possible."""
        for key in keys:
            with suppress(Exception):
                self._fs.rm_file(key)

    def _makedirs(self, key: str) -> None:
        if self.scheme in _GRADUAL:
            with self.translate_errors(writes=True):
                self._fs.makedirs(key, exist_ok=True)

    def _put(self, source: Path, key: str, check: Callable[[], None] | None = None) -> None:
        """Upload a file. If the store shows unfinished uploads, the file has a temporary name until it is complete."""
        with self.translate_errors(writes=True):
            if self.scheme not in _GRADUAL:
                self._fs.put_file(str(source), key, **_callback_options(check))
                return
            folder, _, name = key.rpartition("/")
            partial = f"{folder}/.pc2scan-{secrets.token_hex(4)}-{name}"
            try:
                self._fs.put_file(str(source), partial)
                self._fs.mv(partial, key)
            finally:
                with suppress(Exception):
                    self._fs.rm_file(partial)

    @contextmanager
    def translate_errors(self, *, writes: bool = False) -> Iterator[None]:
        """Turn errors of fsspec and the stores' libraries into our own: one line, without secrets."""
        kind = OutputError if writes else RecordingError
        try:
            yield
        except (Pc2ScanError, ImportError):
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
    found = next((str(entry[name]) for name in _VERSION if entry.get(name) is not None), "")
    return StoredObject(int(entry.get("size") or 0), found.strip('"'))


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


def _callback_options(check: Callable[[], None] | None, arrived: Callable[[int], None] | None = None) -> dict[str, Any]:
    """Return the argument that lets fsspec call functions while it copies: ``arrived`` with the number of bytes."""
    if check is None and arrived is None:
        return {}
    from fsspec.callbacks import Callback  # noqa: PLC0415  # only an extra

    class ArrivalCallback(Callback):  # type: ignore[misc, unused-ignore]
        def call(self, *_names: object, **_values: object) -> None:
            if arrived is not None:
                arrived(self.value)
            if check is not None:
                check()

    return {"callback": ArrivalCallback()}
