"""What ``info`` shows of LaserScans."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan import info
from support.command import run
from support.scan_recordings import GOOD, scans, write

if TYPE_CHECKING:
    from pathlib import Path

#: 2 returns, 1 below range_min, 2 inf, 1 NaN, 1 beyond range_max, 2 returns.
RANGES = np.array([1, 2, 0, math.inf, math.inf, math.nan, 31, 4, 30], np.float32)


def test_what_scans_advertise_and_hold(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", *scans(20, replace(GOOD, ranges=RANGES)))
    found = info(path)
    (scan,) = found.scans
    assert (scan.topic, scan.sampled, scan.frames, scan.beams) == ("/scan", 10, ("laser",), (9, 9))
    assert scan.first is not None
    assert (scan.first.angle_min, scan.first.angle_increment, scan.first.range_max) == (-1, 0.25, 30)
    assert scan.rate_hz == pytest.approx(10, rel=1e-3)
    assert scan.return_share == pytest.approx(4 / 9)
    shown = run("info", path).stdout.splitlines()
    assert "  beams   9, -57.30 to 57.30 deg by 14.3239 deg" in shown
    assert "  limits  0.5 to 30 m; scan_time 0.1 s, time_increment 0 s" in shown
    assert "  returns 44.4% of the beams; no intensities" in shown
    assert "  shifted   gmapping" in shown


def test_the_worst_that_happens_to_any_of_them(tmp_path: Path) -> None:
    content = scans(4)
    content[2] = replace(content[2], ranges=np.full(7, math.inf, np.float32), range_max=math.inf)
    (scan,) = info(write(tmp_path / "a.mcap", *content)).scans
    assert scan.beams == (7, 9)
    assert (scan.consumers["slam_toolbox"], scan.consumers["nav2"]) == ("ignored", "misplaced")
