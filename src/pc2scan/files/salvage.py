"""Decompresses the part of damaged data that can be decompressed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .compression import CompressionError, Decoder, allowed_bytes

if TYPE_CHECKING:
    from pc2scan.model import Buffer

#: A damaged chunk is decompressed up to this size even if it declares less: its declared size may be damaged too.
SIZE_LIMIT = 16 << 20

#: A decompressor that fails drops its output for the piece that it was given, so pieces are small.
_PIECE = 64


def decompressed_prefix(data: Buffer, compression: str, declared: int) -> bytes:
    """Decompress until it fails; of LZ4 whole blocks.

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
    if compression not in {"bz2", "lz4", "zstd"}:
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
