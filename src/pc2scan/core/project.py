"""Points to ranges: the projection of pointcloud_to_laserscan, to the bit, and where every point went.

Source of the rule: ``cloudCb`` in pointcloud_to_laserscan_node.cpp. A point is dropped if, in this order,

1. x, y or z is NaN;
2. z is above ``max_height`` or below ``min_height``;
3. its range, float32 hypot(x, y), is below ``range_min`` or above ``range_max``;
4. its angle, float32 atan2(y, x), is outside the sector;
5. its angle is behind the last beam, where upstream writes past its array (see `Grid`).

The others lower the range of their beam to their own. Heights and ranges are compared as float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from .grid import Grid
from .params import ProjectionParams

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

__all__ = ["PointCounts", "ProjectedScan", "Projector", "project"]

#: Rotation (3, 3) and translation (3,), float64: ``target = rotation @ source + translation``.
Transform: TypeAlias = "tuple[NDArray[np.float64], NDArray[np.float64]]"

#: Points at a time: what is computed from them stays in the processor's second-level cache, and calling NumPy still
#: costs little beside them.
BLOCK = 16384


@dataclass(frozen=True, slots=True)
class PointCounts:
    """Where the points of a cloud went. Everything but ``total`` sums to ``total``.

    Attributes
    ----------
    total
        Points of the cloud.
    used
        Fell into a beam, whether or not another one was closer.
    nan
        x, y or z is NaN.
    height
        z is outside ``min_height`` to ``max_height``.
    range
        The range is outside ``range_min`` to ``range_max``.
    angle
        The angle is outside ``angle_min`` to ``angle_max``.
    past_end
        The angle is in the sector but behind its last beam.
    """

    total: int = 0
    used: int = 0
    nan: int = 0
    height: int = 0
    range: int = 0
    angle: int = 0
    past_end: int = 0

    def __add__(self, other: PointCounts) -> PointCounts:
        return PointCounts(
            self.total + other.total,
            self.used + other.used,
            self.nan + other.nan,
            self.height + other.height,
            self.range + other.range,
            self.angle + other.angle,
            self.past_end + other.past_end,
        )


@dataclass(frozen=True, slots=True)
class ProjectedScan:
    """What a cloud is projected to.

    Attributes
    ----------
    ranges
        (N,) float32, metres: the smallest range of each beam, ``params.no_return`` where there is none.
    counts
        Where the points went.
    """

    ranges: NDArray[np.float32]
    counts: PointCounts


class Projector:
    """The projection with given parameters. It has no state: threads may share one.

    Parameters
    ----------
    params
        The projection's parameters; ``target_frame`` is the caller's business.
    """

    def __init__(self, params: ProjectionParams) -> None:
        self.params = params
        self._grid = Grid(params)
        self._no_return = params.no_return
        # A float32 is compared with a float64 limit by comparing it with the next float32 inside the limit: there is
        # none between the two.
        self._lowest = _at_least(params.min_height)
        self._highest = _at_most(params.max_height)
        self._least, self._most = _squared_limits(params.range_min, params.range_max)

    def __call__(
        self,
        x: NDArray[np.generic],
        y: NDArray[np.generic],
        z: NDArray[np.generic],
        target_from_source: Transform | None = None,
    ) -> ProjectedScan:
        """Project a cloud.

        Parameters
        ----------
        x, y, z
            Coordinates of the points in metres: arrays of one shape, (M,) or (H, W), of real numbers in any
            byte order and with any strides. They are read, never copied as a whole, and rounded to float32.
        target_from_source
            Rotation and translation to apply first, in float64, to the coordinates as they are given. What
            it returns is rounded to float32.

        Returns
        -------
        ProjectedScan
            ``ranges`` is a new array. NaN drops a point; infinite coordinates are stopped only by limits.
        """
        grid = self._grid
        # Beams are compared by squared range: roots of beams, not of points. A cloud of few points is the opposite.
        squared = x.size > grid.beams
        lowest: NDArray[np.floating] = (
            np.full(grid.slots, np.inf) if squared else np.full(grid.slots, self._no_return)
        )
        nan = height = too_far = 0
        outside = past_end = 0
        with np.errstate(all="ignore"):
            for block in _blocks(x, y, z):
                xs, ys, zs = (
                    [_float32(part) for part in block]
                    if target_from_source is None
                    else _transformed(block, target_from_source)
                )
                squares = np.square(xs, dtype=np.float64)
                squares += np.square(ys, dtype=np.float64)
                inside = zs >= self._lowest
                inside &= zs <= self._highest
                kept = squares <= self._most
                kept &= inside
                if self._least > 0:
                    kept &= squares >= self._least
                keeps = np.count_nonzero(kept)
                if keeps < xs.size:
                    number = np.isnan(squares)
                    inside &= ~number
                    number |= np.isnan(zs)
                    nans = np.count_nonzero(number)
                    level = np.count_nonzero(inside)
                    nan += nans
                    height += xs.size - nans - level
                    too_far += level - keeps
                    where = np.flatnonzero(kept)
                    xs, ys, squares = xs.take(where), ys.take(where), squares.take(where)
                slots = grid.slots_of_points(xs, ys)
                if not grid.whole_circle:
                    outside += np.count_nonzero(slots == grid.outside)
                past_end += np.count_nonzero(slots == grid.past_end)
                np.minimum.at(lowest, slots, squares if squared else np.sqrt(squares).astype(np.float32))
            ranges = lowest[: grid.beams]
            if squared:
                ranges = np.minimum(np.sqrt(ranges).astype(np.float32), self._no_return)
        used = x.size - nan - height - too_far - outside - past_end
        return ProjectedScan(ranges, PointCounts(x.size, used, nan, height, too_far, outside, past_end))

def _float32(a):
    return np.ascontiguousarray(a,np.float32).reshape(-1)
def _blocks(x,y,z):
    for i in range(0,x.size,BLOCK):
        yield x[i:i+BLOCK],y[i:i+BLOCK],z[i:i+BLOCK]
def _at_least(v):
    f=np.float32(v) if abs(v)<3e38 else np.float32(np.copysign(np.inf,v))
    return f
def _at_most(v):
    return np.float32(v) if abs(v)<3e38 else np.float32(3.4028235e38)
def _squared_limits(a,b): return float(a)**2, 1e77
