"""Projects points to ranges: bit by bit as pointcloud_to_laserscan does, and with pc2scan's own parameters.

Source of the rule: ``cloudCb`` in pointcloud_to_laserscan_node.cpp. A point is dropped if, in this order,

1. x, y or z is NaN;
2. z is above ``max_height`` or below ``min_height``;
3. its range, float32 hypot(x, y), is below ``range_min`` or above ``range_max``;
4. its angle, float32 atan2(y, x), is outside of the sector;
5. its angle is after the last beam, where upstream writes past its array (see `upstream_beams`).

A beam reads the smallest range of its other points. Heights and ranges are compared as float64. Points are
dropped for the same reasons, in the same order, with every geometry and every ``reduce``.

A point is a return of its beam only if its range is below that of a beam without a return: upstream initialises its
beams with that range. It excludes points if ``inf_epsilon`` is 0 or negative, and infinite ranges. This, too, is so
with every ``reduce``, with intensities and without.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from pc2scan.errors import ParameterError

from . import kernel
from .params import ProjectionParams
from .points import Columns, coordinates_of, values_of
from .reduce import extremes, means, read, surfaces, winners
from .rule import PointCounts, rule_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from .rigid import MovingTransform

#: The rows of a rotation, then a translation, (4, 3): ``target = rotation @ source + translation``; see
#: `pc2scan.core.rigid.Rigid.as_float32`.
Transform: TypeAlias = "NDArray[np.float32]"

#: sensor_msgs/PointField's datatypes, in either byte order; NumPy's other types are converted first.
_READ_AS_IS = {"i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"}

_FLOAT32 = np.dtype(np.float32)


_NO_VALUES = np.empty(0, np.float32)


# Instances are never changed. They are not frozen, because creating a frozen one takes three times as long.
@dataclass(slots=True, eq=False)
class ProjectedScan:
    """The projection of a cloud.

    Attributes
    ----------
    ranges
        (N,) float32, metres: the range of each beam, ``params.empty_range`` without a return.
    counts
        How many points are used and rejected.
    intensities
        (N,) float32, 0 without a return; (0,) if no intensities were requested.
    removed
        How many beams have ``returns``, and how many of these are ``sparse``: they have no range, because they have
        fewer returns than ``params.min_points`` or ``params.kth``. None if these are 1 or 0.
    """

    ranges: NDArray[np.float32]
    counts: PointCounts
    intensities: NDArray[np.float32]
    removed: dict[str, int] | None = None


class PointsPart(NamedTuple):
    """Points that are projected together with others: see `Projector.together`.

    Attributes
    ----------
    x, y, z, intensities
        As for `Projector`.
    target_from_source
        The transform of all points, or a transform for each point's time.
    any_height
        Whether heights are not compared, as for the beams of a scan, which have no height.
    """

    x: NDArray[Any]
    y: NDArray[Any]
    z: NDArray[Any]
    target_from_source: Transform | MovingTransform | None = None
    intensities: NDArray[Any] | None = None
    any_height: bool = False


class Projector:
    """The projection with given parameters. Threads may share one.

    Parameters
    ----------
    params
        The projection's parameters; the caller handles ``target_frame``.

    Attributes
    ----------
    reads_nearest
        Whether beams read the closest return, so that the scan of several parts is the minimum of their scans.
    """

    __slots__ = ("_beams", "_empty", "_is_limited", "_limit", "_rule", "_rule_of_any_height", "params", "reads_nearest")

    def __init__(self, params: ProjectionParams) -> None:
        if params.beams == "auto":
            raise ParameterError(
                "beams is auto, which is measured in the clouds of a recording; a single cloud needs a number",
                name="beams",
                hint="`beams=720`, or `ProjectionParams.at_resolution`",
            )
        self.params = params
        self.reads_nearest = params.reduce == "min" and params.min_points == 1
        self._rule = rule_of(params)
        self._rule_of_any_height = np.concatenate([[-math.inf, math.inf], self._rule[2:]])
        self._beams = params.length
        self._empty = params.empty_range
        # What the range of a return must be below. Upstream's beams begin with the range of no return.
        self._limit = self._empty if params.no_return in {"", "inf", "range-max-plus"} else math.inf
        # Whether ranges up to range_max may not be below it.
        self._is_limited = not self._limit > params.range_max

    def together(self, parts: Sequence[PointsPart]) -> ProjectedScan:
        """Project the points of several messages to one scan.

        The scan equals that of one cloud with all points, transformed before, in the order of the parts.

        Parameters
        ----------
        parts
            The parts. If only some have intensities, those of the others are 0.

        Returns
        -------
        ProjectedScan
            As for one cloud.
        """
        lit = any(part.intensities is not None for part in parts)
        total = sum(part.x.size for part in parts)
        if self.reads_nearest and not lit:
            return self.nearest_of([self.nearest(part) for part in parts])
        counts, begin = PointCounts(), 0
        bins, returns = np.empty(total, np.int32), np.empty(total, np.float32)
        values: list[NDArray[Any]] = []
        for part in parts:
            numbers = np.empty(part.x.size, np.int64)
            places = slice(begin, begin + part.x.size)
            own_counts, used = self._gather(part, bins[places], returns[places], numbers)
            counts += own_counts
            if lit:
                own = part.intensities
                values.append(np.zeros(used) if own is None else own.reshape(-1)[numbers[:used]])
            # The next part's returns follow directly.
            begin += used
        with np.errstate(all="ignore"):
            both = np.concatenate(values) if lit else None
            return self._reduce(bins[:begin], returns[:begin], both, counts)

    def nearest(self, part: PointsPart) -> ProjectedScan:
        """Project a part for `nearest_of`: beams without a return read infinity; intensities are ignored."""
        arrays, ranges = _coordinates(part.x, part.y, part.z, part.intensities), np.empty(self._beams, _FLOAT32)
        transform = part.target_from_source
        rejected = kernel.project(*arrays, self._rule_for(part), transform, ranges, self._limit, math.inf)
        return ProjectedScan(ranges, PointCounts.of_projection(part.x.size, rejected), _NO_VALUES)

    def nearest_of(self, scans: Sequence[ProjectedScan]) -> ProjectedScan:
        """Return the scan of several parts, the same as `together`, if beams read the closest return."""
        ranges = np.full(self._beams, np.inf, np.float32)
        counts = scans[0].counts if scans else PointCounts()
        for scan in scans[1:]:
            counts += scan.counts
        for scan in scans:
            np.minimum(ranges, scan.ranges, out=ranges)
        ranges[np.isinf(ranges)] = self._empty
        return ProjectedScan(ranges, counts, _NO_VALUES)

    def _gather_parts(
        self, part: PointsPart
    ) -> tuple[PointCounts, NDArray[np.int32], NDArray[np.float32], NDArray[np.int64]]:
        """Return the counts of a part, and the beam, range and point number of each return, in the points' order."""
        count = part.x.size
        bins, returns, numbers = np.empty(count, np.int32), np.empty(count, np.float32), np.empty(count, np.int64)
        counts, used = self._gather(part, bins, returns, numbers)
        return counts, bins[:used], returns[:used], numbers[:used]

    def _gather(
        self, part: PointsPart, bins: NDArray[np.int32], returns: NDArray[np.float32], numbers: NDArray[np.int64]
    ) -> tuple[PointCounts, int]:
        """Overwrite the beginning of arrays with a part's returns; return its counts, and how many returns it has."""
        arrays = _coordinates(part.x, part.y, part.z, part.intensities)
        transform = part.target_from_source
        rejected = kernel.gather(*arrays, self._rule_for(part), transform, self._beams, bins, returns, numbers)
        counts = PointCounts.of_projection(part.x.size, rejected)
        used = counts.used
        if self._is_limited:
            near = np.flatnonzero(returns[:used] < self._limit)
            used = near.size
            bins[:used], returns[:used], numbers[:used] = bins[near], returns[near], numbers[near]
        return counts, used

    def _rule_for(self, part: PointsPart) -> NDArray[np.float64]:
        return self._rule_of_any_height if part.any_height else self._rule

    def __call__(
        self,
        x: NDArray[Any],
        y: NDArray[Any],
        z: NDArray[Any],
        target_from_source: Transform | MovingTransform | None = None,
        intensities: NDArray[Any] | None = None,
    ) -> ProjectedScan:
        """Project a cloud.

        Parameters
        ----------
        x, y, z
            Coordinates in metres, of one shape, (M,) or (H, W): integers or floats of any size, byte order,
            alignment and strides. They are rounded to float32.
        target_from_source
            A transform to apply to the rounded coordinates, in float32: every product and every sum is rounded,
            from left to right, as tf2_sensor_msgs does. See `Rigid.as_float32`. Or the transforms of points that move,
            each at its own time; the counts then also have ``no_time`` and ``no_transform``.
        intensities
            A value for every point, of the same shape and any real type; None: the scan has no intensities.

        Returns
        -------
        ProjectedScan
            Its arrays are new. Infinite coordinates are rejected only by the limits.

        Raises
        ------
        ValueError
            If the shapes differ, or have not one or two dimensions.
        """
        if self.reads_nearest and intensities is None:
            arrays, ranges = _coordinates(x, y, z, None), np.empty(self._beams, _FLOAT32)
            rejected = kernel.project(*arrays, self._rule, target_from_source, ranges, self._limit, self._empty)
            return ProjectedScan(ranges, PointCounts.of_projection(x.size, rejected), _NO_VALUES)
        counts, bins, returns, numbers = self._gather_parts(PointsPart(x, y, z, target_from_source, intensities))
        values = None if intensities is None else intensities.reshape(-1)[numbers]
        with np.errstate(all="ignore"):
            return self._reduce(bins, returns, values, counts)

    def read(
        self,
        x: NDArray[Any],
        y: NDArray[Any],
        z: NDArray[Any],
        target_from_source: Transform | MovingTransform | None = None,
    ) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """Return which points the beams read: a cloud of only these points gives the same scan, to the bit.

        Parameters
        ----------
        x, y, z, target_from_source
            As for `__call__`.

        Returns
        -------
        (K,) int64, (K,) int32
            The numbers of points, increasing, and the beam of each. See `pc2scan.core.reduce.read`.
        """
        _, bins, returns, numbers = self._gather_parts(PointsPart(x, y, z, target_from_source))
        with np.errstate(all="ignore"):
            chosen = read(bins, returns, self._beams, self.params)
        return numbers[chosen], bins[chosen]

    def _reduce(
        self, bins: NDArray[np.int32], returns: NDArray[np.float32], values: NDArray[Any] | None, points: PointCounts
    ) -> ProjectedScan:
        """Return the scan of returns in the order of the cloud, with intensities if there are values."""
        params = self.params
        counts = np.bincount(bins, minlength=self._beams)
        ranges = np.full(counts.size, self._empty, np.float32)
        lit = np.zeros(0 if values is None else counts.size, np.float32)
        seen = counts >= max(params.min_points, params.kth)
        removed = None
        if max(params.min_points, params.kth) > 1:
            every = int(np.count_nonzero(counts))
            removed = {"returns": every, "sparse": every - int(np.count_nonzero(seen))}
        if params.reduce == "mean":
            ranges[seen] = means(bins, returns, counts)[seen]
            if values is not None:
                lit[seen] = means(bins, values, counts)[seen]
        elif values is None and params.reduce in {"min", "max"}:
            ranges[seen] = extremes(bins, returns, counts.size, largest=params.reduce == "max")[seen]
        elif params.reduce == "surface":
            winner = surfaces(bins, returns, counts.size, params.layout.angle_increment)[seen]
            ranges[seen] = returns[winner]
            if values is not None:
                lit[seen] = values[winner]
        else:
            winner = winners(bins, returns, counts, params.reduce, params.kth)[seen]
            ranges[seen] = returns[winner]
            if values is not None:
                lit[seen] = values[winner]
        return ProjectedScan(ranges, points, lit, removed)


def _coordinates(
    x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], intensities: NDArray[Any] | None
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return coordinates as the loops over points read them."""
    shape = x.shape
    if not (shape == y.shape == z.shape and 1 <= len(shape) <= 2):
        raise ValueError(f"x, y and z have the shapes {shape}, {y.shape}, {z.shape}, expected one of (M,) or (H, W)")
    if intensities is not None and intensities.shape != shape:
        raise ValueError(f"intensities have the shape {intensities.shape}, expected that of x, {shape}")
    usual = x.dtype == y.dtype == z.dtype == _FLOAT32
    if not usual and not all(array.dtype.str[1:] in _READ_AS_IS for array in (x, y, z)):
        with np.errstate(over="ignore"):
            x, y, z = (array.astype(np.float32) for array in (x, y, z))
    return x, y, z


def contiguous(x: NDArray[Any], y: NDArray[Any], z: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return copies of coordinates, each (M,), in the layout that the loops over points read fastest.

    If float32 x, y and z follow each other in memory, as in nearly all messages, they are copied together, which takes
    a third of the time.
    """
    interface = x.__array_interface__
    place = interface["data"][0]
    if (
        x.dtype == y.dtype == z.dtype == _FLOAT32
        and x.dtype.isnative
        and x.shape == y.shape == z.shape
        and x.strides == y.strides == z.strides
        and (y.__array_interface__["data"][0], z.__array_interface__["data"][0]) == (place + 4, place + 8)
    ):
        rows = np.asarray(_PackedPoints(interface, x, z)).copy().reshape(-1).view(np.float32).reshape(-1, 3)
        return rows[:, 0], rows[:, 1], rows[:, 2]
    return np.array(x).reshape(-1), np.array(y).reshape(-1), np.array(z).reshape(-1)


class _PackedPoints:
    """Memory of points as items of twelve bytes: x, y and z."""

    def __init__(self, interface: dict[str, Any], *owners: NDArray[Any]) -> None:
        row = {"typestr": "|V12", "descr": [("", "|V12")], "shape": interface["shape"], "version": 3}
        self.__array_interface__ = row | {"data": interface["data"], "strides": interface["strides"]}
        self._owners = owners


def project(
    points: ArrayLike | Columns,
    params: ProjectionParams | None = None,
    *,
    intensities: ArrayLike | None = None,
) -> ProjectedScan:
    """Project a cloud to a scan, as pointcloud_to_laserscan does unless the parameters say otherwise.

    Parameters
    ----------
    points
        (M, 3) or (H, W, 3), integers or floats: x, y and z in metres, in the scan's frame. Or a structured array
        or a mapping with x, y and z, such as a `pc2scan.Cloud`, each (M,) or (H, W). They are rounded to float32, as
        upstream reads them. Points with NaN, and masked points, are dropped; infinite coordinates are rejected only
        by the limits.
    params
        The projection's parameters, upstream's defaults if None. Those **drop everything at or below z = 0**.
    intensities
        (M,) or (H, W) real numbers, one for each point: the scan gets those of the points that its beams read, NaN
        where they are masked. None: the scan has none, whatever ``params.intensity_field`` says.

    Returns
    -------
    ProjectedScan
        The range of each beam, and how many points are used and rejected.

    Raises
    ------
    ValueError
        If ``points`` or ``intensities`` have another shape, or x, y or z is missing.
    TypeError
        If ``points`` or ``intensities`` are not real numbers, or ``params`` are something else.

    Examples
    --------
    >>> from pc2scan import ProjectionParams, project
    >>> scan = project([[2.0, 0.1, 0.3], [1.0, 0.1, 0.9]], ProjectionParams(max_height=0.5))
    >>> float(scan.ranges.min()), scan.counts.used, scan.counts.height
    (2.0024983882904053, 1, 1)
    """
    if not (params is None or isinstance(params, ProjectionParams)):
        raise TypeError(f"params is {type(params).__name__}, it must be ProjectionParams")
    x, y, z = coordinates_of(points)
    values = None if intensities is None else values_of(intensities)
    return Projector(params or ProjectionParams())(x, y, z, intensities=values)
