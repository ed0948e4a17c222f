"""Paths as users give them, which may be URLs: whatever reads or writes a path takes a URL. Every command imports it.

A `UrlPath` shows itself without secrets, and so does the `CopyPath` of what is fetched from there, so results and
messages name the URL. Sources are fetched into local copies; results are uploaded when they are complete. ``file:``
URLs become ordinary paths: see `local_path`. The stores' libraries only notice silence, so each download must also keep
a pace.
"""

from __future__ import annotations

import os
import posixpath
import shutil
import tempfile
from collections.abc import Iterable
from concurrent.futures import wait
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, cached_property
from os import PathLike
from pathlib import Path
from socket import gethostname
from time import monotonic
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple
from urllib.parse import unquote, urlsplit

from pc2scan.arguments import value_and_type
from pc2scan.errors import MissingError, OutputError, Pc2ScanError, RecordingError, UsageError
from pc2scan.text import size

from .system import files_below, is_full, private_folder, scratch

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator
    from typing import TypeAlias

    from typing_extensions import Self

    PathText: TypeAlias = str | PathLike[str]

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


def is_url(path: str | PathLike[str] | None) -> bool:
    """Return whether a path was given as a URL.

    >>> is_url("s3://bucket/drive.mcap"), is_url("s3/drive.mcap"), is_url(None)
    (True, False, False)
    """
    if path is None:
        return False
    # A Path has turned the two slashes of the URL into one.
    scheme, _, rest = os.fspath(path).replace(os.sep, "/").partition(":")
    return rest.startswith("/") and scheme in LIBRARIES


def path_or_url(text: str | PathLike[str]) -> Path:
    """Return the path that a text names: a `UrlPath` for a URL."""
    return UrlPath(text) if is_url(text) else Path(text)


def path_of(name: str, value: object) -> Path:
    """Return a path that was given as text or as an object; see `path_text`."""
    return path_or_url(path_text(name, value))


def path_text(name: str, value: object) -> str:
    """Return a path that was given as text or as an object, as text.

    A leading ``~`` is the home folder, as in a shell, unless a file with that name exists. A ``file:`` URL is the path
    that it names: see `local_path`.

    Parameters
    ----------
    name
        The name of the argument.
    value
        The argument.

    Raises
    ------
    TypeError
        If it is not a path.
    UsageError
        If it is empty.
    """
    text: object = os.fspath(value) if isinstance(value, str | PathLike) else value
    if not isinstance(text, str):
        hint = ", not an open file" if hasattr(value, "read") else ""
        raise TypeError(f"{name} is {value_and_type(value)}, it must be a path: str or pathlib.Path{hint}")
    text = local_path(text, f"`{name}`")
    if text.startswith("~") and not os.path.lexists(text):
        return os.path.expanduser(text)  # noqa: PTH111  # Path.expanduser fails where there is no such user
    return text


def local_path(text: str, name: str = "a source") -> str:
    """Return the path that a ``file:`` URL names, as RFC 8089 defines it; any other text is returned as it is.

    All code after this sees a path, so a file has no second kind of name. An empty text, which `pathlib.Path` takes for
    the folder ``.``, is an error; ``name`` says what it was given as.

    >>> local_path("file:///data/a%20b.bag"), local_path("file://localhost/a.bag"), local_path("FILE:/a.bag")
    ('/data/a b.bag', '/a.bag', '/a.bag')
    >>> local_path("s3://bucket/a%20b.bag"), local_path("file:a.bag")
    ('s3://bucket/a%20b.bag', 'file:a.bag')

    Raises
    ------
    UsageError
        If the text is empty, or the URL names another machine, has a query or a fragment, or a character that no path
        can have.
    """
    if not text:
        raise UsageError(f"{name} is an empty path", hint="was a variable empty?")
    scheme, _, rest = text.partition(":")
    if scheme.lower() != "file" or not rest.startswith("/"):
        return text
    url = urlsplit(text)
    is_here = url.netloc.lower() in {"", "localhost", gethostname().lower()}
    if not is_here or not url.path or set("?#") & set(rest) or any(code in rest.upper() for code in ("%00", "%2F")):
        hint = "it has three slashes, %3F for ? and %23 for #: file:///data/drive.bag"
        raise UsageError("is a URL that names no file of this machine", path=text, hint=hint)
    path = "/" + unquote(url.path, errors="surrogateescape").lstrip("/")
    # On Windows a drive follows the slash: file:///C:/data.
    return path[1:] if os.name == "nt" and path[2:3] == ":" else path


def paths_in(name: str, values: PathText | Iterable[PathText]) -> list[Path]:
    """Return the paths of an argument that takes one path or several.

    Raises
    ------
    TypeError
        If one of them is not a path.
    UsageError
        If there is none.
    """
    is_file = hasattr(values, "read")
    if is_file or isinstance(values, str | bytes | PathLike) or not isinstance(values, Iterable):
        return [path_of(name, values)]
    paths = [path_of(name, value) for value in values]
    if not paths:
        raise UsageError(f"{name} is empty: no recording was given")
    return paths


def absolute(path: Path) -> Path:
    """Return a path that is valid in other folders, too; links keep their names."""
    return path if isinstance(path, UrlPath) else Path(os.path.abspath(path))  # noqa: PTH100


def exists(path: Path) -> bool:
    """Return whether anything has this path; a link that leads nowhere counts."""
    return path.exists() if isinstance(path, UrlPath) else os.path.lexists(path)


def is_dir(path: Path) -> bool:
    """Return whether a path is a folder; False if that cannot be found out."""
    # Not Path.is_dir, which raises for some.
    return path.is_dir() if isinstance(path, UrlPath) else os.path.isdir(path)  # noqa: PTH112


def is_file(path: Path) -> bool:
    """Return whether a path is a file; False if that cannot be found out."""
    return path.is_file() if isinstance(path, UrlPath) else os.path.isfile(path)  # noqa: PTH113


def shown_url(url: str) -> str:
    """Return a URL without its parts that may be secret: user and password, and over HTTP query and fragment.

    In the other schemes ``?`` and ``#`` are characters of a name.

    >>> shown_url("https://me:secret@example.org/drive.mcap?signature=1"), shown_url("s3://bucket/drive #1?.mcap")
    ('https://example.org/drive.mcap', 's3://bucket/drive #1?.mcap')
    """
    scheme, _, rest = url.partition("://")
    if scheme in ("http", "https"):
        rest = rest.partition("#")[0].partition("?")[0]
    host, slash, path = rest.partition("/")
    return f"{scheme}://{host.rpartition('@')[2]}{slash}{path}"


# Up to Python 3.11, Path itself has no subclasses, only this has.
if TYPE_CHECKING:
    from pathlib import PosixPath as _LocalPath
else:
    _LocalPath = type(Path())


class UrlPath(_LocalPath):
    """A file or a folder at a URL.

    Its text is the URL without secrets; `os.fspath` returns the whole URL. Methods that look something up raise the
    errors of `pc2scan.errors`, not OSErrors. Nothing is a link there. What is read is fetched first: see
    `fetched`.
    """

    @property
    def url(self) -> str:
        """The whole URL, with secrets."""
        scheme, _, rest = super().__str__().replace(os.sep, "/").partition(":")
        return f"{scheme}://{rest.lstrip('/')}"

    def __str__(self) -> str:
        return shown_url(self.url)

    def __fspath__(self) -> str:
        return self.url

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.url,)

    @property
    def name(self) -> str:
        """The last part, over HTTP without the query."""
        return str(self).rstrip("/").rpartition("/")[2]

    @property
    def scheme(self) -> str:
        """The scheme, such as ``s3``."""
        return self.url.partition(":")[0]

    @property
    def is_read_only(self) -> bool:
        """Whether files there can only be read."""
        return self.scheme in {"http", "https"}

    @property
    def identity(self) -> UrlPath:
        """A path that is equal for URLs of one object, however they are written."""
        return UrlPath(f"{self.scheme}:/{posixpath.normpath(str(self).partition('://')[2])}")

    def absolute(self) -> Self:
        """Return the path itself."""
        return self

    @cached_property
    def _store(self) -> tuple[Any, str]:
        """The file system of fsspec, and what it calls the file; a UsageError if a library is not installed."""
        scheme = self.scheme
        try:
            import fsspec  # noqa: PLC0415  # only an extra

            with translated_errors(self):
                # A listing that is cached by one thread lacks what another one writes meanwhile.
                options = _patience(scheme, fsspec.config.conf.get(scheme, {}))
                file_system, key = fsspec.url_to_fs(self.url, use_listings_cache=False, **options)
        except ImportError as err:
            hint = f'pip install "pc2scan[remote]" {LIBRARIES[scheme]}'.rstrip()
            raise UsageError(f"{scheme}:// needs a library that is not installed", path=self, hint=hint) from err
        return file_system, key

    @cached_property
    def entry(self) -> StoredObject:
        """What is there: from a listing, or else from the store; raises MissingError if nothing is."""
        file_system, key = self._store
        with translated_errors(self):
            stored = stored_object(call(file_system, "info", key))
        if stored.size < 0:
            hint = "download it, and convert the copy"
            raise RecordingError("the server does not report its size", path=self, hint=hint)
        return stored

    def exists(self, *, follow_symlinks: bool = True) -> bool:  # noqa: ARG002  # the signature of Path
        """Return whether anything is there."""
        try:
            return bool(self.entry)
        except MissingError:
            return False

    def is_dir(self, *, follow_symlinks: bool = True) -> bool:  # noqa: ARG002  # the signature of Path
        """Return whether it is a folder."""
        return self.exists() and self.entry.is_folder

    def is_file(self, *, follow_symlinks: bool = True) -> bool:  # noqa: ARG002  # the signature of Path
        """Return whether it is a file."""
        return self.exists() and not self.entry.is_folder

    def iterdir(self) -> Generator[Self]:
        """Yield what is in a folder."""
        yield from self.listed("ls", self)

    def listed(self, method: str, place: UrlPath) -> Generator[Self]:
        """Yield what ``ls`` or ``glob`` of fsspec lists of a place in this folder, in order, without hidden files.

        Long listings take long: only silence ends them.
        """
        (file_system, key), folder = place._store, self._store[1].strip("/")
        with translated_errors(self):
            listing = getattr(file_system, method)(key, detail=True)
        objects = listing.values() if isinstance(listing, dict) else listing
        named = {str(each["name"]).strip("/").removeprefix(folder).lstrip("/"): each for each in objects}
        for name in sorted(named):
            # Some stores list the folder itself, as an empty file.
            if name and "/." not in f"/{name}":
                child = self / name
                child.entry = stored_object(named[name])
                yield child

    def download(self, target: Path) -> None:
        """Write the whole file to a local one; an error if it does not have the size that the store says."""
        file_system, key = self._store
        size = self.entry.size

        def arrived(*, is_all: bool = False) -> int:
            received = target.stat().st_size if target.exists() else 0
            if received > size or (is_all and received < size):
                message = f"the download failed: the server declares {size:,} bytes, and {received:,} arrived"
                raise RecordingError(message, path=self, hint=AGAIN)
            return received

        with translated_errors(self):
            call(file_system, "get_file", key, os.fspath(target), arrived=arrived)
            arrived(is_all=True)

    def upload(self, source: Path) -> None:
        """Upload a file. It is visible when it is complete."""
        file_system, key = self._store
        with translated_errors(self, OutputError):
            file_system.put_file(os.fspath(source), key)

    def delete(self) -> None:
        """Remove a file if it exists."""
        file_system, key = self._store
        with translated_errors(self, OutputError), suppress(FileNotFoundError):
            file_system.rm_file(key)


class CopyPath(_LocalPath):
    """The local copy of what is at a URL, or a path in it; its text is the URL without secrets."""

    #: The folders that have copies, and what is shown in place of each. Errors show it also after a copy is removed.
    _shown: ClassVar[dict[str, str]] = {}

    @classmethod
    def of(cls, url: UrlPath, folder: str) -> Self:
        """Return the path of a copy in a folder of its own."""
        cls._shown[folder] = str(url).rstrip("/").removesuffix(url.name)
        return cls(folder, url.name)

    def __str__(self) -> str:
        text = folder = os.fspath(self)
        while folder != (folder := os.path.dirname(folder)):  # noqa: PTH120  # Path's own uses the text
            if folder in self._shown:
                return self._shown[folder] + text[len(folder) + 1 :].replace(os.sep, "/")
        return text

    def __fspath__(self) -> str:
        return super().__str__()

    def __reduce__(self) -> tuple[Any, ...]:
        return path_or_url, (str(self),)

    def iterdir(self) -> Generator[Self]:
        """Yield what is in a folder."""
        return (self / name for name in os.listdir(self))  # noqa: PTH208  # Path's own uses the text


# --- Copies of sources, and uploads ---


@contextmanager
def fetched(paths: Iterable[Path]) -> Iterator[list[Path]]:
    """Fetch what is at URLs, and yield the paths with local copies in place of URLs, which are removed at the end.

    Raises
    ------
    MissingError
        If nothing is at a URL.
    RecordingError
        If it cannot be fetched, or there is no room: the sizes of all are counted before the first is fetched.
    """
    paths = list(paths)
    sources = {path: _files_of(path) for path in paths if isinstance(path, UrlPath)}
    refuse_without_room(sum(file.entry.size for files in sources.values() for file in files), next(iter(sources), None))
    with ExitStack() as stack:
        copies: dict[Path, Path] = {}
        for path, files in sources.items():
            place = Path(stack.enter_context(private_folder(path)))
            copies[path] = CopyPath.of(path, str(place))
            if path.entry.is_folder:
                place /= path.name
                place.mkdir()
            for file in files:
                file.download(place / file.name)
        yield [copies.get(path, path) for path in paths]


def _files_of(path: UrlPath) -> list[UrlPath]:
    """Return the files in a folder, or a file with the logs beside a database."""
    if path.entry.is_folder:
        return [file for file in path.iterdir() if file.is_file()]
    logs = [path.with_name(path.name + suffix) for suffix in ("-wal", "-journal") if path.suffix == ".db3"]
    return [path, *(log for log in logs if not path.is_read_only and log.exists())]


def refuse_without_room(needed: int, path: Path | None, hint: str = NO_SPACE) -> None:
    """Raise if so many bytes have no room in the folder for local copies."""
    folder = scratch.get() or Path(tempfile.gettempdir())
    # If there is no such folder, making the copy raises.
    with suppress(OSError):
        if needed > (free := shutil.disk_usage(folder).free):
            message = f"no space for local copies: {size(needed)} are fetched, and {folder} has room for {size(free)}"
            raise RecordingError(message, path=path, hint=hint)


def upload(local: Path, dst: UrlPath) -> None:
    """Upload a complete file or folder.

    Raises
    ------
    OutputError
        If it cannot be written. What was uploaded of a folder is removed.
    """
    if not local.is_dir():
        dst.upload(local)
        return
    begun: list[UrlPath] = []
    try:
        # A recording is complete when its metadata.yaml is there.
        for name in sorted(files_below(local), key=lambda name: name.endswith("metadata.yaml")):
            begun.append(dst / name)
            begun[-1].upload(local / name)
    except BaseException:
        for place in begun:
            with suppress(Exception):
                place.delete()
        raise


# --- The stores' libraries ---


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
