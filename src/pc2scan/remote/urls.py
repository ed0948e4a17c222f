"""Recognises paths that are URLs of stores. Every command imports this module, so it must load quickly.

``file:`` URLs are not among them: `pc2scan.arguments.local_path` has made paths of them before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

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
