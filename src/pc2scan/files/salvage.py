"""Decompresses the part of damaged data that can be decompressed."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import lz4.block

from .compression import LZ4_MAGIC, CompressionError, Decoder, allowed_bytes

if TYPE_CHECKING:
    from pc2scan.model import Buffer

#: A damaged chunk is decompressed up to this size even if it declares less: its declared size may be damaged too.
SIZE_LIMIT = 16 << 20

#: A decompressor that fails drops its output for the piece that it was given, so pieces are small.
_PIECE = 64

_LZ4_WINDOW = 1 << 16
_LZ4_BLOCK_SIZES = {4: 1 << 16, 5: 1 << 18, 6: 1 << 20, 7: 4 << 20}


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
    limit = min(max(declared, SIZE_LIMIT), allowed_bytes(len(data)))
    if compression == "none":
        return bytes(data)
    if compression == "lz4":
        return _lz4_frame(memoryview(data), limit)
    if compression not in {"bz2", "zstd"}:
        return b""
    decoding, view = Decoder(compression), memoryview(data)
    parts, size = list[bytes](), 0
    for start in range(0, len(data), _PIECE):
        try:
            part = decoding.feed(bytes(view[start : start + _PIECE]), limit - size)
        except (CompressionError, MemoryError):
            break
        parts.append(part)
        size += len(part)
        if decoding.eof or size >= limit:
            break
    return b"".join(parts)[:limit]


def _lz4_frame(data: memoryview, limit: int) -> bytes:
    """Decode an LZ4 frame block by block; ROS 1's chunks are one block. Source: lz4_Frame_format.md."""
    if len(data) < 7 or bytes(data[:4]) != LZ4_MAGIC:
        return b""
    flags, most = data[4], _LZ4_BLOCK_SIZES.get(data[5] >> 4 & 7, 4 << 20)
    position = 7 + (8 if flags & 0x08 else 0) + (4 if flags & 0x01 else 0)
    out = bytearray()
    while position + 4 <= len(data) and len(out) < limit:
        (length,) = struct.unpack_from("<I", data, position)
        stored, length = length >> 31, length & 0x7FFF_FFFF
        # A block that compression would lengthen is stored uncompressed: none is longer than `most`.
        if not 0 < length <= most:
            break
        block = bytes(data[position + 4 : position + 4 + length])
        position += 4 + length + 4 * bool(flags & 0x10)
        if stored:
            out += block
            continue
        history = b"" if flags & 0x20 else bytes(out[-_LZ4_WINDOW:])
        try:
            if len(block) < length:
                raise ValueError("cut off")
            # lz4 raises RuntimeError on truncated dictionaries, and its own errors are ValueErrors and MemoryErrors.
            out += lz4.block.decompress(block, uncompressed_size=most, dict=history)
        except (lz4.block.LZ4BlockError, ValueError, RuntimeError, MemoryError):
            out += _lz4_block_prefix(block, history, most)
            break
    return bytes(out[:limit])


def _lz4_block_prefix(block: bytes, history: bytes, limit: int) -> bytes:
    """Decode the sequences of an LZ4 block until one is impossible. Source: lz4_Block_format.md."""
    out = bytearray(history)
    limit += len(history)
    position, end = 0, len(block)

    def extended(length: int) -> int:
        nonlocal position
        while length >= 15:
            if position >= end:
                return -1
            more = block[position]
            position += 1
            length += more
            if more != 255:
                break
        return length

    while position < end and len(out) < limit:
        token = block[position]
        position += 1
        literals = extended(token >> 4)
        if literals < 0:
            break
        out += block[position : position + literals]
        position += literals
        if position + 2 > end:
            break
        distance = block[position] | block[position + 1] << 8
        position += 2
        length = extended(token & 15)
        if length < 0 or not 0 < distance <= len(out):
            break
        length += 4
        start = len(out) - distance
        if distance >= length:
            out += out[start : start + length]
        else:
            pattern = bytes(out[start:])
            out += (pattern * (length // distance + 1))[:length]
    return bytes(out[len(history) : limit])
