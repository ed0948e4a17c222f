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

__all__ = ["crc32", "crc32_combined"]

#: zlib is done with fewer bytes before the other library is loaded.
_WORTH_LOADING = 1 << 18


def crc32(data: Buffer, value: int = 0) -> int:
    """Return the CRC-32 of bytes, or continue that of the bytes in front of them, ``value``."""
    return zlib.crc32(data, value) if len(data) < _WORTH_LOADING else _fastest()(data, value)


def crc32_combined(first: int, second: int, length: int) -> int:
    """Return the CRC-32 of bytes, given those of their beginning and of the ``length`` bytes that follow it."""
    try:
        from isal import isal_zlib  # noqa: PLC0415  # seldom needed
    except ImportError:
        return _moved(first, length) ^ second
    return isal_zlib.crc32_combine(first, second, length)


def _moved(value: int, length: int) -> int:
    """Return what a CRC becomes when so many zeros follow, apart from what the zeros themselves would add.

    A CRC is the remainder of a polynomial over GF(2), which ``8 * length`` further bits multiply by x that many times.
    """
    # x^8, the highest bit being x^0.
    power = 1 << 23
    while length:
        if length & 1:
            value = _multiplied(value, power)
        power = _multiplied(power, power)
        length >>= 1
    return value


def _multiplied(one: int, other: int) -> int:
    """Multiply two polynomials modulo that of CRC-32, bits reflected."""
    product = 0
    for bit in range(31, -1, -1):
        if one >> bit & 1:
            product ^= other
        other = other >> 1 ^ (0xEDB88320 if other & 1 else 0)
    return product


@cache
def _fastest() -> Callable[[Buffer, int], int]:
    try:
        from isal import isal_zlib  # noqa: PLC0415  # only large chunks need it
    except ImportError:  # there is none for this processor
        return zlib.crc32
    return isal_zlib.crc32
