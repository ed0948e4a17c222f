"""CARMEN's log files, read by a parser of the published rules."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from exports.driving import MOUNT, PATTERN, POSED, STAMPS, by_odometry, drive
from pc2scan.errors import stamp_text
from support.builders import write_mcap

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.messages.laserscan import LaserScan


def read_log(path: Path) -> list[Any]:
    """The laser messages of a log, by the published rules alone (logger_playback.html).

    One message a line: its name, its content, ``ipc_timestamp ipc_hostname logger_timestamp``. A scan's beams: the
    first at ``start_angle``, each ``angular_resolution`` from the next.
    """
    readings = []
    for line in path.read_text("ascii").splitlines():
        name, *words = line.split()
        if name == "#":
            continue
        assert name == "ROBOTLASER1", line

        def take(count: int, words: list[str] = words) -> list[float]:
            return [float(words.pop(0)) for _ in range(count)]

        _, start, view, step, maximum, _, _ = take(7)
        found = SimpleNamespace(start=start, view=view, step=step, maximum=maximum)
        found.ranges = take(int(words.pop(0)))
        found.remissions = take(int(words.pop(0)))
        found.laser, found.robot = take(3), take(3)
        # laser_tv laser_rv forward_safety_dist side_safety_dist turn_axis
        take(5)
        found.stamp, _, found.since_start = words
        found.angles = [start + i * step for i in range(len(found.ranges))]
        readings.append(found)
    return readings


def written(tmp_path: Path, *scans: LaserScan, name: str = "drive.log", **how: Any) -> Path:
    source = write_mcap(tmp_path / "drive.mcap", drive({"/scan": scans} if scans else None))
    pc2scan.export(source, tmp_path / name, **({"pose_frame": "odom"} | how))
    return tmp_path / name


def test_robotlaser1_says_beams_readings_and_poses(tmp_path: Path) -> None:
    readings = read_log(written(tmp_path, odom_topic="/odom", pose_frame=""))
    assert [reading.stamp for reading in readings] == [stamp_text(stamp) for stamp in POSED]
    assert [reading.since_start for reading in readings] == [stamp_text(stamp - POSED[0]) for stamp in POSED]
    scans = [scan for scan in pc2scan.scans(tmp_path / "drive.mcap") if scan.stamp_ns in POSED]
    for reading, scan, stamp in zip(readings, scans, POSED, strict=True):
        assert np.allclose(reading.angles, scan.angles, atol=1e-6)
        assert reading.view == pytest.approx(2.0)
        assert reading.maximum == 30.0
        expected = np.where(scan.valid, scan.ranges, np.float32(30))
        assert np.array(reading.ranges, np.float32).tobytes() == expected.astype(np.float32).tobytes()
        assert np.array(reading.remissions, np.float32).tobytes() == scan.intensities.tobytes()
        x, y, yaw = by_odometry(stamp)
        laser = [x + MOUNT[0] * math.cos(yaw), y + MOUNT[0] * math.sin(yaw), yaw]
        assert reading.robot == pytest.approx([x, y, yaw], abs=1e-9)
        assert reading.laser == pytest.approx(laser, abs=1e-9)


def test_beams_that_run_clockwise_are_turned(tmp_path: Path) -> None:
    ranges = np.arange(1, 10, dtype=np.float32)
    scan = replace(PATTERN, stamp_ns=STAMPS[1], angle_min=1.0, angle_max=-1.0, angle_increment=-0.25, ranges=ranges)
    (reading,) = read_log(written(tmp_path, scan))
    assert reading.ranges == ranges[::-1].tolist()
    assert reading.remissions == pytest.approx(PATTERN.intensities[::-1].tolist())
    assert (reading.start, reading.step) == (-1.0, 0.25)
