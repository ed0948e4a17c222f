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
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .grid import Grid
from .params import ProjectionParams, float32

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import ArrayLike, NDArray

__all__ = ["PointCounts", "ProjectedScan", "Projector", "project"]

#: Rotation (3, 3) and translation (3,), float64: ``target = rotation @ source + translation``.
Transform: TypeAlias = "tuple[NDArray[np.float64], NDArray[np.float64]]"

#: Points at a time: few enough for the cache, and enough to make the cost of calling NumPy small.
BLOCK = 16384

#: For fewer points it is cheaper to compute every angle in float64 than to find out which ones need it.
_FEW_POINTS = 4096

#: How many points of a block are looked at to tell whether neighbours share a beam, and from which mean
#: length on it pays to take runs of neighbours together.
_PROBE = 1024
_LONG_RUN = 32


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


def _no_values() -> NDArray[np.float32]:
    return np.empty(0, np.float32)


@dataclass(frozen=True, slots=True)
class ProjectedScan:
    """What a cloud is projected to.

    Attributes
    ----------
    ranges
        (N,) float32, metres: what each beam reads, ``params.empty_range`` where there is no return.
    counts
        Where the points went.
    intensities
        (N,) float32, 0 where there is no return; (0,) if none were asked for.
    """

    ranges: NDArray[np.float32]
    counts: PointCounts
    intensities: NDArray[np.float32] = field(default_factory=_no_values)


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
                f"x, y and z have the shapes {x.shape}, {y.shape}, {z.shape}, expected one of (M,) or (H, W)"
            )
        cloud = _Cloud(self._grid, self._limits, x.size)
        with np.errstate(all="ignore"):
            if x.size <= BLOCK:
                cloud.add((x, y, z), target_from_source)
            else:
                for tile in _tiles(x.shape):
                    cloud.add((x[tile], y[tile], z[tile]), target_from_source)
            return cloud.scan()


def project(
    points: ArrayLike, params: ProjectionParams | None = None, *, intensities: ArrayLike | None = None
) -> ProjectedScan:
    """Project a cloud to a scan, as pointcloud_to_laserscan does it unless the parameters say otherwise.

    Parameters
    ----------
    points
        (M, 3) or (H, W, 3), integers or floats: x, y and z in metres, in the scan's frame. They are rounded
        to float32, as upstream reads them. NaN drops a point; infinite coordinates are stopped only by the
        limits.
    params
        The projection's parameters, upstream's defaults if None. Those **drop everything at or below z = 0**.
    intensities
        (M,) or (H, W) real numbers, one for each point: the scan gets those of the points that it shows. None: the
        scan has none, whatever ``params.intensity_field`` says.

    Returns
    -------
    ProjectedScan
        What each beam reads, and where the points went.

    Raises
    ------
    ValueError
        If ``points`` or ``intensities`` have another shape.
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
    params = ProjectionParams() if params is None else params
    columns = array[..., 0], array[..., 1], array[..., 2]
    if params.as_upstream and intensities is None:
        return Projector(params)(*columns)
    from .gather import GatheringProjector  # noqa: PLC0415  # it builds upon this module

    values = None if intensities is None else np.asarray(intensities)
    return GatheringProjector(params)(*columns, intensities=values)


class _Limits:
    """What the coordinates are compared with.

    A float32 is within float64 limits exactly if it is within the float32 next to them on the inner side, for
    there is none in between. And a range, the root of a square rounded twice, does not fall when the square
    grows: there is a smallest square whose range reaches ``range_min``, and a largest one that stays within
    ``range_max``.
    """

    __slots__ = ("highest", "least", "lowest", "most", "no_return")

    def __init__(self, params: ProjectionParams) -> None:
        self.lowest = _first_from(params.min_height)
        self.highest = -_first_from(-params.max_height)
        self.least = _first_square(_first_from(params.range_min))
        self.most = math.inf
        if params.range_max < math.inf:
            with np.errstate(over="ignore"):
                beyond = np.nextafter(-_first_from(-params.range_max), np.float32(np.inf))
            self.most = math.nextafter(_first_square(beyond), -math.inf)
        self.no_return = np.float32(params.empty_range)


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


def _tiles(shape: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Parts of a cloud, up to `BLOCK` points each: whole rows, or equal parts of rows that are longer."""
    *rows, columns = shape
    width = max(1, math.ceil(columns / max(1, math.ceil(columns / BLOCK))))
    height = max(1, BLOCK // width)
    for top in range(0, rows[0] if rows else 1, height):
        for left in range(0, columns, width):
            across = slice(left, left + width)
            yield (slice(top, top + height), across) if rows else (across,)


class _Scratch:
    """Arrays of one length for what is computed from a block, to be used again for the next.

    Fresh arrays may cost more than what is computed in them: allocators hand memory of such a size back to
    the system, which has to provide it again page by page.
    """

    __slots__ = ("_rows", "_shorter", "doubles", "masks", "singles", "slots")

    def __init__(
        self,
        singles: NDArray[np.float32],
        doubles: NDArray[np.float64],
        masks: NDArray[np.bool_],
        slots: NDArray[np.intp],
    ) -> None:
        self._rows = singles, doubles, masks, slots
        self._shorter: _Scratch | None = None
        self.singles = tuple(singles)
        self.doubles = tuple(doubles)
        self.masks = tuple(masks)
        self.slots = slots

    @property
    def size(self) -> int:
        return self.slots.size

    def cut(self, size: int) -> _Scratch:
        """The same memory, as arrays of another length."""
        if size == self.size:
            return self
        if self._shorter is None or self._shorter.size != size:
            singles, doubles, masks, slots = self._rows
            self._shorter = _Scratch(singles[:, :size], doubles[:, :size], masks[:, :size], slots[:size])
        return self._shorter


class _ScratchOfThread(threading.local):
    """Where each thread keeps its `_Scratch`."""

    scratch: _Scratch | None = None

    def of_size(self, size: int) -> _Scratch:
        """The thread's memory, enlarged if it has to be."""
        if self.scratch is None or self.scratch.size < size:
            most = max(size, BLOCK)
            self.scratch = _Scratch(
                np.empty((6, most), np.float32),
                np.empty((5, most), np.float64),
                np.empty((2, most), np.bool_),
                np.empty(most, np.intp),
            )
        return self.scratch.cut(size)


_SCRATCH = _ScratchOfThread()


class _Cloud:
    """A cloud on its way into a scan: the smallest range of each slot so far, and the counts."""

    __slots__ = (
        "_angle",
        "_grid",
        "_height",
        "_limits",
        "_nan",
        "_on_edges",
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
        self._on_edges = not grid.coarse
        # The smallest square has the smallest root: only beams need roots, or the points if they are fewer.
        self._squared = total > grid.beams
        self._smallest: NDArray[np.float32] | NDArray[np.float64]
        if self._squared:
            self._smallest = np.empty(grid.slots, np.float64)
            self._smallest.fill(np.inf)
        else:
            self._smallest = np.empty(grid.slots, np.float32)
            self._smallest.fill(limits.no_return)

    def add(self, tile: tuple[NDArray[Any], NDArray[Any], NDArray[Any]], transform: Transform | None) -> None:
        """Take a block of points."""
        size = tile[0].size
        scratch = _SCRATCH.of_size(size)
        x, y, z = scratch.singles[:3]
        if transform is None:
            _copy(tile, (x, y, z))
        else:
            _transform(tile, transform, (x, y, z), scratch.doubles)
        level, mask = scratch.masks
        np.greater_equal(z, self._limits.lowest, out=level)
        np.less_equal(z, self._limits.highest, out=mask)
        level &= mask
        if np.count_nonzero(level) < size:
            nan = np.isnan(x, out=mask)
            nan |= np.isnan(y)
            nan |= np.isnan(z)
            kept = np.flatnonzero(np.greater(level, nan, out=level))
            nans = int(np.count_nonzero(nan))
            self._nan += nans
            self._height += size - nans - kept.size
            scratch = scratch.cut(kept.size)
            x = x.take(kept, out=scratch.singles[3], mode="clip")
            y = y.take(kept, out=scratch.singles[4], mode="clip")
        self._project(x, y, scratch)

    def _project(self, x: NDArray[np.float32], y: NDArray[np.float32], scratch: _Scratch) -> None:
        """Take the points of a block whose height is right."""
        limits = self._limits
        # float64 holds the squares of float32 exactly, and libm's hypotf adds them in float64.
        squares, more, *_ = scratch.doubles
        np.copyto(squares, x)
        squares *= squares
        np.copyto(more, y)
        more *= more
        squares += more
        spare = scratch.singles[2], scratch.singles[5]
        near, mask = scratch.masks
        np.less_equal(squares, limits.most, out=near)
        if limits.least > 0:
            near &= np.greater_equal(squares, limits.least, out=mask)
        if np.count_nonzero(near) < x.size:
            nans = int(np.count_nonzero(np.isnan(squares, out=mask)))
            kept = np.flatnonzero(near)
            self._nan += nans
            self._range += x.size - nans - kept.size
            scratch = scratch.cut(kept.size)
            x = x.take(kept, out=scratch.singles[2], mode="clip")
            y = y.take(kept, out=scratch.singles[5], mode="clip")
            squares = squares.take(kept, out=scratch.doubles[1], mode="clip")
            spare = scratch.singles[0], scratch.singles[1]
        slots = self._slots(x, y, scratch.slots, spare)
        if self._squared:
            self._lower(slots, squares)
        else:
            np.copyto(spare[0], np.sqrt(squares, out=squares), casting="same_kind")
            self._lower(slots, spare[0])

    def _slots(
        self,
        x: NDArray[np.float32],
        y: NDArray[np.float32],
        out: NDArray[np.intp],
        spare: tuple[NDArray[np.float32], NDArray[np.float32]],
    ) -> NDArray[np.intp]:
        """The slots of points, by the way that is faster."""
        if x.size < _FEW_POINTS or self._on_edges:
            return self._grid.slots_of_points(x, y)
        close = self._grid.find_slots(x, y, out, spare)
        # Simulated lidars, and encoders that count in fractions of a degree, put all their points on edges.
        self._on_edges = 4 * close > x.size
        return out

    def _lower(self, slots: NDArray[np.intp], ranges: NDArray[np.float32] | NDArray[np.float64]) -> None:
        """Lower the slots' ranges, or their squares, to those of points."""
        if _has_long_runs(slots):
            # Each change of a slot waits for the one before: for a run of points in one beam, change it once.
            starts = np.flatnonzero(np.concatenate(([True], slots[1:] != slots[:-1])))
            np.minimum.at(self._smallest, slots.take(starts), np.minimum.reduceat(ranges, starts))
        else:
            np.minimum.at(self._smallest, slots, ranges)
        self._angle += self._fell_into(self._grid.outside, slots)
        self._past_end += self._fell_into(self._grid.past_end, slots)

    def _fell_into(self, slot: int, slots: NDArray[np.intp]) -> int:
        """How many points fell into a slot that is no beam; mostly, one look at the slot says none."""
        if self._smallest[slot] == np.inf and self._limits.most < math.inf:
            return 0
        return int(np.count_nonzero(slots == slot))

    def scan(self) -> ProjectedScan:
        """The scan of the blocks so far."""
        smallest = self._smallest[: self._grid.beams]
        if self._squared:
            np.sqrt(smallest, out=smallest)
        ranges = smallest.astype(np.float32, copy=False)
        if self._squared:
            # Upstream's beams begin with what they read without a return, and a return has to be below that.
            np.minimum(ranges, self._limits.no_return, out=ranges)
        rejected = self._nan + self._height + self._range + self._angle + self._past_end
        counts = PointCounts(
            self._total,
            self._total - rejected,
            self._nan,
            self._height,
            self._range,
            self._angle,
            self._past_end,
        )
        return ProjectedScan(ranges, counts)


def _copy(tile: Sequence[NDArray[Any]], into: Sequence[NDArray[Any]]) -> None:
    """Copy coordinates to contiguous arrays, converted to their type."""
    for part, array in zip(tile, into, strict=True):
        if part.ndim == 1:
            array[...] = part
        else:
            array.reshape(part.shape)[...] = part


def _transform(
    tile: Sequence[NDArray[Any]],
    target_from_source: Transform,
    into: Sequence[NDArray[np.float32]],
    doubles: Sequence[NDArray[np.float64]],
) -> None:
    """Copy coordinates, transformed. Written out: a matrix product may sum in any order."""
    rotation, translation = target_from_source
    total, product, *source = doubles
    _copy(tile, source)
    for row, offset, array in zip(rotation, translation, into, strict=True):
        np.multiply(source[0], row[0], out=total)
        total += np.multiply(source[1], row[1], out=product)
        total += np.multiply(source[2], row[2], out=product)
        total += offset
        np.copyto(array, total, casting="same_kind")


def _has_long_runs(slots: NDArray[np.intp]) -> bool:
    """Whether neighbours mostly share a beam, as in clouds that are stored column by column."""
    probe = slots[:_PROBE]
    return slots.size >= 4 * _PROBE and int(np.count_nonzero(probe[1:] != probe[:-1])) * _LONG_RUN < _PROBE
