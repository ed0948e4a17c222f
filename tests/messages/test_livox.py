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
from pc2scan.messages.pointcloud2 import as_pointcloud2
from support import builders
from support.builders import CLOUD, SECOND, T0, Item, Mcap, Recording, Stream
from support.clouds import LIVOX as KINDS
from support.clouds import livox, livox_points
from support.outputs import opened

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Tags of sound points, one of them a second return of an Avia; and of noise.
SOUND, NOISE = (0, 3, 0x10, 0x20, 0x0C, 0x80), (1, 2, 0x04, 0x08, 0x15, 0x40)


def points_of(step: int, count: int = 300) -> NDArray[Any]:
    """A Livox cloud's points: some at the origin, some that are noise."""
    return livox_points(step, count, [*SOUND] * 5 + [*NOISE])


def returns(points: NDArray[Any]) -> NDArray[np.float32]:
    """Their coordinates and reflectivity; NaN for those that are no returns."""
    table = np.stack([points[name].astype(np.float32) for name in ("x", "y", "z", "reflectivity")], axis=1)
    at_origin = (table[:, :3] == 0).all(axis=1)
    table[at_origin | np.isin(points["tag"], NOISE), 0] = np.nan
    return table


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
            lambda ros, seq, at=at, points=points: livox(points, ros, kind, seq=seq, stamp_ns=at, more=7),  # type: ignore[misc]
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
        assert any("its point_num is 307" in text for text in report.warnings) == (folder == "own")
        scans.append([(each.log_time_ns, each.data) for each in opened(Path(report.destination)).of("/scan")])
    assert len(scans[0]) == 4
    assert scans[0] == scans[1]


@pytest.mark.parametrize("ros_version", [1, 2])
@pytest.mark.parametrize("count", [0, 1, 300])
def test_as_pointcloud2_it_is_what_the_driver_publishes(count: int, ros_version: int) -> None:
    """``xfer_format`` 0 of livox_ros_driver2: LivoxPointXyzrtlt, 26 bytes without padding."""
    points = points_of(3, count)
    cloud = as_pointcloud2(decode_livox(livox(points, ros_version), "ros1" if ros_version == 1 else "cdr"))
    assert (cloud.point_step, cloud.width, cloud.height, cloud.is_bigendian) == (26, count, 1, False)
    assert [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields] == [
        *(("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("intensity", 12, 7, 1)),
        *(("tag", 16, 2, 1), ("line", 17, 2, 1), ("timestamp", 18, 8, 1)),
    ]
    expected = b"".join(
        struct.pack("<ffffBBd", x, y, z, reflectivity, tag, line, float(T0 + offset))
        for offset, x, y, z, reflectivity, tag, line in points.tolist()
    )
    assert bytes(cloud.data) == expected
