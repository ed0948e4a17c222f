"""Records of what earlier runs wrote, and whether it is still as they left it; see `pc2scan.files.ownership`."""

from __future__ import annotations

import json
import os
import stat
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import OutputError

from .compression import crc32

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    #: Reads the record of what is in a folder; text if there is none: the reason.
    FolderRecord = Callable[[Path], "Record | str"]

#: The record in an exported folder.
RECORD = ".pc2scan-files.json"

_RECORD_VERSION = 1

_PIECE_BYTES = 1 << 20


class FileState(NamedTuple):
    """How a run left a file.

    Attributes
    ----------
    size
        In bytes.
    crc
        The CRC-32 of the content. Times of modification would differ between two exports of the same messages, and are
        lost by copying. CRC-32 recognises an edited file and, unlike SHA-256, takes no time beside writing it. It would
        not stop a forger; but whoever can write the record can remove the files, too.
    """

    size: int
    crc: int


class Record(NamedTuple):
    """What earlier runs wrote into a folder, by their own account.

    Attributes
    ----------
    files
        How the files were left, by their paths relative to the folder, with slashes; None if only the name is known.
    name
        The name of the file with this record, for messages.
    """

    files: Mapping[str, FileState | None]
    name: str = "record"


def is_unchanged(path: Path, left: FileState | None) -> bool:
    """Return whether a file is as it was left, as far as that is recorded."""
    try:
        status = path.lstat()
        if left is None:
            return stat.S_ISREG(status.st_mode) or stat.S_ISLNK(status.st_mode)
        if not stat.S_ISREG(status.st_mode) or status.st_size != left.size:
            return False
        return _crc_of(path) == left.crc
    except OSError:
        return False


def _crc_of(path: Path) -> int:
    value = 0
    with path.open("rb") as file:
        while piece := file.read(_PIECE_BYTES):
            value = crc32(piece, value)
    return value


def write_record(folder: Path) -> None:
    """Write the record of a complete folder into it. Folders with the same files get the same bytes.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    try:
        files = {
            name: [(folder / name).stat().st_size, _crc_of(folder / name)]
            for name in sorted(files_below(folder))
            if name != RECORD
        }
        text = json.dumps({"pc2scan files": _RECORD_VERSION, "files": files}, ensure_ascii=True, indent=0) + "\n"
        with (folder / RECORD).open("x", encoding="ascii") as file:
            file.write(text)
    except OSError as err:
        raise OutputError(f"its record cannot be written: {err.strerror}", path=folder) from err


def read_record(folder: Path) -> Record | str:
    """Return the record in a folder; text if there is none that can be read: the reason."""
    try:
        path = folder / RECORD
        noted = json.loads(path.read_bytes() if stat.S_ISREG(path.lstat().st_mode) else b"")
        if noted["pc2scan files"] != _RECORD_VERSION:
            raise ValueError("it is of another version")
        files: dict[str, FileState | None] = {
            str(name): FileState(int(size), int(crc)) for name, (size, crc) in noted["files"].items()
        }
    except FileNotFoundError:
        return f"it has no {RECORD}, which lists what an export wrote"
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return f"its {RECORD} cannot be read as a record of pc2scan"
    return Record({**files, RECORD: None}, RECORD)


def files_below(folder: Path, below: str = "") -> Iterator[str]:
    """Yield everything in a folder that is not a folder itself, and folders that are empty, as relative paths."""
    with os.scandir(folder) as entries:
        listed = list(entries)
    if not listed and below:
        yield below
    for entry in listed:
        name = f"{below}/{entry.name}" if below else entry.name
        if entry.is_dir(follow_symlinks=False):
            yield from files_below(folder / entry.name, name)
        else:
            yield name
