"""The rules of two consumers, a beam at a time, in the words and types of their C++: what `judge` has to agree with.

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

    from pc2scan.core.consumers import ConsumerScan, ScanTransforms

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


def worst(off: float, increment: float) -> str:
    share = off / abs(increment) if increment else (math.inf if off else 0.0)
    if share <= 0.1:
        return "accepted"
    return "shifted" if share <= 1.1 else "misplaced"


def slam_toolbox(scan: ConsumerScan, first: ConsumerScan | None, placed: ScanTransforms) -> str:
    if placed.odometry is False or placed.robot is False:
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


def gmapping(scan: ConsumerScan, first: ConsumerScan | None, placed: ScanTransforms) -> str:
    if placed.odometry is False or placed.robot is False:
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


RULES: dict[str, Callable[[ConsumerScan, ConsumerScan | None, ScanTransforms], str]] = {
    "slam_toolbox": slam_toolbox,
    "gmapping": gmapping,
}
