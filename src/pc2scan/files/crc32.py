"""CRC-32 as zlib and MCAP have it, by the fastest way there is here.

zlib's takes as long as reading an uncompressed recording, and a fifth of decompressing zstd.
"""

from __future__ import annotations

__all__ = ["crc32"]

try:
    from ._crc32 import crc32
except ImportError:  # not compiled, or the processor lacks what it needs
    from zlib import crc32
