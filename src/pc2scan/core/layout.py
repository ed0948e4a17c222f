"""Computes the directions of a scan's beams, as its message advertises them, from the sector and the increment.

Consumers compute with the float32 values in the message, so these are computed here, once. The module does not import
NumPy, because reading parameters does not need it.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, replace

TURN = 2 * math.pi

#: The largest angle, radians. Digits of pi may be missing: 6.2832 is a full turn, and so is -3.15 to 3.15.
FULL_TURN = TURN * 1.01

#: The least and the largest number of beams that MRPT reads right: its bridge asserts more than two, and the roundings
#: of its float32 arithmetic grow with their number.
SYMMETRIC_BEAMS = (3, 100_000)

#: The share of a beam by which a sector may be too short for its last beam, and a circle too short to close: angles are
#: written with few digits, and quotients such as pi / (pi / 180) have rounding errors.
_SLACK = 1e-3
_GAP = 0.5e-3


def float32(value: float) -> float:
    """Round to the nearest float32, as assigning to a message's field does; beyond its range is infinite."""
    try:
        rounded: float = struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)
    return rounded


def beam_count(angle_min: float, angle_max: float, angle_increment: float) -> int:
    """Return the length of a scan's ``ranges``: the ceiling of a float32 quotient.

    Source of the rule: pointcloud_to_laserscan_node.cpp computes ``ceil((angle_max - angle_min) /
    angle_increment)`` on the message's float32 fields. 0 if the quotient is not positive and finite.

    Notes
    -----
    Rounding the float64 result of one operation on float32 operands gives the float32 result: float64 has more
    than twice the digits of float32, so double rounding changes nothing.
    """
    increment = float32(angle_increment)
    if increment == 0:
        return 0
    quotient = float32(float32(float32(angle_max) - float32(angle_min)) / increment)
    return math.ceil(quotient) if 0 < quotient < math.inf else 0


@dataclass(frozen=True, slots=True)
class BeamLayout:
    """The beams that a scan's message advertises; the angles are values of float32, radians.

    Attributes
    ----------
    count
        Length of ``ranges``.
    angle_min, angle_max, angle_increment
        As in the message. The direction of beam ``i`` is ``angle_min + i * angle_increment``: in upstream's geometry
        the lower edge of the beam, in the others its middle.
    full_circle
        Whether the last beam and the first are neighbours, and every angle belongs to one of the beams. Always False
        for upstream's geometry.
    """

    count: int
    angle_min: float
    angle_max: float
    angle_increment: float
    full_circle: bool = False


def upstream_layout(angle_min: float, angle_max: float, angle_increment: float, beams: int = 0) -> BeamLayout:
    """Return the layout of pointcloud_to_laserscan: it advertises the parameters unchanged.

    Parameters
    ----------
    angle_min, angle_max, angle_increment
        Radians.
    beams
        The number of beams, from which the increment follows; 0: use the increment.
    """
    if beams:
        angle_increment = float32((float32(angle_max) - float32(angle_min)) / beams)
        while beam_count(angle_min, angle_max, angle_increment) > beams:
            angle_increment = _float32_beside(angle_increment, 1)
    count = beam_count(angle_min, angle_max, angle_increment)
    return BeamLayout(count, float32(angle_min), float32(angle_max), float32(angle_increment))


def centered_layout(angle_min: float, angle_max: float, angle_increment: float, beams: int = 0) -> BeamLayout:
    """Return beams whose middles are at ``angle_min + i * angle_increment``, the last one at ``angle_max``.

    Parameters
    ----------
    angle_min, angle_max
        Middle of the first beam, and limit of the middle of the last one, radians; any angles, so that a circle may be
        -pi to pi or 0 to 2 pi.
    angle_increment
        Radians, positive.
    beams
        The number of beams, at least 2, from which the increment follows; 0: use the increment.

    Returns
    -------
    BeamLayout
        A full circle if the sector is a whole turn, or leaves no gap between the last beam and the first: its beams
        divide the circle evenly without repeating one, with the nearest possible increment to the given one.
        ``angle_max`` is the float32 next to the last beam's middle.

    Notes
    -----
    These float32 values suit the consumers, because: slam_toolbox (Karto) expects ``round((angle_max - angle_min) /
    angle_increment) + 1`` ranges unless it takes the scan for a circle that repeats its first beam, for which the
    span has to be closer to 2 pi than an increment by 2 pi times float32's epsilon (7.5e-7). With an increment that
    is rounded down only the roundings of ``angle_max`` and of the span count, at most 4.8e-7 within +-8 rad. MRPT's
    step, ``(angle_max - angle_min) / (len - 1)``, is the increment to within the same.
    """
    first, span = float32(angle_min), angle_max - angle_min
    step = span / (beams - 1) if beams else angle_increment
    full_circle = True
    count = beams
    if span < TURN:
        count = beams or math.floor(span / step + _SLACK) + 1
        full_circle = count * step >= TURN - _GAP * step
    if full_circle:
        count = beams or max(1, round(TURN / step))
        step = TURN / count
    increment = float32(step)
    if (beams or full_circle) and increment > step:
        increment = _float32_beside(increment, -1)
    return BeamLayout(count, first, float32(first + (count - 1) * increment), increment, full_circle)


def half_open_layout(angle_min: float, angle_max: float, angle_increment: float, beams: int = 0) -> BeamLayout:
    """Return the beams of `centered_layout`, with an ``angle_max`` one increment after the last beam's middle.

    gmapping needs this, because it places beam ``i`` at ``(i - N / 2) * angle_increment`` from the middle between
    ``angle_min`` and ``angle_max``, which is correct if ``angle_max`` is ``angle_min + N * angle_increment``.
    """
    layout = centered_layout(angle_min, angle_max, angle_increment, beams)
    return replace(layout, angle_max=float32(layout.angle_min + layout.count * layout.angle_increment))


def symmetric_layout(angle_min: float, angle_max: float, angle_increment: float, beams: int = 0) -> BeamLayout:
    """Return the beams of `centered_layout`, shifted so that their middle is 0.

    A circle begins half an increment after -pi. The beams are as MRPT reads them, see `symmetric_sector`.
    """
    layout = centered_layout(angle_min, angle_max, angle_increment, beams)
    low, high = symmetric_sector((layout.count - 1) * layout.angle_increment / 2)
    return replace(layout, angle_min=low, angle_max=high)


def symmetric_sector(half: float) -> tuple[float, float]:
    """Return the ``angle_min`` and ``angle_max`` of beams from ``-half`` to ``half``, radians, that MRPT reads right.

    Notes
    -----
    MRPT takes the middle of the sector for 0, and truncates the quotient that is a beam's index (see
    `pc2scan.core.consumers`). Its bridges compute this index ``i`` with two (MRPT 2.5) or five (mrpt_ros_bridge 3.2)
    roundings to float32, so the result may be too small by ``5 * 2**-24 * i``. Therefore ``angle_min`` is 20 steps of
    float32 lower than ``-angle_max``: the result for the first beam is then not 0, but ten steps in increments, which
    is at least ``5 * 2**-24`` times the number of increments. All angles are even multiples of the step, so that their
    sums and differences are float32 values, too. The shift is less than a tenth of an increment with up to
    `SYMMETRIC_BEAMS` beams; with 1,000 beams, it is a thousandth.
    """
    last = float32(half)
    grid = 2 * (_float32_beside(last, 1) - last)
    last, shift = round(last / grid) * grid, 5 * grid
    return float32(-(last + shift)), float32(last - shift)


def _float32_beside(value: float, steps: int) -> float:
    """Return the float32 that is ``steps`` steps from one that is positive or 0."""
    (bits,) = struct.unpack("<I", struct.pack("<f", value))
    beside: float = struct.unpack("<f", struct.pack("<I", bits + steps))[0]
    return beside
