"""Livox's clouds: held to rosbags' encoding of the drivers' definitions, and to PointCloud2 with the same points."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.errors import DecodeError
from pc2scan.messages.livox import decode_livox
from support import builders
from support.builders import CLOUD, SECOND, T0, Item, Mcap, Recording, Stream
from support.outputs import opened

if TYPE_CHECKING:
    from numpy.typing import NDArray

KINDS = ("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg")

#: Tags of sound points, one of them a second return of an Avia; and of noise.
SOUND, NOISE = (0, 3, 0x10, 0x20, 0x0C), (1, 2, 0x04, 0x08, 0x15)


def points_of(step: int, count: int = 300) -> NDArray[Any]:
    """A Livox cloud's points: some at the origin, some that are noise."""
    random = np.random.default_rng(step)
    kind = [("offset_time", "<u4"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    points = np.zeros(count, [*kind, ("reflectivity", "u1"), ("tag", "u1"), ("line", "u1")])
    for axis in "xyz":
        points[axis] = random.uniform(-8, 8, count)
    points["offset_time"] = np.arange(count) * 100_000_000 // max(count, 1)
    points["reflectivity"] = random.integers(0, 256, count)
    points["tag"] = random.choice([*SOUND] * 5 + [*NOISE], count)
    points["line"] = np.arange(count) % 4
    for axis in "xyz":
        points[axis][::17] = 0
    return points


def livox(points: NDArray[Any], ros_version: int, kind: str = KINDS[1], *, seq: int = 0, stamp_ns: int = T0) -> bytes:
    """A CustomMsg as rosbags serialises it; ``point_num`` is wrong."""
    store = builders.typestore(ros_version)
    point = store.types[kind.replace("CustomMsg", "CustomPoint")]
    message = store.types[kind](
        header=builders.header(store, ros_version, seq, stamp_ns, "livox_frame"),
        timebase=stamp_ns,
        point_num=len(points) + 7,
        lidar_id=3,
        rsvd=np.zeros(3, np.uint8),
        points=[point(*each) for each in points.tolist()],
    )
    return builders.serialized(store, message, kind, ros_version)


def returns(points: NDArray[Any]) -> NDArray[np.float32]:
    """Their coordinates and reflectivity; NaN for those that are no returns."""
    table = np.stack([points[name].astype(np.float32) for name in ("x", "y", "z", "reflectivity")], axis=1)
    at_origin = (table[:, :3] == 0).all(axis=1)
    table[at_origin | np.isin(points["tag"], NOISE), 0] = np.nan
    return table


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("ros_version", "serialization"), [(1, "ros1"), (2, "cdr")])
@pytest.mark.parametrize("count", [0, 1, 2, 300])
def test_points_are_those_of_the_message(kind: str, ros_version: int, serialization: str, count: int) -> None:
    points = points_of(5, count)
    found = decode_livox(livox(points, ros_version, kind, seq=9), serialization)
    assert (found.stamp_ns, found.frame_id, found.sequence) == (T0, "livox_frame", 9 if ros_version == 1 else 0)
    np.testing.assert_array_equal(found.field("x"), returns(points)[:, 0])
    for name in ("y", "z", "offset_time", "reflectivity", "tag", "line"):
        np.testing.assert_array_equal(found.field(name), points[name])
        assert found.field(name).dtype.newbyteorder("<") == points.dtype[name]


def test_the_layout_is_that_of_the_definition() -> None:
    """By hand: a point of 19 bytes, in CDR at every twentieth, also big-endian."""
    point = (7, 1.5, -2.5, 0.5, 200, 0, 3)
    ros1 = struct.pack("<IIII", 1, 10, 20, 1) + b"f" + struct.pack("<QIB3xI", 5, 2, 1, 2)
    ros1 += 2 * struct.pack("<IfffBBB", *point)
    for order in "<>":
        flag = b"\0\1\0\0" if order == "<" else b"\0\0\0\0"
        cdr = struct.pack(f"{order}iII", 10, 20, 2) + b"f\0" + bytes(2) + struct.pack(f"{order}QIB3xI", 5, 2, 1, 2)
        cdr += struct.pack(f"{order}IfffBBBx", *point) + struct.pack(f"{order}IfffBBB", *point)
        for data, serialization in ((ros1, "ros1"), (flag + cdr, "cdr")):
            found = decode_livox(data, serialization)
            assert (found.stamp_ns, found.frame_id) == (10 * SECOND + 20, "f")
            for name, value in zip(("offset_time", "x", "y", "z", "reflectivity", "tag", "line"), point, strict=True):
                assert found.field(name).tolist() == [value] * 2


@pytest.mark.parametrize(("ros_version", "serialization"), [(1, "ros1"), (2, "cdr")])
def test_a_message_that_ends_too_early_is_an_error(ros_version: int, serialization: str) -> None:
    data = livox(points_of(0, 4), ros_version)
    for size in range(len(data)):
        with pytest.raises(DecodeError, match="bytes"):
            decode_livox(data[:size], serialization)
    assert len(decode_livox(data + b"more", serialization).field("x")) == 4


FORMS = {
    "ros1.bag": 1,
    "ros1.mcap": 1,
    "ros2.mcap": 2,
}


def written(path: Path, stream: Stream, items: list[Item], ros_version: int) -> Path:
    recording = Recording((stream,), tuple(items))
    if path.suffix == ".bag":
        return builders.write_rosbag1(path, recording)
    return builders.write_mcap(path, recording, Mcap(ros_version=ros_version, profile=f"ros{ros_version}"))


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("kind", KINDS)
def test_scans_are_those_of_the_same_points_as_pointcloud2(name: str, kind: str, tmp_path: Path) -> None:
    columns = ("x", "y", "z", "reflectivity")
    steps = [(T0 + step * SECOND // 10, points_of(step)) for step in range(4)]
    own = [
        builders.item(
            Stream("/lidar", kind),
            at,
            lambda ros, seq, at=at, points=points: livox(points, ros, kind, seq=seq, stamp_ns=at),  # type: ignore[misc]
        )
        for at, points in steps
    ]
    usual = [
        builders.item(
            Stream("/lidar", CLOUD),
            at,
            lambda ros, seq, at=at, points=points: builders.cloud(  # type: ignore[misc]
                returns(points), ros, seq=seq, stamp_ns=at, frame_id="livox_frame", names=columns
            ),
        )
        for at, points in steps
    ]
    scans = []
    for folder, stream, items in (("own", own[0].stream, own), ("usual", usual[0].stream, usual)):
        (tmp_path / folder).mkdir()
        source = written(tmp_path / folder / name, stream, items, FORMS[name])
        report = pc2scan.convert(
            source,
            tmp_path / folder / f"scans{source.suffix}",
            min_height=-3.0,
            max_height=3.0,
            range_min=0.1,
            intensity_field="reflectivity",
            where="reflectivity > 20",
        )
        assert report.topics[0].points.nan > 40
        scans.append([(each.log_time_ns, each.data) for each in opened(Path(report.destination)).of("/scan")])
    assert len(scans[0]) == 4
    assert scans[0] == scans[1]


def test_info_describes_them_and_their_times_deskew(tmp_path: Path) -> None:
    at = T0
    stream = Stream("/livox/lidar", KINDS[1])
    items = [builders.item(stream, at, lambda ros, seq: livox(points_of(1), ros, seq=seq, stamp_ns=at))]
    source = written(tmp_path / "a.mcap", stream, items, 2)
    (cloud,) = pc2scan.info(source).clouds
    assert cloud.frames == ("livox_frame",)
    assert [name for name, *_ in cloud.fields] == [
        "x",
        "y",
        "z",
        "offset_time",
        "reflectivity",
        "tag",
        "line",
        "intensity",
    ]
    assert cloud.nan_share > 0.1
