"""The rule of the loops over points: the numbers that points are compared with, why points are rejected, and how many.

A rule is thirteen float64, in this order:

``lowest``, ``highest``
    Limits of z, inclusive: float32 values.
``least``, ``most``
    Limits of the squared range, inclusive.
``first``, ``last``
    Limits of the angle, inclusive: float32 values.
``offset``, ``turn``, ``end``
    An angle plus the offset is its distance from the first edge; while it is ``turn`` or more, ``turn`` is subtracted,
    at most twice. An angle beyond ``end`` is outside.
``skew``, ``increment``
    The beam's index is the truncated quotient ``(turned + skew) / increment``.
``closed``
    1 if angles after the last beam belong to it, 0 if they are past the end.
``glibc``
    1 if angles are those of glibc 2.31 to 2.40, 0 if they are rounded correctly.
"""

from __future__ import annotations

import math
from operator import add
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .layout import TURN, float32

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from .layout import BeamLayout
    from .params import ProjectionParams


class Rejection(NamedTuple):
    """A reason why points are rejected.

    Attributes
    ----------
    name
        The name of its count.
    explanation
        Describes these points to a user whose scans are empty: completes "40% of all points were".
    title
        The name in a table's header; empty: the name itself.
    by_default
        A parameter whose default rejects more than users expect, and the explanation if it has its default. Empty if
        there is none.
    absent
        The warning if no point of a topic is rejected; empty if that is normal.
    remedy
        What to type if many points are rejected, where nobody asks for that; empty for limits and regions, which
        reject what users ask them to.
    """

    name: str
    explanation: str
    title: str = ""
    by_default: tuple[str, str] = ("", "")
    absent: str = ""
    remedy: str = ""


_DEFAULT_MIN_HEIGHT = "the node's default min_height drops everything at z <= 0; `min_height` sets it below the sensor"
_OUTSIDE = "outside angle_min and angle_max (is x forward in this frame?)"

#: The reasons of the loops over points, in the order of the counts that they return.
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

#: Additional reasons for points that are placed at their own times.
NO_TIME = Rejection(
    "no_time", "without a time of their own", remedy="without `deskew` they are used, at the stamp of their cloud"
)
NO_TRANSFORM = Rejection(
    "no_transform",
    "measured when there was no transform to `fixed_frame`",
    remedy="`tf_from` or `trajectory` adds transforms; if the clocks differ, `time_offset=auto` measures by how much",
)


def rule_of(params: ProjectionParams) -> NDArray[np.float64]:
    """Return the rule of a projection, (13,).

    A float32 is within float64 limits exactly if it is within the nearest float32 inside of them, because there is no
    float32 in between. A range, the root of a square rounded twice, never falls when the square grows. So there is a
    smallest square whose range reaches ``range_min``, and a largest one whose range does not exceed ``range_max``.
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
    """Return whether values are within limits, inclusive, compared as float64; NaN never is.

    Values of float32 are compared with the nearest float32 inside of the limits, as in `rule_of`: the result is the
    same, and no copy is needed.
    """
    if values.dtype.kind == "f" and values.dtype.itemsize == 4:
        return (values >= _first_from(lowest)) & (values <= -_first_from(-highest))
    return (values >= np.float64(lowest)) & (values <= np.float64(highest))


def upstream_beams(layout: BeamLayout) -> tuple[float, ...]:
    """Return the eight numbers about angles for upstream's beams.

    Source of the rule: pointcloud_to_laserscan_node.cpp computes ``int index = (angle - angle_min) /
    angle_increment``, where ``angle`` is a double that holds a float32, atan2f(y, x), and the other two are the
    message's float32 fields: a float64 quotient, truncated. Its check of the sector comes first. Beam ``i`` is
    half open, and ``angle_max``, inclusive, ends the last one. If the sector is a multiple of the increment,
    ``angle_max`` itself is after the last beam: there upstream writes past its array.
    """
    first, last = layout.angle_min, layout.angle_max
    return first, last, -first, math.inf, math.inf, 0.0, layout.angle_increment, 0.0


def centered_beams(layout: BeamLayout) -> tuple[float, ...]:
    """Return the eight numbers about angles for beams with half an increment on either side of their middle.

    Angles are compared in float64 with the edges between the beams that the message's float32 values describe. Beams
    are half open, the last one of a sector closed. On a full circle every angle belongs to the nearest beam; the gap
    or overlap that rounding the increment causes is divided between the last beam and the first.
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
    # No angle is below -pi by more than a rounding. With whole turns added, no angle is before the first edge.
    offset = TURN * math.ceil((first_edge + math.pi + 1e-6) / TURN) - first_edge
    return -math.inf, math.inf, offset, TURN, end, skew, increment, 1.0


def _first_from(limit: float) -> np.float32:
    """Return the smallest float32 that is not below a limit."""
    nearest = np.float32(float32(limit))
    with np.errstate(over="ignore"):
        return nearest if float(nearest) >= limit else np.nextafter(nearest, np.float32(np.inf))


def _first_square(limit: np.float32) -> float:
    """Return the smallest float64, from 0 on, whose root is not below a limit after rounding to float32."""
    if limit <= 0:
        return 0.0
    # Numbers that round to the limit begin half way from the float32 before it; the square is at most some steps off.
    # Rounding treats infinity as the next power of two.
    before = np.nextafter(limit, np.float32(0))
    square = ((float(before) + min(float(limit), 2.0**128)) / 2) ** 2
    while float32(math.sqrt(square)) >= limit:
        square = math.nextafter(square, 0)
    while float32(math.sqrt(square)) < limit:
        square = math.nextafter(square, math.inf)
    return square


_REASONS = tuple(rejection.name for rejection in REJECTIONS)
_MOVING_REASONS = (*_REASONS, NO_TIME.name, NO_TRANSFORM.name)
_NONE = dict.fromkeys(_REASONS, 0)


class PointCounts:
    """How many points a cloud has, and how many are used and rejected. All counts except ``total`` sum to ``total``.

    Each point is counted once, under the first reason that rejects it. Filters come first, then the reasons of the
    projection, which always exist: ``nan`` (x, y or z is NaN), ``height``, ``range`` and ``angle`` (outside of the
    limits), and ``past_end`` (in the sector, but after its last beam). Each is an attribute: ``counts.height``.

    Attributes
    ----------
    total
        Points of the cloud.
    used
        Points that fall into a beam, even if another point is closer, or the range of a beam without a return.
    rejected
        The other points, by reason: those of the projection, then those of filters.

    Examples
    --------
    >>> counts = PointCounts(5, 2, height=1, exclude_box=2)
    >>> counts.exclude_box, counts.angle
    (2, 0)
    >>> counts + PointCounts(1, 0, nan=1)
    PointCounts(total=6, used=2, nan=1, height=1, range=0, angle=0, past_end=0, exclude_box=2)
    """

    # Tuples instead of a dictionary, because counts are made and added for every cloud.
    __slots__ = ("_reasons", "_values", "total", "used")

    total: int
    used: int
    _reasons: tuple[str, ...]
    _values: tuple[int, ...]

    def __init__(self, total: int = 0, used: int = 0, **rejected: int) -> None:
        self.total = total
        self.used = used
        known = _NONE | rejected
        self._reasons, self._values = tuple(known), tuple(known.values())

    @classmethod
    def of_filters(cls, rejected: Mapping[str, int]) -> PointCounts:
        """Return the counts of points that filters rejected, by the filter's name."""
        return cls(sum(rejected.values()), **rejected)

    @classmethod
    def of_projection(cls, total: int, rejected: tuple[int, ...]) -> PointCounts:
        """Return the counts of a cloud, from the result of the loops over points.

        These are in the order of `REJECTIONS`; for deskewed points, the points without a time and the points without a
        transform follow.
        """
        counts = cls.__new__(cls)
        counts.total = total
        counts.used = total - sum(rejected)
        reasons = _REASONS if len(rejected) == len(_REASONS) else _MOVING_REASONS
        counts._reasons, counts._values = reasons, rejected  # noqa: SLF001  # its own class
        return counts

    @property
    def rejected(self) -> dict[str, int]:
        """The points that are not used, by reason."""
        return dict(zip(self._reasons, self._values, strict=True))

    def __getattr__(self, name: str) -> int:
        # Python calls this only for names that are no attributes. An object that is being unpickled has no counts yet.
        if name in self.__slots__ or name.startswith("__"):
            raise AttributeError(name)
        if name in self._reasons:
            return self._values[self._reasons.index(name)]
        raise AttributeError(f"there is no count {name!r}, only {', '.join(self.as_dict())}")

    def __add__(self, other: PointCounts) -> PointCounts:
        if other is NO_POINTS:
            return self
        # Not by keywords, which take as long as all of it.
        added = PointCounts.__new__(PointCounts)
        added.total, added.used = self.total + other.total, self.used + other.used
        reasons = self._reasons
        if reasons == other._reasons:
            added._reasons, added._values = reasons, tuple(map(add, self._values, other._values))
            return added
        rejected = self.rejected
        for name, count in other.rejected.items():
            rejected[name] = rejected.get(name, 0) + count
        added._reasons, added._values = tuple(rejected), tuple(rejected.values())
        return added

    def __eq__(self, other: object) -> bool:
        return self.as_dict() == other.as_dict() if isinstance(other, PointCounts) else NotImplemented

    def __hash__(self) -> int:
        return hash(frozenset(self.as_dict().items()))

    def __repr__(self) -> str:
        return f"PointCounts({', '.join(f'{name}={count}' for name, count in self.as_dict().items())})"

    def as_dict(self) -> dict[str, int]:
        """Return all counts by name, ``total`` and ``used`` first."""
        return {"total": self.total, "used": self.used, **self.rejected}


#: The counts of a message without points, or whose points are not counted.
NO_POINTS = PointCounts()
