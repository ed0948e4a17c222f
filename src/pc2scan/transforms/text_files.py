"""Reads text files of transforms and of options; they are untrusted, so their size is bounded."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from pc2scan.errors import UsageError
from pc2scan.files.places import missing_hint
from pc2scan.files.source import open_text

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import TextIO


def text_of(path: Path, most: int, what: str) -> str:
    """Return the text of a file; see `open_bounded`."""
    with open_bounded(path, most, what) as file:
        return file.read(most)


@contextmanager
def open_bounded(path: Path, most: int, what: str) -> Iterator[TextIO]:
    """Open a text file.

    Parameters
    ----------
    path
        The file.
    most
        The largest size, bytes.
    what
        What the file is, for errors: ``a trajectory``.

    Raises
    ------
    UsageError
        If the file cannot be read, is too large, or is not text in UTF-8.
    """
    try:
        if (size := path.stat().st_size) > most:
            raise UsageError(f"has {size:,} bytes; {what} has at most {most:,}", path=path)
        with open_text(path) as file:
            yield file
    except FileNotFoundError as err:
        raise UsageError("does not exist", path=path, hint=missing_hint(path)) from err
    except OSError as err:
        raise UsageError(f"cannot be read: {err.strerror}", path=path) from err
    except UnicodeDecodeError as err:
        raise UsageError(f"is not {what}: it is not text in UTF-8", path=path) from err
