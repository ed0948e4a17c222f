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
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .grid import Grid
from .params import ProjectionParams, float32

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
    """The projection with given parameters. It keeps nothing from call to call: threads may share one.

    Parameters
    ----------
    params
        The projection's parameters; ``target_frame`` is the caller's business.
    """

    __slots__ = ("grid", "limits", "params")

    def __init__(self, params: ProjectionParams) -> None:
        self.params = params
        self.grid = Grid(params)
        self.limits = _Limits(params)

    def __call__(
        self,
        x: NDArray[Any],
        y: NDArray[Any],
        z: NDArray[Any],
        target_from_source: Transform | None = None,
    ) -> ProjectedScan:
        """Project a cloud.

        Parameters
        ----------
        x, y, z
            Coordinates in metres, of one shape, (M,) or (H, W): integers or floats of any size, byte order,
            alignment and strides. They are read a block at a time and rounded to float32.
        target_from_source
            A transform to apply first, in float64, to the coordinates as they are; what it returns is
            rounded to float32.

        Returns
        -------
        ProjectedScan
            Its ``ranges`` are a new array. Infinite coordinates are stopped only by the limits.

        Raises
        ------
        ValueError
            If the shapes differ, or have more than two dimensions.
        """
        if not (x.shape == y.shape == z.shape and 1 <= x.ndim <= 2):
            raise ValueError(f"x, y and z have the shapes {x.shape}, {y.shape} and {z.shape}, expected one of (M,) or (H, W)")
        cloud = _Cloud(self.grid, self.limits, x.size)
        with np.errstate(all="ignore"):
            for block in _blocks(x, y, z, target_from_source):
                cloud.add(*block)
            return cloud.scan()


class _Limits:
    """What coordinates are compared with.

    A float32 is within float64 limits exactly if it is within the float32 numbers next to them on the inner
    side, for there are no others in between. And a range, the root of a square rounded twice, does not fall when
    the square grows: so there is a smallest square with a range of ``range_min``, and a largest one with
    ``range_max``.
    """

    __slots__ = ("highest", "least", "lowest", "most", "no_return")

    def __init__(self, params: ProjectionParams) -> None:
        self.lowest = _first_from(params.min_height)
        self.highest = _last_to(params.max_height)
        with np.errstate(over="ignore"):
            self.least = _first_square(_first_from(params.range_min))
            beyond = np.nextafter(_last_to(params.range_max), np.float32(np.inf))
            self.most = np.inf if params.range_max == np.inf else np.nextafter(_first_square(beyond), -np.inf)
        self.no_return = np.float32(params.no_return)


def _first_from(limit: float) -> np.float32:
    """The smallest float32 that is not below a limit."""
    rounded = np.float32(float32(limit))
    return rounded if rounded >= np.float64(limit) else np.nextafter(rounded, np.float32(np.inf))


def _last_to(limit: float) -> np.float32:
    """The largest float32 that is not above a limit."""
    return -_first_from(-limit)


def _first_square(limit: np.float32) -> np.float64:
    """The smallest float64 whose root, rounded to float32, is not below a limit; 0 for limits below 0.

    Bisects the bit patterns, which positive floats are in the order of.
    """
    below, enough = -1, int(np.float64(np.inf).view(np.int64))
    while enough - below > 1:
        middle = (below + enough) // 2
        if np.sqrt(np.int64(middle).view(np.float64)).astype(np.float32) >= limit:
            enough = middle
        else:
            below = middle
    return np.int64(enough).view(np.float64)


class _Cloud:
    """A cloud on its way into a scan: the smallest range of each slot so far, and the counts.

    Points pass three stages, each cheaper for a point than the next one: the heights; if it pays, a filter that
    knows which points cannot change the scan; the rule itself.
    """

    def __init__(self, grid: Grid, limits: _Limits, total: int) -> None:
        self._grid = grid
        self._limits = limits
        self._total = total
        # Squares are compared, which saves the points' roots, unless there are more beams than points.
        self._squared = total > grid.beams
        self._smallest = (
            np.full(grid.slots, np.inf) if self._squared else np.full(grid.slots, limits.no_return, np.float32)
        )
        self._nan = self._height = self._range = self._angle = self._past_end = 0

    def add(self, x: NDArray[np.float32], y: NDArray[np.float32], z: NDArray[np.float32]) -> None:
        """Take a block of points, (M,) each."""
        level = z >= self._limits.lowest
        level &= z <= self._limits.highest
        if np.count_nonzero(level) < z.size:
            nan = np.isnan(x)
            nan |= np.isnan(y)
            nan |= np.isnan(z)
            nans = np.count_nonzero(nan)
            np.greater(level, nan, out=level)
            kept = np.flatnonzero(level)
            self._nan += nans
            self._height += z.size - nans - kept.size
            x, y = x.take(kept), y.take(kept)
        self._project(x, y)

    def _project(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> None:
        """Upstream's rule."""
        grid, limits = self._grid, self._limits
        # float64 holds the product of two float32 exactly: this is how libm's hypotf computes a range.
        squares = x.astype(np.float64)
        squares *= squares
        more = y.astype(np.float64)
        more *= more
        squares += more
        near = squares <= limits.most
        if limits.least > 0:
            near &= squares >= limits.least
        if np.count_nonzero(near) < x.size:
            nans = np.count_nonzero(np.isnan(squares))
            kept = np.flatnonzero(near)
            self._nan += nans
            self._range += x.size - nans - kept.size
            x, y, squares = x.take(kept), y.take(kept), squares.take(kept)
        slots = grid.slots_of_points(x, y)
        values = squares if self._squared else np.sqrt(squares).astype(np.float32)
        if RUNS and 8*np.count_nonzero(slots[1:1025]!=slots[:1024][:slots.size-1])<min(slots.size,1024):
            starts = np.flatnonzero(slots[1:] != slots[:-1])
            starts += 1
            starts = np.concatenate(([0], starts))
            values = np.minimum.reduceat(values, starts)
            np.minimum.at(self._smallest, slots.take(starts), values)
        else:
            np.minimum.at(self._smallest, slots, values)
        if self._smallest[grid.outside]<np.inf:
            self._angle += np.count_nonzero(slots == grid.outside)
            self._smallest[grid.outside]=np.inf
        if self._smallest[grid.past_end]<np.inf:
            self._past_end += np.count_nonzero(slots == grid.past_end)
            self._smallest[grid.past_end]=np.inf

    def scan(self) -> ProjectedScan:
        """The scan of the blocks so far."""
        ranges = self._smallest[: self._grid.beams]
        if self._squared:
            # Upstream's beams begin with what they read without a return, and a return has to be below that.
            ranges = np.minimum(np.sqrt(ranges).astype(np.float32), self._limits.no_return)
        rejected = self._nan + self._height + self._range + self._angle + self._past_end
        return ProjectedScan(
            ranges,
            PointCounts(
                self._total,
                self._total - rejected,
                self._nan,
                self._height,
                self._range,
                self._angle,
                self._past_end,
            ),
        )


def _blocks(x, y, z, target_from_source):
    for tile in _tiles(x.shape):
        yield [part[tile].astype(np.float32, order="C", copy=False).reshape(-1) for part in (x, y, z)]

def _tiles(shape):
    for i in range(0,shape[0],BLOCK): yield slice(i,i+BLOCK)

_SAMPLE = 7
_PARTS = 4
_POINTS_PER_BEAM = 64
_SLACK = 2.0**-21
_TINY = 1e-37

RUNS=True
