"""Zstandard around a recording: whole files, and messages one by one, as rosbag2 compresses them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import RecordingError

from .limits import MAX_FILE_RATIO, MAX_UNPACKED, allowed_bytes

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from .model import Buffer

__all__ = [
    "MAGIC",
    "SUFFIXES",
    "compressions",
    "is_zstd",
    "unpacked_file",
    "unpacked_message",
    "without_suffix",
]

#: How every frame begins.
MAGIC = b"\x28\xb5\x2f\xfd"

#: Bytes that are decompressed at a time. Zeros shrink to a thirty-thousandth, and a piece's result is held in memory.
_PIECE = 1 << 11

#: What the names of packed files end with.
SUFFIXES = (".zstd", ".zst")


def is_zstd(path: Path) -> bool:
    """Whether a file is compressed as a whole, by its content."""
    try:
        with path.open("rb") as file:
            return file.read(4) == MAGIC
    except OSError as err:
        raise RecordingError(f"cannot be read: {err.strerror}", path=path) from err


def unpacked_file(path: Path, folder: Path) -> Path:
    """Decompress a zstd file into a directory, in pieces; returns the new file.

    Raises
    ------
    RecordingError
        If it is damaged, or the result does not fit.
    """
    import zstandard  # noqa: PLC0415  (only compressed recordings need it)

    target = folder / without_suffix(path.name)
    try:
        with path.open("rb") as packed, target.open("wb") as out:
            complete = True
            decoder = zstandard.ZstdDecompressor().decompressobj()
            allowed = MAX_UNPACKED + MAX_FILE_RATIO * path.stat().st_size
            while piece := packed.read(_PIECE):
                while piece:
                    allowed -= out.write(decoder.decompress(piece))
                    if allowed < 0:
                        raise RecordingError(
                            f"unpacks to more than {MAX_FILE_RATIO} times its size, which no recording does", path=path
                        )
                    complete, piece = decoder.eof, decoder.unused_data
                    if complete:
                        # Another frame may follow: pzstd writes many.
                        decoder = zstandard.ZstdDecompressor().decompressobj()
        if not complete:
            raise RecordingError("cannot be decompressed: it is cut off", path=path)
    except zstandard.ZstdError as err:
        raise RecordingError(f"cannot be decompressed: {err}", path=path) from err
    except OSError as err:
        raise RecordingError(
            f"cannot be decompressed: {err.strerror}",
            path=path,
            hint=f"it is unpacked in {folder.parent}; the environment variable TMPDIR names another place",
        ) from err
    return target


def unpacked_message(data: Buffer, path: Path, topic: str) -> bytes:
    """Return a message that was compressed by itself (rosbag2's compression mode ``message``).

    Raises
    ------
    RecordingError
        If it is not a complete zstd frame.
    """
    import zstandard  # noqa: PLC0415  (only compressed recordings need it)

    allowed = allowed_bytes(len(data))
    try:
        declared = zstandard.frame_content_size(data)
        if 0 < declared <= allowed:
            return zstandard.ZstdDecompressor().decompress(data, max_output_size=declared)
        # Not `decompress`: it needs the frame's word on the size.
        decoder = zstandard.ZstdDecompressor().decompressobj()
        parts, size, view = [], 0, memoryview(data)
        while not decoder.eof and view and size <= allowed and declared <= allowed:
            parts.append(decoder.decompress(view[:_PIECE]))
            size, view = size + len(parts[-1]), view[_PIECE:]
    except zstandard.ZstdError as err:
        raise RecordingError(f"a message cannot be decompressed: {err}", path=path, topic=topic) from err
    if max(size, declared) > allowed:
        raise RecordingError(
            f"a message of {len(data)} bytes unpacks to more than the {allowed} that may be", path=path, topic=topic
        )
    if not decoder.eof:
        raise RecordingError("a message's zstd frame is cut off", path=path, topic=topic)
    return b"".join(parts)


def without_suffix(name: str) -> str:
    """What a packed file was called before."""
    for suffix in SUFFIXES:
        name = name.removesuffix(suffix)
    return name


def compressions(inner: Iterable[str]) -> tuple[str, ...]:
    """Compressions of a recording with zstd around it: its own ``none`` is none no longer."""
    return tuple(sorted({"zstd", *inner} - {"none"}))
