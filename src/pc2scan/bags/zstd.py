"""Zstandard around a recording: whole files, and messages one by one, as rosbag2 compresses them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import RecordingError

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
            # Small pieces: zeros shrink to a thirty-thousandth, and a piece's result is held in memory.
            while piece := packed.read(1 << 14):
                while piece:
                    out.write(decoder.decompress(piece))
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

    # Not `decompress`: it trusts the frame's word on the size and needs one.
    decoder = zstandard.ZstdDecompressor().decompressobj()
    try:
        message = decoder.decompress(data)
    except zstandard.ZstdError as err:
        raise RecordingError(f"a message cannot be decompressed: {err}", path=path, topic=topic) from err
    if not decoder.eof:
        raise RecordingError("a message's zstd frame is cut off", path=path, topic=topic)
    return message


def without_suffix(name: str) -> str:
    """What a packed file was called before."""
    for suffix in SUFFIXES:
        name = name.removesuffix(suffix)
    return name


def compressions(inner: Iterable[str]) -> tuple[str, ...]:
    """Compressions of a recording with zstd around it: its own ``none`` is none no longer."""
    return tuple(sorted({"zstd", *inner} - {"none"}))
