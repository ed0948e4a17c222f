"""What consumers judge, a scan and the transforms at its stamp, and their verdict on it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from .layout import float32
from .params import range_max_minus

if TYPE_CHECKING:
    from numpy.typing import NDArray

Outcome = Literal["accepted", "shifted", "misplaced", "ignored", "aborts"]

#: From harmless to worst: accepted; accepted, but rotated by up to one beam; accepted, but with beams or ranges in
#: wrong places; dropped; the consumer's process ends.
OUTCOMES: tuple[Outcome, ...] = ("accepted", "shifted", "misplaced", "ignored", "aborts")


@dataclass(frozen=True, slots=True, kw_only=True)
class ConsumerScan:
    """The header of a scan, and the counts of its values.

    Attributes
    ----------
    angle_min, angle_max, angle_increment
        Radians; rounded to float32 when the object is created, like all numbers here.
    range_min, range_max
        Metres.
    scan_time, time_increment
        Seconds between scans, and between beams.
    beams
        Length of ``ranges``.
    intensities
        Length of ``intensities``.
    returns
        Ranges that are finite and within ``range_min`` and ``range_max``, inclusive.
    infinite
        Ranges that are +inf.
    nan
        Ranges that are NaN.
    zero
        Ranges that are 0, as some drivers write a beam without a return.
    short
        Ranges below ``range_min``, including zeros.
    long
        Finite ranges above ``range_max``.
    full
        Ranges that are ``range_max`` or 0.1 mm less (``no_return: range-max-minus``), which some drivers write for no
        return.
    """

    angle_min: float
    angle_max: float
    angle_increment: float
    range_min: float
    range_max: float
    beams: int
    scan_time: float = 0.0
    time_increment: float = 0.0
    intensities: int = 0
    returns: int = 0
    infinite: int = 0
    nan: int = 0
    zero: int = 0
    short: int = 0
    long: int = 0
    full: int = 0

    def __post_init__(self) -> None:
        floats = ("angle_min", "angle_max", "angle_increment", "range_min", "range_max", "scan_time", "time_increment")
        for name in floats:
            object.__setattr__(self, name, float32(getattr(self, name)))

    @classmethod
    def of(cls, ranges: NDArray[np.float32], **header: Any) -> ConsumerScan:
        """Count the values of the ranges, float32, shape (beams,), metres; the other parameters as in the class."""
        low, high = float32(header["range_min"]), float32(header["range_max"])
        full = (ranges == high) | (ranges == range_max_minus(high))
        return cls(
            **header,
            beams=len(ranges),
            returns=int(are_returns(ranges, low, high).sum()),
            infinite=int((ranges == math.inf).sum()),
            nan=int(np.isnan(ranges).sum()),
            zero=int((ranges == 0).sum()),
            short=int((ranges < low).sum()),
            long=int(((ranges > high) & (ranges < math.inf)).sum()),
            full=int(full.sum()) if 0 < high < math.inf else 0,
        )


def are_returns(ranges: NDArray[np.float32], range_min: float, range_max: float) -> NDArray[np.bool_]:
    """Return which ranges are finite and within the limits, inclusive; the limits are float32 values."""
    returns: NDArray[np.bool_] = (ranges >= range_min) & (ranges <= range_max)
    if range_max == math.inf:
        # inf <= inf is true, but infinity is no return.
        returns &= ranges < math.inf
    return returns


class ScanTransforms(NamedTuple):
    """What the transforms at a scan's stamp say about its frame.

    Attributes
    ----------
    frame_id
        The frame in the scan's header.
    odometry, robot
        Whether there is a transform from the scan's frame to the odometry's frame, and to the robot's; None if unknown.
    up
        The z coordinate, in the scan's frame, of the point on the robot's z axis that is 1 m above the sensor: 1 for
        a level sensor, -1 for one that is upside down. None if unknown.
    turned, moved
        How far the scan's frame has turned around the robot's z axis (radians) and moved in its x-y plane (metres)
        since the first scan in this frame that had both transforms.
    missing
        Why a transform is missing.
    cure
        What to type if the frame's name is wrong; empty if that is not known.
    """

    frame_id: str = ""
    odometry: bool | None = None
    robot: bool | None = None
    up: float | None = None
    turned: float = 0.0
    moved: float = 0.0
    missing: str = ""
    cure: str = ""


class Verdict(NamedTuple):
    """What a consumer does with a scan.

    Attributes
    ----------
    consumer
        One of `pc2scan.core.consumers.CONSUMERS`.
    outcome
        One of `OUTCOMES`.
    rule
        The consumer's rule that decided; empty if the scan is accepted, like the following ones.
    observed, allowed
        What the scan has, and what the rule allows.
    cure
        How to change that.
    unplaced
        Whether the scan is ignored because of its transforms. The consumer then waits for the next one, and stores
        nothing of this one.
    """

    consumer: str
    outcome: Outcome = "accepted"
    rule: str = ""
    observed: str = ""
    allowed: str = ""
    cure: str = ""
    unplaced: bool = False

    @property
    def refused(self) -> bool:
        """Whether the consumer does not use the scan."""
        return self.outcome in ("ignored", "aborts")
