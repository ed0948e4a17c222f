"""Zstandard around a recording: whole files, and messages one by one, as rosbag2 compresses them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.errors import DamageError, RecordingError
from pc2scan.files import compression
from pc2scan.files.compression import MAX_RATIO, MAX_UNPACKED, ZSTD_MAGIC, CompressionError, allowed_bytes
from pc2scan.files.source_file import open_bytes
from pc2scan.files.system import copy_errors, private_folder

from .damage import RECOVER, DamageLog

if TYPE_CHECKING:
    from pc2scan.model import Buffer, RawMessage

    from .formats import Format
    from .reader import Reader

#: Bytes that are read, and written, at a time.
_PIECE = 1 << 14

#: Limit of what the messages of one chunk may unpack to.
_MAX_TOGETHER = 128 << 20

#: Suffixes of compressed files.
SUFFIXES = (".zstd", ".zst")


def decompress_file(path: Path, folder: Path, log: DamageLog) -> Path:
    """Decompress a zstd file into a directory, in pieces; returns the new file.

    Parameters
    ----------
    path
        The file.
    folder
        Gets the new one.
    log
        Gets the damage; the bytes before the damage are written.

    Raises
    ------
    RecordingError
        If there is not enough space for the result.
    """
    target = folder / without_suffix(path.name)
    size = path.stat().st_size
    allowed = MAX_UNPACKED + MAX_RATIO * size
    with copy_errors(path, folder), open_bytes(path) as packed, target.open("wb") as out:
        try:
            for piece in compression.zstd_pieces(packed, _PIECE):
                allowed -= out.write(piece)
                if allowed < 0:
                    what = f"unpacks to more than {MAX_RATIO} times its size, which no recording does"
                    raise RecordingError(what, path=path)
        except CompressionError as err:
            error = DamageError(f"cannot be decompressed: {err}", path=path, hint=RECOVER)
            log.note(error, offset=packed.tell(), bytes_lost=size - packed.tell())
    return target


def decompress_message(data: Buffer, path: Path, topic: str) -> Buffer:
    """Decompress a message that was compressed by itself (rosbag2's compression mode ``message``).

    Raises
    ------
    DamageError
        If it is not a complete zstd frame, or larger than it may be.
    """
    try:
        return compression.decompress_within("zstd", data, allowed_bytes(len(data)))
    except CompressionError as err:
        raise DamageError(f"a message cannot be decompressed: {err}", path=path, topic=topic, hint=RECOVER) from err


def decompress_messages(messages: list[RawMessage], log: DamageLog, place: int, path: Path) -> list[RawMessage]:
    """Decompress the messages of one segment if they are compressed one by one; only metadata.yaml declares that.

    Parameters
    ----------
    messages
        Messages of one segment. If neither the first nor the last is a zstd frame, they are returned unchanged.
    log
        Gets messages that cannot be decompressed; they are skipped.
    place
        Offset of the segment in the file, bytes.
    path
        The file.

    Notes
    -----
    CDR begins with a zero byte, so that a message in CDR never looks like a frame. Other serialisations may begin
    with any byte, but rosbag2 compresses only CDR.
    """
    if not messages or not (is_frame(messages[0]) or is_frame(messages[-1])):
        return messages
    decompressed, total = [], 0
    for message in messages:
        unpacked = message
        if message.connection.serialization == "cdr":
            try:
                unpacked = message._replace(data=decompress_message(message.data, path, message.connection.topic))
            except DamageError as err:
                key = message.connection.id, message.log_time_ns, message.sequence
                log.note_message(err, key, message.log_time_ns, offset=place, bytes_lost=message.size)
                continue
        decompressed.append(unpacked)
        total += unpacked.size
        if total > _MAX_TOGETHER:
            raise RecordingError(f"a chunk's messages unpack to more than {_MAX_TOGETHER:,} bytes", path=path)
    return decompressed


def is_frame(message: RawMessage) -> bool:
    """Whether a message is compressed by itself."""
    return message.connection.serialization == "cdr" and message.data[:4] == ZSTD_MAGIC


def without_suffix(name: str) -> str:
    """Return a compressed file's name without the suffix."""
    return name.rpartition(".")[0] if name.endswith(SUFFIXES) else name


def open_packed(path: Path, inner: Format, *, strict: bool) -> Reader:
    """Open a file that is compressed as a whole: its reader reads a temporary copy.

    Parameters
    ----------
    path
        The compressed file.
    inner
        The format of the decompressed file.
    strict
        Whether damage is an error.
    """
    damage = DamageLog(strict=strict)
    temporary = private_folder(path)
    try:
        reader = inner.open_reader(decompress_file(path, Path(temporary.name), damage), strict=strict)
    except BaseException as err:
        temporary.cleanup()
        if isinstance(err, RecordingError):
            err.path = path
        raise
    reader.stand_for(path, temporary, damage)
    return reader
