"""TFMessage on the wire, against rosbags' own serialisers and against truncation at every byte."""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.errors import DecodeError
from pc2scan.messages.tfmessage import decode_transforms, encode_transforms

if TYPE_CHECKING:
    from pc2scan.core.rigid import TransformRow

FORMATS = ["ros1", "cdr"]
ROWS: list[TransformRow] = [
    ("odom", "base_link", 1_600_000_000_123_456_789, 1.0, -2.5, 1e-300, 0.0, 0.0, 0.6, 0.8),
    ("/base_link", "lidar_ö", 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    ("", "x", 5, math.inf, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0),
]

name = st.text(st.characters(blacklist_characters="\0", blacklist_categories=["Cs"]), max_size=9)
rows = st.lists(
    st.tuples(name, name, st.integers(0, 2**31 * 10**9 - 1), *[st.floats(allow_nan=False)] * 7),
    max_size=4,
)


@pytest.mark.parametrize("serialization", FORMATS)
@given(transforms=rows)
def test_round_trip(serialization: str, transforms: list[TransformRow]) -> None:
    assert decode_transforms(encode_transforms(transforms, serialization), serialization) == transforms


@pytest.mark.parametrize("serialization", FORMATS)
def test_lengths_that_lie(serialization: str) -> None:
    base = 4 if serialization == "cdr" else 0
    data = bytearray(encode_transforms(ROWS, serialization))
    data[base : base + 4] = b"\xff" * 4
    with pytest.raises(DecodeError, match="declares 4294967295 transforms"):
        decode_transforms(bytes(data), serialization)
    data[base : base + 4] = struct.pack("<I", 4)
    with pytest.raises(DecodeError, match="transform 4 of 4"):
        decode_transforms(bytes(data), serialization)
    data = bytearray(encode_transforms(ROWS, serialization))
    length = base + (16 if serialization == "ros1" else 12)
    data[length : length + 4] = b"\xff" * 4
    with pytest.raises(DecodeError, match="transform 1 of 3"):
        decode_transforms(bytes(data), serialization)
