"""When the points of a cloud were measured: the field that says it, or how the lidar turned: as given, or measured."""

from __future__ import annotations

from functools import reduce
from itertools import pairwise
from operator import or_
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from pc2scan.core import kernel
from pc2scan.core.percentiles import median
from pc2scan.core.points import TIME, Points
from pc2scan.core.quantities import duration_ns
from pc2scan.core.timing import (
    AZIMUTH,
    LEAST_TURN,
    TIME_FIELDS,
    TIME_UNITS,
    absolute_times,
    azimuth_times,
    median_interval_ns,
    offset_and_unit,
    time_field,
    turn_by_order,
)
from pc2scan.errors import DecodeError, ParameterError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray


#: Returns the times of points at some places, seconds after their cloud's stamp.
Times: TypeAlias = "Callable[[tuple[NDArray[np.intp], ...]], NDArray[np.float64]]"


#: What to type if the points' own times are of no use.
BY_AZIMUTH = "`point_time=azimuth` computes the times of a lidar that turns"


#: A turn is measured in this many clouds, and at least so many intervals between them.
TURN_CLOUDS = 11
_FEWEST = 3

#: The longest time of a turn, seconds.
_LONGEST = 60.0

#: How far a regular interval between stamps may be from a multiple of the median, and the minimum share of these.
_JITTER = 0.1
_REGULAR = 0.8

#: The share of all directions that a lidar on a robot sees at least (much may be hidden), and that each cloud has of
#: those that all have: a tenth of a turn has others in each cloud.
_SEEN = 0.5
_OF_ALL = 0.85

#: Directions are compared in this many sectors of a turn.
DIRECTIONS = 90

#: The longest delay from stamp to log time, as a share of the turn, that proves the stamp to be that of the last point:
#: no cloud is logged before its last point is measured. A longer delay proves nothing, because drivers may need it.
_OF_LAST = 0.4

_WAYS = {"cw": -1, "ccw": 1}
_ENDS = {"start": False, "end": True}


class Turn(NamedTuple):
    """How a lidar turned, if its points have no times.

    Attributes
    ----------
    period
        The time of one turn, seconds; 0: it is measured, and so is everything else that is not given.
    direction
        1 counter-clockwise, -1 clockwise; 0: not given, so taken from the order of each cloud's points.
    ended
        Whether the stamp is the time of the last point instead of the first; None: not given, so the first.
    """

    period: float = 0.0
    direction: int = 0
    ended: bool | None = None

    @classmethod
    def parse(cls, text: str) -> Turn:
        """Read ``azimuth``, which ``:PERIOD``, ``:cw`` or ``:ccw``, ``:start`` or ``:end`` may follow.

        Raises
        ------
        UsageError
            If it is anything else.
        """
        words = text.split(":")[1:]
        period, direction, ended = 0.0, 0, None
        for number, word in enumerate(words):
            if word in _WAYS and not direction:
                direction = _WAYS[word]
            elif word in _ENDS and ended is None:
                ended = _ENDS[word]
            elif number == 0 and 0 < _seconds(word) <= _LONGEST:
                period = _seconds(word)
            else:
                raise UsageError(
                    f"`point_time` is {text!r}, but {word!r} is not the time of a turn (at most {_LONGEST:g} s), a "
                    "direction (cw or ccw), or the stamped end of the turn (start or end)",
                    hint="write `point_time=azimuth` to measure the turn, `point_time=azimuth:0.1` for 10 Hz. The "
                    "direction may follow, as seen from above, and which end of the turn the stamp is of: "
                    "`point_time=azimuth:0.1:cw:end`",
                )
        return cls(period, direction, ended)

    def times(self, points: Points) -> NDArray[np.float64]:
        """Return seconds after the stamp.

        Raises
        ------
        DecodeError
            If the period or the direction of the turn is unknown.
        """
        if not self.period:
            raise DecodeError(
                "the time of a turn was not measured",
                stamp_ns=points.stamp_ns,
                hint="give it: `point_time=azimuth:0.1`",
            )
        times = azimuth_times(points.field("x"), points.field("y"), self.period, self.direction)
        if times is None:
            raise DecodeError(
                "the order of its points does not show in which direction the lidar turned",
                stamp_ns=points.stamp_ns,
                hint=f"give the direction: `point_time=azimuth:{self.period:g}:cw` (clockwise, seen from above) or ccw",
            )
        return times - np.fmax.reduce(times, axis=None, initial=0.0) if self.ended else times

    def __str__(self) -> str:
        way = {1: "counter-clockwise", -1: "clockwise", 0: "in the order of its points"}[self.direction]
        stamp = "last" if self.ended else "first"
        return f"one turn takes {self.period:g} s, {way}, and the stamp is that of the {stamp} point"


def _seconds(text: str) -> float:
    return (duration_ns(text) or duration_ns(f"{text}s") or 0) / 1e9


class PointTime(NamedTuple):
    """The source of the points' times.

    Attributes
    ----------
    field
        The field with the times. Empty: the first of `TIME_FIELDS` that the cloud has.
    unit
        ``s``, ``ms``, ``us`` or ``ns``. Empty: the numbers decide; see `offset_and_unit`.
    turn
        How the lidar turned, if its points have no times. None: the times are in ``field``.
    """

    field: str = ""
    unit: str = ""
    turn: Turn | None = None

    @classmethod
    def parse(cls, text: str) -> PointTime:
        """Parse ``FIELD``, ``FIELD:UNIT``, or the forms that `Turn` parses.

        Raises
        ------
        UsageError
            If the text has another form.
        """
        field, colon, unit = text.partition(":")
        if field == AZIMUTH:
            return cls(turn=Turn.parse(text))
        if not field or (colon and unit not in TIME_UNITS):
            raise UsageError(
                f"`point_time` is {text!r}, it must be a field, or a field and a unit",
                hint=f"write `point_time=t` or `point_time=t:ns`; units: {', '.join(TIME_UNITS)}",
            )
        return cls(field, unit)

    def read(self, points: Points) -> FieldTimes:
        """Return the times of a cloud's points; those of the field `TIME`, if it has that.

        Raises
        ------
        DecodeError
            If the cloud has no field with times, or one with several values a point.
        """
        offset, unit = 0.0, 1.0
        if given := TIME in points.fields:
            name, whole = TIME, False
        else:
            name = self.field or time_field(points.fields)
            if not name:
                raise DecodeError(
                    f"its points have no times: there is no field {', '.join(TIME_FIELDS)}",
                    stamp_ns=points.stamp_ns,
                    hint="name the field that has them: `point_time=FIELD`",
                )
            whole = points.field(name).dtype.kind in "iu"
            points = _mask_zero_times(points, name, self.unit)
        x, values = points.field("x"), points.field(name)
        if values.shape != x.shape:
            message = f"its field {name} has several values a point"
            raise DecodeError(
                message, stamp_ns=points.stamp_ns, hint="if another field has the times, name it: `point_time=FIELD`"
            )
        low, high, measured, unknown = kernel.span(x, values)
        if not given and measured > unknown:
            offset, unit = offset_and_unit(low, high, points.stamp_ns, self.unit, whole=whole)
        low, high = (low - offset) * unit, (high - offset) * unit
        return FieldTimes(points, name, offset, unit, low, high, measured, unknown)


class FieldTimes(NamedTuple):
    """The times of a cloud's points, as a field has them.

    Attributes
    ----------
    points
        The cloud; a time that is not known is NaN or infinite, also where drivers write 0.
    field
        The field.
    offset, unit
        A point was measured ``(value - offset) * unit`` seconds after the stamp.
    low, high
        The times of the first and the last point, seconds after the stamp; inf and -inf if no time is known.
    measured
        How many points have an ``x`` that is not NaN.
    unknown
        How many of them have no time.
    """

    points: Points
    field: str
    offset: float
    unit: float
    low: float
    high: float
    measured: int
    unknown: int

    def at(self, places: Any = ...) -> NDArray[np.float64]:
        """Return the times of the points at some places, or of all, seconds after the stamp."""
        times: NDArray[np.float64] = self.points.field(self.field)[places].astype(np.float64)
        return (times - self.offset) * self.unit


def _mask_zero_times(points: Points, name: str, unit: str) -> Points:
    """Return points with NaN in place of times of 0, if the other times are absolute.

    Drivers write 0 for points without a return. Among times after the stamp, 0 is a time.
    """
    values = points.field(name)
    if absolute_times(values, points.stamp_ns, unit) is None or not (missing := values == 0).any():
        return points
    with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
        times = values.astype(np.float64)
    times[missing] = np.nan
    return points.replace({name: times}, points.frame_id)


class TurnSample(NamedTuple):
    """What one cloud shows of the lidar's turns.

    Attributes
    ----------
    stamp_ns, log_time_ns
        Its stamp and its log time.
    turns
        How many times its points go round, in their order; positive counter-clockwise; 0 if the order shows no
        direction.
    directions
        See `directions_of`.
    """

    stamp_ns: int
    log_time_ns: int
    turns: float
    directions: int


@np.errstate(all="ignore")
def turn_sample(points: Points, log_time_ns: int) -> TurnSample:
    """Return the properties of a cloud."""
    angles = _azimuths(points)
    near, turns = turn_by_order(angles)
    turns = turns if near >= 0.5 and abs(turns) >= LEAST_TURN else 0.0
    return TurnSample(points.stamp_ns, log_time_ns, turns, _directions(angles))


@np.errstate(all="ignore")
def directions_of(points: Points) -> int:
    """Return the directions of a cloud's points: a bit for each 4 degrees."""
    return _directions(_azimuths(points))


def _azimuths(points: Points) -> NDArray[np.float64]:
    """Return the azimuths of the points that have a direction, radians, in their order."""
    x, y = (points.field(name).astype(np.float64).ravel() for name in "xy")
    return np.asarray(np.arctan2(y, x)[np.isfinite(x) & np.isfinite(y) & ((x != 0) | (y != 0))])


def _directions(azimuths: NDArray[np.float64]) -> int:
    places = ((azimuths / (2 * np.pi) + 0.5) * DIRECTIONS).astype(np.intp) % DIRECTIONS
    return sum(1 << place for place in np.flatnonzero(np.bincount(places)).tolist())


def measure_turn(topic: str, given: Turn, clouds: Sequence[TurnSample]) -> tuple[Turn, str]:
    """Return how a lidar turns, as given or measured, and a note about it.

    Raises
    ------
    ParameterError
        If the turn cannot be measured in the first clouds; the hint is what to type.
    """
    turn, why = given, ""
    stamps = sorted({cloud.stamp_ns for cloud in clouds})
    intervals = [(later - earlier) / 1e9 for earlier, later in pairwise(stamps)]
    period = (median_interval_ns(stamps) or 1) / 1e9
    # If a cloud is missing, an interval is twice as long.
    regular = sum(abs(interval / period - max(1, round(interval / period))) <= _JITTER for interval in intervals)
    covered = median([cloud.directions.bit_count() for cloud in clouds]) / DIRECTIONS
    union = reduce(or_, (cloud.directions for cloud in clouds)).bit_count() / DIRECTIONS
    if regular < max(_FEWEST, _REGULAR * len(intervals)) or period > _LONGEST:
        spread = f"{min(intervals, default=0):.4g} to {max(intervals, default=0):.4g} s"
        why = f"{len(stamps)} different stamps with intervals of {spread}, {_FEWEST} regular ones are needed"
    elif covered < max(_SEEN, _OF_ALL * union):
        why = f"they cover {covered:.0%} of all directions, together {union:.0%}"
    else:
        # Rounded to the digits that are shown, so that typing the shown period gives the same scans.
        turn = given._replace(period=float(f"{period:.4g}"))
        ways = [1 if cloud.turns > 0 else -1 for cloud in clouds if cloud.turns]
        delays = [(cloud.log_time_ns - cloud.stamp_ns) / 1e9 for cloud in clouds]
        if not turn.direction:
            if 2 * len(ways) <= len(clouds) or len(set(ways)) > 1:
                why = f"the points of {ways.count(-1)} are in clockwise order, of {ways.count(1)} counter-clockwise"
            else:
                turn = turn._replace(direction=ways[0])
        if turn.ended is None:
            if min(delays) < 0 or not any(delays) or median(delays) >= _OF_LAST * turn.period:
                logged = f"they are logged {min(delays):.4g} to {max(delays):.4g} s after their stamps"
                why = why or f"{logged}, which may be the time of the first or of the last point"
            else:
                turn = turn._replace(ended=True)
    if why:
        way, end = "ccw" if turn.direction > 0 else "cw", "start" if turn.ended is False else "end"
        raise ParameterError(
            f"the turn of the lidar cannot be measured in the first {len(clouds)} clouds on {topic}: {why}",
            name="point_time",
            hint=f"give it, such as `point_time={AZIMUTH}:{turn.period or 0.1:g}:{way}:{end}`: the time of a turn, cw "
            "or ccw as seen from above, and start or end: whether the first point is stamped or the last one",
        )
    return turn, f"{topic}: the times of points are computed from their azimuth, as its first clouds are: {turn}"
