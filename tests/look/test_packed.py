"""Arrays as the page reads them."""

from __future__ import annotations

import zlib

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pc2scan.look.packed import described, packed


@given(st.integers(0, 50).flatmap(lambda n: st.tuples(arrays("<f4", n), arrays("u1", n), arrays("<f8", n))))
def test_bytes_sorted_by_place_can_be_put_together(columns: tuple[np.ndarray, ...]) -> None:
    named = dict(zip(("x", "ring", "time"), columns, strict=True))
    data = zlib.decompress(packed(named), -zlib.MAX_WBITS)
    description = described("cloud-0", named)
    assert description["id"] == "cloud-0"
    begin = 0
    for field in description["fields"]:
        kind = np.dtype(f"<{field['type']}")
        length = description["length"] * kind.itemsize
        planes = np.frombuffer(data[begin : begin + length], np.uint8).reshape(kind.itemsize, -1)
        assert planes.T.tobytes() == named[field["name"]].tobytes()
        begin += length
    assert begin == len(data)
