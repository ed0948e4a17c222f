"""Whether files are what they were: their names, sizes and times of modification, and a checksum where it is wanted."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pc2scan.files.source import opened_bytes

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

__all__ = ["Identity", "checksum_of", "identity_of"]

_PIECE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Identity:
    """The files of a recording: the name, size and time of modification (ns) of each; none if it is not there."""

    files: tuple[tuple[str, int, int], ...] = ()

    @property
    def size_bytes(self) -> int:
        """Bytes of all files."""
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
        return cls(tuple((str(name), int(size), int(time)) for name, size, time in files))


def identity_of(paths: Iterable[Path]) -> Identity:
    """Return the identity of a recording: of a file, of the files in a folder, or of several files."""
    found = []
    for path in paths:
        try:
            # Not Path: a thousand recordings are asked for.
            if os.path.isdir(path):  # noqa: PTH112
                with os.scandir(path) as entries:
                    files = sorted((entry.name, entry.stat()) for entry in entries if entry.is_file())
            else:
                files = [(path.name, os.stat(path))]  # noqa: PTH116
        except OSError:
            continue
        found += [(name, status.st_size, status.st_mtime_ns) for name, status in files]
    return Identity(tuple(found))


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
            with opened_bytes(file) as opened:
                while piece := opened.read(_PIECE_BYTES):
                    digest.update(piece)
    return digest.hexdigest()
