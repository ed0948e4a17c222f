"""TFMessage on the wire, against rosbags' own serialisers and against truncation at every byte."""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pc2scan.errors import DecodeError
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms, encode_transforms
from pc2scan.model import normalized_type

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


def encoded_by_rosbags(transforms: list[TransformRow], serialization: str) -> bytes:
    store = get_typestore(Stores.ROS1_NOETIC if serialization == "ros1" else Stores.ROS2_HUMBLE)
    if "tf2_msgs/msg/TFMessage" not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    types = store.types
    messages = []
    for parent, child, stamp_ns, *pose in transforms:
        stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
        sequence = (7,) if serialization == "ros1" else ()
        messages.append(
            types["geometry_msgs/msg/TransformStamped"](
                types["std_msgs/msg/Header"](*sequence, stamp, parent),
                child,
                types["geometry_msgs/msg/Transform"](
                    types["geometry_msgs/msg/Vector3"](*pose[:3]),
                    types["geometry_msgs/msg/Quaternion"](*pose[3:]),
                ),
            )
        )
    message = types["tf2_msgs/msg/TFMessage"](messages)
    serialize = store.serialize_ros1 if serialization == "ros1" else store.serialize_cdr
    return bytes(serialize(message, "tf2_msgs/msg/TFMessage"))


@pytest.mark.parametrize("serialization", FORMATS)
@pytest.mark.parametrize("count", [0, 1, 3])
def test_decodes_what_rosbags_encodes(serialization: str, count: int) -> None:
    assert decode_transforms(encoded_by_rosbags(ROWS[:count], serialization), serialization) == ROWS[:count]


@pytest.mark.parametrize("serialization", FORMATS)
def test_encodes_what_rosbags_encodes(serialization: str) -> None:
    expected = encoded_by_rosbags(ROWS, serialization)
    if serialization == "ros1":
        # Ours has no sequence numbers to give.
        expected = expected.replace(struct.pack("<I", 7), bytes(4))
    assert encode_transforms(ROWS, serialization) == expected


@pytest.mark.parametrize("serialization", FORMATS)
@given(transforms=rows)
def test_round_trip(serialization: str, transforms: list[TransformRow]) -> None:
    assert decode_transforms(encode_transforms(transforms, serialization), serialization) == transforms


@pytest.mark.parametrize("serialization", FORMATS)
def test_keeps_nan_and_undecodable_names(serialization: str) -> None:
    rows = [("\udcff", "b", 1, math.nan, *[0.0] * 6)]
    ((parent, _, _, x, *_),) = decode_transforms(encode_transforms(rows, serialization), serialization)  # type: ignore[arg-type]
    assert (parent, math.isnan(x)) == ("\udcff", True)


@pytest.mark.parametrize("serialization", FORMATS)
def test_says_which_transform_is_cut(serialization: str) -> None:
    data = encode_transforms(ROWS[:2], serialization)[:-1]
    with pytest.raises(DecodeError, match=rf"ends after {len(data)} bytes, inside transform 2 of 2"):
        decode_transforms(data, serialization)


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


def test_types() -> None:
    for recorded in ("tf/tfMessage", "tf2_msgs/TFMessage", "tf2_msgs/msg/TFMessage"):
        assert normalized_type(recorded) in TF_TYPES
