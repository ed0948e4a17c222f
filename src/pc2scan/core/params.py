"""The parameters of pointcloud_to_laserscan: upstream's names, types, defaults and meanings."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, fields

from pc2scan.errors import ParameterError

__all__ = ["MAX_BEAMS", "ProjectionParams", "beam_count", "float32"]

#: More beams than this is a mistyped increment: a ten-thousandth of a degree over a full circle makes 3.6 million.
MAX_BEAMS = 4_000_000


def float32(value: float) -> float:
    """Round to the nearest float32, as assigning to a message's field does; beyond its range is infinite.

    In plain Python, so that reading parameters (and ``--help``, which shows their defaults) needs no NumPy.
    """
    try:
        rounded: float = struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)
    return rounded


def beam_count(angle_min: float, angle_max: float, angle_increment: float) -> int:
    """Length of a scan's ``ranges``: the ceiling of a float32 quotient.

    Source of the rule: pointcloud_to_laserscan_node.cpp computes ``ceil((angle_max - angle_min) /
    angle_increment)`` on the message's float32 fields. 0 where the quotient is not positive and finite.

    Notes
    -----
    Rounding the float64 result of one operation on float32 operands gives the float32 result: float64 has more
    than twice the digits that double rounding could spoil.
    """
    increment = float32(angle_increment)
    if increment == 0:
        return 0
    quotient = float32(float32(float32(angle_max) - float32(angle_min)) / increment)
    return math.ceil(quotient) if 0 < quotient < math.inf else 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectionParams:
    """Parameters of the projection, validated once and immutable.

    Names, units and defaults are those of the ROS node ``pointcloud_to_laserscan``. Angles and ranges
    reach the scan as float32; heights and ranges of points are compared as float64.

    Parameters
    ----------
    target_frame
        Frame that the cloud is transformed into before anything else; empty keeps the cloud's own.
    transform_tolerance
        Seconds that a stamp may lie outside the known transforms.
    min_height, max_height
        Limits of z in the target frame, metres, inclusive. **The default of ``min_height`` is the
        smallest positive double: everything at or below z = 0 is dropped.**
    angle_min, angle_max
        The sector, radians, inclusive.
    angle_increment
        Width of a beam, radians.
    scan_time
        Seconds, copied into the scan.
    range_min, range_max
        Limits of hypot(x, y), metres, inclusive.
    use_inf
        Whether a beam without a return reads +inf; otherwise ``range_max + inf_epsilon``.
    inf_epsilon
        Metres, see ``use_inf``.
    queue_size
        Messages in flight at most; 0 means as many as there are processor cores, and bounds memory only: nothing
        is ever dropped.

    Raises
    ------
    ParameterError
        If a value is NaN or cannot be (an increment that is not positive, an empty sector, range
        or height band, more than `MAX_BEAMS` beams).
    """

    target_frame: str = ""
    transform_tolerance: float = 0.01
    min_height: float = 2.2250738585072014e-308
    max_height: float = 1.7976931348623157e308
    angle_min: float = -math.pi
    angle_max: float = math.pi
    angle_increment: float = math.pi / 180
    scan_time: float = 1 / 30
    range_min: float = 0.0
    range_max: float = 1.7976931348623157e308
    use_inf: bool = True
    inf_epsilon: float = 1.0
    queue_size: int = 0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and math.isnan(value):
                raise ParameterError(f"{field.name} is NaN", name=field.name)
        for name in ("transform_tolerance", "scan_time", "queue_size"):
            if getattr(self, name) < 0:
                raise ParameterError(f"{name} is {getattr(self, name)}, it must not be negative", name=name)
        for name in ("angle_min", "angle_max", "angle_increment"):
            if math.isinf(getattr(self, name)):
                raise ParameterError(f"{name} is {getattr(self, name)}, it must be finite", name=name)
        if not float32(self.angle_increment) > 0:
            raise ParameterError(
                f"angle_increment is {self.angle_increment} rad, it must be positive",
                name="angle_increment",
            )
        if not float32(self.angle_min) < float32(self.angle_max):
            raise ParameterError(
                f"angle_min {self.angle_min} rad is not below angle_max {self.angle_max} rad",
                name="angle_min",
            )
        for low, high in (("range_min", "range_max"), ("min_height", "max_height")):
            if getattr(self, low) > getattr(self, high):
                raise ParameterError(f"{low} {getattr(self, low)} m is above {high} {getattr(self, high)} m", name=low)
        count = beam_count(self.angle_min, self.angle_max, self.angle_increment)
        if not 0 < count <= MAX_BEAMS:
            raise ParameterError(
                f"angle_increment is {self.angle_increment} rad, which makes {count:,} beams of the sector "
                f"{self.angle_min} to {self.angle_max} rad; at most {MAX_BEAMS:,} are allowed",
                name="angle_increment",
            )

    @property
    def beams(self) -> int:
        """Length of the scan's ``ranges``."""
        return beam_count(self.angle_min, self.angle_max, self.angle_increment)

    @property
    def no_return(self) -> float:
        """What a beam without a return reads, metres: a float32 value.

        Source: ``range_max + inf_epsilon`` is the node's sum of the message's float32 ``range_max`` and a
        double, stored as float32; a default ``range_max`` is inf as float32, and so is the sum.
        """
        return math.inf if self.use_inf else float32(float32(self.range_max) + self.inf_epsilon)
