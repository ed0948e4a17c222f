"""Compresses and decompresses data, by the compression's name, and computes CRC-32.

Compressed data are untrusted: every function that decompresses takes a limit for the result.
"""

from __future__ import annotations

import bz2
import zlib
from contextlib import suppress
from importlib import import_module
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any

import zstandard

# The libraries that not every run needs are imported by name, with the first data of that compression: 2 MB.
_zlib: Any = zlib
# Half the time of zlib, and a quarter for checksums; there is no build of it for some processors.
with suppress(ImportError):
    _zlib = import_module("isal.isal_zlib")

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pc2scan.model import Buffer

#: The first bytes of every LZ4 frame.
LZ4_MAGIC = b"\x04\x22\x4d\x18"

#: The first bytes of every zstd frame.
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

#: Size to which any chunk or message may be decompressed, even if it is stored in few bytes.
MAX_UNPACKED = 32 << 20

#: Limit of the ratio, for large chunks and for files that are compressed as a whole.
MAX_RATIO = 1000


class CompressionError(ValueError):
    """Data cannot be decompressed; the message is the library's."""


def allowed_bytes(file_size: int, stored: int | None = None) -> int:
    """Return the allowed size of decompressed data.

    Parameters
    ----------
    file_size
        Size of the file (or message) that holds them, bytes.
    stored
        Their compressed size, if it is not the whole file.
    """
    return MAX_UNPACKED + min(2 * file_size, 2 * file_size if stored is None else MAX_RATIO * stored)


def decompress(compression: str, data: Buffer, out: memoryview) -> None:
    """Decompress into memory of exactly the size of the result.

    Parameters
    ----------
    compression
        ``bz2``, ``lz4`` or ``zstd``.
    data
        All of the compressed data.
    out
        Gets the result. No more memory is used.

    Raises
    ------
    CompressionError
        If the data have another format, are damaged, or have another size decompressed.
    """
    size = _from_zstd(data, out) if compression == "zstd" else _from_cramjam(compression, data, out)
    if size != len(out):
        raise CompressionError("there is more" if size > len(out) else f"it ends after {size} bytes")


def decompress_within(compression: str, data: Buffer, limit: int) -> Buffer:
    """Decompress to a size that is not known.

    Parameters
    ----------
    compression
        ``zlib`` (also with gzip's header) or ``zstd``.
    data
        All of the compressed data.
    limit
        Largest size of the result, bytes. Little more memory is used.

    Raises
    ------
    CompressionError
        If the data have another format, are damaged or cut off, or the result is larger.
    """
    larger = CompressionError(f"the data are larger than {limit:,} bytes, which is the limit for {len(data):,} bytes")
    try:
        if compression == "zlib":
            # With a header of gzip or of zlib.
            inflate = _zlib.decompressobj(47)
            content: bytes = inflate.decompress(data, limit + 1)
            if len(content) > limit:
                raise larger
            if not inflate.eof:
                raise CompressionError("the data are cut off")
            return content
        if zstandard.frame_content_size(data) > limit:
            raise larger
        # Streaming compressors write frames without their size: memory is used as far as it is filled.
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=limit)
    except (zlib.error, _zlib.error, zstandard.ZstdError) as err:
        raise CompressionError(str(err)) from err


def compress(compression: str, data: Buffer, level: int = 3) -> Buffer:
    """Compress with ``none``, ``bz2``, ``lz4`` or ``zstd``; only zstd has a level. Default: the libraries' settings."""
    match compression:
        case "none":
            return data
        case "bz2":
            return bz2.compress(data)
        case "lz4":
            return bytes(import_module("lz4.frame").compress(data))
    return zstandard.ZstdCompressor(level=level).compress(data)


def zstd_pieces(file: IO[bytes], size: int) -> Iterator[bytes]:
    """Yield what is in a zstd file, of one frame or many, in pieces of at most so many bytes.

    Raises
    ------
    CompressionError
        If it is damaged. A file that is cut off just ends.
    """
    reader = zstandard.ZstdDecompressor().stream_reader(file, read_size=size, read_across_frames=True)
    try:
        while piece := reader.read1(size):
            yield piece
    except zstandard.ZstdError as err:
        raise CompressionError(str(err)) from err


def _from_cramjam(compression: str, data: Buffer, out: memoryview) -> int:
    cramjam = import_module("cramjam")
    try:
        return int((cramjam.bzip2 if compression == "bz2" else cramjam.lz4).decompress_into(data, out))
    except cramjam.DecompressionError as err:
        # What it says of memory that is too small.
        raise CompressionError(str(err).replace("failed to write whole buffer", "there is more")) from err


def _from_zstd(data: Buffer, out: memoryview) -> int:
    reader = zstandard.ZstdDecompressor().stream_reader(data)
    done = 0
    try:
        while done < len(out) and (more := reader.readinto(out[done:])):
            done += more
        return done + len(reader.read(1))
    except zstandard.ZstdError as err:
        raise CompressionError(str(err)) from err


# --- CRC-32 ---


#: Returns the CRC-32 of bytes as zlib and MCAP define it; a second argument is the CRC of the bytes before them. With
#: zlib, it takes as long as reading an uncompressed recording, and a fifth of the time of decompressing zstd.
crc32: Callable[..., int] = _zlib.crc32

# --- The part of damaged data that can be decompressed ---

#: A decompressor that fails drops the piece of its output that it was to return, so pieces are small.
_PIECE = 64


def decompressed_prefix(data: Buffer, compression: str, declared: int) -> bytes:
    """Decompress until it fails.

    Parameters
    ----------
    data
        The compressed data, perhaps cut off.
    compression
        ``none``, ``bz2``, ``lz4`` or ``zstd``; any other gives no bytes.
    declared
        The size that the chunk declares, bytes. It may be wrong: the result may have up to `allowed_bytes`.
    """
    limit, data, out = allowed_bytes(len(data)), bytes(data), bytearray()
    if compression == "none":
        return data
    # Most chunks are sound, even if the file is damaged, and the libraries take a fiftieth of the time.
    with suppress(CompressionError, MemoryError):
        whole = bytearray(min(declared, limit))
        decompress(compression, data, memoryview(whole))
        return bytes(whole)
    # In an lz4 block, there is no byte behind the end.
    with suppress(OSError, EOFError, zstandard.ZstdError, MemoryError, IndexError):
        if compression == "lz4":
            _decode_lz4(data, out, limit)
        else:
            library: Any = bz2 if compression == "bz2" else zstandard
            file = library.open(BytesIO(data))
            while len(out) < limit and (piece := file.read1(_PIECE)):
                out += piece
    return bytes(out[:limit])


def _decode_lz4(data: bytes, out: bytearray, limit: int) -> None:
    """Decode the blocks of an LZ4 frame; ROS 1's chunks are one block. Source: lz4_Frame_format.md."""
    flags = data[4]
    position = 7 + 8 * bool(flags & 0x08) + 4 * bool(flags & 0x01)
    while data.startswith(LZ4_MAGIC) and len(out) < limit:
        length = int.from_bytes(data[position : position + 4], "little")
        stored, length = length >> 31, length & 0x7FFF_FFFF
        block = data[position + 4 : position + 4 + length]
        position += 4 + length + 4 * bool(flags & 0x10)
        if stored:
            out += block
        elif block:
            _decode_block(block, out, limit)
        else:
            break


def _decode_block(block: bytes, out: bytearray, limit: int) -> None:
    """Decode the sequences of a block, which refer to what is before them; an IndexError where they are damaged.

    Source: lz4_Block_format.md.
    """
    position = 0

    def extended(length: int) -> int:
        nonlocal position
        more = 255 if length == 15 else 0
        while more == 255:
            more = block[position]
            position += 1
            length += more
        return length

    while len(out) < limit:
        token = block[position]
        position += 1
        literals = extended(token >> 4)
        out += block[position : position + literals]
        position += literals
        # The last sequence has literals only.
        if position == len(block):
            return
        distance = block[position] | block[position + 1] << 8
        position += 2
        length = min(extended(token & 15) + 4, limit)
        if not 0 < distance <= len(out):
            raise IndexError
        start = len(out) - distance
        out += (out[start : start + length] * (length // distance + 1))[:length]
