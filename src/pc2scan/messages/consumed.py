"""Turns LaserScan messages into the scans of the consumers' rules."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.core.verdicts import Scan

if TYPE_CHECKING:
    from .laserscan import LaserScan


def consumed_scan(message: LaserScan) -> Scan:
    """Return a decoded scan in the form that the consumers' rules need."""
    return Scan.of(
        message.ranges,
        angle_min=message.angle_min,
        angle_max=message.angle_max,
        angle_increment=message.angle_increment,
        range_min=message.range_min,
        range_max=message.range_max,
        scan_time=message.scan_time,
        time_increment=message.time_increment,
        intensities=len(message.intensities),
    )
