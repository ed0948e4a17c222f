"""Finds the beams of a scan to remove: shadows behind edges, and speckles.

Source of the rule of `speckles`: ``LaserScanSpeckleFilter`` (by distance) of laser_filters 2.0, with the parameters of
its example, in float32 as there; but laser_filters stops at the first and the last beam, while a full circle has no end
here. `veiled_beams` is pc2scan's own rule.

A beam without a return is inf or NaN here, whatever number the scan has for it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

#: A return is between two others if it is at least this far behind one and in front of the other, metres ...
_APART = 0.1
#: ... and both lines are nearly parallel to the beam: tan of the largest angle between them.
_PARALLEL = math.tan(math.radians(15.0))
#: The most beams from a return to the next one that it is compared with.
_REACH = 3
#: The largest width of a lidar's beam, radians: so wide are mixed pixels at an edge. A line must be longer.
_WIDTH = 0.006
#: How many returns a line needs at most.
_MOST = 10
#: How far from the line through two others a return may be, metres: five times the noise of a lidar.
_NOISE = 0.1


def veiled_beams(ranges: NDArray[np.float32], increment: float, *, closed: bool = False) -> NDArray[np.bool_]:
    """Return which beams are on neither of two surfaces: between an edge and the surface behind it.

    Such a return is behind its neighbour on one side and in front of the one on the other side, by more than a surface
    at an angle of 15 degrees explains. On a wall at an even smaller angle this holds for true returns, too. They are on
    a line with the next two returns of one side, and are kept; so is every return of an object that is in front of both
    neighbours, however thin it is, and the surface behind an edge from its first return on.

    Parameters
    ----------
    ranges
        (N,) metres.
    increment
        Radians from beam to beam.
    closed
        Whether the first beam follows the last one.
    """
    veiled = np.zeros(ranges.size, np.bool_)
    beams = np.flatnonzero(np.isfinite(ranges) & (ranges > 0))
    if beams.size:
        returns = ranges[beams].astype(np.float64)
        before, after = (_neighbours(returns, beams, step, ranges.size, increment, closed) for step in (-1, 1))
        between = (before.nearer & after.farther) | (before.farther & after.nearer)
        veiled[beams] = between & ~before.aligned & ~after.aligned
    return veiled


class _Neighbours(NamedTuple):
    """Returns compared with those on one side of them.

    Attributes
    ----------
    nearer, farther
        Whether the next return is nearer or farther, much more than a wall explains.
    aligned
        Whether they are on a line with the next two returns; with more of them in fine scans, where two may be at the
        same edge.
    """

    nearer: NDArray[np.bool_]
    farther: NDArray[np.bool_]
    aligned: NDArray[np.bool_]


def _neighbours(
    returns: NDArray[np.float64], beams: NDArray[np.intp], step: int, count: int, increment: float, closed: bool
) -> _Neighbours:
    """Compare returns with those on one side: ``step`` is 1 for the returns after them, -1 for those before them."""
    one, apart = _next(beams, step, count, closed)
    first, second, apart_there = returns[one], returns[one[one]], apart[one]
    known = apart <= _REACH
    limit = np.maximum(_APART, np.minimum(returns, first) * (apart * abs(increment) / _PARALLEL))
    # On a line, 1 / range changes evenly from beam to beam, nearly. Returns are anywhere in their beams, so a step may
    # be up to twice as large as the one before it, or nothing.
    change = (1 / first - 1 / second) * (apart / np.maximum(apart_there, 1))
    difference, noise = 1 / returns - 1 / first, _NOISE / returns**2
    alike = (difference >= np.minimum(0, 2 * change) - noise) & (difference <= np.maximum(0, 2 * change) + noise)
    alike &= known & (apart_there <= _REACH)
    aligned = alike
    for _ in range(2, min(_MOST, math.ceil(_WIDTH / abs(increment)))):
        aligned = alike & aligned[one]
    return _Neighbours(known & (returns - first > limit), known & (first - returns > limit), aligned)


def _next(beams: NDArray[np.intp], step: int, count: int, closed: bool) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the place of the return next to each one, and how many beams away it is; beyond an end very many."""
    places = (np.arange(beams.size) + step) % beams.size
    apart = ((beams[places] - beams) * step) % count
    if not closed:
        apart[-1 if step > 0 else 0] = count + _REACH
    return places, apart


def speckles(
    ranges: NDArray[np.float32],
    _increment: float = 0.0,
    *,
    max_range: float = 2.0,
    max_range_difference: float = 0.1,
    filter_window: int = 2,
    closed: bool = False,
) -> NDArray[np.bool_]:
    """Return which beams are speckles: beams in no run of ``filter_window`` beams with ranges like its first one.

    Parameters
    ----------
    ranges
        (N,) metres.
    max_range
        Ranges beyond this are never removed, metres.
    max_range_difference
        How much the ranges of a run may differ from its first one, metres.
    filter_window
        How many beams a run has.
    closed
        Whether the first beam follows the last one.
    """
    with np.errstate(all="ignore"):
        valid = ~np.isnan(ranges)
        for away in range(1, filter_window):
            other, in_scan = _shift(ranges, away, closed)
            # The difference of two beams without a return is NaN, which does not count as too large.
            like = ~(np.abs(other - ranges).astype(np.float64) > max_range_difference)
            valid &= in_scan & ~np.isnan(other) & like
        kept = ranges.astype(np.float64) > max_range
        for away in range(filter_window):
            begun, in_scan = _shift(valid, -away, closed)
            kept |= in_scan & begun
    removed: NDArray[np.bool_] = ~kept
    return removed


def _shift(values: NDArray, away: int, closed: bool) -> tuple[NDArray, NDArray[np.bool_]]:  # type: ignore[type-arg]
    """Return the value ``away`` beams after each one, and whether there is one."""
    places = np.arange(values.size) + away
    in_scan = np.ones(values.size, np.bool_) if closed else (places >= 0) & (places < values.size)
    return values[places % values.size], in_scan


#: What finds the beams that `remove` names, from the ranges, the radians from beam to beam, and whether it is a circle.
BEAM_FILTERS: dict[str, Callable[..., NDArray[np.bool_]]] = {"shadows": veiled_beams, "speckles": speckles}
