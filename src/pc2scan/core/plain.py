"""The loops over points in NumPy: what runs where ``_kernel.c`` is not compiled, and what explains it.

Source of the rules: `project` and the beams in pointcloud_to_laserscan_node.cpp, which computes ``int index =
(angle - angle_min) / angle_increment``, where ``angle`` is a double that holds a float32, atan2f(y, x), and the other
two are the message's float32 fields: a float64 quotient, truncated. Its check of the sector comes first.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

__all__ = ["angles", "project"]

#: Points at a time: few enough for the cache, and enough to make the cost of calling NumPy small.
BLOCK = 16384


def project(
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    limits: NDArray[np.float64],
    moved: NDArray[np.float64] | None,
    ranges: NDArray[np.float32],
    no_return: float,
) -> tuple[int, int, int, int, int]:
    """Lower the ranges of beams to those of the points that fall into them.

    Parameters
    ----------
    x, y, z
        Coordinates in metres, of one shape, (M,) or (H, W), all float32 or all float64.
    limits
        (7,): the lowest and highest z, the least and most square of the range, all inclusive; then the scan's
        ``angle_min``, ``angle_max`` and ``angle_increment``.
    moved
        (12,): a transform to apply first, in float64: the rotation by rows, then the translation.
    ranges
        (N,), overwritten: the smallest range of each of N beams, ``no_return`` where that is smaller.
    no_return
        A float32 value, metres.

    Returns
    -------
    tuple of int
        How many points are NaN, at the wrong height, out of range, out of the sector, behind the last beam.
    """
    lowest, highest, least, most, angle_min, angle_max, angle_increment = limits.tolist()
    beams = ranges.size
    smallest = np.full(beams, np.inf)
    nans = heights = far = outside = past_end = 0
    with np.errstate(all="ignore"):
        for tile in _tiles(x.shape):
            px, py, pz = (part[tile].ravel() for part in (x, y, z))
            if moved is not None:
                px, py, pz = _move(px, py, pz, moved)
            px, py, pz = (part.astype(np.float32, copy=False) for part in (px, py, pz))
            nan = np.isnan(px) | np.isnan(py) | np.isnan(pz)
            level = ~nan & (pz >= lowest) & (pz <= highest)
            px, py = px[level], py[level]
            # float64 holds the squares of float32 exactly, and libm's hypotf adds them in float64.
            squares = np.square(px, dtype=np.float64) + np.square(py, dtype=np.float64)
            near = (squares >= least) & (squares <= most)
            px, py, squares = px[near], py[near], squares[near]
            angle = np.empty_like(px)
            angles(px, py, angle)
            inside = (angle >= angle_min) & (angle <= angle_max)
            # Outside the sector, a quotient may be beyond the integers.
            index = ((angle[inside].astype(np.float64) - angle_min) / angle_increment).astype(np.intp)
            beam = index < beams
            np.minimum.at(smallest, index[beam], squares[inside][beam])
            nans += int(np.count_nonzero(nan))
            heights += nan.size - int(np.count_nonzero(nan)) - px.size - int(np.count_nonzero(~near))
            far += int(np.count_nonzero(~near))
            outside += px.size - index.size
            past_end += index.size - int(np.count_nonzero(beam))
        # The smallest square has the smallest root, and beams are mostly fewer than points.
        ranges[...] = np.sqrt(smallest)
        np.minimum(ranges, np.float32(no_return), out=ranges)
    return nans, heights, far, outside, past_end


def angles(x: NDArray[np.float32], y: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """float32(atan2(y, x)): all (M,), float32, contiguous, not NaN; metres to radians."""
    # What float64 is off by is lost in the rounding, but for about one in a hundred million.
    out[...] = np.arctan2(y, x, dtype=np.float64)


def _move(
    x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], moved: NDArray[np.float64]
) -> tuple[NDArray[np.float64], ...]:
    """Coordinates, transformed. Written out: a matrix product may sum in any order."""
    rotation, translation = moved[:9].reshape(3, 3), moved[9:]
    x, y, z = (part.astype(np.float64, copy=False) for part in (x, y, z))
    return tuple(
        x * row[0] + y * row[1] + z * row[2] + offset for row, offset in zip(rotation, translation, strict=True)
    )


def _tiles(shape: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Parts of a cloud, up to `BLOCK` points each: whole rows, or equal parts of rows that are longer."""
    *rows, columns = shape
    width = max(1, math.ceil(columns / max(1, math.ceil(columns / BLOCK))))
    height = max(1, BLOCK // width)
    for top in range(0, rows[0] if rows else 1, height):
        for left in range(0, columns, width):
            across = slice(left, left + width)
            yield (slice(top, top + height), across) if rows else (across,)
