from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from pc2scan.errors import DecodeError
from pc2scan.messages.pointcloud2 import DATATYPES, POINTCLOUD2, PointCloud2, PointField, decode_pointcloud2

ROS2 = get_typestore(Stores.ROS2_JAZZY)


def message(
    fields: list[PointField],
    data: bytes,
    *,
    height: int = 1,
    width: int = 1,
    point_step: int = 12,
    row_step: int | None = None,
    big_endian: bool = False,
    frame: str = "lidar",
) -> Any:
    """A PointCloud2 as rosbags builds it, ready to be serialised by rosbags: an oracle of the layout."""
    t = ROS2.types
    return t["sensor_msgs/msg/PointCloud2"](
        header=t["std_msgs/msg/Header"](
            stamp=t["builtin_interfaces/msg/Time"](sec=12, nanosec=345),
            frame_id=frame,
        ),
        height=height,
        width=width,
        fields=[
            t["sensor_msgs/msg/PointField"](name=f.name, offset=f.offset, datatype=f.datatype, count=f.count)
            for f in fields
        ],
        is_bigendian=big_endian,
        point_step=point_step,
        row_step=width * point_step if row_step is None else row_step,
        data=np.frombuffer(data, np.uint8),
        is_dense=True,
    )


def decoded(*args: Any, **kwargs: Any) -> PointCloud2:
    return decode_pointcloud2(ROS2.serialize_cdr(message(*args, **kwargs), POINTCLOUD2), "cdr")


XYZ = [PointField("x", 0, 7), PointField("y", 4, 7), PointField("z", 8, 7)]


def test_a_cloud_without_points_may_have_any_steps() -> None:
    assert [axis.size for axis in decoded(XYZ, b"", width=0, point_step=0).xyz()] == [0, 0, 0]


def test_fields_that_share_their_bytes_are_a_table_up_to_a_limit() -> None:
    same = [PointField(f"{number}", 0, 7, 3) for number in range(9)]
    assert decoded(same[:8], bytes(12)).structured_points().size == 1
    with pytest.raises(DecodeError, match="its fields have 108 bytes, and a point has 12"):
        decoded(same, bytes(12)).structured_points()


@given(
    st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9), max_size=6),
    st.text(max_size=9).filter(lambda s: "\0" not in s),
    st.binary(max_size=50),
)
def test_decoding_agrees_with_rosbags_in_both_byte_orders(names: list[str], frame: str, data: bytes) -> None:
    fields = [PointField(name, 3 * i, i % 8 + 1, i) for i, name in enumerate(names)]
    built = message(fields, data, height=2, width=3, frame=frame)
    for little in (True, False):
        cloud = decode_pointcloud2(ROS2.serialize_cdr(built, POINTCLOUD2, little_endian=little), "cdr")
        assert cloud.frame_id == frame
        assert cloud.stamp_ns == 12_000_000_345
        assert list(cloud.fields) == fields
        assert bytes(cloud.data) == data
        assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (2, 3, 12, 36)


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("datatype", sorted(DATATYPES))
@pytest.mark.parametrize("step", [15, 22, 48])
def test_any_datatype_at_any_alignment(datatype: int, step: int, big_endian: bool) -> None:
    dtype = np.dtype((">" if big_endian else "<") + DATATYPES[datatype])
    values = np.array([0, 1, 3, 100], dtype)
    raw = (values[i : i + 1].tobytes() for i in range(4))
    data = b"".join(b"\xff" * 5 + value + b"\xff" * (step - 5 - dtype.itemsize) for value in raw)
    cloud = decoded([PointField("x", 5, datatype)], data, width=4, point_step=step, big_endian=big_endian)
    assert cloud.field("x").tolist() == values.tolist()
    assert cloud.field("x").dtype == dtype


def test_padded_rows_become_two_dimensions_and_packed_ones_one() -> None:
    rows = [struct.pack("<2f", r, r + 0.5) + b"\xee" * 3 for r in range(3)]
    cloud = decoded([PointField("x", 0, 7)], b"".join(rows), height=3, width=2, point_step=4, row_step=11)
    assert cloud.field("x").tolist() == [[0, 0.5], [1, 1.5], [2, 2.5]]
    # The last row's padding may be missing.
    shorter = decoded([PointField("x", 0, 7)], b"".join(rows)[:-3], height=3, width=2, point_step=4, row_step=11)
    assert shorter.field("x").tolist() == cloud.field("x").tolist()
    packed = decoded([PointField("x", 0, 7)], struct.pack("<4f", *range(4)), height=2, width=2, point_step=4)
    assert packed.field("x").tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("kwargs", "words"),
    [
        ({"fields": XYZ[:2], "data": bytes(12)}, ["no field 'z'", "x, y"]),
        ({"fields": [], "data": bytes(12)}, ["no field 'x'", "none"]),
        ({"fields": [PointField("x", 0, 9)], "data": bytes(12)}, ["datatype 9"]),
        ({"fields": [PointField("x", 10, 7)], "data": bytes(12)}, ["10 to 14", "point_step is 12"]),
        ({"fields": XYZ, "data": bytes(23), "width": 2}, ["23 bytes", "1 x 2", "take 24"]),
        (
            {"fields": XYZ, "data": bytes(44), "height": 2, "width": 2, "row_step": 20},
            ["row_step is 20", "take 24"],
        ),
        (
            {"fields": XYZ, "data": bytes(12), "height": 2**31, "width": 2**31, "row_step": 2**32 - 1},
            ["row_step"],
        ),
    ],
)
def test_contradictions_are_errors_with_numbers_and_stamp(kwargs: dict[str, Any], words: list[str]) -> None:
    cloud = decoded(**kwargs)
    with pytest.raises(DecodeError) as caught:
        cloud.xyz()
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert caught.value.stamp_ns == 12_000_000_345
