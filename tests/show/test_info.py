from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pc2scan import info
from support import ROOT
from support.builders import CLOUD, SECOND, T0, Item, Recording, Stream, cloud, write_mcap
from support.scan_recordings import GOOD, scans
from support.scan_recordings import write as write_scans

if TYPE_CHECKING:
    from pathlib import Path

POINTS = Stream("/points", CLOUD)


def write(path: Path, *clouds: object, names: str = "xyz") -> Path:
    points = [np.array(each, np.float32).reshape(-1, len(names)) for each in clouds]
    items = [Item(POINTS, T0 + i * SECOND, {2: cloud(each, 2, names=names)}) for i, each in enumerate(points)]
    return write_mcap(path, Recording((POINTS,), tuple(items)))


def test_the_fixture() -> None:
    found = info(ROOT / "fixtures" / "hall.bag")
    assert found.messages == 11
    assert found.duration_ns == 405_000_000
    topics = {t.topic: (t.msgtype, t.messages, t.latched) for t in found.topics}
    assert topics == {
        "/points": ("sensor_msgs/msg/PointCloud2", 5, False),
        "/tf": ("tf2_msgs/msg/TFMessage", 5, False),
        "/tf_static": ("tf2_msgs/msg/TFMessage", 1, True),
    }
    (cloud,) = found.clouds
    assert (cloud.frames, cloud.shape, cloud.points_max) == (("lidar",), (1, 3840), 3840)
    assert cloud.fields[-1] == ("time", "float32")
    json.dumps(found.as_dict(), allow_nan=False)


def test_what_is_measured(tmp_path: Path) -> None:
    points = [[1, 0, -1], [0, 2, 1], [0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 3], [3, 4, 2], [0, 0, 0], [0, 0, 0]]
    (cloud,) = info(write(tmp_path / "a.mcap", points)).clouds
    assert (cloud.nan_share, cloud.zero_share) == (1 / 8, 3 / 8)
    # Of the four that are returns, three are above the sensor.
    assert cloud.above_zero_share == 3 / 4
    assert cloud.limits == {"x": (0, 3), "y": (0, 4), "z": (-1, 3), "range": (1, 5)}


def test_clouds_that_are_empty_or_cannot_be_decoded(tmp_path: Path) -> None:
    (empty,) = info(write(tmp_path / "a.mcap", np.zeros((0, 3)))).clouds
    assert (empty.points_max, empty.limits) == (0, {})
    found = info(write(tmp_path / "b.mcap", [[1, 2]], names="xy"))
    assert found.warnings == ("/points: no command is proposed: none of its first clouds can be placed",)
    (odd,) = found.clouds
    assert "no field 'z'" in odd.problems[0]
    assert odd.fields == ()


#: 2 returns, 1 below range_min, 2 inf, 1 NaN, 1 beyond range_max, 2 returns.
RANGES = np.array([1, 2, 0, np.inf, np.inf, np.nan, 31, 4, 30], np.float32)


def test_what_scans_advertise_and_hold(tmp_path: Path) -> None:
    content = scans(20, replace(GOOD, ranges=RANGES))
    content[18] = replace(content[18], ranges=np.full(7, np.inf, np.float32), range_max=np.inf)
    (scan,) = (found := info(write_scans(tmp_path / "a.mcap", *content))).scans
    assert (scan.topic, scan.scans, scan.frames, scan.beams) == ("/scan", 10, ("laser",), (7, 9))
    # The worst that happens to any of them.
    outcomes = {each.consumer: each.outcome for each in scan.consumers}
    assert (outcomes["slam_toolbox"], outcomes["nav2"]) == ("ignored", "misplaced")
    shown = str(found).splitlines()
    assert "/scan: 10 scans of 7 to 9 beams, 9.99 Hz, in frame 'laser'" in shown
    assert "  misplaced cartographer, nav2, mrpt" in shown
