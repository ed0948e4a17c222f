"""Scans made for their consumers, by the real command, read by other people's libraries and by `pc2scan check`."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.core.consumers import ConsumerScan, ScanTransforms
from pc2scan.core.presets import PRESETS
from support import ROOT
from support.command import run
from support.consumer_rules import RULES
from support.outputs import opened

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.mcap"
HEIGHTS = ("--min-height", "-0.3", "--max-height", "1")


def described(message: Any) -> ConsumerScan:
    return ConsumerScan.of(
        message.ranges,
        **{name: getattr(message, name) for name in ("angle_min", "angle_max", "angle_increment")},
        **{name: getattr(message, name) for name in ("range_min", "range_max", "scan_time", "time_increment")},
        intensities=len(message.intensities),
    )


def stamp_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)


@pytest.mark.parametrize("consumer", PRESETS)
def test_a_preset_is_accepted_by_its_consumer(consumer: str, tmp_path: Path) -> None:
    destination, report = tmp_path / "out.mcap", tmp_path / "report.json"
    done = run("convert", HALL, "-o", destination, *HEIGHTS, "--preset", consumer, "--report", report)
    assert (done.status, done.stderr) == (0, "")
    assert f"note: range_max is 100 m, chosen by --preset {consumer}" in done.stdout
    scans = opened(destination).scans()
    assert len(scans) == 5
    first = described(scans[0])
    for scan in scans if consumer in RULES else ():
        assert RULES[consumer](described(scan), first, ScanTransforms()) == "accepted"
    # gmapping wants angle_max one increment behind the last beam.
    steps = 360 if consumer == "gmapping" else 359
    for scan in scans:
        assert len(scan.ranges) == 360
        last = scan.angle_min + steps * float(np.float32(scan.angle_increment))
        assert scan.angle_max == pytest.approx(last, abs=1e-6)
        assert (scan.angle_min + scan.angle_max == pytest.approx(0, abs=1e-5)) == (consumer in {"gmapping", "mrpt"})
        assert scan.scan_time == np.float32(0.1)
        assert np.isinf(scan.ranges).any() == (consumer != "gmapping")
    told = json.loads(report.read_text())
    assert told["scans"][0]["param_origins"]["geometry"] == f"--preset {consumer}"
    assert told["notes"][0] == "/points: scan_time is 0.1 s, the median interval of its 5 stamps"
    checked = run("check", destination, "--for", consumer)
    assert checked.status == 0, checked.stdout


def test_beams_have_the_times_of_their_points(tmp_path: Path) -> None:
    # The lidar of the hall turns clockwise from x, ten times a second, and stamps the end of its turn.
    destination = tmp_path / "out.mcap"
    where = ("--angle-min", "0.026", "--angle-max", str(0.026 + 2 * math.pi), "--geometry", "centered")
    done = run(
        "convert", HALL, "-o", destination, *HEIGHTS, *where, "--keep-clouds", "--time-increment", "auto",
        "--intensity-field", "time",
    )  # fmt: skip
    assert (done.status, done.stderr) == (0, "")
    assert "the lidar turns clockwise" in done.stdout
    output = opened(destination)
    for scan, cloud in zip(output.scans(), output.clouds("/points"), strict=True):
        seen = np.flatnonzero(np.isfinite(scan.ranges))
        after_cloud = (stamp_ns(scan) - stamp_ns(cloud)) / 1e9
        times = after_cloud + seen * float(scan.time_increment)
        # The intensities here are the times of the points: columns are 0.42 ms apart, the seam is one of them.
        assert np.median(np.abs(times - scan.intensities[seen])) < 0.0003
        assert np.max(np.abs(times - scan.intensities[seen])[3:-3]) < 0.0006
        assert scan.time_increment == pytest.approx(-0.1 / 360, rel=2e-3)
