from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.compare.messages import compare_messages
from pc2scan.compare.rules import Rules
from pc2scan.messages.laserscan import LASERSCAN, decode_laserscan, encode_laserscan
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from pc2scan.model import Connection, RawMessage
from support.builders import CLOUD, T0, cloud, deserialized, points_of, scan, serialized, typestore

if TYPE_CHECKING:
    from pc2scan.compare.difference import MessageDifference

ENCODINGS = {1: "ros1", 2: "cdr"}
EXACT = Rules()
RANGES = np.array([1.0, np.inf, 2.5, 3.0], np.float32)


def message(data: bytes, msgtype: str, ros_version: int = 2, log_time_ns: int = T0) -> RawMessage:
    return RawMessage(Connection(0, "/x", msgtype, ENCODINGS[ros_version]), log_time_ns, data, log_time_ns)


def names(difference: MessageDifference) -> set[str]:
    return {change.name for change in difference.changes} | {values.name for values in difference.values}


class TestScans:
    def test_both_wire_formats_say_the_same(self) -> None:
        one, other = (message(scan(RANGES, g, seq=g), LASERSCAN, g) for g in (1, 2))
        found = compare_messages(one, other, EXACT)
        assert found.same
        assert found.elements == 4

    @pytest.mark.parametrize(
        ("field", "value"),
        [
            ("sequence", 5),
            ("frame_id", "other"),
            ("angle_min", -1.6),
            ("angle_max", 1.6),
            ("angle_increment", 0.2),
            ("time_increment", -0.0),
            ("scan_time", float("nan")),
            ("range_min", 0.2),
            ("range_max", float("inf")),
        ],
    )
    def test_each_field_is_found_and_can_be_ignored(self, field: str, value: Any) -> None:
        data = scan(RANGES, 1)
        changed = encode_laserscan(replace(decode_laserscan(data, "ros1"), **{field: value}), "ros1")
        one, other = message(data, LASERSCAN, 1), message(changed, LASERSCAN, 1)
        name = "seq" if field == "sequence" else field
        assert names(compare_messages(one, other, EXACT)) == {name}
        assert compare_messages(one, other, Rules(ignore=frozenset({name}))).same

    def test_the_log_time_counts_unless_it_is_ignored(self) -> None:
        data = scan(RANGES, 2)
        one, other = message(data, LASERSCAN), message(data, LASERSCAN, log_time_ns=T0 + 1)
        assert names(compare_messages(one, other, EXACT)) == {"log_time"}
        assert compare_messages(one, other, Rules(ignore=frozenset({"log_time"}))).same

    def test_another_number_of_beams(self) -> None:
        found = compare_messages(message(scan(RANGES, 2), LASERSCAN), message(scan(RANGES[:3], 2), LASERSCAN), EXACT)
        assert {"beams", "angle_increment"} == names(found)

    def test_intensities_have_their_own_tolerance(self) -> None:
        plain = decode_laserscan(scan(RANGES, 2), "cdr")
        one, other = (
            message(encode_laserscan(replace(plain, intensities=RANGES + np.float32(step)), "cdr"), LASERSCAN)
            for step in (0, 0.25)
        )
        assert names(compare_messages(one, other, EXACT)) == {"intensities"}
        assert compare_messages(one, other, Rules(atol={"intensities": 0.25})).same
        assert not compare_messages(one, other, Rules(atol={"ranges": 1.0})).same
        assert compare_messages(one, other, Rules(ignore=frozenset({"intensities"}))).same
        assert names(compare_messages(message(scan(RANGES, 2), LASERSCAN), one, EXACT)) == {"intensities"}

    def test_what_cannot_be_decoded_is_told_by_its_bytes(self) -> None:
        broken = scan(RANGES, 2)[:-9]
        assert compare_messages(message(broken, LASERSCAN), message(broken, LASERSCAN), EXACT).same
        (change,) = compare_messages(message(broken, LASERSCAN), message(scan(RANGES, 2), LASERSCAN), EXACT).changes
        assert change.name == "bytes"
        assert "message ends" in change.b


def built(ros_version: int = 2, points: int = 60, **changed: Any) -> bytes:
    """A cloud of x, y, z and a byte of padding behind them; ``changed`` replaces parts of the message."""
    store = typestore(ros_version)
    base = deserialized(cloud(points_of(3, points), ros_version), CLOUD, ros_version)
    data = np.zeros((points, 13), np.uint8)
    data[:, :12] = base.data.reshape(points, 12)
    parts = {"point_step": 13, "row_step": 13 * points, "data": data.ravel(), **changed}
    return serialized(store, replace(base, **parts), CLOUD, ros_version)


def compared(one: bytes, other: bytes, rules: Rules = EXACT, ros_versions: tuple[int, int] = (2, 2)) -> set[str]:
    a, b = (message(data, POINTCLOUD2, g) for data, g in zip((one, other), ros_versions, strict=True))
    return names(compare_messages(a, b, rules))


def data_of(raw: bytes) -> Any:
    return deserialized(raw, CLOUD, 2).data.copy()


class TestClouds:
    def test_both_wire_formats_say_the_same(self) -> None:
        assert compared(built(1), built(2), ros_versions=(1, 2)) == set()

    def test_a_bit_of_a_field_is_told_from_a_bit_of_padding(self) -> None:
        data = data_of(built())
        data[13 * 7 + 4] ^= 1
        assert compared(built(), built(data=data)) == {"y"}
        padded = data_of(built())
        padded[13 * 7 + 12] ^= 1
        assert compared(built(), built(data=padded)) == {"padding"}
        assert compared(built(), built(data=padded), Rules(ignore=frozenset({"padding"}))) == set()

    def test_values_are_found_wherever_they_are(self) -> None:
        # The same points without padding: the layout differs, the values do not.
        packed = cloud(points_of(3), 2)
        assert compared(built(), packed) == {"layout"}
        ignored = Rules(ignore=frozenset({"layout"}))
        assert compared(built(), packed, ignored) == set()
        moved = points_of(3)
        moved[5, 2] += 1
        assert compared(built(), cloud(moved, 2), ignored) == {"z"}

    def test_the_byte_order_is_layout(self) -> None:
        base = deserialized(cloud(points_of(3), 2), CLOUD, 2)
        swapped = base.data.view("<f4").astype(">f4").view(np.uint8)
        big = serialized(typestore(2), replace(base, is_bigendian=True, data=swapped), CLOUD, 2)
        assert compared(cloud(points_of(3), 2), big) == {"layout"}

    def test_rows_with_gaps(self) -> None:
        data = np.full((4, 15 * 13 + 6), 9, np.uint8)
        data[:, : 15 * 13] = data_of(built()).reshape(4, 15 * 13)
        gaps = {"height": 4, "width": 15, "row_step": 15 * 13 + 6}
        one = built(**gaps, data=data.ravel())
        assert compared(built(), one) == {"shape", "layout"}
        data[2, -1] = 8
        assert compared(one, built(**gaps, data=data.ravel())) == {"padding"}
        data[2, -1] = 9
        data[2, 13] ^= 1
        assert compared(one, built(**gaps, data=data.ravel())) == {"x"}

    def test_other_fields_other_points_and_flags(self) -> None:
        assert compared(cloud(points_of(3), 2), cloud(points_of(3), 2, names=("x", "y", "w"))) == {"fields", "layout"}
        assert compared(built(), built(points=59)) == {"shape", "layout"}
        assert compared(built(), built(is_dense=True)) == {"is_dense"}

    def test_a_tolerance_is_a_fields_own(self) -> None:
        points = points_of(3)
        moved = points + np.float32(1e-3)
        one, other = cloud(points, 2), cloud(moved, 2)
        assert compared(one, other) == {"x", "y", "z"}
        assert compared(one, other, Rules(atol={"x": 0.01, "y": 0.01})) == {"z"}
        assert compared(one, other, Rules(atol={"": 0.01})) == set()

    def test_data_that_is_cut_off(self) -> None:
        short = cloud(points_of(3), 2, cut=5)
        assert compared(short, short) == set()
        assert "bytes" in compared(cloud(points_of(3), 2), short)

    def test_a_datatype_that_nobody_knows_is_told_by_its_bytes(self) -> None:
        fields = deserialized(built(), CLOUD, 2).fields
        odd = [*fields[:2], replace(fields[2], datatype=77)]
        data = data_of(built())
        data[10] ^= 1
        assert compared(built(fields=odd), built(fields=odd)) == set()
        assert compared(built(fields=odd), built(fields=odd, data=data)) == {"padding"}

    def test_a_field_of_several_elements(self) -> None:
        fields = deserialized(built(), CLOUD, 2).fields
        several = [replace(fields[0], count=3)]
        data = data_of(built())
        data[13 * 2 + 9] ^= 1
        assert compared(built(fields=several), built(fields=several, data=data)) == {"x"}
        wide = [replace(fields[0], count=4)]
        assert compared(built(fields=wide), built(fields=wide, data=data)) == {"bytes"}

    def test_clouds_without_points(self) -> None:
        empty = cloud(np.empty((0, 3), np.float32), 2)
        assert compared(empty, empty) == set()


#: Where a ROS 1 message has its stamp, by which messages are matched.
STAMP = range(4, 12)


@pytest.mark.parametrize("msgtype", [LASERSCAN, POINTCLOUD2])
def test_every_bit_of_a_message_matters(msgtype: str) -> None:
    data = scan(RANGES, 1, seq=6) if msgtype == LASERSCAN else built(1, points=3)
    original = message(data, msgtype, 1)
    assert compare_messages(original, message(bytes(data), msgtype, 1), EXACT).same
    for place in range(len(data)):
        for bit in range(8):
            if place not in STAMP:
                flipped = bytearray(data)
                flipped[place] ^= 1 << bit
                found = compare_messages(original, message(bytes(flipped), msgtype, 1), EXACT)
                assert not found.same, (place, bit)
