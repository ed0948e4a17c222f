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
from contextlib import ExitStack, contextmanager, suppress
from functools import cached_property
from operator import itemgetter
from os import PathLike
from pathlib import Path
from platform import node
from time import monotonic
from typing import TYPE_CHECKING, Any, ClassVar
from urllib.parse import unquote, urlsplit

from pc2scan.arguments import value_and_type
from pc2scan.errors import MissingError, OutputError, Pc2ScanError, RecordingError, UsageError
from pc2scan.text import size

from .system import files_below, private_folder, scratch

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator
    from typing import TypeAlias

    from typing_extensions import Self

    PathText: TypeAlias = str | PathLike[str]

#: The library that fsspec needs for a scheme; empty if it needs none.
LIBRARIES = {"s3": "s3fs", "gs": "gcsfs", "az": "adlfs", "https": "aiohttp", "http": "aiohttp", "memory": ""}

#: The slowest transfer, on average: so many bytes arrive in so many seconds.
LEAST_BYTES = 1 << 16
SLOWEST_SECONDS = 60.0

#: Attributes that distinguish versions of an object, the best first. Stores differ in which of these they have.
_VERSION = ("ETag", "etag", "generation", "Last-Modified", "created")

_NOT_FOUND = 404

_AGAIN = "try again; if it fails again, check the network, and your permissions and credentials for the store"
_NO_SPACE = "set the environment variable TMPDIR to a folder with enough space, or give one as `scratch`"


def is_url(path: str | PathLike[str]) -> bool:
    """Return whether a path was given as a URL.

    >>> is_url("s3://bucket/drive.mcap"), is_url("s3/drive.mcap")
    (True, False)
    """
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
    is_here = url.netloc.lower() in {"", "localhost", node().lower()}
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
    if hasattr(values, "read") or isinstance(values, str | bytes | PathLike) or not isinstance(values, Iterable):
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
        """Return the URL without its parts that may be secret: user and password, and over HTTP query and fragment.

        In the other schemes ``?`` and ``#`` are characters of a name.
        """
        scheme, _, rest = self.url.partition("://")
        if self.is_read_only:
            rest = rest.partition("#")[0].partition("?")[0]
        host, slash, path = rest.partition("/")
        return f"{scheme}://{host.rpartition('@')[2]}{slash}{path}"

    def __fspath__(self) -> str:
        return self.url

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

    @cached_property
    def store(self) -> tuple[Any, str]:
        """The file system of fsspec, and what it calls the file; a UsageError if a library is not installed."""
        scheme = self.scheme
        try:
            import fsspec  # noqa: PLC0415  # only an extra

            with translated_errors(self):
                # A listing that is cached by one thread lacks what another one writes meanwhile.
                options = _options(scheme, fsspec.config.conf.get(scheme, {}))
                file_system, key = fsspec.url_to_fs(self.url, use_listings_cache=False, **options)
        except ImportError as err:
            hint = f'pip install "pc2scan[remote]" {LIBRARIES[scheme]}'.rstrip()
            raise UsageError(f"{scheme}:// needs a library that is not installed", path=self, hint=hint) from err
        return file_system, key

    @cached_property
    def details(self) -> dict[str, Any]:
        """What fsspec knows of the file, from a listing or on request; raises MissingError if there is none."""
        file_system, key = self.store
        with translated_errors(self):
            return dict(file_system.info(key))

    @property
    def size(self) -> int:
        """The bytes of a file; 0 if the server does not report them."""
        return int(self.details.get("size") or 0)

    @property
    def version(self) -> str:
        """Text that changes if the file does; empty if the store has none."""
        return next((str(self.details[name]).strip('"') for name in _VERSION if self.details.get(name) is not None), "")

    def exists(self, *, follow_symlinks: bool = True) -> bool:  # noqa: ARG002  # the signature of Path
        """Return whether anything is there."""
        with suppress(MissingError):
            return bool(self.details)
        return False

    def is_dir(self, *, follow_symlinks: bool = True) -> bool:  # noqa: ARG002  # the signature of Path
        """Return whether it is a folder."""
        return self.exists() and self.details["type"] == "directory"

    def iterdir(self) -> Generator[Self]:
        """Yield what is in a folder, in order."""
        file_system, key = self.store
        with translated_errors(self):
            objects = file_system.ls(key, detail=True)
        for details in sorted(objects, key=itemgetter("name")):
            place = details["name"].strip("/")
            # Some stores list the folder itself, as an empty file.
            if place != key.strip("/"):
                child = self / posixpath.basename(place)
                child.details = details
                yield child

    def download(self, target: Path) -> None:
        """Write the whole file to a local one; an error if it does not have the size that the store says."""
        from fsspec.callbacks import Callback  # noqa: PLC0415  # only an extra

        file_system, key = self.store
        most, begun = self.size, monotonic()
        message = f"the server declares {most:,} bytes, and sends another number of them"
        other_size = RecordingError(message, path=self, hint=_AGAIN)

        def arrived(_: object, received: int) -> None:
            if received > most:
                raise other_size
            if monotonic() - begun > SLOWEST_SECONDS * (1 + received // LEAST_BYTES):
                least = f"fewer than {LEAST_BYTES:,} bytes arrive in {SLOWEST_SECONDS:g} seconds"
                raise RecordingError(f"the transfer is too slow to finish: {least}", path=self, hint=_AGAIN)

        with translated_errors(self):
            try:
                file_system.get_file(key, os.fspath(target), callback=Callback(hooks={"arrived": arrived}))
            finally:
                # After Ctrl-C, the library's thread would go on.
                most = -1
            if target.stat().st_size != self.size:
                raise other_size


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
    refuse_without_room(sum(file.size for files in sources.values() for file in files), next(iter(sources), None))
    with ExitStack() as stack:
        copies: dict[Path, Path] = {}
        for path, files in sources.items():
            place = Path(stack.enter_context(private_folder(path)))
            copies[path] = CopyPath.of(path, str(place))
            if path.is_dir():
                place /= path.name
                place.mkdir()
            for file in files:
                file.download(place / file.name)
        yield [copies.get(path, path) for path in paths]


def _files_of(path: UrlPath) -> list[UrlPath]:
    """Return the files in a folder, or a file with the logs beside a database."""
    if path.is_dir():
        return [file for file in path.iterdir() if not file.is_dir()]
    logs = [path.with_name(path.name + suffix) for suffix in ("-wal", "-journal") if path.suffix == ".db3"]
    return [path, *(log for log in logs if not path.is_read_only and log.exists())]


def refuse_without_room(needed: int, path: Path | None, hint: str = _NO_SPACE) -> None:
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
    file_system, key = dst.store
    with translated_errors(dst, OutputError):
        if not local.is_dir():
            file_system.put_file(os.fspath(local), key)
            return
        begun: list[str] = []
        try:
            # A recording is complete when its metadata.yaml is there.
            for name in sorted(files_below(local), key=lambda name: name.endswith("metadata.yaml")):
                begun.append(f"{key}/{name}")
                file_system.put_file(os.fspath(local / name), begun[-1])
        except BaseException:
            for place in begun:
                with suppress(Exception):
                    file_system.rm_file(place)
            raise


# --- The stores' libraries ---


@contextmanager
def translated_errors(path: UrlPath, kind: type[Pc2ScanError] = RecordingError) -> Iterator[None]:
    """Turn errors of fsspec and the stores' libraries into our own; their texts may have the URL with its signature."""
    try:
        yield
    except (Pc2ScanError, ImportError):
        raise
    except Exception as error:  # noqa: BLE001  # each store's library has errors of its own
        # fsspec raises FileNotFoundError for every error of a web server.
        err = (error.__cause__ if path.is_read_only else None) or error
        status = getattr(err, "status", None)
        if kind is RecordingError and (isinstance(err, FileNotFoundError) or status == _NOT_FOUND):
            hint = "check its spelling (case matters), and the bucket's; some stores say so if permissions are missing"
            raise MissingError("does not exist", path=path, hint=hint) from None
        errno = getattr(err, "errno", None)
        why = f"status {status}" if status else os.strerror(errno) if errno else type(err).__name__
        action = "upload" if kind is OutputError else "download"
        raise kind(f"the {action} failed ({why})", path=path, hint=_AGAIN) from None


def _options(scheme: str, configured: dict[str, Any]) -> dict[str, Any]:
    """Return options of a store: with our patience, and for one stream at a time.

    By default S3 takes minutes to give up, and fetches ten parts of 50 MB at once.
    """
    if scheme in {"http", "https"}:
        from aiohttp import ClientTimeout  # noqa: PLC0415  # only where it is needed

        timeout = ClientTimeout(total=None, sock_connect=SLOWEST_SECONDS, sock_read=SLOWEST_SECONDS)
        # What a server compresses would have another size than it declares.
        return {"timeout": timeout, "headers": {"Accept-Encoding": "identity"} | configured.get("headers", {})}
    if scheme == "s3":
        # No retries of the S3 library: s3fs itself tries five times.
        ours = {"connect_timeout": 10, "read_timeout": 20, "retries": {"max_attempts": 0}}
        return {"max_concurrency": 1, "config_kwargs": ours | configured.get("config_kwargs", {})}
    return {}
