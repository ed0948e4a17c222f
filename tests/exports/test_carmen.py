"""CARMEN's log files, read by a parser of the published rules."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from exports.carmen_log import read_log
from exports.driving import MOUNT, PATTERN, POSED, STAMPS, by_odometry, by_tf, drive
from pc2scan.errors import UsageError, stamp_text
from support.builders import write_mcap

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.messages.laserscan import LaserScan


def written(tmp_path: Path, *scans: LaserScan, name: str = "drive.log", **how: Any) -> Path:
    source = write_mcap(tmp_path / "drive.mcap", drive({"/scan": scans} if scans else None))
    pc2scan.export(source, tmp_path / name, **({"pose_frame": "odom"} | how))
    return tmp_path / name


def test_robotlaser1_says_beams_readings_and_poses(tmp_path: Path) -> None:
    readings, _ = read_log(written(tmp_path))
    assert [reading.stamp for reading in readings] == [stamp_text(stamp) for stamp in POSED]
    assert [reading.since_start for reading in readings] == [stamp_text(stamp - POSED[0]) for stamp in POSED]
    scans = [scan for scan in pc2scan.scans(tmp_path / "drive.mcap") if scan.stamp_ns in POSED]
    for reading, scan, stamp in zip(readings, scans, POSED, strict=True):
        assert np.allclose(reading.angles, scan.angles, atol=1e-6)
        assert reading.field_of_view == pytest.approx(2.0)
        assert reading.maximum == 30.0
        expected = np.where(scan.valid, scan.ranges, np.float32(30))
        assert np.array(reading.ranges, np.float32).tobytes() == expected.astype(np.float32).tobytes()
        assert np.array(reading.remissions, np.float32).tobytes() == scan.intensities.tobytes()
        x, y, yaw = by_tf(stamp)
        assert reading.robot == pytest.approx([x, y, yaw])
        assert reading.laser == pytest.approx([x + MOUNT[0], y + MOUNT[1], yaw])


def test_the_laser_turns_with_the_robot(tmp_path: Path) -> None:
    readings, _ = read_log(written(tmp_path, odom_topic="/odom", pose_frame=""))
    for reading, stamp in zip(readings, POSED, strict=True):
        x, y, yaw = by_odometry(stamp)
        assert reading.robot == pytest.approx([x, y, yaw], abs=1e-9)
        assert reading.laser == pytest.approx(
            [x + MOUNT[0] * math.cos(yaw), y + MOUNT[0] * math.sin(yaw), yaw], abs=1e-9
        )


def test_beams_that_run_clockwise_are_turned(tmp_path: Path) -> None:
    ranges = np.arange(1, 10, dtype=np.float32)
    scan = replace(PATTERN, stamp_ns=STAMPS[1], angle_min=1.0, angle_max=-1.0, angle_increment=-0.25, ranges=ranges)
    (reading,), _ = read_log(written(tmp_path, scan))
    assert reading.ranges == ranges[::-1].tolist()
    assert reading.remissions == pytest.approx(PATTERN.intensities[::-1].tolist())
    assert (reading.start_angle, reading.resolution) == (-1.0, 0.25)


def sick(count: int, step: float, **changes: Any) -> LaserScan:
    ranges = np.linspace(1, 40, count, dtype=np.float32)
    ranges[3] = np.inf
    return replace(
        PATTERN,
        stamp_ns=STAMPS[2],
        angle_min=-math.pi / 2,
        angle_max=-math.pi / 2 + (count - 1) * step,
        angle_increment=step,
        range_max=50.0,
        ranges=ranges,
        intensities=np.empty(0, np.float32),
        **changes,
    )


@pytest.mark.parametrize(
    ("count", "degrees"), [(181, 1.0), (180, 1.0), (361, 0.5), (360, 0.5), (721, 0.25), (19, 10.0)]
)
def test_flaser_of_beams_that_its_readers_guess(count: int, degrees: float, tmp_path: Path) -> None:
    scan = sick(count, math.radians(degrees))
    (reading,), parameters = read_log(written(tmp_path, scan, name="drive.clf"))
    assert np.allclose(reading.angles, scan.angle_min + np.arange(count) * scan.angle_increment, atol=1e-5)
    assert reading.ranges[3] > reading.maximum
    assert np.array(reading.ranges[4:], np.float32).tobytes() == scan.ranges[4:].tobytes()
    assert float(parameters["laser_front_laser_resolution"]) == degrees
    assert float(parameters["robot_front_laser_max"]) == reading.maximum
    assert reading.laser == pytest.approx([2.0 * 0.5 + MOUNT[0], -1.0, 0.0])


def test_two_readings_are_half_a_turn_apart(tmp_path: Path) -> None:
    ranges = np.full(2, 4, np.float32)
    scan = replace(sick(5, 0.5), angle_max=math.pi / 2, angle_increment=math.pi, ranges=ranges)
    (reading,), _ = read_log(written(tmp_path, scan, name="drive.clf"))
    assert np.array(reading.ranges, np.float32).tobytes() == ranges.tobytes()


@pytest.mark.parametrize(
    ("scan", "said"),
    [
        (replace(PATTERN, stamp_ns=STAMPS[2]), "FLASER has no directions of beams"),
        (sick(401, math.radians(180 / 400)), "are 0.25 degrees apart"),
        (
            replace(sick(181, math.radians(1)), range_max=200.0, ranges=np.full(181, 90, np.float32)),
            "a reading of 90 m",
        ),
    ],
)
def test_what_flaser_cannot_say_is_refused(scan: LaserScan, said: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=said):
        written(tmp_path, scan, name="drive.clf")
    assert not (tmp_path / "drive.clf").exists()


def test_what_carmen_cannot_say_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="range_max is infinite"):
        written(tmp_path, replace(PATTERN, stamp_ns=STAMPS[2], range_max=math.inf))
    with pytest.raises(UsageError, match="upside down"):
        written(tmp_path, static_tf="base_link laser 0 0 0 180deg 0 0")
    with pytest.raises(UsageError, match="carmen needs poses"):
        written(tmp_path, pose_frame="")
