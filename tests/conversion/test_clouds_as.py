"""Clouds of all types, written as PointCloud2: beside their scans, and without any."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.messages.livox import decode_livox
from pc2scan.messages.pointcloud2 import as_pointcloud2, decode_pointcloud2, encode_cloud
from support import builders, clouds
from support.builders import CLOUD, INERTIA, SECOND, T0, Mcap, Recording, Stream
from support.outputs import opened

if TYPE_CHECKING:
    from collections.abc import Callable

LIVOX = Stream("/livox/lidar", clouds.LIVOX[1])


def at(step: int) -> int:
    return T0 + step * SECOND // 10


def recording(path: Path, stream: Stream, make: Callable[[int, int], bytes], ros_version: int) -> Path:
    """Three clouds, and an IMU between them."""
    items = [builders.Item(stream, at(step), {ros: make(step, ros) for ros in (1, 2)}) for step in range(3)]
    items += [
        builders.item(INERTIA, at(step) + 9, lambda g, s, step=step: builders.imu_message(g, seq=s, stamp_ns=at(step)))  # type: ignore[misc]
        for step in range(3)
    ]
    content = Recording((stream, INERTIA), tuple(sorted(items, key=lambda item: item.log_time_ns)))
    if path.suffix == ".bag":
        return builders.write_rosbag1(path, content)
    return builders.write_mcap(path, content, Mcap(ros_version=ros_version, profile=f"ros{ros_version}"))


def livox(step: int, ros_version: int) -> bytes:
    return clouds.livox(clouds.livox_points(step), ros_version, stamp_ns=at(step), seq=step)


def packed(step: int, ros_version: int) -> bytes:
    return clouds.compressed(clouds.lidar_points(step), ros_version, stamp_ns=at(step), seq=step)


def raw(step: int, ros_version: int) -> bytes:
    return clouds.structured(clouds.lidar_points(step), ros_version, stamp_ns=at(step), seq=step)


@pytest.mark.parametrize(("source", "target"), [("bag", "bag"), ("bag", "mcap"), ("mcap", "bag"), ("mcap", "mcap")])
@pytest.mark.parametrize("options", [{}, {"keep_clouds": True, "min_height": -9.0}])
def test_compressed_clouds_are_written_as_they_were(
    source: str, target: Any, options: dict[str, Any], tmp_path: Path
) -> None:
    stream = Stream("/points/zstd", clouds.COMPRESSED)
    ros = {"bag": 1, "mcap": 2}
    path = recording(tmp_path / f"a.{source}", stream, packed, ros[source])
    report = pc2scan.convert(path, tmp_path / f"b.{target}", clouds_as="pointcloud2", to=target, **options)
    if target == "mcap" and source == "bag":
        # A ROS 1 recording stays one.
        ros["mcap"] = 1
    found = opened(Path(report.destination))
    (publisher,) = (each for each in found.publishers if each.topic == stream.topic)
    assert publisher.msgtype == CLOUD
    expected = [raw(step, ros[target]) for step in range(3)]
    if source == "mcap" and target == "bag":
        expected = [builders.unnumbered(data, CLOUD) for data in expected]
    assert [each.data for each in found.of(stream.topic)] == expected
    assert len(found.of("/imu")) == 3
    assert len(found.of("/scan")) == (3 if options else 0)


@pytest.mark.parametrize("form", ["bag", "mcap"])
@pytest.mark.parametrize("jobs", [1, 2])
def test_livox_clouds_get_the_fields_of_the_driver(form: str, jobs: int, tmp_path: Path) -> None:
    ros_version, serialization = (1, "ros1") if form == "bag" else (2, "cdr")
    path = recording(tmp_path / f"a.{form}", LIVOX, livox, ros_version)
    report = pc2scan.convert(path, clouds_as="pointcloud2", jobs=jobs)
    assert Path(report.destination).name == f"a_clouds.{form}"
    found = [each.data for each in opened(Path(report.destination)).of(LIVOX.topic)]
    clouds_of = [as_pointcloud2(decode_livox(livox(step, ros_version), serialization)) for step in range(3)]
    assert found == [encode_cloud(cloud, serialization) for cloud in clouds_of]
    names = [field.name for field in decode_pointcloud2(found[0], serialization).fields]
    assert names == ["x", "y", "z", "intensity", "tag", "line", "timestamp"]
    # The scans of both are the same; points at the origin are below range_min.
    made = []
    for source in (path, Path(report.destination)):
        (scan, *_) = pc2scan.scans(source, min_height=-9.0, range_min=0.1, intensity_field="intensity")
        made.append((scan.ranges.tobytes(), scan.intensities.tobytes()))
    assert made[0] == made[1]
