"""Decompresses the part of damaged data that can be decompressed."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from .compression import LZ4_MAGIC, CompressionError, Decoder, allowed_bytes, decompress

if TYPE_CHECKING:
    from pc2scan.model import Buffer

#: A damaged chunk is decompressed up to this size even if it declares less: its declared size may be damaged too.
SIZE_LIMIT = 16 << 20

#: A decompressor that fails drops its output for the piece that it was given, so pieces are small.
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
        The size that the chunk declares, bytes. It may be wrong: the result may have up to `SIZE_LIMIT`.
    """
    limit, data, out = min(max(declared, SIZE_LIMIT), allowed_bytes(len(data))), bytes(data), bytearray()
    if compression == "none":
        return data
    if compression == "lz4":
        # Most chunks are sound, even if the file is damaged, and the library takes a fiftieth of the time.
        with suppress(CompressionError, MemoryError):
            whole = bytearray(min(declared, limit))
            decompress(compression, data, memoryview(whole))
            return bytes(whole)
        # Behind the end, there is no byte.
        with suppress(IndexError):
            _decode_lz4(data, out, limit)
    elif compression in {"bz2", "zstd"}:
        decoder = Decoder(compression)
        with suppress(CompressionError, MemoryError):
            for start in range(0, len(data), _PIECE):
                out += decoder.feed(data[start : start + _PIECE], limit - len(out))
                if decoder.codec.eof or len(out) >= limit:
                    break
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
        elif not block or not _decode_block(block, out, limit):
            break


def _decode_block(block: bytes, out: bytearray, limit: int) -> bool:
    """Decode the sequences of a block, which refer to what is before them, and return whether it is whole.

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
            return True
        distance = block[position] | block[position + 1] << 8
        position += 2
        length = min(extended(token & 15) + 4, limit)
        if not 0 < distance <= len(out):
            break
        start = len(out) - distance
        out += (out[start : start + length] * (length // distance + 1))[:length]
    return False
