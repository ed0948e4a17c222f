"""Scans and trajectories as files, read back by readers that are not ours."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pc2scan
from exports.driving import PATTERN, POSED, STAMPS, by_odometry, by_tf, drive
from pc2scan.errors import TransformError, UsageError, stamp_text
from pc2scan.exports.export import file_names
from pc2scan.exports.writers import FORMATS
from pc2scan.options.table import options_of
from support import HALL
from support.builders import write_mcap
from support.scan_recordings import recording as recording_of
from support.tables import rows

TABLES = Path(__file__).with_name("requests.txt")


@pytest.fixture
def mcap(tmp_path: Path) -> Path:
    return write_mcap(tmp_path / "drive.mcap", drive())


# --- npz ---


def test_npz_has_what_the_messages_have(mcap: Path, tmp_path: Path) -> None:
    calls: list[tuple[int, int, int]] = []
    report = pc2scan.export(mcap, tmp_path / "scans.npz", progress=lambda *call: calls.append(call))
    assert all(0 <= done <= total == calls[-1][0] for done, total, _ in calls)
    assert (report.messages, report.exit_status, report.format) == (6, 0, "npz")
    scans = list(pc2scan.scans(mcap))
    # NumPy reads it, without pickles.
    with np.load(tmp_path / "scans.npz") as archive:
        found = dict(archive)
    assert found["ranges"].dtype == found["intensities"].dtype == np.float32
    assert found["ranges"].tobytes() == np.stack([scan.ranges for scan in scans]).tobytes()
    assert found["intensities"].tobytes() == np.stack([scan.intensities for scan in scans]).tobytes()
    assert found["stamps"].dtype == np.int64
    assert found["stamps"].tolist() == list(STAMPS)
    assert found["log_times"].tolist() == [scan.log_time_ns for scan in scans]
    assert np.array_equal(found["angles"], scans[0].angles)
    for name in ("range_min", "range_max", "time_increment", "scan_time"):
        assert found[name].tolist() == [getattr(scan, name) for scan in scans]
    assert (str(found["topic"]), str(found["frame"])) == ("/scan", "laser")
    assert "poses" not in found


def test_poses_are_at_the_stamps_and_scans_without_are_skipped(mcap: Path, tmp_path: Path) -> None:
    report = pc2scan.export(mcap, tmp_path / "scans.npz", pose_frame="odom")
    with np.load(tmp_path / "scans.npz") as archive:
        assert archive["stamps"].tolist() == list(POSED)
        assert archive["poses"].dtype == np.float64
        assert np.allclose(archive["poses"], [by_tf(stamp) for stamp in POSED], rtol=0, atol=1e-12)
        assert (str(archive["pose_frame"]), str(archive["base_frame"])) == ("odom", "base_link")
        assert len(archive["ranges"]) == len(archive["intensities"]) == len(POSED)
    assert [entry.stamp_ns for entry in report.skipped] == [STAMPS[0], STAMPS[-1]]
    assert (report.messages, report.exit_status, report.topics[0].skipped) == (4, 3, 2)
    pc2scan.export(mcap, tmp_path / "again.npz", pose_frame="odom")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "scans.npz").read_bytes()
    with pytest.raises(TransformError, match=r"1699999999\.9"):
        pc2scan.export(mcap, tmp_path / "other.npz", pose_frame="odom", strict=True)
    assert not (tmp_path / "other.npz").exists()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (
            {"ranges": PATTERN.ranges[:8], "intensities": PATTERN.intensities[:8]},
            "has 8 beams with .* and the first 9 beams",
        ),
        ({"angle_min": -0.5}, "from -0.5 rad on"),
        ({"intensities": np.empty(0, np.float32)}, "9 beams without intensities"),
    ],
)
def test_scans_that_one_archive_cannot_hold_are_refused(change: dict[str, object], named: str, tmp_path: Path) -> None:
    scans = [replace(PATTERN, stamp_ns=STAMPS[1]), replace(PATTERN, stamp_ns=STAMPS[2], **change)]  # type: ignore[arg-type]
    path = write_mcap(tmp_path / "odd.mcap", drive({"/scan": scans}))
    with pytest.raises(UsageError, match=named) as caught:
        pc2scan.export(path, tmp_path / "scans.npz")
    assert caught.value.topic == "/scan"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["odd.mcap"]


# --- csv ---


def test_csv_is_exact(mcap: Path, tmp_path: Path) -> None:
    pc2scan.export(mcap, tmp_path / "scans.csv", pose_frame="odom")
    with (tmp_path / "scans.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    scans = [scan for scan in pc2scan.scans(mcap) if scan.stamp_ns in POSED]
    assert [int(row["stamp_ns"]) for row in rows] == list(POSED)
    for row, scan in zip(rows, scans, strict=True):
        assert np.array([row[f"range_{i}"] for i in range(9)], np.float32).tobytes() == scan.ranges.tobytes()
        assert np.array([row[f"intensity_{i}"] for i in range(9)], np.float32).tobytes() == scan.intensities.tobytes()
        assert tuple(float(row[name]) for name in ("x", "y", "yaw")) == pytest.approx(by_tf(scan.stamp_ns), abs=1e-12)
        for name in ("angle_min", "angle_increment", "time_increment", "scan_time", "range_min", "range_max"):
            assert np.float32(row[name]) == np.float32(getattr(scan, name))
        assert (row["frame"], int(row["log_time_ns"])) == ("laser", scan.log_time_ns)


# --- tum ---


def test_tum_is_exact(mcap: Path, tmp_path: Path) -> None:
    pc2scan.export(mcap, tmp_path / "robot.tum", odom_topic="/odom")
    lines = [line.split() for line in (tmp_path / "robot.tum").read_text().splitlines()]
    assert [line[0] for line in lines] == [stamp_text(stamp) for stamp in POSED]
    poses = [[float(number) for number in line[1:]] for line in lines]
    for pose, (x, y, yaw) in zip(poses, map(by_odometry, POSED), strict=True):
        assert pose == pytest.approx([x, y, 0, 0, 0, np.sin(yaw / 2), np.cos(yaw / 2)], abs=1e-12)


# --- made of clouds ---


def test_scans_made_of_clouds_are_those_that_convert_writes(tmp_path: Path) -> None:
    heights = {"min_height": -0.3, "max_height": 1.0, "range_max": 20.0}
    pc2scan.convert(HALL, tmp_path / "scans.mcap", **heights)  # type: ignore[arg-type]
    pc2scan.export(HALL, tmp_path / "made.npz", pose_frame="odom", **heights)  # type: ignore[arg-type]
    pc2scan.export(tmp_path / "scans.mcap", tmp_path / "read.npz", pose_frame="odom")
    assert (tmp_path / "made.npz").read_bytes() == (tmp_path / "read.npz").read_bytes()


# --- several topics, and what is there already ---


def test_a_topic_of_which_nothing_can_be_written_has_no_file(tmp_path: Path) -> None:
    topics = {topic: [replace(PATTERN, stamp_ns=STAMPS[n])] for n, topic in enumerate(("/lost", "/known"))}
    path = write_mcap(tmp_path / "drive.mcap", drive(topics))
    report = pc2scan.export(path, f"{tmp_path}/out/", format="csv", pose_frame="odom")
    assert {topic.topic: topic.written for topic in report.topics} == {"/known": 1, "/lost": 0}
    assert "/lost: nothing to write, so there is no file" in report.warnings
    assert [entry.name for entry in (tmp_path / "out").glob("[!.]*")] == ["known.csv"]


def test_names_of_files_are_safe_and_never_the_same() -> None:
    topics = ["/a/b", "/a_b", "/A_B", "/a_b_2", "/..", "/.", "/ö", "/" + "x" * 300, "/" + "x" * 301, "/a\0b\n/c"]
    names = list(file_names(topics).values())
    assert len({name.lower() for name in names}) == len(topics)
    for name in names:
        assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,128}", name)
    assert options_of("export")["format"].value.words == options_of("batch")["format"].value.words == tuple(FORMATS)


# --- what is wrong with requests ---


@pytest.mark.parametrize(("how", "said"), rows(TABLES, "wrong requests"))
def test_wrong_requests_write_nothing(how: dict[str, Any], said: str, mcap: Path, tmp_path: Path) -> None:
    how = dict(how)
    destination = tmp_path / how.pop("destination", "scans.npz")
    with pytest.raises(UsageError, match=said):
        pc2scan.export(mcap, destination, **how)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["drive.mcap"]


#: The frames from odom to the laser, and the robot's.
ROBOTS = [(("base_footprint", "base_link", "laser"), "base_link"), (("robot", "laser"), "laser")]


@pytest.mark.parametrize(("frames", "expected"), ROBOTS)
def test_the_robots_frame_follows_from_the_transforms(frames: tuple[str, ...], expected: str, tmp_path: Path) -> None:
    edges = list(pairwise(("odom", *frames)))
    scans = [replace(PATTERN, stamp_ns=stamp) for stamp in POSED]
    path = write_mcap(tmp_path / "drive.mcap", recording_of({"/scan": scans}, edges[-1:]))
    others = write_mcap(tmp_path / "moving.mcap", recording_of({}, edges[:-1], static=False))
    report = pc2scan.export(path, tmp_path / "scans.npz", pose_frame="odom", tf_from=others)
    assert (report.topics[0].base_frame, report.messages) == (expected, len(POSED))
