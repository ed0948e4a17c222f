"""Computes CRC-32 as zlib and MCAP define it, with the fastest available library.

With zlib, it takes as long as reading an uncompressed recording, and a fifth of the time of decompressing zstd.
"""

from __future__ import annotations

import zlib
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.model import Buffer

#: For fewer bytes, zlib is faster than loading the other library.
_WORTH_LOADING = 1 << 18


def crc32(data: Buffer, value: int = 0) -> int:
    """Return the CRC-32 of bytes; ``value`` is the CRC of the bytes before them."""
    return zlib.crc32(data, value) if len(data) < _WORTH_LOADING else _fastest()(data, value)


def combine_crc32(first: int, second: int, length: int) -> int:
    """Return the CRC-32 of two parts together: ``first``, and ``second`` of ``length`` bytes."""
    try:
        from isal import isal_zlib  # noqa: PLC0415  # seldom needed
    except ImportError:
        return _shift(first, length) ^ second
    return isal_zlib.crc32_combine(first, second, length)


def _shift(value: int, length: int) -> int:
    """Multiply a CRC, the remainder of a polynomial over GF(2), by x to the power of ``8 * length``."""
    # x^8, the highest bit being x^0.
    power = 1 << 23
    while length:
        if length & 1:
            value = _multiply(value, power)
        power = _multiply(power, power)
        length >>= 1
    return value


def _multiply(one: int, other: int) -> int:
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
    except ImportError:  # the library has no build for this processor
        return zlib.crc32
    return isal_zlib.crc32
