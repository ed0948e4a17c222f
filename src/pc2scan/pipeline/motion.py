"""The motion of a sensor while a scan was measured."""

from __future__ import annotations

from typing import NamedTuple


class Motion(NamedTuple):
    """The largest distance of the sensor from its pose at the scan's time: metres and radians.

    ``gap`` is the longest time that transforms were interpolated over, seconds.
    """

    distance: float
    angle: float
    gap: float = 0.0
