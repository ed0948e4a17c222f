"""What differs between two messages, field by field."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.compare.rules import Rules, compare_messages
from pc2scan.messages.laserscan import LASERSCAN, decode_laserscan, encode_laserscan
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from pc2scan.model import Connection, RawMessage
from support.builders import CLOUD, T0, cloud, deserialized, points_of, scan, serialized, typestore

if TYPE_CHECKING:
    from collections.abc import Callable

ENCODINGS = {1: "ros1", 2: "cdr"}
EXACT = Rules()
RANGES = np.array([1.0, np.inf, 2.5, 3.0], np.float32)


def message(data: bytes, msgtype: str, ros_version: int = 2, log_time_ns: int = T0) -> RawMessage:
    return RawMessage(Connection(0, "/x", msgtype, ENCODINGS[ros_version]), log_time_ns, data, log_time_ns)


def differing(one: RawMessage, other: RawMessage, **rules: Any) -> set[str]:
    """The names of what differs."""
    found = compare_messages(one, other, Rules(**rules))
    names = {change.name for change in found.changes} | {values.name for values in found.values}
    assert found.same == (not names)
    return names


# --- scans ---


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
        ("intensities", RANGES),
        ("ranges", RANGES + np.float32(0.5)),
        ("log_time", 1),
    ],
)
def test_each_field_of_a_scan_is_found_and_can_be_ignored(field: str, value: Any) -> None:
    data = scan(RANGES, 1)
    one = other = message(data, LASERSCAN, 1)
    if field == "log_time":
        other = one._replace(log_time_ns=T0 + value)
    else:
        other = message(
            encode_laserscan(replace(decode_laserscan(data, "ros1"), **{field: value}), "ros1"), LASERSCAN, 1
        )
    name = "seq" if field == "sequence" else field
    assert differing(one, other) == {name}
    assert differing(one, other, ignore=frozenset({name})) == set()


def test_what_cannot_be_decoded_is_compared_by_its_bytes() -> None:
    whole, broken = (message(data, LASERSCAN) for data in (scan(RANGES, 2), scan(RANGES, 2)[:-9]))
    assert differing(broken, broken) == set()
    (change,) = compare_messages(broken, whole, EXACT).changes
    assert change.name == "bytes"
    assert "message ends" in change.b


# --- clouds ---


def built(ros_version: int = 2, points: int = 60, **changed: Any) -> bytes:
    """A cloud of x, y, z and a byte of padding behind them; ``changed`` replaces parts of the message."""
    base = deserialized(cloud(points_of(3, points), ros_version), CLOUD, ros_version)
    data = np.zeros((points, 13), np.uint8)
    data[:, :12] = base.data.reshape(points, 12)
    parts = {"point_step": 13, "row_step": 13 * points, "data": data.ravel(), **changed}
    return serialized(typestore(ros_version), replace(base, **parts), CLOUD, ros_version)


def flipped(place: int, **changed: Any) -> bytes:
    """Such a cloud with a bit of its data flipped."""
    data = deserialized(built(), CLOUD, 2).data.copy()
    data[place] ^= 1
    return built(data=data, **changed)


def rows(value: int = 9, x: int = 0) -> bytes:
    """Its points in four rows with gaps between them; a byte of a gap, and a bit of an x."""
    data = np.full((4, 15 * 13 + 6), 9, np.uint8)
    data[:, : 15 * 13] = deserialized(built(), CLOUD, 2).data.reshape(4, 15 * 13)
    data[2, -1] = value
    data[2, 13] ^= x
    return built(height=4, width=15, row_step=15 * 13 + 6, data=data.ravel())


def packed(change: float = 0.0, **options: Any) -> bytes:
    """The same points without padding, one of their heights changed."""
    points = points_of(3)
    points[5, 2] += change
    return cloud(points, 2, **options)


def big_endian() -> bytes:
    base = deserialized(packed(), CLOUD, 2)
    swapped = base.data.view("<f4").astype(">f4").view(np.uint8)
    return serialized(typestore(2), replace(base, is_bigendian=True, data=swapped), CLOUD, 2)


X, Y, Z = deserialized(built(), CLOUD, 2).fields
#: A datatype that nobody knows, fields of several elements, the last beyond the point.
ODD, SEVERAL, WIDE = [X, Y, replace(Z, datatype=77)], [replace(X, count=3)], [replace(X, count=4)]
EMPTY = cloud(np.empty((0, 3), np.float32), 2)


@pytest.mark.parametrize(
    ("one", "other", "names", "ignore"),
    [
        (built, partial(flipped, 13 * 7 + 4), "y", ""),
        (built, partial(flipped, 13 * 7 + 12), "padding", ""),
        (built, partial(flipped, 13 * 7 + 12), "", "padding"),
        # The layout differs, the values do not.
        (built, packed, "layout", ""),
        (built, packed, "", "layout"),
        (built, partial(packed, 1.0), "z", "layout"),
        (packed, big_endian, "layout", ""),
        (built, rows, "shape layout", ""),
        (rows, partial(rows, 8), "padding", ""),
        (rows, partial(rows, 9, 1), "x", ""),
        (packed, partial(packed, names=("x", "y", "w")), "fields layout", ""),
        (built, partial(built, points=59), "shape layout", ""),
        (built, partial(built, is_dense=True), "is_dense", ""),
        (partial(packed, cut=5), partial(packed, cut=5), "", ""),
        (packed, partial(packed, cut=5), "bytes", ""),
        (partial(built, fields=ODD), partial(built, fields=ODD), "", ""),
        (partial(built, fields=ODD), partial(flipped, 10, fields=ODD), "padding", ""),
        (partial(built, fields=SEVERAL), partial(flipped, 13 * 2 + 9, fields=SEVERAL), "x", ""),
        (partial(built, fields=WIDE), partial(flipped, 13 * 2 + 9, fields=WIDE), "bytes", ""),
        (lambda: EMPTY, lambda: EMPTY, "", ""),
    ],
)
def test_what_differs_between_clouds(
    one: Callable[[], bytes], other: Callable[[], bytes], names: str, ignore: str
) -> None:
    a, b = message(one(), POINTCLOUD2), message(other(), POINTCLOUD2)
    assert differing(a, b, ignore=frozenset(ignore.split())) == set(names.split())


@pytest.mark.parametrize(
    ("atol", "names"), [({}, "x y z"), ({"x": 0.01, "y": 0.01}, "z"), ({"": 0.01}, ""), ({"": 0.01, "y": 1e-6}, "y")]
)
def test_a_tolerance_is_a_fields_own(atol: dict[str, float], names: str) -> None:
    points = points_of(3)
    one, other = (message(cloud(points + np.float32(by), 2), POINTCLOUD2) for by in (0, 1e-3))
    assert differing(one, other, atol=atol) == set(names.split())


# --- both ---


#: Where a ROS 1 message has its stamp, by which messages are matched.
STAMP = range(4, 12)


@pytest.mark.parametrize("msgtype", [LASERSCAN, POINTCLOUD2])
def test_every_bit_of_a_message_matters(msgtype: str) -> None:
    data = scan(RANGES, 1, seq=6) if msgtype == LASERSCAN else built(1, points=3)
    original = message(data, msgtype, 1)
    assert differing(original, message(bytes(data), msgtype, 1)) == set()
    for place in set(range(len(data))) - set(STAMP):
        for bit in range(8):
            flipped = bytearray(data)
            flipped[place] ^= 1 << bit
            assert differing(original, message(bytes(flipped), msgtype, 1)), (place, bit)
