"""Measures the azimuth resolution of a lidar: the step between neighbouring points of one ring."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .percentiles import median

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Fields in which drivers store the number of a point's laser; the first one that a cloud has is used: Velodyne's,
#: Ouster's, Hesai's and RoboSense's ``ring``, Autoware's ``channel``, Luminar's ``laser_id``.
RING_FIELDS = ("ring", "channel", "laser_id")

#: Azimuths that are closer than this, radians, are one direction: two returns of one shot. No lidar has a finer step.
_SAME = 5e-5

#: Elevations of neighbouring points that differ by less than this, radians, are one ring.
_ONE_RING = 1e-4

#: Rings with fewer points than this, or than half of the fullest ring's, are ignored.
_FEW = 16

#: Steps within this share of the median are regular ...
_NEAR = 0.25

#: ... and this share of all steps must be regular; otherwise there are no rings, as for a risley prism or several
#: lidars.
_REGULAR = 0.5

#: The largest step of a lidar, radians: 10 degrees.
_COARSE = 0.1745


def azimuth_step(
    x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], rings: NDArray[np.integer[Any]] | None = None
) -> float | None:
    """Measure the azimuth resolution of a cloud.

    Parameters
    ----------
    x, y, z
        Coordinates around the sensor, metres, of one shape, (M,) or (H, W). NaN and (0, 0, 0) are no returns.
    rings
        The number of each point's laser, of the same size; None: rings are the rows or the columns of an organised
        cloud, or else are found by the elevations of the points.

    Returns
    -------
    float
        Radians: the median step between neighbours of one ring. None if the points are not in regular rings.
    """
    points = np.stack([np.ravel(part).astype(np.float64) for part in (x, y, z)])
    returned = np.isfinite(points).all(axis=0) & points.any(axis=0)
    points = points[:, returned]
    ahead, left, up = points
    if rings is not None:
        return _regular_step(np.ravel(rings)[returned], np.arctan2(left, ahead))
    elevations = np.arctan2(up, np.hypot(ahead, left))
    if len(x.shape) == 2 and min(x.shape) > 1:
        places = (np.ravel(index)[returned] for index in np.indices(x.shape, np.int32))
        # A ring has one elevation: drivers put rings into rows, or into columns.
        numbers: NDArray[Any] = min(places, key=lambda lines: _spread(lines, elevations))
    else:
        numbers = _levels(elevations)
    return _regular_step(numbers, np.arctan2(left, ahead))


def _spread(lines: NDArray[Any], elevations: NDArray[np.float64]) -> float:
    """Return the mean square of elevations' distances from the mean of their line."""
    counts = np.maximum(np.bincount(lines), 1)
    means = np.bincount(lines, elevations) / counts
    return float(np.square(elevations - means[lines]).sum())


def _levels(elevations: NDArray[np.float64]) -> NDArray[np.intp]:
    """Number the elevations, so that those without a gap between them have the same number."""
    order = np.argsort(elevations, kind="stable")
    numbers = np.zeros(order.size, np.intp)
    numbers[order[1:]] = np.cumsum(np.diff(elevations[order]) > _ONE_RING)
    return numbers


def _regular_step(rings: NDArray[Any], azimuths: NDArray[np.float64]) -> float | None:
    """Return the median step between the azimuths of a ring; None if the steps are not regular."""
    order = np.lexsort((azimuths, rings))
    rings, azimuths = rings[order], azimuths[order]
    begins = np.flatnonzero(np.r_[True, rings[1:] != rings[:-1]]) if rings.size else np.empty(0, np.intp)
    counts = np.diff(np.r_[begins, rings.size])
    if not counts.size or counts.max() < _FEW:
        return None
    full = np.repeat(counts >= max(_FEW, counts.max() / 2), counts)
    steps = np.diff(azimuths)[full[1:] & (rings[1:] == rings[:-1])]
    steps = steps[steps > _SAME]
    if steps.size < _FEW - 1:
        return None
    middle = median(steps)
    near = steps[np.abs(steps - middle) <= _NEAR * middle]
    if middle > _COARSE or near.size < _REGULAR * steps.size:
        return None
    return float(near.mean())
