"""Tells whether files have changed: by their names, sizes and times of modification, or by a checksum."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pc2scan.files.records import RECORD
from pc2scan.files.source import file_beside, open_bytes
from pc2scan.files.urls import UrlPath

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

_PIECE_BYTES = 1 << 20

#: Identities list up to this many files of a folder one by one; more are summed up.
_MOST = 100


@dataclass(frozen=True, slots=True)
class Identity:
    """The files of a recording: the name, size and time of modification (ns) of each; no files if it does not exist.

    A file in a store has its version there, such as an ETag, instead of a time.
    """

    files: tuple[tuple[str, int, int | str], ...] = ()

    @property
    def size_bytes(self) -> int:
        """Return the total size of the files."""
        return sum(size for _, size, _ in self.files)

    def has_sizes_of(self, other: Identity) -> bool:
        """Whether the files have the same sizes; their names and times may differ."""
        return [size for _, size, _ in self.files] == [size for _, size, _ in other.files]

    def as_json(self) -> list[list[Any]]:
        """Return it as JSON's types."""
        return [list(file) for file in self.files]

    @classmethod
    def from_json(cls, files: Iterable[Sequence[Any]]) -> Identity:
        """Read what `as_json` returned."""
        return cls(
            tuple((str(name), int(size), time if isinstance(time, str) else int(time)) for name, size, time in files)
        )


def identity_of(paths: Iterable[Path]) -> Identity:
    """Return the identity of a recording: of a file, of the files in a folder, or of several files."""
    found = []
    for path in paths:
        if isinstance(path, UrlPath):
            found += _stored_files(path)
            continue
        try:
            # os.path is faster than Path, which matters for thousands of recordings.
            found += _files_in(path) if os.path.isdir(path) else _file_and_logs(path)  # noqa: PTH112
        except OSError:
            continue
    return Identity(tuple(found))


def _file_and_logs(path: Path) -> list[tuple[str, int, int | str]]:
    """Return the entries of a file and of the logs beside a database: a running recorder may write only to the logs."""
    logs = filter(None, (file_beside(path, suffix) for suffix in ("-wal", "-journal")))
    states = [(path.name, os.stat(path)), *((log.name, log.stat()) for log in logs)]  # noqa: PTH116
    return [(name, state.st_size, state.st_mtime_ns) for name, state in states if state.st_size or name == path.name]


def _stored_files(path: UrlPath) -> list[tuple[str, int, int | str]]:
    """Return the entries of a file at a URL, or of the files in a folder; none if it does not exist."""
    if not path.is_dir():
        return [(path.name, *path.known()[:2])] if path.exists() else []
    files = [(below.relative_to(path).as_posix(), *below.known()[:2]) for below in path.below()]
    return _summed_up(sorted(files))


def _files_in(folder: Path) -> list[tuple[str, int, int | str]]:
    """Return the files in a folder and its subfolders; very many (one for each cloud) are summed up in one entry."""
    found: list[tuple[str, int, int | str]] = []
    for place, folders, names in os.walk(folder):
        folders.sort()
        below = os.path.relpath(place, folder)
        # Not -shm: programs that only read a database create and change that file.
        # Nor the record of an export, which says nothing that its files do not.
        for name in sorted(name for name in names if not name.endswith("-shm") and name != RECORD):
            # Broken links are ignored.
            with suppress(OSError):
                path = os.path.join(place, name)  # noqa: PTH118
                state = os.stat(path)  # noqa: PTH116
                found.append((os.path.normpath(os.path.join(below, name)), state.st_size, state.st_mtime_ns))  # noqa: PTH118
    return _summed_up(found)


def _summed_up(found: list[tuple[str, int, int | str]]) -> list[tuple[str, int, int | str]]:
    """Return the files of a folder; very many as one entry."""
    if len(found) <= _MOST:
        return found
    times = [time for _, _, time in found]
    last = max((time for time in times if isinstance(time, int)), default=0)
    if any(isinstance(time, str) for time in times):
        import hashlib  # noqa: PLC0415  # few recordings have so many files

        return [
            (f"{len(found)} files", sum(size for _, size, _ in found), hashlib.sha256(repr(times).encode()).hexdigest())
        ]
    return [(f"{len(found)} files", sum(size for _, size, _ in found), last)]


def checksum_of(paths: Iterable[Path]) -> str:
    """Return the SHA-256 of the content of a recording's files, in the order of `identity_of`.

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    import hashlib  # noqa: PLC0415  # only where it is wanted

    digest = hashlib.sha256()
    for path in paths:
        files = sorted(each for each in path.iterdir() if each.is_file()) if path.is_dir() else [path]
        for file in files:
            digest.update(f"{file.name if path.is_dir() else ''}\0{file.stat().st_size}\0".encode())
            with open_bytes(file) as opened:
                while piece := opened.read(_PIECE_BYTES):
                    digest.update(piece)
    return digest.hexdigest()
