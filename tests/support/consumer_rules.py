"""The consumers' rules one scan at a time, in the words and types of their C++: what `judge` has to agree with.

``f`` is a float, Python's own numbers are doubles. A rule returns what happens to the scan; ``first`` is None for the
first one.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.core.verdicts import ConsumerScan, ScanTransforms

f = np.float32


def std_round(value: float) -> float:
    """Halves away from zero."""
    return math.copysign(math.floor(abs(value) + 0.5), value)


def number_of_range_readings(scan: ConsumerScan) -> int:
    """LaserAssistant::makeLaser and karto::LaserRangeFinder::Update of slam_toolbox."""
    angle_min, angle_max, angle_increment = f(scan.angle_min), f(scan.angle_max), f(scan.angle_increment)
    is_360_lidar = False
    angular_range = np.abs(angle_max - angle_min)
    assert angular_range.dtype == np.float32
    epsilon = np.finfo(np.float32).eps
    if abs(float(angular_range) - 2.0 * math.pi) < float(angle_increment) - float(epsilon * f(2)) * math.pi:
        is_360_lidar = True
    steps = angular_range / angle_increment
    assert steps.dtype == np.float32
    if float(angular_range) > 6.10865 and f(std_round(float(steps))) + f(1) == f(scan.beams):
        is_360_lidar = False
    residual = 0 if is_360_lidar else 1
    return int(std_round((float(angle_max) - float(angle_min)) / float(angle_increment)) + residual)


def transforms(needs: tuple[str, ...], placed: ScanTransforms) -> bool:
    """Whether a scan has the transforms that a consumer looks up."""
    return not any(getattr(placed, role) is False for role in needs)


def worst(off: float, increment: float) -> str:
    share = off / abs(increment) if increment else (math.inf if off else 0.0)
    if share <= 0.1:
        return "accepted"
    return "shifted" if share <= 1.1 else "misplaced"


def slam_toolbox(scan: ConsumerScan, first: ConsumerScan | None, placed: ScanTransforms) -> str:
    if not transforms(("odometry", "robot"), placed):
        return "ignored"
    laser = first or scan
    if scan.beams != number_of_range_readings(laser):
        return "ignored"
    # SetRangeThreshold(min(max_laser_range, range_max)); in OccupancyGrid::AddScan and LocalizedRangeScan::Update a
    # reading up to the threshold is a point.
    threshold = min(25.0, f(laser.range_max).item())
    if threshold == f(laser.range_max) and scan.full > 0.01 * scan.beams:
        return "misplaced"
    if turned(scan, laser):
        return "misplaced"
    # getLaser: the laser's offset pose is that of the first scan.
    if abs(placed.turned) > math.radians(2) or placed.moved > 0.1:
        return "misplaced"
    if placed.up is None or placed.up > 0 or not scan.beams:
        return "accepted"
    # Inverted: readings from rbegin to rend, at minimum angle + i * resolution, of a frame that is turned over.
    low, step = float(f(laser.angle_min)), float(f(laser.angle_increment))
    last = float(f(low + (laser.beams - 1) * step))
    off = max(abs(math.remainder(low + i * step + (last - i * step), 2 * math.pi)) for i in range(scan.beams))
    return worst(off, float(f(scan.angle_increment)))


def turned(scan: ConsumerScan, first: ConsumerScan) -> bool:
    """Whether a beam lies more than a tenth of an increment from where the first scan says."""
    if scan is first:
        return False
    begin, step = f(scan.angle_min).item(), f(scan.angle_increment).item()
    first_begin, first_step = f(first.angle_min).item(), f(first.angle_increment).item()
    return any(
        abs(begin + i * step - (first_begin + i * first_step)) > 0.1 * abs(first_step) for i in range(scan.beams)
    )


def cartographer(scan: ConsumerScan, _first: ConsumerScan | None, placed: ScanTransforms) -> str:
    if not transforms(("robot",), placed):
        return "ignored"
    if not f(scan.range_min) >= f(0):
        return "aborts"
    if not f(scan.range_max) >= f(scan.range_min):
        return "aborts"
    if f(scan.angle_increment) > f(0):
        if not f(scan.angle_max) > f(scan.angle_min):
            return "aborts"
    elif not f(scan.angle_min) > f(scan.angle_max):
        return "aborts"
    hits = scan.returns + (scan.infinite if np.isposinf(f(scan.range_max)) else 0)
    if hits and scan.intensities > 0 and scan.intensities != scan.beams:
        return "aborts"
    # CheckNoLeadingSlash, once there are points.
    if hits and placed.frame_id[:1] == "/":
        return "aborts"
    # AddRangeData: the second point is earlier than the pose that the first one was placed at.
    if hits > 1 and f(scan.time_increment) < f(0):
        return "misplaced"
    return infinite_hits(scan)


def infinite_hits(scan: ConsumerScan) -> str:
    """``range <= range_max`` for an infinite range."""
    return "misplaced" if scan.infinite and f(np.inf) <= f(scan.range_max) else "accepted"


def gmapping(scan: ConsumerScan, first: ConsumerScan | None, placed: ScanTransforms) -> str:
    if not transforms(("odometry", "robot"), placed):
        return "ignored"
    # initMapper: abs(abs(up.z()) - 1) > 0.001
    if first is None and placed.up is not None and not abs(abs(placed.up) - 1) <= 0.001:
        return "ignored"
    laser = first or scan
    if not laser.beams < 2048:
        return "aborts"
    if scan.beams != laser.beams:
        return "ignored"
    max_range = float(f(laser.range_max)) - 0.01
    written = ([float(f(scan.range_max))] if scan.short else []) + ([math.inf] if scan.infinite else [])
    # computeActiveArea leaves out what is beyond the laser's range, and grows the map until it contains the rest.
    if any(not r > max_range and math.isinf(r) and r > 0 for r in written):
        return "aborts"
    if turned(scan, laser):
        return "misplaced"
    if not scan.beams:
        return "accepted"
    off = gmapping_off(
        scan.angle_min, scan.angle_max, scan.angle_increment, scan.beams, upwards=placed.up is None or placed.up > 0
    )
    return worst(off, f(scan.angle_increment).item())


@cache
def gmapping_off(low: float, high: float, step: float, beams: int, *, upwards: bool) -> float:
    """How far gmapping's beams are from the scan's, at most."""
    angle_min, angle_max, increment = f(low), f(high), f(step)
    angle_center = float((angle_min + angle_max) / f(2))
    do_reverse_range = bool(angle_min > angle_max) if upwards else bool(angle_min < angle_max)
    res = abs(float(increment))
    off = 0.0
    for ros in range(beams):
        # RangeSensor: angle = -.5 * res * beams, then += res
        own = beams - 1 - ros if do_reverse_range else ros
        theta = -0.5 * res * beams + own * res
        seen = angle_center + theta if upwards else angle_center - theta
        off = max(off, abs(seen - (float(angle_min) + ros * float(increment))))
    return off


def amcl(scan: ConsumerScan, _first: ConsumerScan | None, placed: ScanTransforms) -> str:
    if not transforms(("odometry", "robot"), placed):
        return "ignored"
    if float(f(scan.range_max)) <= 0.0:
        return "ignored"
    # addNewScanner: the laser's place is that of the first scan.
    if placed.moved > 0.1:
        return "misplaced"
    return "accepted"


def nav2(scan: ConsumerScan, _first: ConsumerScan | None, placed: ScanTransforms) -> str:
    if not transforms(("robot",), placed):
        return "ignored"
    return infinite_hits(scan)


RULES: dict[str, Callable[[ConsumerScan, ConsumerScan | None, ScanTransforms], str]] = {
    rule.__name__: rule for rule in (slam_toolbox, cartographer, gmapping, amcl, nav2)
}
