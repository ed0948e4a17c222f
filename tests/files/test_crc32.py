from __future__ import annotations

import zlib

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.files.compression import crc32

NOISE = np.random.default_rng(1).bytes(1 << 20)


@given(st.binary(max_size=2000), st.integers(0, 2**32 - 1))
def test_it_is_zlibs(data: bytes, before: int) -> None:
    assert crc32(data) == zlib.crc32(data)
    assert crc32(data, before) == zlib.crc32(data, before)


def test_lengths_and_beginnings_of_every_kind() -> None:
    view = memoryview(NOISE)
    for length in [*range(300), 4095, 4096, 4097, 1 << 19]:
        for first in (0, 1, 7, 16):
            part = view[first : first + length]
            assert crc32(part) == zlib.crc32(part), (first, length)
