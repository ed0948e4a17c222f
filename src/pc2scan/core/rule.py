"""The rule that the loops over points follow: the numbers that points are compared with, and why points are rejected.

A rule is thirteen float64, in this order:

``lowest``, ``highest``
    Limits of z, inclusive: float32 values.
``least``, ``most``
    Limits of the squared range, inclusive.
``first``, ``last``
    Limits of the angle, inclusive: float32 values.
``offset``, ``turn``, ``end``
    An angle plus the offset is how far it is turned from the first edge; while that is ``turn`` or more, ``turn`` is
    subtracted, at most twice. What is turned beyond ``end`` is outside.
``skew``, ``increment``
    The beam is the truncated quotient ``(turned + skew) / increment``.
``closed``
    1 if the last beam takes what is behind it, 0 if that is past the end.
``glibc``
    1 if angles are those of glibc 2.31 to 2.40, 0 if they are rounded correctly.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .layout import TURN, float32

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .layout import BeamLayout
    from .params import ProjectionParams

__all__ = [
    "NO_TIME",
    "NO_TRANSFORM",
    "REJECTIONS",
    "Rejection",
    "centered_beams",
    "rule_of",
    "upstream_beams",
    "within",
]


class Rejection(NamedTuple):
    """A reason why points are rejected.

    Attributes
    ----------
    name
        The name of its count.
    explanation
        What these points are, for a user whose scans are empty: completes "40% of all points were".
    title
        The name in a table's header; empty: the name itself.
    by_default
        A parameter whose default rejects more than users expect, and the explanation where it has its default.
        Empty: there is none.
    absent
        The warning if no point of a topic is rejected, where that is a surprise. Empty: it is none.
    """

    name: str
    explanation: str
    title: str = ""
    by_default: tuple[str, str] = ("", "")
    absent: str = ""

    @property
    def heading(self) -> str:
        """The name in a table's header."""
        return self.title or self.name.replace("_", " ")


_DEFAULT_MIN_HEIGHT = "upstream's default min_height drops everything at z <= 0; `min_height` sets it below the sensor"
_OUTSIDE = "outside angle_min and angle_max (is x forward in this frame?)"

#: Why the loops over points reject points, in the order of the counts that they return.
REJECTIONS = (
    Rejection("nan", "NaN", title="NaN"),
    Rejection(
        "height",
        "outside min_height and max_height (is z up in this frame? see target_frame)",
        by_default=(
            "min_height",
            f"outside the heights: {_DEFAULT_MIN_HEIGHT}",
        ),
    ),
    Rejection("range", "outside range_min and range_max"),
    Rejection("angle", _OUTSIDE),
    Rejection("past_end", _OUTSIDE),
)

#: Further reasons for points that are placed at their own times.
NO_TIME = Rejection("no_time", "without a time of their own")
NO_TRANSFORM = Rejection("no_transform", "measured when there was no transform to `fixed_frame`")


def rule_of(params: ProjectionParams) -> NDArray[np.float64]:
    """Make the rule of a projection, (13,).

    A float32 is within float64 limits exactly if it is within the float32 next to them on the inner side, for
    there is none in between. And a range, the root of a square rounded twice, does not fall when the square
    grows: there is a smallest square whose range reaches ``range_min``, and a largest one that stays within
    ``range_max``.
    """
    most = math.inf
    if params.range_max < math.inf:
        with np.errstate(over="ignore"):
            beyond = np.nextafter(-_first_from(-params.range_max), np.float32(np.inf))
        most = math.nextafter(_first_square(beyond), -math.inf)
    beams = upstream_beams if params.geometry == "upstream" else centered_beams
    lowest, highest = float(_first_from(params.min_height)), -float(_first_from(-params.max_height))
    least = _first_square(_first_from(params.range_min))
    glibc = float(params.angle_rounding == "glibc-2.40")
    return np.array([lowest, highest, least, most, *beams(params.layout), glibc])


def within(values: NDArray[Any], lowest: float, highest: float) -> NDArray[np.bool_]:
    """Whether values are within limits, inclusive, compared as float64; NaN never is.

    Values of float32 are compared with the float32 next to the limits on the inner side, as in `rule_of`: that is the
    same, and takes no copy.
    """
    if values.dtype.kind == "f" and values.dtype.itemsize == 4:
        return (values >= _first_from(lowest)) & (values <= -_first_from(-highest))
    return (values >= np.float64(lowest)) & (values <= np.float64(highest))


def upstream_beams(layout: BeamLayout) -> tuple[float, ...]:
    """The eight numbers about angles for upstream's beams.

    Source of the rule: pointcloud_to_laserscan_node.cpp computes ``int index = (angle - angle_min) /
    angle_increment``, where ``angle`` is a double that holds a float32, atan2f(y, x), and the other two are the
    message's float32 fields: a float64 quotient, truncated. Its check of the sector comes first. Beam ``i`` is
    half open, and ``angle_max``, inclusive, cuts the last one off. If the sector is a multiple of the increment,
    ``angle_max`` itself lies behind the last beam: there upstream writes past its array.
    """
    first, last = layout.angle_min, layout.angle_max
    return first, last, -first, math.inf, math.inf, 0.0, layout.angle_increment, 0.0


def centered_beams(layout: BeamLayout) -> tuple[float, ...]:
    """The eight numbers about angles for beams of which each takes what is within half an increment of its middle.

    Angles are compared in float64 with the edges between the beams that the message's float32 values describe. Beams
    are half open, the last one of a sector closed. On a full circle every angle belongs to the nearest beam; what
    rounding the increment leaves of the circle, or takes twice, is shared by the last beam and the first.
    """
    increment = layout.angle_increment
    end = math.inf
    skew = 0.0
    if layout.full_circle:
        # The first edge is half way from the first middle to the last one.
        skew = (layout.count * increment - TURN) / 2
    elif layout.count * increment < TURN:
        end = layout.count * increment
    first_edge = layout.angle_min - increment / 2 + skew
    # No angle is below -pi by more than a rounding: with whole turns added, none comes before the first edge.
    offset = TURN * math.ceil((first_edge + math.pi + 1e-6) / TURN) - first_edge
    return -math.inf, math.inf, offset, TURN, end, skew, increment, 1.0


def _first_from(limit: float) -> np.float32:
    """The smallest float32 that is not below a limit."""
    nearest = np.float32(float32(limit))
    with np.errstate(over="ignore"):
        return nearest if float(nearest) >= limit else np.nextafter(nearest, np.float32(np.inf))


def _first_square(limit: np.float32) -> float:
    """The smallest float64, from 0 on, whose root is not below a limit once it is rounded to float32."""
    if limit <= 0:
        return 0.0
    # What is rounded to the limit begins half way from the float32 before it, some steps beside its square at
    # most. Rounding treats infinity as the power of two that would be next.
    before = np.nextafter(limit, np.float32(0))
    square = ((float(before) + min(float(limit), 2.0**128)) / 2) ** 2
    while float32(math.sqrt(square)) >= limit:
        square = math.nextafter(square, 0)
    while float32(math.sqrt(square)) < limit:
        square = math.nextafter(square, math.inf)
    return square
