"""What `pc2scan.files.urls` needs of fsspec: its file systems, calls that do not hang, and errors in one line.

The stores' libraries only notice silence, so each download must also keep a pace.
"""

from __future__ import annotations

from concurrent.futures import wait
from contextlib import contextmanager
from functools import cache
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import MissingError, OutputError, Pc2ScanError, RecordingError, UsageError

from .system import is_full

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: The library that fsspec needs for a scheme; empty if it needs none.
LIBRARIES = {"s3": "s3fs", "gs": "gcsfs", "az": "adlfs", "https": "aiohttp", "http": "aiohttp", "memory": ""}

#: The slowest transfer: so many bytes, or all that are left, arrive in so many seconds.
LEAST_BYTES = 1 << 16
SLOWEST_SECONDS = 60.0

#: Attributes that distinguish versions of an object, the best first. Stores differ in which of these they have.
_VERSION = ("ETag", "etag", "generation", "Last-Modified", "created")

_DENIED, _NOT_FOUND = (401, 403), 404

_NO_RIGHTS = (
    "check the permissions, and the credentials that the store's own tools use (environment, configuration files)"
)
AGAIN = "try again; if it fails again, check the network and the store"
NO_SPACE = "set the environment variable TMPDIR to a folder with enough space, or give one as `scratch`"


class TransferError(Exception):
    """A transfer is too slow, or a web server names another host."""


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


def open_store(url: str, shown: str) -> tuple[Any, str]:
    """Return the file system of fsspec for a URL, and what it calls the file there.

    Parameters
    ----------
    url, shown
        The URL, and the URL without secrets.

    Raises
    ------
    UsageError
        If a library is not installed.
    """
    scheme = url.partition(":")[0]
    try:
        import fsspec  # noqa: PLC0415  # only an extra

        with translated_errors(shown):
            # A listing that is cached by one thread lacks what another one writes meanwhile.
            options = _patience(scheme, fsspec.config.conf.get(scheme, {}))
            file_system, key = fsspec.url_to_fs(url, use_listings_cache=False, **options)
    except ImportError as err:
        hint = f'pip install "pc2scan[remote]" {LIBRARIES[scheme]}'.rstrip()
        raise UsageError(f"{scheme}:// needs a library that is not installed", path=shown, hint=hint) from err
    return file_system, key


def call(file_system: Any, name: str, *args: str, arrived: Callable[[], int] = int) -> Any:
    """Call a method of a file system; it ends if fewer than `LEAST_BYTES` arrive in `SLOWEST_SECONDS`."""
    if not file_system.async_impl:
        return getattr(file_system, name)(*args)
    # fsspec has loaded it; all that reads no URL would take 5 MB for it.
    from asyncio import run_coroutine_threadsafe  # noqa: PLC0415

    future = run_coroutine_threadsafe(getattr(file_system, f"_{name}")(*args), file_system.loop)
    try:
        wanted = deadline = 0.0
        while not wait([future], 1).done:
            if (done := arrived()) >= wanted:
                wanted, deadline = done + LEAST_BYTES, monotonic() + SLOWEST_SECONDS
            elif monotonic() > deadline:
                least = f"fewer than {LEAST_BYTES:,} bytes arrived in {SLOWEST_SECONDS:g} seconds"
                raise TransferError(f"the transfer is too slow to finish: {least}")
        return future.result()
    finally:
        future.cancel()


@contextmanager
def translated_errors(shown: object, kind: type[Pc2ScanError] = RecordingError) -> Iterator[None]:
    """Turn errors of fsspec and the stores' libraries into our own: one line, without secrets."""
    try:
        yield
    except (Pc2ScanError, ImportError):
        raise
    except Exception as err:  # noqa: BLE001  # each store's library has errors of its own
        raise _translated(err, str(shown), kind) from None


def stored_object(found: dict[str, Any]) -> StoredObject:
    """Return what fsspec says of a file or a folder."""
    version = next((str(found[name]) for name in _VERSION if found.get(name) is not None), "")
    is_folder = found.get("type") == "directory"
    size = 0 if is_folder else -1 if found.get("size") is None else int(found["size"])
    return StoredObject(size, version.strip('"'), is_folder)


def _patience(scheme: str, configured: dict[str, Any]) -> dict[str, Any]:
    """Return options of a store with our patience; what the user has configured wins.

    By default S3 takes minutes to give up, and a web server's file may not take longer than five minutes.
    """
    if scheme in {"http", "https"}:
        name, ours = "client_kwargs", _web_client()
    elif scheme == "s3":
        # No retries of the S3 library: s3fs itself tries five times.
        name, ours = "config_kwargs", {"connect_timeout": 10, "read_timeout": 20, "retries": {"max_attempts": 0}}
    else:
        return {}
    return {name: ours | configured.get(name, {})}


@cache
def _web_client() -> dict[str, Any]:
    """Return the options of aiohttp's client: no timeout beside `SLOWEST_SECONDS`, no redirects to other hosts."""
    from aiohttp import ClientTimeout, TraceConfig  # noqa: PLC0415  # only where it is needed

    async def stay(_session: object, _context: object, redirect: Any) -> None:
        response = redirect.response
        target = response.url.join(type(response.url)(response.headers.get("Location", "")))
        if target.host != response.url.host:
            raise TransferError(f"the server redirects to another host, {target.host}")

    traces = TraceConfig()
    traces.on_request_redirect.append(stay)
    # What a server compresses would have another size than it declares.
    headers = {"Accept-Encoding": "identity"}
    return {"timeout": ClientTimeout(total=None), "trace_configs": [traces], "headers": headers}


def _translated(err: BaseException, shown: str, kind: type[Pc2ScanError]) -> Pc2ScanError:
    """Return our error for one of a store's library. Its text is not shown: it may have the URL with its signature."""
    response = getattr(cause := err.__cause__, "response", None)
    # fsspec raises FileNotFoundError for every error of a web server, not only for 404.
    if isinstance(err, FileNotFoundError) and cause and response is None and getattr(cause, "status", 0) != _NOT_FOUND:
        err = cause
    metadata = response.get("ResponseMetadata", {}) if isinstance(response, dict) else {}
    name, status = type(err).__name__, getattr(err, "status", metadata.get("HTTPStatusCode"))
    if isinstance(err, FileNotFoundError) or "NoSuchBucket" in name:
        if kind is OutputError:
            return kind("there is no such bucket or folder", path=shown, hint=_NO_RIGHTS)
        hint = "check its spelling (case matters), and the bucket's; some stores answer this if permissions are missing"
        return MissingError("does not exist", path=shown, hint=hint)
    if isinstance(err, TransferError):
        return kind(str(err), path=shown, hint=AGAIN)
    if isinstance(err, PermissionError) or status in _DENIED or "Credential" in name:
        return kind(f"access is refused ({status or 403}, or no credentials)", path=shown, hint=_NO_RIGHTS)
    if is_full(err):
        return kind("no space for its local copy", path=shown, hint=NO_SPACE)
    what = f"status {status}" if status else "no answer in time" if "Timeout" in name else name
    return kind(f"the {'upload' if kind is OutputError else 'download'} failed ({what})", path=shown, hint=AGAIN)
