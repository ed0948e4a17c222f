"""A floor at right angles to z, where it catches the eye: by far the most frequent case, found in a millisecond.

It needs neither RANSAC nor linear algebra, and loads nothing; `pc2scan.core.ground` does what it leaves open.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["LEVEL", "MOST_POINTS", "Floor", "cells_of", "level_floor", "thinned", "tolerances"]

_Points: TypeAlias = "NDArray[np.float64]"

#: Points of a cloud that are looked at.
MOST_POINTS = 4_000

#: Up to here a frame counts as level, radians. Roads and yards are no flatter, and robots pitch.
LEVEL = math.radians(5.0)

_GOLDEN = 0.6180339887498949

#: What a floor needs: this share of the cells at least, and at most this share below it; metres below the sensor.
_LEAST_SHARE = 0.15
_MOST_BELOW = 0.05
_LEAST_HEIGHT = 0.03


class Floor(NamedTuple):
    """A level floor: its normal, upwards, and how far the sensor is above it, metres."""

    up: tuple[float, float, float]
    height: float


def thinned(x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], most: int = MOST_POINTS) -> _Points:
    """Some of a cloud's returns, (N, 3): spread over it whatever its order, without those that are no return.

    Parameters
    ----------
    x, y, z
        Coordinates, one a point, of any shape.
    most
        Points to take; returns are fewer where some of these are none.
    """
    count = x.size
    # Multiples of the golden ratio fall into no step with rings or columns.
    order = np.arange(count) if count <= most else (np.arange(most) * _GOLDEN % 1.0 * count).astype(np.intp)
    with np.errstate(all="ignore"):
        points = np.stack([_picked(part, order) for part in (x, y, z)], axis=1)
        # The nearest are the robot itself, or no return at all.
        good = (np.abs(points).max(axis=1, initial=0) < 1e4) & ((points * points).sum(axis=1) > 0.0025)
    return np.asarray(points[good])


def _picked(values: NDArray[Any], order: NDArray[np.intp]) -> NDArray[np.float64]:
    if values.ndim == 1:
        return np.asarray(values[order], np.float64)
    return np.asarray(values[np.unravel_index(order, values.shape)], np.float64)


def cells_of(points: _Points) -> _Points:
    """One point a cell, sorted by place: a spinning lidar measures what is near a hundred times as densely."""
    # Twenty-one bits for each coordinate: cells are never below 1 cm, and points lie within 10 km.
    keys = np.floor(points / min(0.3, max(0.01, 0.05 * _middle(points)))).astype(np.int64) + (1 << 20)
    _, first = np.unique(keys[:, 0] << 42 | keys[:, 1] << 21 | keys[:, 2], return_index=True)
    return points[first]


def tolerances(points: _Points) -> NDArray[np.float64]:
    """How far from a plane its points may lie, metres: noise and roughness, and what grows with the distance."""
    return np.asarray(min(0.05, max(0.01, 0.02 * _middle(points))) + 0.008 * np.sqrt((points * points).sum(axis=1)))


def _middle(points: _Points) -> float:
    """The median distance."""
    squares = np.sort((points * points).sum(axis=1))
    return math.sqrt(float(squares[len(squares) // 2]))


def level_floor(cells: _Points) -> Floor | None:
    """The level floor of a cloud; None if there is none, or it takes more to find it.

    Parameters
    ----------
    cells
        What `cells_of` returns, some hundred at least.
    """
    below = np.sort(cells[cells[:, 2] < 0, 2])
    if len(below) < 0.1 * len(cells):
        return None
    tolerance = tolerances(cells)
    low = float(below[len(below) // 50])
    bins = 24
    width = max(-low, 1e-6) / bins
    peak = int(np.bincount(np.clip((below - low) / width, 0, bins - 1).astype(np.intp)).argmax())
    inliers = np.abs(cells[:, 2] - (low + (peak + 0.5) * width)) < tolerance + width / 2
    slope = (0.0, 0.0, 0.0)
    distance = np.zeros(len(cells))
    for _ in range(4):
        members = cells[inliers]
        found = _fitted(members, 1 / tolerance[inliers] ** 2) if len(members) >= 10 else None
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
    return Floor((-slope[0] / length, -slope[1] / length, 1 / length), height)


def _fitted(points: _Points, weights: NDArray[np.float64]) -> tuple[float, float, float] | None:
    """The plane z = a x + b y + c of least squares; None where the points are on a line."""
    middle = (weights[:, None] * points).sum(axis=0) / weights.sum()
    x, y, z = (points - middle).T
    xx, xy, yy = float((weights * x * x).sum()), float((weights * x * y).sum()), float((weights * y * y).sum())
    xz, yz = float((weights * x * z).sum()), float((weights * y * z).sum())
    determinant = xx * yy - xy * xy
    if not determinant > 1e-9 * xx * yy:
        return None
    a, b = (xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant
    return a, b, float(middle[2] - a * middle[0] - b * middle[1])
