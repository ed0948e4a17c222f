"""Opens recordings; the format is detected by content, never by name."""

from __future__ import annotations

import shlex
import stat
from typing import TYPE_CHECKING

from pc2scan.errors import MissingError, RecordingError
from pc2scan.files.compression import ZSTD_MAGIC, CompressionError, zstd_pieces
from pc2scan.files.source_file import LFS_HINT, LFS_POINTER, file_beside, missing_hint, open_bytes
from pc2scan.files.urls import UrlPath, fetched

from . import zstd
from .folders import is_rosbag2, recordings_in, several_recordings
from .formats import FORMATS, and_list
from .merged import MergedReader

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from contextlib import ExitStack
    from pathlib import Path

    from .reader import Reader

#: Other files that users try to open: their first bytes, what they are, and a hint.
_LOOKALIKES = (
    (LFS_POINTER, "a Git LFS pointer, not the file itself", LFS_HINT),
    (b"#ROSBAG V1", "a ROS bag of version 1", "ROS 1's rosbag reindex converts it"),
)


def sniff(path: Path) -> str:
    """Return the name of a recording's format, detected by its content.

    Parameters
    ----------
    path
        A file or a directory.

    Returns
    -------
    str
        ``rosbag1``, ``mcap``, ``sqlite3`` (a ``.db3`` file) or ``rosbag2`` (a directory); ``+zstd`` is
        appended for a file that must be decompressed first.

    Raises
    ------
    MissingError
        If nothing is there.
    RecordingError
        If it is not permitted to read it, or it is not a recording.
    UsageError
        If it is a directory with several recordings, or a URL.
    """
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            return _sniff_directory(path)
        if not stat.S_ISREG(mode):
            raise RecordingError("is neither a file nor a directory", path=path, hint="save it as a file first")
        with open_bytes(path) as file:
            head, packed = file.read(64), ""
            if head.startswith(ZSTD_MAGIC):
                file.seek(0)
                head, packed = next(zstd_pieces(file, 64), b""), "+zstd"
    except FileNotFoundError as err:
        raise MissingError("does not exist", path=path, hint=missing_hint(path)) from err
    except OSError as err:
        raise RecordingError(f"cannot be read: {err.strerror}", path=path) from err
    except CompressionError as err:
        raise RecordingError(f"cannot be decompressed: {err}", path=path) from err
    magics = {entry.magic: name for name, entry in FORMATS.items() if entry.magic}
    name = next((name for magic, name in magics.items() if head.startswith(magic)), "")
    return (name or _content_hint(head, path, magics, " (after zstd decompression)" if packed else "")) + packed


def open_recording(path: Path, *, strict: bool = False) -> Reader:
    """Open a recording of any format.

    Parameters
    ----------
    path
        A ROS 1 bag, an MCAP or ``.db3`` file, one of these compressed by zstd, or a rosbag2 directory.
    strict
        Whether damage is an error; otherwise it is in the reader's ``damage``, and the rest is recovered.

    Raises
    ------
    RecordingError
        If it cannot be read.
    DamageError
        With ``strict``, if it is damaged; without, if nothing of it can be recovered.
    """
    name, _, packed = sniff(path).partition("+")
    if packed:
        return zstd.open_packed(path, FORMATS[name], strict=strict)
    return FORMATS[name].open_reader(path, strict=strict)


def open_recordings(paths: Iterable[Path], stack: ExitStack, *, strict: bool = False) -> list[Reader]:
    """Open several, each as `open_recording` does, to be closed with the stack; what is at URLs is fetched first."""
    paths = list(paths)
    if any(isinstance(path, UrlPath) for path in paths):
        paths = stack.enter_context(fetched(paths))
    readers = []
    for path in paths:
        reader = open_recording(path, strict=strict)
        stack.callback(reader.close)
        readers.append(reader)
    return readers


def _sniff_directory(path: Path) -> str:
    if is_rosbag2(path):
        return "rosbag2"
    recordings = recordings_in(path)
    if len(recordings) > 1:
        raise several_recordings(path, recordings)
    raise RecordingError(
        "is a directory without a rosbag2 recording (no metadata.yaml, .db3 or .mcap files)",
        path=path,
        hint=f"name the recording in it: {shlex.quote(str(recordings[0]))}" if recordings else None,
    )


def _content_hint(head: bytes, path: Path, magics: Iterable[bytes], state: str) -> str:
    if not head:
        raise RecordingError(f"is empty{state}", path=path)
    if any(magic.startswith(head) for magic in magics):
        raise RecordingError(f"is cut off after {len(head)} bytes: there is nothing to recover{state}", path=path)
    for magic, description, hint in _LOOKALIKES:
        if head.startswith(magic):
            raise RecordingError(f"is not a recording: it is {description}{state}", path=path, hint=hint)
    # The first page of a database may be damaged, and sound in the log beside it.
    if path.suffix == FORMATS["sqlite3"].suffix and file_beside(path, "-wal"):
        return "sqlite3"
    readable = f"a recording is a {and_list([entry.readable for entry in FORMATS.values()], 'or')}"
    # Bytes of unknown origin for a terminal: printable ASCII as it is, everything else escaped.
    raise RecordingError(f"is not a recording: it begins with {repr(head[:16])[1:]}{state}", path=path, hint=readable)


def as_one(readers: Sequence[Reader]) -> Reader:
    """Return several recordings as one; a single one is returned unchanged."""
    if len(readers) == 1:
        return readers[0]
    return MergedReader(readers)
