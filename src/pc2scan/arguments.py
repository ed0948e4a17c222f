"""Calls of the public functions: paths and names in any of their usual forms, misspelt keywords, callable packages."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from importlib import import_module
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from .errors import UsageError
from .text import nearest

if TYPE_CHECKING:
    from collections.abc import Mapping
    from inspect import Signature
    from typing import Any, TypeAlias

    PathText: TypeAlias = str | PathLike[str]

#: Maximum number of characters of a value in an error message.
_LONGEST = 80


def value_and_type(value: object) -> str:
    """Return a value and its type, for an error message."""
    text = repr(value)
    return f"{text if len(text) <= _LONGEST else f'{text[:_LONGEST]}...'} ({type(value).__name__})"


def path_of(name: str, value: object) -> Path:
    """Return a path that was given as text or as an object; see `path_text`."""
    return Path(path_text(name, value))


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
    if not text:
        raise UsageError(f"{name} is an empty path")
    text = local_path(text)
    if text.startswith("~") and not os.path.lexists(text):
        return os.path.expanduser(text)  # noqa: PTH111  # Path.expanduser fails where there is no such user
    return text


def local_path(text: str) -> str:
    """Return the path that a ``file:`` URL names, as RFC 8089 defines it; any other text is returned as it is.

    All code after this sees a path, so a file has no second kind of name.

    >>> local_path("file:///data/a%20b.bag"), local_path("file://localhost/a.bag"), local_path("FILE:/a.bag")
    ('/data/a b.bag', '/a.bag', '/a.bag')
    >>> local_path("s3://bucket/a%20b.bag"), local_path("file:a.bag")
    ('s3://bucket/a%20b.bag', 'file:a.bag')

    Raises
    ------
    UsageError
        If the URL names another machine, has a query or a fragment, or a character that no path can have.
    """
    scheme, _, rest = text.partition(":")
    if scheme.lower() != "file" or not rest.startswith("/"):
        return text
    if rest.startswith("//"):
        host, slash, path = rest[2:].partition("/")
        _refuse_other_host(text, host)
        rest = slash + path
    if not rest:
        raise UsageError("is a URL without a path", path=text, hint="with three slashes: file:///data/drive.bag")
    if odd := next((sign for sign in "?#" if sign in rest), None):
        raise UsageError(
            f"is a URL with a {odd}, which begins no part of a file's name",
            path=text,
            hint=f"write %{ord(odd):02X} if it belongs to the name",
        )
    from urllib.parse import unquote_to_bytes  # noqa: PLC0415  # few paths are URLs

    if odd := next((code for code in ("%00", "%2F") if code in rest.upper()), None):
        raise UsageError(f"is a URL with {odd}, which no file's name can have", path=text)
    found = "/" + os.fsdecode(unquote_to_bytes(os.fsencode(rest))).lstrip("/")
    # On Windows a drive follows the slash: file:///C:/data, or file:///C|/data.
    has_drive = os.name == "nt" and found[2:3] in {":", "|"}
    return f"{found[1]}:{found[3:]}" if has_drive else found


def _refuse_other_host(url: str, host: str) -> None:
    """Raise if the host of a ``file:`` URL is not this machine."""
    if host.lower() in {"", "localhost"}:
        return
    from socket import gethostname  # noqa: PLC0415  # few URLs name a host

    if host.lower() != gethostname().lower():
        raise UsageError(
            f"is a file of another machine, {host}",
            path=url,
            hint="a path of this machine has three slashes: file:///data/drive.bag",
        )


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


def names_in(name: str, values: object) -> tuple[str, ...]:
    """Return the names of an argument that takes one name or several; an empty tuple for None.

    Raises
    ------
    TypeError
        If one of them is not text.
    """
    if values is None:
        return ()
    if isinstance(values, str):
        return (values,)
    if isinstance(values, bytes) or not isinstance(values, Iterable):
        raise TypeError(f"{name} is {value_and_type(values)}, it must be a str or several")
    found = tuple(values)
    for value in found:
        if not isinstance(value, str):
            raise TypeError(f"{name} has {value_and_type(value)}, it must be a str or several")
    return found


def refuse_unknown(
    function: str, names: Iterable[str], known: Iterable[str], synonyms: Mapping[str, str] | None = None
) -> None:
    """Raise a TypeError for the first unknown name, with a suggestion: the synonym's meaning, or a similar name."""
    candidates = sorted(known)
    for name in names:
        if name in candidates:
            continue
        word = name.lower().strip("_")
        synonym = (synonyms or {}).get(word)
        meant = synonym if synonym in candidates else nearest(word, candidates)
        raise TypeError(f"{function}() has no argument {name!r}{f'; did you mean {meant!r}?' if meant else ''}")


# --- packages with the name of a public function ---
#
# ``pc2scan.tf`` and ``pc2scan.golden`` are packages. Python sets them as attributes of ``pc2scan`` when anything in
# them is imported, so a function of that name would be there or not depending on what was imported before.


class _CallablePackage(ModuleType):
    """A package that is called like the function of its name in ``pc2scan.api``."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return _function(self)(*args, **kwargs)

    @property
    def __signature__(self) -> Signature:
        from inspect import signature  # noqa: PLC0415  # only who looks at signatures pays for it

        return signature(_function(self))

    @property
    def __doc__(self) -> str | None:  # type: ignore[override]  # what help() shows
        doc: str | None = _function(self).__doc__
        return doc


def _function(package: ModuleType) -> Any:
    parent, _, name = package.__name__.rpartition(".")
    return getattr(import_module(f"{parent}.api"), name)


def make_callable(name: str) -> None:
    """Make a package callable; to be called in its ``__init__`` with ``__name__``."""
    sys.modules[name].__class__ = _CallablePackage
