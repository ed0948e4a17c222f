"""Recordings that other people made: exact scans, and every message accounted for."""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rosbags.rosbag1 import Reader

from support import RECORDINGS, needs_shared, sampled
from support.command import run
from support.outputs import opened

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = needs_shared

CASES: dict[str, dict[str, Any]] = (
    {case["name"]: case for case in json.loads((RECORDINGS / "expected_scans.json").read_text())}
    if RECORDINGS.is_dir()
    else {}
)


def options_of(case: dict[str, Any]) -> list[str]:
    options = ["--topic", f"{case['topic']}:=/e2e_scan"]
    for name, value in case["params"].items():
        options += [f"--{name.replace('_', '-')}", repr(value)]
    return options


@pytest.mark.parametrize(
    ("name", "suffix"), sampled([(name, suffix) for suffix in (".bag", ".mcap", "") for name in CASES], 4)
)
def test_scans_are_equal_to_the_bit(name: str, suffix: str, tmp_path: Path) -> None:
    case = CASES[name]
    destination = tmp_path / f"out{suffix}"
    report = tmp_path / "report.json"
    done = run("convert", RECORDINGS / case["recording"], "-o", destination, "--report", report, *options_of(case))
    assert done.status == 0, done.stderr
    output = opened(destination)
    found, scans = output.of("/e2e_scan"), output.scans("/e2e_scan")
    assert [message.log_time_ns for message in found] == [scan["log_time"] for scan in case["scans"]]
    for scan, reference in zip(scans, case["scans"], strict=True):
        stamp = scan.header.stamp
        assert stamp.sec * 1_000_000_000 + stamp.nanosec == reference["stamp"]
        assert scan.header.frame_id == reference["frame_id"]
        ranges = np.array([float(value) for value in reference["ranges"]], np.float32)
        assert scan.ranges.tobytes() == ranges.tobytes()
    # Everything else is there too, message by message.
    topics = {entry["topic"]: entry for entry in json.loads(report.read_text())["topics"]}
    written = Counter(message.topic for message in output.messages)
    for entry in topics.values():
        assert entry["messages_in"] == entry["messages_out"] > 0 or entry["messages_in"] == 0
        if entry["messages_in"]:
            assert written[entry["target"]] == entry["messages_in"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["jarvis_two_lasers.bag", "guardian_pallet.bag"])
def test_every_laser_message_is_accounted_for(name: str, tmp_path: Path) -> None:
    source = RECORDINGS / name
    with Reader(source) as reader:
        counts = Counter[str]()
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        for connection in reader.connections:
            counts[connection.topic] += connection.msgcount
    lasers = {topic for topic, kind in kinds.items() if kind == "sensor_msgs/msg/LaserScan"}
    root = odometry_root(source)
    report_path, destination = tmp_path / "report.json", tmp_path / "clouds.bag"
    done = run("convert", source, "-o", destination, "--reverse", "--target-frame", root, "--report", report_path)
    assert done.status in (0, 3), done.stderr
    report = json.loads(report_path.read_text())
    assert report["exit_status"] == done.status
    output = opened(destination)
    written = Counter(message.topic for message in output.messages)
    entries = {entry["topic"]: entry for entry in report["topics"]}
    assert lasers == {topic for topic, entry in entries.items() if entry["action"] == "converted"}
    for topic, entry in entries.items():
        assert entry["messages_in"] == counts[topic] == entry["messages_out"] + entry["skipped"]
        assert written[entry["target"]] == entry["messages_out"]
    skipped = sum(entry["skipped"] for entry in entries.values())
    assert skipped == report["skipped_count"]
    assert (done.status == 3) == (skipped > 0)
    assert len(report["skipped"]) == min(skipped, 100)
    assert all(entry["topic"] in lasers and entry["reason"] and entry["stamp_ns"] for entry in report["skipped"])
    # Nearly all of them: the transforms are there, only the very ends of the recording may lack one.
    assert all(entries[topic]["messages_out"] >= 0.9 * counts[topic] for topic in lasers)
    for topic in lasers:
        assert {cloud.header.frame_id for cloud in output.clouds(entries[topic]["target"])} == {root}


def odometry_root(source: Path) -> str:
    """The root of the tree with the most frames, as ``pc2scan tf`` shows it."""
    done = run("tf", source, "--json")
    assert done.status == 0, done.stderr
    trees = json.loads(done.stdout)["trees"]
    return str(max(trees, key=lambda tree: len(tree["frames"]))["roots"][0])
