"""What is at URLs, with fsspec: listings, downloads, uploads, and errors in one line.

The stores' libraries only notice silence, so each download must also keep a pace.
"""

from __future__ import annotations

import errno
import os
from concurrent.futures import wait
from contextlib import contextmanager, suppress
from functools import cache
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import MissingError, OutputError, Pc2ScanError, RecordingError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

#: The slowest transfer: so many bytes, or all that are left, arrive in so many seconds.
LEAST_BYTES = 1 << 16
SLOWEST_SECONDS = 60.0

#: Timeouts in seconds: for a connection, and for the next bytes.
_CONNECT_SECONDS, _READ_SECONDS = 10, 20

#: Attributes that distinguish versions of an object, the best first. Stores differ in which of these they have.
_VERSION = (
    *("ETag", "etag", "md5Hash", "generation", "mtime", "LastModified", "last_modified", "Last-Modified"),
    *("Content-MD5", "created"),
)

_DENIED = (401, 403)
_NOT_FOUND = 404

#: Names of the stores' libraries' errors for hosts that do not answer.
_UNREACHABLE = ("ClientConnector", "EndpointConnectionError", "ConnectTimeout", "ConnectionRefused", "gaierror")

_NO_RIGHTS = (
    "check the permissions, and the credentials that the store's own tools use (environment, configuration files)"
)
_AGAIN = "try again; if it fails again, check the network and the store"
NO_SPACE = "set the environment variable TMPDIR to a folder with enough space, or give one as `scratch`"


class TooSlowError(Exception):
    """A transfer is too slow."""


class RedirectError(Exception):
    """A web server names another host."""


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
        self.shown = shown
        scheme = url.partition(":")[0]
        try:
            import fsspec  # noqa: PLC0415  # only an extra

            with self._translated_errors():
                # A listing that is cached by one thread lacks what another one writes meanwhile.
                options = _patience(scheme, fsspec.config.conf.get(scheme, {}))
                self._fs, self.key = fsspec.url_to_fs(url, use_listings_cache=False, **options)
        except ImportError as err:
            raise UsageError(
                f"{scheme}:// needs a library that is not installed",
                path=shown,
                hint=f'pip install "pc2scan[remote]" {library}'.rstrip(),
            ) from err

    def entry(self) -> StoredObject:
        """Return what is there now.

        Raises
        ------
        MissingError
            If nothing is there.
        """
        stored = _object(self._call("info"))
        if stored.size < 0:
            hint = "download it, and convert the copy"
            raise RecordingError("the server does not report its size", path=self.shown, hint=hint)
        return stored

    def listed(self, method: str, folder: str = "") -> dict[str, StoredObject]:
        """Return what ``ls``, ``find`` or ``glob`` of fsspec lists, by paths relative to a folder; default: this one.

        Long listings take long: only silence ends them.
        """
        with self._translated_errors():
            listing = getattr(self._fs, method)(self.key, detail=True)
        start = (folder or self.key).strip("/")
        objects = {
            str(each["name"]).strip("/").removeprefix(start).lstrip("/"): _object(each)
            for each in (listing.values() if isinstance(listing, dict) else listing)
        }
        # Some stores list the folder itself, as an empty file.
        return {name: objects[name] for name in sorted(objects) if name}

    def read(self, end: int | None = None) -> bytes:
        """Return the content of a small file, or its first bytes."""
        return bytes(self._call("cat_file", end=end))

    def write(self, data: bytes) -> None:
        """Write a small file."""
        with self._translated_errors(writes=True):
            self._fs.pipe_file(self.key, data)

    def delete(self) -> None:
        """Remove a file if it exists."""
        with self._translated_errors(writes=True), suppress(FileNotFoundError):
            self._fs.rm_file(self.key)

    def upload(self, source: Path) -> None:
        """Upload a file. It is visible when it is complete."""
        with self._translated_errors(writes=True):
            self._fs.put_file(os.fspath(source), self.key)

    def download(self, target: Path, size: int) -> None:
        """Write the whole file to a local one; an error if it does not have ``size`` bytes."""

        def arrived() -> int:
            received = target.stat().st_size if target.exists() else 0
            if received > size:
                message = f"the server sends more than the {size:,} bytes that it declares"
                raise RecordingError(message, path=self.shown, hint=_AGAIN)
            return received

        self._call("get_file", os.fspath(target), arrived=arrived)
        if arrived() < size:
            message = f"the download was cut off: {arrived():,} of {size:,} bytes arrived"
            raise RecordingError(message, path=self.shown, hint=_AGAIN)

    def _call(self, name: str, *args: object, arrived: Callable[[], int] = int, **options: Any) -> Any:
        """Call a method of the file system; it ends if fewer than `LEAST_BYTES` arrive in `SLOWEST_SECONDS`."""
        with self._translated_errors():
            if not self._fs.async_impl:
                return getattr(self._fs, name)(self.key, *args, **options)
            # fsspec has loaded it; all that reads no URL would take 5 MB for it.
            from asyncio import run_coroutine_threadsafe  # noqa: PLC0415

            work = getattr(self._fs, f"_{name}")(self.key, *args, **options)
            future = run_coroutine_threadsafe(work, self._fs.loop)
            try:
                wanted = deadline = 0.0
                while not wait([future], 1).done:
                    if (done := arrived()) >= wanted:
                        wanted, deadline = done + LEAST_BYTES, monotonic() + SLOWEST_SECONDS
                    elif monotonic() > deadline:
                        raise TooSlowError
                return future.result()
            finally:
                future.cancel()

    @contextmanager
    def _translated_errors(self, *, writes: bool = False) -> Iterator[None]:
        """Turn errors of fsspec and the stores' libraries into our own: one line, without secrets."""
        try:
            yield
        except (Pc2ScanError, ImportError):
            raise
        except Exception as err:  # noqa: BLE001  # each store's library has errors of its own
            kind, message, hint = _meaning(err, writes=writes)
            raise kind(message, path=self.shown, hint=hint) from None


def _object(found: dict[str, Any]) -> StoredObject:
    version = next((str(found[name]) for name in _VERSION if found.get(name) is not None), "")
    is_folder = found.get("type") == "directory"
    size = 0 if is_folder else -1 if found.get("size") is None else int(found["size"])
    return StoredObject(size, version.strip('"'), is_folder)


def _patience(scheme: str, configured: dict[str, Any]) -> dict[str, Any]:
    """Return options with timeouts for a store; what the user has configured wins.

    By default S3 takes minutes to give up, and a web server's file may not take longer than five minutes.
    """
    if scheme in {"http", "https"}:
        name, ours = "client_kwargs", _web_client(_CONNECT_SECONDS, _READ_SECONDS)
    elif scheme in {"s3", "s3a"}:
        # No retries of the S3 library: s3fs itself tries five times.
        ours = {"connect_timeout": _CONNECT_SECONDS, "read_timeout": _READ_SECONDS, "retries": {"max_attempts": 0}}
        name = "config_kwargs"
    else:
        return {}
    return {name: ours | configured.get(name, {})}


@cache
def _web_client(connect_seconds: float, read_seconds: float) -> dict[str, Any]:
    """Return the options of aiohttp's client: its timeouts, and what refuses redirects to other hosts."""
    from aiohttp import ClientTimeout, TraceConfig  # noqa: PLC0415  # only where it is needed

    async def stay(_session: object, _context: object, redirect: Any) -> None:
        response = redirect.response
        target = response.url.join(type(response.url)(response.headers.get("Location", "")))
        if target.host != response.url.host:
            raise RedirectError(target.host)

    traces = TraceConfig()
    traces.on_request_redirect.append(stay)
    timeout = ClientTimeout(total=None, sock_connect=connect_seconds, sock_read=read_seconds)
    # What a server compresses would have another size than it declares.
    return {"timeout": timeout, "trace_configs": [traces], "headers": {"Accept-Encoding": "identity"}}


def _meaning(err: BaseException, *, writes: bool) -> tuple[type[Pc2ScanError], str, str]:
    """Return which of our errors a store's library means, with message and hint.

    The text of its error is not shown, because it may have the URL with its signature.
    """
    # fsspec raises FileNotFoundError for every error of a web server, not only for 404.
    cause = err.__cause__
    is_web = cause is not None and not hasattr(cause, "response")
    if isinstance(err, FileNotFoundError) and is_web and getattr(cause, "status", 0) != _NOT_FOUND:
        err = cause or err
    kind: type[Pc2ScanError] = OutputError if writes else RecordingError
    name, status = type(err).__name__, _status(err)
    if isinstance(err, FileNotFoundError) or "NoSuchBucket" in name:
        if writes:
            return kind, "there is no such bucket or folder", _NO_RIGHTS
        hint = "check its spelling (case matters), and the bucket's; some stores answer this if permissions are missing"
        return MissingError, "does not exist", hint
    if isinstance(err, RedirectError):
        return kind, f"the server redirects to another host, {err}", "give the URL of that host, if you trust it"
    if isinstance(err, PermissionError) or status in _DENIED or "Credential" in name:
        return kind, f"access is refused ({status or 403}, or no credentials)", _NO_RIGHTS
    if isinstance(err, OSError) and err.errno == errno.ENOSPC:
        return kind, "no space for its local copy", NO_SPACE
    if isinstance(err, TooSlowError):
        least = f"fewer than {LEAST_BYTES:,} bytes arrived in {SLOWEST_SECONDS:g} seconds"
        return kind, f"the transfer is too slow to finish: {least}", _AGAIN
    if name.startswith(_UNREACHABLE):
        return kind, f"the host cannot be reached ({name})", _AGAIN
    if "Timeout" in name:
        return kind, f"the store does not answer in time ({name})", _AGAIN
    what = f"status {status}" if status else name
    return kind, f"the {'upload' if writes else 'download'} failed ({what})", _AGAIN


def _status(err: BaseException) -> int | None:
    """Return the HTTP status that an error reports; None if it has none."""
    status = getattr(err, "status", None)
    if status is None:
        response = getattr(err.__cause__, "response", None)
        status = response.get("ResponseMetadata", {}).get("HTTPStatusCode") if isinstance(response, dict) else None
    return status if isinstance(status, int) else None
