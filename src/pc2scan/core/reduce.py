"""Reduces the returns of each beam to the one that the scan reads.

Returns are given as two arrays of one length, in the order of the cloud: the beam of each, and its range. If ranges
in a beam are equal, the first one in this order wins. The result does not depend on blocks or threads.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .params import ProjectionParams

#: How far a surface extends behind its closest return: metres, and beam widths.
_SURFACE_DEPTH = 0.05
_SURFACE_SLOPE = 3.0


def extremes(
    beams: NDArray[Any], ranges: NDArray[np.float32], count: int, *, largest: bool = False
) -> NDArray[np.float32]:
    """Return the smallest or the largest range of each beam.

    Parameters
    ----------
    beams, ranges
        (M,): beams from 0 to ``count - 1``, ranges in metres, not NaN.
    count
        N, the beams of the scan.

    Returns
    -------
    (N,) float32, metres; +inf (of the largest: -inf) for a beam without returns.
    """
    extreme = np.full(count, -np.inf if largest else np.inf, np.float32)
    (np.maximum if largest else np.minimum).at(extreme, beams, ranges)
    return extreme


def winners(
    beams: NDArray[Any], ranges: NDArray[np.float32], counts: NDArray[np.intp], how: str, kth: int = 0
) -> NDArray[np.intp]:
    """Return which return each beam reads.

    Parameters
    ----------
    beams, ranges
        (M,), as for `extremes`.
    counts
        (N,) returns of each beam.
    how
        ``min``, ``max``, ``median`` (of an even number the lower one of the two in the middle) or ``kth=N``.
    kth
        1 is the closest return, 2 the next.

    Returns
    -------
    (N,) intp, 0 to M - 1; -1 for a beam without returns, or with fewer than ``kth``.
    """
    chosen = np.full(counts.size, -1, np.intp)
    if how in {"min", "max"}:
        extreme = extremes(beams, ranges, counts.size, largest=how == "max")
        equal = np.flatnonzero(ranges == extreme[beams])[::-1]
        # Assigned from the last to the first, so that the first one remains.
        chosen[beams[equal]] = equal
        return chosen
    order = np.lexsort((ranges, beams))
    begins = np.cumsum(counts) - counts
    places = begins + (kth - 1 if kth else (counts - 1) // 2)
    enough = counts >= max(1, kth)
    chosen[enough] = order[places[enough]]
    return chosen


def surfaces(beams: NDArray[Any], ranges: NDArray[np.float32], count: int, increment: float) -> NDArray[np.intp]:
    """Return which return each beam reads for ``reduce`` ``surface``: the median of those on the closest surface.

    Parameters
    ----------
    beams, ranges
        (M,), as for `extremes`.
    count
        N, the beams of the scan.
    increment
        The width of a beam, radians. A surface extends behind its closest return, of range r, by `_SURFACE_DEPTH` +
        `_SURFACE_SLOPE` * r * increment.

    Returns
    -------
    (N,) intp, 0 to M - 1; -1 for a beam without returns. If their number is even, the lower one of the two in the
    middle.

    Notes
    -----
    A beam is as wide as its increment, so on a slanted wall its returns differ by about ``r * increment / tan(angle)``.
    The closest return is at the near edge of the beam, or has the largest error of the
    sensor; the median is in the middle. Returns behind the surface are ignored, so that no range lies between a near
    object and a far one.
    """
    limits = _surface_limits(beams, ranges, count, increment)
    near = np.flatnonzero(ranges <= limits[beams])
    own = beams[near]
    order = near[np.lexsort((ranges[near], own))]
    counts = np.bincount(own, minlength=count)
    chosen = np.full(count, -1, np.intp)
    filled = counts > 0
    chosen[filled] = order[(np.cumsum(counts) - counts + (counts - 1) // 2)[filled]]
    return chosen


def _surface_limits(
    beams: NDArray[Any], ranges: NDArray[np.float32], count: int, increment: float
) -> NDArray[np.float64]:
    """Return how far the closest surface of each beam extends, metres; inf for a beam without returns."""
    limits = extremes(beams, ranges, count).astype(np.float64)
    seen = limits < np.inf
    limits[seen] += _SURFACE_DEPTH + _SURFACE_SLOPE * increment * limits[seen]
    return limits


def means(beams: NDArray[Any], values: NDArray[Any], counts: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the mean of each beam's values, (N,) float64, summed in the order of the cloud; 0 without values."""
    sums = np.bincount(beams, weights=values, minlength=counts.size)
    return np.divide(sums, counts, out=np.zeros(counts.size), where=counts > 0)


def read(beams: NDArray[Any], ranges: NDArray[np.float32], count: int, params: ProjectionParams) -> NDArray[np.intp]:
    """Return which returns the beams need: with these alone their ranges are the same.

    Parameters
    ----------
    beams, ranges, count
        As for `extremes`.
    params
        The projection's parameters.

    Returns
    -------
    (K,) intp, increasing
        The return itself with ``reduce`` ``min`` and ``max``; the closest ones up to it with ``kth=N``; those of the
        surface with ``surface``; all returns of the beam with ``mean`` and ``median``, and with ``min_points``, which
        counts them. No return of a beam without a range.
    """
    how = params.reduce
    counts = np.bincount(beams, minlength=count)
    seen = counts >= max(params.min_points, params.kth, 1)
    if params.min_points > max(params.kth, 1) or how in {"mean", "median"}:
        return np.flatnonzero(seen[beams])
    if params.kth:
        order = np.lexsort((ranges, beams))
        begins = np.cumsum(counts) - counts
        places = np.arange(beams.size) - begins[beams[order]]
        return np.sort(order[(places < params.kth) & seen[beams[order]]])
    if how == "surface":
        limits = _surface_limits(beams, ranges, count, params.layout.angle_increment)
        return np.flatnonzero(ranges <= limits[beams])
    return np.sort(winners(beams, ranges, counts, how)[seen])
