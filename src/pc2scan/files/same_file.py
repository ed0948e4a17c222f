"""Which paths are names of one file: links, hard links, paths through linked folders, names that differ in case."""

from __future__ import annotations

import os
import unicodedata
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

#: Device and inode.
FileId = tuple[int, int]

#: Links that lead to links: the system follows at most this many.
_MAX_LINKS = 40


def places(path: Path) -> Iterator[Path]:
    """Return a path without links in its folders, and if it is a symbolic link each path that it leads to."""
    for _ in range(_MAX_LINKS):
        has_name = path.name not in {"", ".."}
        path = Path(os.path.realpath(path.parent), path.name) if has_name else Path(os.path.realpath(path))
        yield path
        try:
            path = path.parent / path.readlink()
        except OSError:
            return


def file_ids(*paths: Path) -> list[FileId]:
    """Return device and inode of those paths that exist; for a symbolic link its own and its target's."""
    found = []
    for path in paths:
        for look in (os.lstat, os.stat):
            with suppress(OSError):
                status = look(path)
                found.append((status.st_dev, status.st_ino))
    return found


def path_key(path: Path) -> object:
    """Return a key that is equal for paths that may be one file: file systems may ignore case or Unicode's forms."""
    place = next(places(path))
    return tuple(file_ids(place.parent)[-1:]) or place.parent, name_key(place.name)


def name_key(name: str) -> str:
    """Return a key that is equal for names that may be one on a file system that ignores case or Unicode's forms."""
    return unicodedata.normalize("NFC", name).casefold()
