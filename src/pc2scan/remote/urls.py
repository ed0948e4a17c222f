"""Recognises paths that are URLs of stores, and shows URLs to users. Every command imports it, so it loads quickly.

``file:`` URLs are not among them: `pc2scan.arguments.local_path` has made paths of them before.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pc2scan.errors import Pc2ScanError

#: The library that fsspec needs for a scheme; empty if it needs none.
LIBRARIES = {
    "s3": "s3fs",
    "s3a": "s3fs",
    "gs": "gcsfs",
    "gcs": "gcsfs",
    "az": "adlfs",
    "abfs": "adlfs",
    "abfss": "adlfs",
    "https": "aiohttp",
    "http": "aiohttp",
    "memory": "",
}


def is_url(path: Path | None) -> bool:
    """Return whether a path was given as a URL.

    >>> from pathlib import PurePosixPath as Path
    >>> is_url(Path("s3://bucket/drive.mcap")), is_url(Path("s3/drive.mcap")), is_url(None)
    (True, False, False)
    """
    if path is None:
        return False
    # Path has turned the two slashes of the URL into one.
    scheme, _, rest = path.as_posix().partition(":")
    return rest.startswith("/") and scheme in LIBRARIES


def url_of(path: Path) -> str:
    """Return the URL that a path was given as.

    >>> from pathlib import PurePosixPath as Path
    >>> url_of(Path("s3://bucket/drive.mcap"))
    's3://bucket/drive.mcap'
    """
    scheme, _, rest = path.as_posix().partition(":")
    return f"{scheme}://{rest.lstrip('/')}"


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


def shown_path(path: Path) -> str:
    """Return a path, or a URL as `shown_url` shows it, for messages and reports."""
    return shown_url(url_of(path)) if is_url(path) else str(path)


class UrlNames:
    """Replaces local folders by the URLs of which they contain copies."""

    def __init__(self) -> None:
        self._urls: dict[str, str] = {}

    def add(self, folder: Path, url: str) -> None:
        """Replace paths in ``folder`` by URLs below ``url`` from now on."""
        self._urls[str(folder)] = url.rstrip("/")

    def text(self, text: str) -> str:
        """Replace the folders in a text."""
        for folder, url in self._urls.items():
            text = text.replace(folder, url)
        return text

    def of(self, value: Any) -> Any:
        """Replace the folders in a result: text, paths, lists, dictionaries and, in place, data classes."""
        if isinstance(value, str):
            return self.text(value)
        if isinstance(value, Path):
            text = self.text(str(value))
            return value if text == str(value) else UrlText(text)
        if type(value) is tuple or hasattr(value, "_fields"):
            items = map(self.of, value)
            return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
        if type(value) is list:
            return [self.of(item) for item in value]
        if type(value) is dict:
            return {key: self.of(item) for key, item in value.items()}
        if is_dataclass(value) and not isinstance(value, type):
            for each in fields(value):
                found = getattr(value, each.name)
                # Most values are numbers, and are skipped.
                if isinstance(found, str | Path | tuple | list | dict) or is_dataclass(found):
                    object.__setattr__(value, each.name, self.of(found))
        return value

    def error(self, err: Pc2ScanError) -> None:
        """Replace the folders in an error, in place."""
        err.message = self.text(err.message)
        err.args = (err.message,)
        err.path = None if err.path is None else self.text(str(err.path))
        err.hint = None if err.hint is None else self.text(err.hint)


class UrlText(str):
    """A URL in a result that otherwise has a path there."""

    __slots__ = ()

    @property
    def name(self) -> str:
        """The last part of the URL's path."""
        return self.rpartition("/")[2]
