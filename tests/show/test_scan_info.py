"""What ``info`` shows of LaserScans."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.core.consumers import CONSUMERS
from pc2scan.show.info import info
from support.builders import write_mcap
from support.command import run
from support.scan_recordings import GOOD, START, recording, scans, write

if TYPE_CHECKING:
    from pathlib import Path

#: 2 returns, 1 below range_min, 2 inf, 1 NaN, 1 beyond range_max, 2 returns.
RANGES = np.array([1, 2, 0, math.inf, math.inf, math.nan, 31, 4, 30], np.float32)


def test_what_scans_advertise_and_hold(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", *scans(20, replace(GOOD, ranges=RANGES)))
    found = info([path], samples=5)
    (scan,) = found.scans
    assert (scan.topic, scan.sampled, scan.frames) == ("/scan", 5, ("laser",))
    assert (scan.beams_min, scan.beams_max) == (9, 9)
    assert (scan.angle_min, scan.angle_max, scan.angle_increment) == (-1, 1, 0.25)
    assert (scan.range_min, scan.range_max) == (0.5, 30)
    assert scan.scan_time == pytest.approx(0.1)
    assert scan.rate_hz == pytest.approx(10, rel=1e-3)
    shares = (scan.return_share, scan.infinite_share, scan.nan_share, scan.short_share, scan.long_share)
    assert shares == pytest.approx((4 / 9, 2 / 9, 1 / 9, 1 / 9, 1 / 9))
    assert scan.range is not None
    assert (scan.range.min, scan.range.median, scan.range.max) == (1, 3, 30)
    assert dict(scan.consumers) == dict.fromkeys(CONSUMERS, "accepted") | {"gmapping": "shifted"}
    told = json.loads(json.dumps(found.as_dict(), allow_nan=False))["scans"][0]
    assert told["consumers"]["gmapping"] == "shifted"
    assert found.clouds == ()


def test_the_worst_that_happens_to_any_of_them(tmp_path: Path) -> None:
    empty = np.full(9, math.inf, np.float32)
    content = scans(4)
    content[2] = replace(content[2], ranges=empty[:7], range_max=math.inf, frame_id="laser")
    (scan,) = info([write(tmp_path / "a.mcap", *content)], samples=100).scans
    assert (scan.beams_min, scan.beams_max, scan.empty) == (7, 9, 1)
    assert dict(scan.consumers)["slam_toolbox"] == "ignored"
    assert dict(scan.consumers)["nav2"] == "misplaced"
    json.dumps(info([tmp_path / "a.mcap"]).as_dict(), allow_nan=False)


def test_scans_that_cannot_be_decoded(tmp_path: Path) -> None:
    content = recording({"/scan": scans(2)})
    cut = [
        replace(entry, data={g: data[:50] for g, data in entry.data.items()})
        if entry.stream.topic == "/scan"
        else entry
        for entry in content.items
    ]
    path = write_mcap(tmp_path / "a.mcap", replace(content, items=tuple(cut)))
    (scan,) = info([path]).scans
    assert scan.sampled == 2
    assert scan.problems
    assert scan.angle_min is None
    assert run("info", path).status == 0


def test_the_command_shows_them(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", *scans(20, replace(GOOD, ranges=RANGES)))
    done = run("info", path)
    assert (done.status, done.stderr) == (0, "")
    shown = done.stdout[done.stdout.index("/scan: 10 scans sampled, 9.99 Hz") :].splitlines()
    assert max(map(len, shown)) <= 80
    assert "  beams   9, -57.30 to 57.30 deg by 14.3239 deg" in shown
    assert "  limits  0.5 to 30 m; scan_time 0.1 s, time_increment 0 s" in shown
    assert "  returns 44.4% of the beams; no intensities" in shown
    assert "          inf 22.2%, NaN 11.1%, below range_min 11.1%, above range_max 11.1%" in shown
    assert "  accepted  slam_toolbox, cartographer, amcl, nav2, mrpt" in shown
    assert "  shifted   gmapping" in shown
    assert str(START)[:10] in done.stdout
