"""Paths as users give them, which may be URLs: whatever reads or writes a path takes a URL. Every command imports it.

``file:`` URLs become ordinary paths: see `local_path`.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from platform import node
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from pc2scan.arguments import value_and_type
from pc2scan.errors import UsageError

from .urls import LIBRARIES, UrlPath

if TYPE_CHECKING:
    from typing import TypeAlias

    PathText: TypeAlias = str | PathLike[str]


def is_url(path: str | PathLike[str]) -> bool:
    """Return whether a path was given as a URL.

    >>> is_url("s3://bucket/drive.mcap"), is_url("s3/drive.mcap")
    (True, False)
    """
    # A Path has turned the two slashes of the URL into one.
    scheme, _, rest = os.fspath(path).replace(os.sep, "/").partition(":")
    return rest.startswith("/") and scheme in LIBRARIES


def path_or_url(text: str | PathLike[str]) -> Path:
    """Return the path that a text names: a `UrlPath` for a URL, which is equal for all URLs of one object."""
    if not is_url(text):
        return Path(text)
    url = UrlPath(text)
    # A web server, to which nothing is written, gets what was typed.
    return url if url.is_read_only else UrlPath(os.path.normpath(url))


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
        If the text is empty, or a URL of no known kind, or the URL names another machine, has a query or a fragment, or
        a character that no path can have.
    """
    if not text:
        raise UsageError(f"{name} is an empty path", hint="was a variable empty?")
    scheme, _, rest = text.partition(":")
    is_file = scheme.lower() == "file"
    if not is_file and rest.startswith("//") and scheme.isalnum() and scheme[1:] and scheme not in LIBRARIES:
        # What follows may have a password.
        raise UsageError(f"{name} begins with {scheme}://", hint=f"URLs begin with file, {', '.join(LIBRARIES)}")
    if not is_file or not rest.startswith("/"):
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
