"""The consumers' rules one scan at a time, in the words and types of their C++: what `judge` has to agree with.

``f`` is a float, Python's own numbers are doubles. A rule returns what happens to the scan.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.core.consumers import Scan

f = np.float32


def std_round(value: float) -> float:
    """Halves away from zero."""
    return math.copysign(math.floor(abs(value) + 0.5), value)


def number_of_range_readings(scan: Scan) -> int:
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


def slam_toolbox(scan: Scan, first: Scan) -> str:
    if scan.beams != number_of_range_readings(first):
        return "ignored"
    return "misplaced" if turned(scan, first) else "accepted"


def turned(scan: Scan, first: Scan) -> bool:
    """Whether a beam lies more than a tenth of an increment from where the first scan says."""
    begin, step = f(scan.angle_min).item(), f(scan.angle_increment).item()
    first_begin, first_step = f(first.angle_min).item(), f(first.angle_increment).item()
    return any(
        abs(begin + i * step - (first_begin + i * first_step)) > 0.1 * abs(first_step) for i in range(scan.beams)
    )


def cartographer(scan: Scan, _first: Scan) -> str:
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
    return infinite_hits(scan)


def infinite_hits(scan: Scan) -> str:
    """``range <= range_max`` for an infinite range."""
    return "misplaced" if scan.infinite and f(np.inf) <= f(scan.range_max) else "accepted"


def gmapping(scan: Scan, first: Scan) -> str:
    if not first.beams < 2048:
        return "aborts"
    if scan.beams != first.beams:
        return "ignored"
    written = ([scan.range_max] if scan.short else []) + ([math.inf] if scan.infinite else [])
    max_range = float(f(scan.range_max))
    # The matcher leaves out what is beyond the laser's range.
    if any(not r > max_range and math.isinf(r) for r in written):
        return "misplaced"
    return "misplaced" if turned(scan, first) else "accepted"


def amcl(scan: Scan, _first: Scan) -> str:
    return "ignored" if float(f(scan.range_max)) <= 0.0 else "accepted"


def nav2(scan: Scan, _first: Scan) -> str:
    return infinite_hits(scan)


def mrpt(scan: Scan, _first: Scan) -> str:
    if not scan.beams > 2:
        return "aborts"
    aperture = f(scan.angle_max) - f(scan.angle_min)
    ang_step = float(aperture) / (scan.beams - 1)
    increment = f(scan.angle_increment).item()
    off = max(abs(i * ang_step - i * increment) for i in range(scan.beams))
    return "misplaced" if off > 0.1 * abs(increment) else "accepted"


RULES: dict[str, Callable[[Scan, Scan], str]] = {
    rule.__name__: rule for rule in (slam_toolbox, cartographer, gmapping, amcl, nav2, mrpt)
}
