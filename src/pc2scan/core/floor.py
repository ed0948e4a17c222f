"""Samples of clouds, and the obvious floor at right angles to z in them: the most frequent case, in a millisecond.

It needs neither RANSAC nor linear algebra, and imports nothing; `pc2scan.core.ground` handles all other cases.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .points import Points
    from .rigid import Rigid

_Points: TypeAlias = "NDArray[np.float64]"

#: How many clouds of a topic are judged if the first one has no level floor, how many points of each are sampled, and
#: with how many a cloud is not judged.
JUDGED_CLOUDS = 3
MOST_POINTS = 2_000
FEWEST_POINTS = 300

#: A frame with at most this tilt counts as level, radians: roads and yards are not flatter, and robots pitch.
LEVEL = math.radians(5.0)

#: A transform is wrong if it tilts by more than this, radians, a floor that is level without it, up to this share of
#: the tilt. Floors of simulated lidars are off by 0.1 degrees (median), and by 0.4 (95 %).
_LEAST_TILT = math.radians(0.9)
_LEVEL_BESIDE = 0.3

#: Points with a larger median distance, metres, are in another unit: lidars do not see as far.
FARTHEST_MEDIAN = 400.0

#: The golden ratio's inverse.
GOLDEN = 0.6180339887498949

#: The conditions of a floor: the least share of the cells on it, the largest share below it, and metres below the
#: sensor.
_LEAST_SHARE = 0.15
_MOST_BELOW = 0.05
_LEAST_HEIGHT = 0.03


class Floor(NamedTuple):
    """A level floor.

    Attributes
    ----------
    up
        Its normal, upwards.
    height
        The height of the sensor above it, metres.
    above
        How far the points above the sensor reach, metres; negative if there are none. If that is less than the height,
        the floor may be a ceiling, and the sensor upside down.
    """

    up: tuple[float, float, float]
    height: float
    above: float


@dataclass(frozen=True)
class CloudSample:
    """Some points of a cloud, relative to the sensor along the axes of the frame in which it is judged.

    Attributes
    ----------
    frame_id, stamp_ns
        Of the cloud.
    judged_in
        The frame of its scan.
    points
        The result of `thin_points`, metres.
    transform
        The transform to that frame; None if it is the cloud's own.
    zeros
        How many points of the whole cloud are at the sensor itself.
    distance
        The median distance of the points, metres; 0 if there are too few.
    lossy
        See `pc2scan.core.points.Points`.
    """

    frame_id: str
    stamp_ns: int
    judged_in: str
    points: _Points
    transform: Rigid | None = None
    zeros: int = 0
    distance: float = 0.0
    lossy: str = ""

    @classmethod
    def of(cls, cloud: Points) -> CloudSample:
        """Return a sample of a cloud, which is judged in its own frame."""
        x, y, z = cloud.xyz()
        with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
            zeros = int(np.count_nonzero((x == 0) & (y == 0) & (z == 0)))
        points = thin_points(x, y, z)
        distance = _median_distance(points) if len(points) >= FEWEST_POINTS else 0.0
        header = cloud.frame_id, cloud.stamp_ns, cloud.frame_id
        return cls(*header, points, zeros=zeros, distance=distance, lossy=cloud.lossy)

    def placed_in(self, frame: str, transform: Rigid | None) -> CloudSample:
        """Return the sample in another frame, in which it is judged; without a transform, only the name differs."""
        if transform is None:
            return replace(self, judged_in=frame)
        return replace(self, judged_in=frame, points=transform.rotation.apply(self.points), transform=transform)

    @property
    def origin(self) -> tuple[float, float, float]:
        """The position of the sensor in the frame in which it is judged, metres."""
        if self.transform is None:
            return (0.0, 0.0, 0.0)
        x, y, z = self.transform.translation.tolist()
        return x, y, z

    @property
    def placed(self) -> _Points:
        """The points in the frame in which it is judged."""
        return np.asarray(self.points + self.origin)

    @cached_property
    def floor_tilted_by_transform(self) -> Floor | None:
        """The floor in the frame in which it is judged, if the transform tilts it, and the cloud's own frame does not.

        None if the floor is not level in the cloud's own frame: then the sensor is tilted, or the robot. None, too, if
        it seems level in both, as parts of floors do.
        """
        if self.transform is None or len(self.points) < FEWEST_POINTS:
            return None
        matrix = self.transform.matrix
        turned = _angle(matrix[2, 2])
        if turned <= _LEAST_TILT:
            return None
        own, here = level_floor(cells_of(self.points @ matrix)), self.floor
        if own is None or _angle(own.up[2]) > _LEVEL_BESIDE * turned:
            return None
        if here is not None and _angle(here.up[2]) < _LEVEL_BESIDE * turned:
            return None
        x, y, z = (matrix @ np.array(own.up)).tolist()
        return Floor((x, y, z), own.height, own.above) if abs(_angle(z) - turned) < _LEVEL_BESIDE * turned else None

    @cached_property
    def floor(self) -> Floor | None:
        """The level floor; None if there is none, or if the cloud is too small."""
        return level_floor(cells_of(self.points)) if len(self.points) >= FEWEST_POINTS else None


def are_far(points: _Points) -> bool:
    """Return whether points are so far away that they are in another unit than metres."""
    return len(points) >= FEWEST_POINTS and _median_distance(points) > FARTHEST_MEDIAN


def _angle(cosine: float) -> float:
    return math.acos(max(-1.0, min(1.0, float(cosine))))


def are_enough(samples: Sequence[CloudSample]) -> bool:
    """Return whether the first clouds show how a sensor is mounted: one with a level floor, or `JUDGED_CLOUDS`."""
    return len(samples) >= JUDGED_CLOUDS or (len(samples) > 0 and samples[0].floor is not None)


def thin_points(x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], most: int = MOST_POINTS) -> _Points:
    """Return a sample of a cloud's returns, (N, 3), spread over the cloud whatever its order.

    Parameters
    ----------
    x, y, z
        Coordinates, one a point, of any shape.
    most
        How many points to sample; the result has fewer, because points without a return are removed.
    """
    count = x.size
    # Multiples of the golden ratio never coincide with rings or columns.
    order = np.arange(count) if count <= most else (np.arange(most) * GOLDEN % 1.0 * count).astype(np.intp)
    with np.errstate(all="ignore"):
        # Without a copy of an organised cloud, whose rows may be padded.
        places = np.unravel_index(order, x.shape)
        points = np.stack([np.asarray(part[places], np.float64) for part in (x, y, z)], axis=1)
        # The nearest points are the robot itself, or no returns.
        good = (np.abs(points).max(axis=1, initial=0) < 1e4) & ((points * points).sum(axis=1) > 0.0025)
    return np.asarray(points[good])


def cells_of(points: _Points) -> _Points:
    """Return one point per cell, sorted by place: a spinning lidar measures near objects a hundred times as densely."""
    # Twenty-one bits for each coordinate: cells are at least 1 cm, and points are within 10 km.
    keys = np.floor(points / min(0.3, max(0.01, 0.05 * _median_distance(points)))).astype(np.int64) + (1 << 20)
    _, first = np.unique(keys[:, 0] << 42 | keys[:, 1] << 21 | keys[:, 2], return_index=True)
    return points[first]


def tolerances(points: _Points) -> NDArray[np.float64]:
    """Return how far from a plane its points may be, metres: noise, roughness, and a part that grows with distance."""
    return np.asarray(
        min(0.05, max(0.01, 0.02 * _median_distance(points))) + 0.008 * np.sqrt((points * points).sum(axis=1))
    )


def _median_distance(points: _Points) -> float:
    """Return the median distance."""
    squares = np.sort((points * points).sum(axis=1))
    return math.sqrt(float(squares[len(squares) // 2]))


def level_floor(cells: _Points) -> Floor | None:
    """Return the level floor of a cloud; None if there is none, or if this method cannot find it.

    Parameters
    ----------
    cells
        The result of `cells_of`, some hundred at least.
    """
    below = np.sort(cells[cells[:, 2] < 0, 2])
    if len(below) < 0.1 * len(cells):
        return None
    tolerance = tolerances(cells)
    low = float(below[len(below) // 50])
    if -low < _LEAST_HEIGHT:
        return None
    bins = 24
    width = -low / bins
    peak = int(np.bincount(np.clip((below - low) / width, 0, bins - 1).astype(np.intp)).argmax())
    inliers = np.abs(cells[:, 2] - (low + (peak + 0.5) * width)) < tolerance + width / 2
    slope = (0.0, 0.0, 0.0)
    distance = np.zeros(len(cells))
    for _ in range(4):
        members = cells[inliers]
        found = _fit_plane(members, 1 / tolerance[inliers] ** 2) if len(members) >= 10 else None
        if found is None:
            return None
        slope = found
        distance = cells[:, 2] - cells[:, 0] * slope[0] - cells[:, 1] * slope[1] - slope[2]
        inliers = np.abs(distance) < tolerance
    length = math.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    height = -slope[2] / length
    if length > 1 / math.cos(LEVEL) or height < _LEAST_HEIGHT:
        return None
    if inliers.mean() < _LEAST_SHARE or (distance < -2.5 * tolerance).mean() > _MOST_BELOW:
        return None
    above = float(np.sort(cells[:, 2])[-1 - len(cells) // 100])
    return Floor((-slope[0] / length, -slope[1] / length, 1 / length), height, above)


def _fit_plane(points: _Points, weights: NDArray[np.float64]) -> tuple[float, float, float] | None:
    """Return the least-squares plane z = a x + b y + c; None if the points are on a line."""
    middle = (weights[:, None] * points).sum(axis=0) / weights.sum()
    x, y, z = (points - middle).T
    xx, xy, yy = float((weights * x * x).sum()), float((weights * x * y).sum()), float((weights * y * y).sum())
    xz, yz = float((weights * x * z).sum()), float((weights * y * z).sum())
    determinant = xx * yy - xy * xy
    if not determinant > 1e-9 * xx * yy:
        return None
    a, b = (xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant
    return a, b, float(middle[2] - a * middle[0] - b * middle[1])
