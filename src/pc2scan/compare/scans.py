"""Compares two LaserScan messages."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.compare import compare_arrays

from .difference import Change, ValueChange
from .rules import GEOMETRY

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.messages.laserscan import LaserScan

    from .rules import Rules


def scan_changes(a: LaserScan, b: LaserScan) -> Iterator[Change]:
    """Yield differences in geometry, bit for bit."""
    for name in GEOMETRY:
        left, right = getattr(a, name), getattr(b, name)
        # By bits: NaN equals NaN, and -0.0 differs from 0.0.
        if struct.pack("<d", left) != struct.pack("<d", right):
            yield Change(name, str(np.float32(left)), str(np.float32(right)))
    if len(a.ranges) != len(b.ranges):
        yield Change("beams", f"{len(a.ranges)}", f"{len(b.ranges)}")
    if len(a.intensities) != len(b.intensities):
        yield Change("intensities", f"{len(a.intensities)} values", f"{len(b.intensities)} values")


def scan_values(a: LaserScan, b: LaserScan, rules: Rules) -> Iterator[ValueChange]:
    """Yield differing ranges and intensities, if both scans have as many."""
    for name in ("ranges", "intensities"):
        left, right = getattr(a, name), getattr(b, name)
        if name in rules.ignore or len(left) != len(right):
            continue
        # Values outside the scan's own limits mean no return.
        limits = (a.range_min, a.range_max) if name == "ranges" else None
        found = compare_arrays(left, right, rules.tolerance(name), limits=limits)
        if found.differing:
            yield ValueChange(name, found, (a.angle_min, a.angle_increment))
