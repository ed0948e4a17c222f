"""Beams as points: as laser_geometry places them, with their times, and what is no point is counted as what it is."""

from __future__ import annotations

import numpy as np

from pc2scan.core.points import TIME
from pc2scan.core.unproject import unproject
from pc2scan.messages.beams import scan_points
from pc2scan.messages.laserscan import LaserScan

RANGES = np.array([1, np.nan, np.inf, 0.05, 9.0, 10.0, -np.inf, 12.0, 3.5], np.float32)


def scan(**changes: object) -> LaserScan:
    made = LaserScan(3, 17, "laser", -1.0, 1.0, 0.25, 0.001, 0.1, 0.1, 10.0, RANGES, np.arange(9, dtype=np.float32))
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def test_beams_are_points_at_their_own_times() -> None:
    points, rejected = scan_points(scan())
    expected = unproject(
        RANGES, np.arange(9, dtype=np.float32), angle_min=-1.0, angle_increment=0.25, range_min=0.1, range_max=10.0
    )
    assert (points.stamp_ns, points.frame_id) == (17, "laser")
    for name in ("x", "y", "z", "intensity", "index"):
        assert points.field(name).tobytes() == np.ascontiguousarray(expected.points[name]).tobytes()
    assert points.field("index").tolist() == [0, 4, 8]
    np.testing.assert_allclose(points.field(TIME), [0, 0.004, 0.008], rtol=1e-7)
    assert rejected == {"nan": 1, "range": 5}


def test_what_sicks_lms1xx_have_where_nothing_returns_is_no_point() -> None:
    ranges = np.array([65.533, 65.0, 65.533, 3.0, 1, 1, 1, 1, 1], np.float32)
    points, rejected = scan_points(scan(ranges=ranges, range_max=80.0))
    assert points.field("index").tolist() == [1, 3, 4, 5, 6, 7, 8]
    assert rejected == {"nan": 0, "range": 2}
    assert ranges[0] == np.float32(65.533)
