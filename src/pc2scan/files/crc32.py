"""CRC-32 as zlib and MCAP have it, by the fastest way there is here.

zlib's takes as long as reading an uncompressed recording, and a fifth of decompressing zstd.
"""

from __future__ import annotations

import zlib
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.model import Buffer

__all__ = ["crc32"]

#: zlib is done with fewer bytes before the other library is loaded.
_WORTH_LOADING = 1 << 18


def crc32(data: Buffer, value: int = 0) -> int:
    """Return the CRC-32 of bytes, or continue that of the bytes in front of them, ``value``."""
    return zlib.crc32(data, value) if len(data) < _WORTH_LOADING else _fastest()(data, value)


@cache
def _fastest() -> Callable[[Buffer, int], int]:
    try:
        from isal import isal_zlib  # noqa: PLC0415  # only large chunks need it
    except ImportError:  # there is none for this processor
        return zlib.crc32
    return isal_zlib.crc32
