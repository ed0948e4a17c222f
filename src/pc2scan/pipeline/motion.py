"""How far a sensor moved while a scan was measured."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Motion"]


class Motion(NamedTuple):
    """How far the sensor was from its pose at the scan's time, at most: metres and radians.

    ``gap`` is the longest time that transforms were interpolated over, seconds.
    """

    distance: float
    angle: float
    gap: float = 0.0
