"""Points to ranges: the projection of pointcloud_to_laserscan, to the bit, and where every point went.

Source of the rule: ``cloudCb`` in pointcloud_to_laserscan_node.cpp. A point is dropped if, in this order,

1. x, y or z is NaN;
2. z is above ``max_height`` or below ``min_height``;
3. its range, float32 hypot(x, y), is below ``range_min`` or above ``range_max``;
4. its angle, float32 atan2(y, x), is outside the sector;
5. its angle is behind the last beam, where upstream writes past its array (see `pc2scan.core.grid`).

The others lower the range of their beam to their own. Heights and ranges are compared as float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from . import kernel
from .params import ProjectionParams, float32

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["PointCounts", "ProjectedScan", "Projector", "project"]

#: Rotation (3, 3) and translation (3,), float64: ``target = rotation @ source + translation``.
Transform: TypeAlias = "tuple[NDArray[np.float64], NDArray[np.float64]]"


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

    __slots__ = ("_limits", "params")

    def __init__(self, params: ProjectionParams) -> None:
        self.params = params
        self._limits = _limits(params)

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
            alignment and strides. They are rounded to float32.
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
        # What is rounded to float32 first, and what only after the transform, decides about the last bit.
        wanted = np.dtype(np.float32 if target_from_source is None else np.float64)
        if not x.dtype == y.dtype == z.dtype or x.dtype not in {np.dtype(np.float32), np.dtype(np.float64)}:
            with np.errstate(over="ignore"):
                x, y, z = (array.astype(wanted) for array in (x, y, z))
        moved = None
        if target_from_source is not None:
            moved = np.concatenate([part.ravel() for part in target_from_source], dtype=np.float64)
        params = self.params
        ranges = np.empty(params.length, np.float32)
        nan, height, far, angle, past_end = kernel.project(x, y, z, self._limits, moved, ranges, params.empty_range)
        used = x.size - nan - height - far - angle - past_end
        return ProjectedScan(ranges, PointCounts(x.size, used, nan, height, far, angle, past_end))


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


def _limits(params: ProjectionParams) -> NDArray[np.float64]:
    """What the coordinates are compared with, (7,), as `kernel.project` takes it.

    A float32 is within float64 limits exactly if it is within the float32 next to them on the inner side, for
    there is none in between. And a range, the root of a square rounded twice, does not fall when the square
    grows: there is a smallest square whose range reaches ``range_min``, and a largest one that stays within
    ``range_max``.
    """
    most = math.inf
    if params.range_max < math.inf:
        with np.errstate(over="ignore"):
            beyond = np.nextafter(-_first_from(-params.range_max), np.float32(np.inf))
        most = math.nextafter(_first_square(beyond), -math.inf)
    return np.array(
        [
            _first_from(params.min_height),
            -_first_from(-params.max_height),
            _first_square(_first_from(params.range_min)),
            most,
            float32(params.angle_min),
            float32(params.angle_max),
            float32(params.angle_increment),
        ]
    )


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
