"""Writes and detects the LZ4 frames that ROS 1's own reader accepts: independent blocks, no content size, a checksum.

Source: ``roslz4/src/lz4s.c`` in ros_comm, and https://github.com/lz4/lz4/blob/dev/doc/lz4_Frame_format.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.files.compression import LZ4_MAGIC

from .records import UINT32

if TYPE_CHECKING:
    from pc2scan.model import Buffer

#: Version 1, independent blocks, content checksum; no block checksums, content size or dictionary.
_FLAGS = 0b0110_0100
#: Blocks of at most 64 KiB, 256 KiB, 1 MiB, 4 MiB.
_BLOCK_SIZES = {0x40: 1 << 16, 0x50: 1 << 18, 0x60: 1 << 20, 0x70: 1 << 22}
_STORED = 0x8000_0000
_HEADER_SIZE = 7


def packed(data: Buffer) -> bytes:
    """Compress data into such a frame."""
    import lz4.frame  # noqa: PLC0415  # heavy

    frame: bytes = lz4.frame.compress(
        data,
        block_size=lz4.frame.BLOCKSIZE_MAX1MB,
        block_linked=False,
        store_size=False,
        content_checksum=True,
    )
    return frame


def ros1_reads(data: Buffer) -> bool:
    """Whether these bytes are exactly one such frame."""
    if len(data) < _HEADER_SIZE or data[:4] != LZ4_MAGIC or data[4] != _FLAGS or data[5] not in _BLOCK_SIZES:
        return False
    limit = _BLOCK_SIZES[data[5]]
    position = _HEADER_SIZE
    while position + 4 <= len(data):
        (size,) = UINT32.unpack_from(data, position)
        position += 4
        if size == 0:
            # The checksum, and the end.
            return position + 4 == len(data)
        size &= ~_STORED
        if size > limit:
            return False
        position += size
    return False
