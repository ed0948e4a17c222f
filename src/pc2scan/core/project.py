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
import threading
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
    """The projection with given parameters. Threads may share one.

    Parameters
    ----------
    params
        The projection's parameters; ``target_frame`` is the caller's business.
    """

    __slots__ = ("_grid", "_limits", "params")

    def __init__(self, params: ProjectionParams) -> None:
        self.params = params
        self._grid = Grid(params)
        self._limits = _Limits(params)

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
            If the shapes differ, or have not one or two dimensions.
        """
        if not (x.shape == y.shape == z.shape and 1 <= x.ndim <= 2):
            raise ValueError(
                f"x, y and z have the shapes {x.shape}, {y.shape} and {z.shape}, expected the same (M,) or (H, W)"
            )
        cloud = _Cloud(self._grid, self._limits, x.size)
        with np.errstate(all="ignore"):
            for tile in _tiles(x.shape):
                cloud.add(x[tile], y[tile], z[tile], target_from_source)
            return cloud.scan()


def project(points: ArrayLike, params: ProjectionParams | None = None) -> ProjectedScan:
    """Project a cloud to a scan, as pointcloud_to_laserscan does it.

    Parameters
    ----------
    points
        (M, 3) or (H, W, 3), integers or floats: x, y and z in metres, in the scan's frame. They are rounded to float32,
        which is what upstream reads. NaN drops a point; infinite coordinates are stopped only by the limits.
    params
        The projection's parameters, upstream's defaults if None. Those **drop everything at or below z = 0**.

    Returns
    -------
    ProjectedScan
        The smallest range of each beam, and where the points went.

    Raises
    ------
    ValueError
        If ``points`` has another shape.
    TypeError
        If ``points`` are not real numbers.

    Examples
    --------
    >>> from pc2scan import ProjectionParams, project
    >>> scan = project([[2.0, 0.1, 0.3], [1.0, 0.1, 0.9]], ProjectionParams(max_height=0.5))
    >>> float(scan.ranges.min()), scan.counts.used, scan.counts.height
    (2.0024983882904053, 1, 1)
    """
    array = np.asarray(points)
    if array.ndim not in {2, 3} or array.shape[-1] != 3:
        raise ValueError(f"points have the shape {array.shape}, expected (M, 3) or (H, W, 3)")
    if array.dtype.kind not in "biuf":
        raise TypeError(f"points are of type {array.dtype}, expected integers or floats")
    projector = Projector(ProjectionParams() if params is None else params)
    return projector(array[..., 0], array[..., 1], array[..., 2])


class _Limits:
    """What the coordinates are compared with.

    A float32 is within float64 limits exactly if it is within the float32 next to them on the inner side, for
    there is none in between. And a range, the root of a square rounded twice, does not fall when the square grows:
    there is a smallest square whose range reaches ``range_min``, and a largest one within ``range_max``.
    """

    __slots__ = ("highest", "least", "lowest", "most", "no_return")

    def __init__(self, params: ProjectionParams) -> None:
        self.lowest = _first_from(params.min_height)
        self.highest = -_first_from(-params.max_height)
        self.least = _first_square(_first_from(params.range_min))
        self.most = math.inf
        if params.range_max < math.inf:
            beyond = np.nextafter(-_first_from(-params.range_max), np.float32(np.inf))
            self.most = math.nextafter(_first_square(beyond), -math.inf)
        self.no_return = np.float32(params.no_return)


def _first_from(limit: float) -> np.float32:
    """The smallest float32 that is not below a limit."""
    nearest = np.float32(float32(limit))
    return nearest if float(nearest) >= limit else np.nextafter(nearest, np.float32(np.inf))


def _first_square(limit: np.float32) -> float:
    """The smallest float64, from 0 on, whose root is not below a limit once it is rounded to float32.

    Bisects bit patterns: those of positive floats are in the order of their values.
    """
    below, enough = -1, int(np.float64(np.inf).view(np.int64))
    while enough - below > 1:
        middle = (below + enough) // 2
        if float32(math.sqrt(np.int64(middle).view(np.float64))) >= limit:
            enough = middle
        else:
            below = middle
    return float(np.int64(enough).view(np.float64))


def _tiles(shape: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Parts of a cloud of about `BLOCK` points: whole rows, or equal parts of one row where rows are long."""
    *rows, columns = shape
    parts = max(1, math.ceil(columns / BLOCK))
    width = max(1, math.ceil(columns / parts))
    height = max(1, BLOCK // width)
    for top in range(0, rows[0] if rows else 1, height):
        for left in range(0, columns, width):
            across = slice(left, left + width)
            yield (slice(top, top + height), across) if rows else (across,)


class _Scratch:
    """Arrays for what is computed from a block, of one length, and used again for block after block.

    Fresh memory is no alternative: the allocator hands blocks of this size back to the system, and each of their pages
    has to be faulted in again.
    """

    __slots__ = ("_shorter", "arrays", "coordinates", "doubles", "masks", "singles", "size", "slots")

    def __init__(self, singles, doubles, masks, slots) -> None:
        self.arrays = singles, doubles, masks, slots
        self.size = singles.shape[1]
        self.coordinates = singles[:3]
        self.singles = tuple(singles)
        self.doubles = tuple(doubles)
        self.masks = tuple(masks)
        self.slots = slots
        self._shorter: _Scratch | None = None

    @classmethod
    def of_size(cls, size: int) -> _Scratch:
        return cls(
            np.empty((6, size), np.float32),
            np.empty((2, size)),
            np.empty((2, size), np.bool_),
            np.empty(size, np.intp),
        )

    def cut(self, size: int) -> _Scratch:
        """The same arrays up to a length."""
        if size == self.size:
            return self
        if self._shorter is None or self._shorter.size != size:
            self._shorter = _Scratch(*(array[..., :size] for array in self.arrays))
        return self._shorter


class _PerThread(threading.local):
    """Scratch arrays of a thread."""

    scratch: _Scratch | None = None

    def of_size(self, size: int) -> _Scratch:
        if self.scratch is None or self.scratch.size < size:
            self.scratch = _Scratch.of_size(max(size, BLOCK))
        return self.scratch.cut(size)


_PER_THREAD = _PerThread()


class _Cloud:
    """A cloud on its way into a scan: the smallest range of each slot so far, and the counts."""

    __slots__ = (
        "_angle",
        "_grid",
        "_height",
        "_limits",
        "_nan",
        "_past_end",
        "_range",
        "_smallest",
        "_squared",
        "_total",
    )

    def __init__(self, grid: Grid, limits: _Limits, total: int) -> None:
        self._grid = grid
        self._limits = limits
        self._total = total
        self._nan = self._height = self._range = self._angle = self._past_end = 0
        # Squares are compared, which saves the points' roots, unless there are more beams than points.
        self._squared = total > grid.beams
        if self._squared:
            self._smallest = np.full(grid.slots, np.inf)
        else:
            self._smallest = np.full(grid.slots, limits.no_return, np.float32)
            self._smallest[grid.beams :] = np.inf

    def add(self, x, y, z, target_from_source) -> None:
        """Take a block of points."""
        size = x.size
        scratch = _PER_THREAD.of_size(size)
        xs, ys, zs = scratch.singles[:3]
        if target_from_source is None:
            for array, part in ((xs, x), (ys, y), (zs, z)):
                np.copyto(array.reshape(part.shape) if part.ndim > 1 else array, part, casting="unsafe")
        else:
            _transform(x, y, z, target_from_source, scratch)

        level, mask = scratch.masks
        np.greater_equal(zs, self._limits.lowest, out=level)
        np.less_equal(zs, self._limits.highest, out=mask)
        level &= mask
        if np.count_nonzero(level) < size:
            nan = np.isnan(xs, out=mask)
            nan |= np.isnan(ys)
            nan |= np.isnan(zs)
            nans = np.count_nonzero(nan)
            kept = np.flatnonzero(np.greater(level, nan, out=level))
            self._nan += nans
            self._height += size - nans - kept.size
            scratch = scratch.cut(kept.size)
            xs = xs.take(kept, out=scratch.singles[3], mode="clip")
            ys = ys.take(kept, out=scratch.singles[4], mode="clip")
        self._project(xs, ys, scratch)

    def _project(self, x: NDArray[np.float32], y: NDArray[np.float32], scratch: _Scratch) -> None:
        """Take points that passed the heights; their coordinates are in the scratch, or not."""
        limits = self._limits
        # float64 holds the product of two float32 exactly: this is how libm's hypotf computes a range.
        squares, more = scratch.doubles
        np.copyto(squares, x)
        squares *= squares
        np.copyto(more, y)
        more *= more
        squares += more
        near, mask = scratch.masks
        np.less_equal(squares, limits.most, out=near)
        if limits.least > 0:
            near &= np.greater_equal(squares, limits.least, out=mask)
        if np.count_nonzero(near) < x.size:
            nans = np.count_nonzero(np.isnan(squares, out=mask))
            kept = np.flatnonzero(near)
            self._nan += nans
            self._range += x.size - nans - kept.size
            scratch = scratch.cut(kept.size)
            x = x.take(kept, out=scratch.singles[0], mode="clip")
            y = y.take(kept, out=scratch.singles[1], mode="clip")
            squares = squares.take(kept, out=scratch.doubles[1], mode="clip")
        slots = self._grid.slots_of_points(x, y, scratch.slots, (scratch.singles[2], scratch.singles[5]))
        ranges = squares
        if not self._squared:
            ranges = scratch.singles[5]
            np.copyto(ranges, np.sqrt(squares, out=squares), casting="same_kind")
        self._lower(slots, ranges)

    def _lower(self, slots, ranges) -> None:
        smallest = self._smallest
        # Lowering the same beam again and again waits for itself: where neighbours share a beam, each run does it once.
        probe = slots[:_PROBE]
        if probe.size==_PROBE and np.count_nonzero(probe[1:] != probe[:-1]) * 8 < _PROBE:
            starts = np.flatnonzero(np.concatenate(([True], slots[1:] != slots[:-1])))
            np.minimum.at(smallest, slots.take(starts), np.minimum.reduceat(ranges, starts))
        else:
            np.minimum.at(smallest, slots, ranges)
        grid = self._grid
        self._angle += self._fell_into(grid.outside, slots)
        self._past_end += self._fell_into(grid.past_end, slots)

    def _fell_into(self, slot, slots):
        if self._limits.most < math.inf:
            if self._smallest[slot] == math.inf: return 0
            self._smallest[slot] = math.inf
        return np.count_nonzero(slots == slot)

    def scan(self) -> ProjectedScan:
        """The scan of the blocks so far."""
        ranges = self._smallest[: self._grid.beams]
        if self._squared:
            # Upstream's beams begin with what they read without a return, and a return has to be below that.
            ranges = np.minimum(np.sqrt(ranges, out=ranges).astype(np.float32), self._limits.no_return)
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
_PROBE=512
RUNS=True
