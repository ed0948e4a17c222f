"""What is latched when a cut begins is written at its beginning."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.messages.tfmessage import decode_transforms
from support.builders import (
    BODY,
    MOUNT,
    SECOND,
    STRING,
    T0,
    Mcap,
    Recording,
    Stream,
    cloud,
    fixed,
    item,
    points,
    points_of,
    string,
    write_mcap,
    write_rosbag1,
    write_rosbag2,
)
from support.builders import CLOUD as CLOUD_TYPE

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

MAPS = Stream("/map_name", STRING, "/map_server", latched=True)
OTHER_MAPS = Stream("/map_name", STRING, "/other_server", latched=True)
FIXED_CLOUDS = Stream("/map_points", CLOUD_TYPE, "/map_server", latched=True)

#: Each publisher sends everything again every hundred seconds: the maps, and its transforms with new stamps.
HOUR = Recording(
    (MAPS, OTHER_MAPS, MOUNT, BODY, FIXED_CLOUDS, Stream("/points", CLOUD_TYPE, "/lidar_driver")),
    tuple(
        sorted(
            [
                *(
                    item(MAPS, T0 + at * SECOND, lambda version, seq: string(f"map {seq}", version), at)
                    for at in range(0, 3600, 100)
                ),
                item(OTHER_MAPS, T0 + 7 * SECOND, lambda version, _: string("other", version)),
                *(fixed(MOUNT, T0 + at * SECOND + 1, "lidar", 0.5 + at / 1e4) for at in range(0, 3600, 100)),
                fixed(MOUNT, T0 + 2 * SECOND, "camera", 0.7),
                fixed(BODY, T0 + 3 * SECOND, "imu", 0.6),
                *(
                    item(
                        FIXED_CLOUDS,
                        T0 + at * SECOND + 2,
                        lambda version, seq: cloud(points_of(seq), version, seq=seq, stamp_ns=T0 + seq * SECOND),
                        at,
                    )
                    for at in range(0, 3600, 1200)
                ),
                *(points(T0 + at * SECOND, T0 + at * SECOND, at) for at in range(3500, 3600, 10)),
            ],
            key=lambda each: each.log_time_ns,
        )
    ),
)

WRITERS: dict[str, Callable[[Path, Recording], Path]] = {
    "h.bag": write_rosbag1,
    "h.mcap": write_mcap,
    "joined.mcap": lambda path, recording: write_mcap(path, recording, Mcap(joined=True)),
    "h": write_rosbag2,
}
START = T0 + 3550 * SECOND


def cut(tmp_path: Path, name: str, **options: Any) -> tuple[list[Any], pc2scan.Report]:
    """The messages of a cut that begins after 3550 s, and the report."""
    source = WRITERS[name](tmp_path / name, HOUR)
    destination = tmp_path / "cut.mcap"
    report = pc2scan.convert(source, destination, start=3550, topics="/points:=/scan", min_height=-9, **options)
    reader = open_recording(destination)
    try:
        return [each._replace(data=bytes(each.data)) for each in reader.messages()], report
    finally:
        reader.close()


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("jobs", [1, 3])
def test_the_newest_of_each_latched_topic_is_at_the_start(name: str, jobs: int, tmp_path: Path) -> None:
    found, report = cut(tmp_path, name, jobs=jobs)
    assert {each.log_time_ns for each in found} == {START, *(T0 + at * SECOND for at in range(3550, 3600, 10))}
    assert all(each.publish_time_ns >= START - SECOND for each in found)
    latched = [each for each in found if each.connection.topic in {"/map_name", "/tf_static", "/map_points"}]
    assert {each.log_time_ns for each in latched} == {START}
    maps = [each.data for each in latched if each.connection.topic == "/map_name"]
    # A rosbag2 topic and a joined channel do not say which publisher a message is of.
    publishers = 2 if name in {"h.bag", "h.mcap"} else 1
    assert len(maps) == publishers
    assert any(b"map 3500" in each for each in maps)
    assert sum(b"other" in each for each in maps) == publishers - 1
    assert len([each for each in latched if each.connection.topic == "/map_points"]) == 1
    (entry,) = (each for each in report.topics if each.topic == "/map_points")
    assert (entry.messages_in, entry.messages_out) == (1, 1)


@pytest.mark.parametrize("name", WRITERS)
def test_no_static_transform_is_lost(name: str, tmp_path: Path) -> None:
    found, _ = cut(tmp_path, name)
    static = [each for each in found if each.connection.topic == "/tf_static"]
    rows = [row for each in static for row in decode_transforms(each.data, each.connection.serialization)]
    assert {row[1]: round(row[5], 6) for row in rows} == {"lidar": 0.85, "camera": 0.7, "imu": 0.6}
    assert len(rows) == 3
