"""Computes when the beams of a scan were measured, from the stamps of clouds and the times of their points."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .layout import TURN
from .percentiles import median

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from .layout import BeamLayout

#: Fields in which drivers store a point's time; the first one that a cloud has is used: Ouster's ``t``, Velodyne's
#: ``time``, Hesai's, RoboSense's and Livox's ``timestamp``, Autoware's ``time_stamp``, Livox's ``offset_time``.
TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")

#: A cloud takes 2 ms to 2 s. These are the units of floating-point times that count from the stamp, by their span.
_UNITS = ((2.0, 1.0), (2e3, 1e-3), (2e6, 1e-6))

#: Named instead of a field: the times are computed from the directions of the points.
AZIMUTH = "azimuth"

#: Units that a user may name, in seconds.
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

#: The least and the largest duration of a cloud or a scan, seconds.
_SHORTEST, LONGEST = 1e-9, 60.0

#: A lidar takes longer for a cloud or a scan, seconds, and for a larger share of the time from one to the next.
_BRIEF, _BRIEF_SHARE = 1e-3, 0.02
#: No turn takes so many times as long as it is from one scan to the next, even if a sector is swept to and fro.
_LONG = 10.0

#: What to do about a ``time_increment`` in another unit.
IN_SECONDS = "time_increment is in seconds, and this one is probably in another unit"

#: Times of this many seconds and more do not count from the cloud's beginning, but from 1970, or from the sensor's
#: start.
_ABSOLUTE = 1000.0
#: How many points' times show whether they are absolute.
_SOME = 64
#: Shorter times are absolute, too, if they differ from the stamp by less than this factor. It tells units apart.
_NEAR = 2.0

#: The number of equal parts of a cloud's time, to whose mean directions a sweep is fitted.
_SLICES = 64

#: How far a sweep may be off the fitted line, radians: the lasers of one column point up to 5 degrees to the side.
_STRAIGHT = 0.1

#: The largest angle between consecutive points, radians; how many turns determine a direction; and the number of turns
#: from which on points are stored ring by ring.
_NEXT = 0.2
LEAST_TURN = 0.05
_ONE_TURN = 1.5

#: How far the two ends of a turn may overlap, radians, for the same reason.
_OVERLAP = 0.2


def median_interval_ns(stamps_ns: Iterable[int]) -> int | None:
    """Return the median time between stamps, in any order: the lower one, if two are in the middle.

    None for fewer than two different stamps.
    """
    ordered = sorted(set(stamps_ns))
    intervals = sorted(later - earlier for earlier, later in pairwise(ordered))
    return intervals[(len(intervals) - 1) // 2] if intervals else None


def is_brief(seconds: float, period: float) -> bool:
    """Whether a lidar measures for an implausibly short part of its period; both times in seconds.

    Packets are brief, too, but follow each other; and points of a flash lidar have one time.
    """
    return 0 < seconds < _BRIEF and seconds < _BRIEF_SHARE * period


def increment_doubt(turn: float, period: float) -> str:
    """Return what is implausible about a ``time_increment``; empty if nothing is.

    Parameters
    ----------
    turn
        How long a whole turn takes by it, seconds.
    period
        The time from one scan to the next, seconds.
    """
    if is_brief(turn, period) or turn > _LONG * period > 0:
        return f"by its time_increment a turn takes {turn:.3g} s, but scans come every {period:.3g} s"
    return ""


def time_field(fields: Iterable[str]) -> str:
    """Return the field that has the times of a cloud's points; empty if none has."""
    names = set(fields)
    return next((name for name in TIME_FIELDS if name in names), "")


def offset_and_unit(low: float, high: float, stamp_ns: int, unit_name: str, *, whole: bool) -> tuple[float, float]:
    """Return the offset and the unit of the values of one of the `TIME_FIELDS`.

    Integers are nanoseconds. Floating-point numbers are seconds, milli-, micro- or nanoseconds: the unit in which they
    are about as large as the stamp, as absolute times are, even of a cloud with one point. If there is none, they count
    from the stamp, and their span decides.

    Parameters
    ----------
    low, high
        The least and the largest value.
    stamp_ns
        The cloud's stamp.
    unit_name
        One of `TIME_UNITS`; empty: judged by the numbers.
    whole
        Whether the values are integers.

    Returns
    -------
    (float, float)
        A point was measured ``(value - offset) * unit`` seconds after the stamp.
    """
    near = [unit for unit in TIME_UNITS.values() if _are_near(low * unit, high * unit, stamp_ns / 1e9)]
    if unit_name or whole:
        unit = TIME_UNITS[unit_name or "ns"]
    else:
        unit = near[0] if near else next((unit for most, unit in _UNITS if high - low < most), 1e-9)
    is_absolute = unit in near or abs(low * unit) >= _ABSOLUTE
    # Subtracted as whole numbers of the unit, because seconds since 1970 need all digits of a float64.
    return (stamp_ns / round(1e9 * unit) if is_absolute else 0.0), unit


def absolute_times(values: NDArray[Any], stamp_ns: int, unit_name: str = "") -> tuple[float, float] | None:
    """Return the offset and the unit of times that are absolute, by some of them; None if they count from the stamp.

    A 0, which drivers write for points without a return, is not looked at, and neither are NaN and infinity.

    Parameters
    ----------
    values
        One of the `TIME_FIELDS`, of any shape.
    stamp_ns, unit_name
        See `offset_and_unit`.
    """
    with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
        some = values.reshape(-1)[:: max(1, values.size // _SOME)].astype(np.float64)
    some = some[np.isfinite(some) & (some != 0)]
    if not some.size:
        return None
    low, high = float(some.min()), float(some.max())
    offset, unit = offset_and_unit(low, high, stamp_ns, unit_name, whole=values.dtype.kind in "iu")
    # Without a span, nothing but its distance from the stamp shows the unit of a time that all points share.
    is_absolute = offset and (low < high or abs(low - offset) * unit < LONGEST)
    return (offset, unit) if is_absolute else None


def _are_near(low: float, high: float, stamp: float) -> bool:
    """Whether times of a cloud are about as large as its stamp, and too large to count from it: seconds."""
    return high - low <= LONGEST <= low and stamp / _NEAR <= low and high <= stamp * _NEAR


def azimuth_times(x: NDArray[Any], y: NDArray[Any], period: float, direction: int = 0) -> NDArray[np.float64] | None:
    """Return when points were measured by a lidar that turns evenly, from their azimuth.

    Parameters
    ----------
    x, y
        Coordinates in the lidar's frame, metres: (H, W), or (M,) one ring or one column after the other.
    period
        The time of one turn, seconds.
    direction
        1 counter-clockwise, -1 clockwise, as seen from above; 0: by the order of the points.

    Returns
    -------
    Seconds after the first point, of the shape of ``x``, NaN where ``x`` is. None if the order shows no direction.

    Notes
    -----
    Lasers of one column point a little to the side, so the azimuth of some points is before that of the first point,
    and that of some of the last points is after it. If points are stored column by column, their order shows which turn
    it is; not if they are stored in the other direction, as by drivers that sort them by azimuth.
    """
    with np.errstate(all="ignore"):
        angles = np.arctan2(y.astype(np.float64), x.astype(np.float64)).ravel()
        angles[((x == 0) & (y == 0)).ravel()] = np.nan
    places = np.flatnonzero(np.isfinite(angles))
    times = np.full(angles.size, np.nan)
    if not places.size:
        return times.reshape(x.shape)
    known = angles[places]
    near, turns = turn_by_order(known)
    if not direction:
        if near < 0.5 or abs(turns) < LEAST_TURN:
            return None
        direction = 1 if turns > 0 else -1
    share = np.remainder((known - known[0]) * direction, TURN) / TURN
    in_rows = x.ndim == 2 and abs(turns) > _ONE_TURN
    if turns * direction < 0:
        pass
    elif in_rows:
        share += np.round(places % x.shape[1] / x.shape[1] * abs(turns) / x.shape[0] - share)
    elif abs(turns) <= _ONE_TURN:
        share += np.round(places / angles.size * abs(turns) - share)
    times[places] = share * period
    return times.reshape(x.shape)


def turn_by_order(angles: NDArray[np.float64]) -> tuple[float, float]:
    """How points go round in their order.

    Parameters
    ----------
    angles
        (M,) the directions of points, radians.

    Returns
    -------
    (float, float)
        The share of steps from one to the next that are small, and the turns that these add up to, positive
        counter-clockwise.
    """
    if angles.size < 2:
        return 0.0, 0.0
    steps = np.remainder(np.diff(angles) + math.pi, TURN) - math.pi
    near = np.abs(steps) < _NEXT
    return float(near.mean()), float(steps[near].sum()) / TURN


class Sweep(NamedTuple):
    """The rotation of a lidar while it measured a cloud.

    Attributes
    ----------
    begin, end
        Seconds after the cloud's stamp.
    angle
        Its direction at ``begin``, radians.
    rate
        Radians per second, positive counter-clockwise.
    """

    begin: float
    end: float
    angle: float
    rate: float

    @property
    def lowest(self) -> float:
        """The smallest angle of the sweep, radians, -pi to pi: a scan that begins there contains it in one piece."""
        angle = self.angle + min(0.0, self.rate * (self.end - self.begin))
        return math.remainder(angle, TURN)


def fit_sweep(angles: NDArray[Any], times: NDArray[np.float64]) -> Sweep | None:
    """Fit the rotation of a lidar to the directions and the times of a cloud's points.

    Parameters
    ----------
    angles, times
        (M,), radians and seconds after the stamp; points with a NaN are ignored.

    Returns
    -------
    Sweep
        None if the points are not of one turn at a constant rate: depth cameras, risley prisms, times that are all
        equal or wrong.
    """
    known = np.isfinite(angles) & np.isfinite(times)
    angles, times = angles[known].astype(np.float64), times[known]
    if times.size < _SLICES:
        return None
    begin, end = float(times.min()), float(times.max())
    if not _SHORTEST < end - begin < LONGEST:
        return None
    slices = np.minimum(((times - begin) * (_SLICES / (end - begin))).astype(np.intp), _SLICES - 1)
    points = np.bincount(slices, minlength=_SLICES)
    filled = points > 0
    if np.count_nonzero(filled) < _SLICES / 4:
        return None
    x, y, when = (_sums(slices, weights)[filled] for weights in (np.cos(angles), np.sin(angles), times))
    directions = np.unwrap(np.arctan2(y, x))
    when /= points[filled]
    # The median of the slopes between any two slices (Theil and Sen), because some slices have only the outermost
    # lasers.
    first, second = np.triu_indices(when.size, 1)
    rate = median((directions[second] - directions[first]) / (when[second] - when[first]))
    angle = median(directions - rate * (when - begin))
    off = median(np.abs(angle + rate * (when - begin) - directions))
    turned = abs(rate) * (end - begin)
    if off > _STRAIGHT or not 4 * _STRAIGHT < turned < TURN + 2 * _OVERLAP:
        return None
    return Sweep(begin, end, angle, rate)


def _sums(slices: NDArray[np.intp], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.bincount(slices, weights, _SLICES).astype(np.float64)


def beam_times(sweep: Sweep, layout: BeamLayout) -> tuple[float, float] | None:
    """Return when a scan's first beam was measured, and the time from beam to beam.

    Returns
    -------
    (float, float)
        Seconds after the cloud's stamp, and seconds, negative if the lidar turns clockwise. None if the sweep begins
        inside the scan's sector, so that the times of its beams are not in order, or if it does not reach the sector.
    """
    edge = layout.angle_min - layout.angle_increment / 2
    width = layout.count * layout.angle_increment
    start = sweep.angle - edge
    low, high = sorted((start, start + sweep.rate * (sweep.end - sweep.begin)))
    turns = range(math.floor((low - width) / TURN), math.ceil(high / TURN) + 1)
    seen = [turn for turn in turns if min(high, turn * TURN + width) - max(low, turn * TURN) > _OVERLAP]
    if len(seen) != 1:
        return None
    first = sweep.begin + (seen[0] * TURN + layout.angle_min - sweep.angle) / sweep.rate
    return first, layout.angle_increment / sweep.rate
