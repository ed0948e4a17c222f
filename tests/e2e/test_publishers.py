"""Several publishers of one topic: rosbag2's recordings have one row, or one channel, a topic."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from rosbags.rosbag2 import Reader
from ruamel.yaml import YAML

from support.builders import (
    CONTENT,
    MOUNT,
    ODOMETRY,
    POINTS,
    SECOND,
    T0,
    Mcap,
    Recording,
    fixed,
    odometry,
    points,
    write_mcap,
    write_rosbag1,
)
from support.command import run
from support.outputs import opened

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

#: Two more nodes that publish odometry, one that publishes another mount, and one that publishes clouds.
MORE = (
    replace(ODOMETRY, publisher="/wheels"),
    replace(ODOMETRY, publisher="/lidar_odometry", latched=True),
    replace(MOUNT, publisher="/arm"),
    replace(POINTS, publisher="/lidar_restarted"),
)


def crowded() -> Recording:
    """The usual content with further publishers of its topics, whose messages alternate."""
    items = list(CONTENT.items)
    for number in range(40):
        at = T0 + number * SECOND // 100
        items += [odometry(at, at, 0.01 * number, number, stream) for stream in MORE[:2]]
    items.append(fixed(MORE[2], T0 + 3, "arm", 1.0))
    items += [points(T0 + 50_000_000 + number, T0, number, MORE[3]) for number in range(3)]
    return Recording((*CONTENT.streams, *MORE), tuple(sorted(items, key=lambda entry: entry.log_time_ns)))


CROWDED = crowded()
SOURCES: dict[str, Callable[[Path], Path]] = {
    "bag": lambda folder: write_rosbag1(folder / "drive.bag", CROWDED),
    "mcap": lambda folder: write_mcap(folder / "drive.mcap", CROWDED),
    "mcap-ros1": lambda folder: write_mcap(folder / "drive.mcap", CROWDED, Mcap(ros_version=1, profile="ros1")),
}


def topics_of(folder: Path) -> list[dict[str, Any]]:
    info = YAML(typ="safe").load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    return [{**entry["topic_metadata"], "count": entry["message_count"]} for entry in info["topics_with_message_count"]]


NUMBERS = {"volatile": 2, "transient_local": 1}


def durabilities(profiles: Any) -> list[int]:
    found = YAML(typ="safe").load(profiles) if isinstance(profiles, str) else profiles
    return [NUMBERS.get(own["durability"], own["durability"]) for own in found]


@pytest.mark.parametrize(
    ("source", "storage"),
    [("bag", "sqlite3"), ("mcap", "sqlite3"), ("mcap", "mcap"), ("mcap-ros1", "mcap"), ("bag", "mcap")],
)
def test_a_topic_has_one_row_in_rosbag2(source: str, storage: str, tmp_path: Path) -> None:
    path, folder = SOURCES[source](tmp_path), tmp_path / "out"
    options = ("--storage", storage, "--keep-clouds", "--min-height", "-9")
    done = run("convert", path, "-o", folder, *options)
    assert done.status == 0, done.stderr
    listed = topics_of(folder)
    names = [(topic["name"], topic["type"]) for topic in listed]
    assert len(names) == len(set(names))
    counts = {topic["name"]: topic["count"] for topic in listed}
    assert counts["/tf"] == len(CROWDED.of("/tf")) == 83
    assert counts["/tf_static"] == 3
    assert counts["/scan"] == counts["/points"] == 6
    # Read again by others: every message is there, in its order.
    output = opened(folder)
    for topic in ("/tf", "/tf_static", "/points"):
        assert [found.log_time_ns for found in output.of(topic)] == [entry.log_time_ns for entry in CROWDED.of(topic)]
    # As rosbag2's recorder does: one profile a publisher, equal ones too. ROS 1 records nothing but latching.
    found = {topic["name"]: topic["offered_qos_profiles"] for topic in listed}
    assert durabilities(found["/tf_static"]) == [1, 1, 1]
    if source == "mcap":
        assert [durabilities(found[name]) for name in ("/tf", "/scan", "/chatter")] == [[2, 2, 1], [2, 2], [2]]
    else:
        assert len(durabilities(found["/tf"])) == 1
    # The storage has the same.
    with Reader(folder) as reader:
        for each in reader.connections:
            profiles = getattr(each.ext, "offered_qos_profiles", None) or []
            assert [profile.durability.value for profile in profiles] == durabilities(found[each.topic] or [])
