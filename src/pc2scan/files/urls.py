"""Paths as users give them, which may be URLs: whatever reads or writes a path takes a URL. Every command imports it.

A `UrlPath` shows itself without secrets, and so does the `CopyPath` of what is fetched from there, so results and
messages name the URL. `pc2scan.files.store` has the store's side, and is loaded when anything is looked up, read or
written there. ``file:`` URLs become ordinary paths: see `local_path`.
"""

from __future__ import annotations

import os
import posixpath
from collections.abc import Iterable
from contextlib import suppress
from functools import cached_property
from os import PathLike
from pathlib import Path
from socket import gethostname
from typing import TYPE_CHECKING, Any, ClassVar
from urllib.parse import unquote, urlsplit

from pc2scan.arguments import value_and_type
from pc2scan.errors import MissingError, OutputError, RecordingError, UsageError

from .store import AGAIN, LIBRARIES, call, open_store, stored_object, translated_errors

if TYPE_CHECKING:
    from collections.abc import Generator
    from typing import TypeAlias

    from typing_extensions import Self

    from .store import StoredObject

    PathText: TypeAlias = str | PathLike[str]


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
    `pc2scan.files.transfers`.
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
        return open_store(self.url, str(self))

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
