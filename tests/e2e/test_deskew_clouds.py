"""Clouds of a robot that turns, deskewed by the real command."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from support import ROOT, conversions
from support.command import run
from support.worlds.moving import Lidar, write_world

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.messages.laserscan import LaserScan
    from support.command import Finished

HALL = ROOT / "fixtures" / "hall.mcap"


def converted(folder: Path, *options: str) -> tuple[Finished, list[LaserScan], dict[str, Any]]:
    made = conversions.converted(folder / "b.mcap", HALL, "--min-height", "-0.3", "--only-scans", *options)
    return made.done, made.scans, made.report


@pytest.mark.parametrize("stamp", ["header", "start", "middle", "end"])
def test_deskewed_scans_say_how_far_the_sensor_moved(tmp_path: Path, stamp: str) -> None:
    done, scans, report = converted(tmp_path, "--deskew", "--fixed-frame", "odom", "--stamp", stamp)
    assert done.status == 3
    (topic,) = (entry for entry in report["topics"] if entry["action"] == "converted")
    assert topic["messages_out"] == len(scans) >= 4
    assert 0.01 < topic["motion"]["median_m"] <= topic["motion"]["largest_m"] < 0.5
    assert 0.1 < topic["motion"]["median_deg"] <= topic["motion"]["largest_deg"] < 30
    assert topic["motion"]["longest_gap_s"] == pytest.approx(0.1)
    assert "transforms to --fixed-frame were missing" not in done.stderr
    points = topic["points"]
    assert points["total"] == sum(count for name, count in points.items() if name != "total")
    assert points["no_time"] == 0
    assert all(scan.time_increment == 0 and scan.frame_id == "lidar" for scan in scans)
    assert "deskewed; within a cloud the sensor moved by up to" in done.stdout


def test_deskewing_without_motion_changes_only_the_last_bits(tmp_path: Path) -> None:
    _, plain, report = converted(tmp_path)
    assert [entry["motion"] for entry in report["topics"]] == [None] * len(report["topics"])
    _, same, report = converted(tmp_path, "--deskew", "--fixed-frame", "base_link")
    assert len(plain) == len(same) == 5
    for one, other in zip(plain, same, strict=True):
        both = np.isfinite(one.ranges) & np.isfinite(other.ranges)
        assert both.sum() > 200
        assert np.mean(np.abs(one.ranges[both] - other.ranges[both]) < 1e-5) > 0.99
    (motion,) = (entry["motion"] for entry in report["topics"] if entry["motion"])
    assert motion["largest_m"] < 1e-9


def test_the_turn_of_a_lidar_is_measured(tmp_path: Path) -> None:
    moved = ("--deskew", "--fixed-frame", "odom")
    _, timed, _ = converted(tmp_path, *moved)
    done, scans, report = converted(tmp_path, *moved, "--point-time", "azimuth")
    (note,) = (note for note in report["notes"] if "azimuth" in note)
    assert "one turn takes 0.1 s, clockwise, and the stamp is that of the last point; measured: the period" in note
    assert note in " ".join(done.stdout.split())
    # Of the first cloud only the last point has a transform, where its azimuth gives it the time of the stamp.
    assert len(scans[1:]) == len(timed) == 4
    for one, other in zip(scans[1:], timed, strict=True):
        both = np.isfinite(one.ranges) & np.isfinite(other.ranges)
        assert both.sum() > 200
        assert np.mean(np.abs(one.ranges[both] - other.ranges[both]) < 1e-3) > 0.98
    measured = (tmp_path / "b.mcap").read_bytes()
    converted(tmp_path, *moved, "--point-time", "azimuth:0.1:cw:end")
    assert (tmp_path / "b.mcap").read_bytes() == measured
    converted(tmp_path, *moved, "--point-time", "azimuth:start")
    assert (tmp_path / "b.mcap").read_bytes() != measured


def test_a_turn_that_clouds_do_not_tell_is_to_be_typed(tmp_path: Path) -> None:
    world = write_world(tmp_path / "w.mcap", [Lidar()], seconds=1.0)
    words = ("convert", world, "-o", tmp_path / "out.mcap", "--deskew", "--fixed-frame", "odom", "--point-time")
    done = run(*words, "azimuth")
    assert done.status == 2
    assert not (tmp_path / "out.mcap").exists()
    said = " ".join(done.stderr.split())
    assert "/points" in said
    assert "logged 0.1019 s after their stamps, so the stamp may be the time of the first or of the last point" in said
    assert "--point-time azimuth:0.1:ccw:start" in said
    assert run(*words, "azimuth:start").status == 0
