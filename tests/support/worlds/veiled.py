"""Simulated clouds with mixed pixels and dust, of which each point is known to be a return of a surface or not.

The lidar's beams have a width. Where one hits an edge and what is behind it, it measures the mean of both distances,
weighted by area: a mixed pixel. All surfaces are vertical, so a world is a plan: segments, seen from the origin.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.project import Projector

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.core.params import ProjectionParams

__all__ = ["LIDARS", "PLANS", "Kind", "Scan", "Veiled", "scan_of", "veiled"]

#: The full width of a beam, radians, and the parts that it is divided into.
_WIDTH = 0.003
_PARTS = 9
#: A mean that is this far from every surface which the beam hits is a mixed pixel, metres.
_APART = 0.1
#: The share of points that are dust.
_DUST = 0.002

Segment = tuple[float, float, float, float]


class Kind:
    """What a point is a return of."""

    WALL, POST, MIXED, DUST = range(4)


class Plan(NamedTuple):
    """Segments of walls and of objects, and posts of 5 cm."""

    walls: tuple[Segment, ...]
    posts: tuple[Segment, ...] = ()


class Lidar(NamedTuple):
    """The elevations of the rings, degrees, and how many times each of them measures in a turn."""

    elevations: tuple[float, ...]
    columns: int


class Veiled(NamedTuple):
    """A cloud: (N, 3) points, and the kind of each."""

    points: NDArray[np.float32]
    kinds: NDArray[np.int64]


class Scan(NamedTuple):
    """Ranges of the beams, and the kind of the point that each reads; -1 without a return."""

    ranges: NDArray[np.float32]
    kinds: NDArray[np.int64]


def _box(x0: float, x1: float, y0: float, y1: float) -> tuple[Segment, ...]:
    return (x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)


def _turned(segments: tuple[Segment, ...], degrees: float) -> tuple[Segment, ...]:
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))

    def turned(x: float, y: float) -> tuple[float, float]:
        return cosine * x - sine * y, sine * x + cosine * y

    return tuple((*turned(x0, y0), *turned(x1, y1)) for x0, y0, x1, y1 in segments)


def _posts(*places: tuple[float, float]) -> tuple[Segment, ...]:
    """Posts of 5 cm, at distances and in directions, degrees."""
    found: tuple[Segment, ...] = ()
    for distance, direction in places:
        x, y = distance * math.cos(math.radians(direction)), distance * math.sin(math.radians(direction))
        found += _box(x - 0.025, x + 0.025, y - 0.025, y + 0.025)
    return found


_ROOM = _turned(_box(-3.1, 4.7, -2.4, 3.3), 7)
_CORRIDOR = _turned(_box(-14, 22, -0.9, 1.1), 3)
_HALL = _turned(_box(-14, 17, -9, 12), 11)
_FURNITURE = _turned(
    (
        *_box(1.5, 2.1, 0.8, 1.5),
        *_box(-1.8, -1.2, -1.6, -0.9),
        *_box(0.2, 0.6, -2.0, -1.6),
        *_box(-2.4, -2.0, 1.7, 2.9),
        *_box(2.9, 3.3, -1.6, -1.2),
    ),
    7,
)
_DOORS = _turned((*_box(3, 3.9, 0.95, 1.1), *_box(8, 8.9, -0.9, -0.75), *_box(-6, -5, 0.9, 1.1)), 3)
_PILLARS = _turned(
    tuple(
        side for x, y in ((4, 3), (8, -4), (-5, 6), (-8, -3), (12, 7), (1, -6)) for side in _box(x, x + 0.5, y, y + 0.4)
    ),
    11,
)
_ALL_ROUND = _posts((0.8, 100), (1.2, 20), (1.7, 250), (2.1, 65), (2.4, 310), (2.9, 165), (2.2, 130))


def _store(seed: int) -> Plan:
    """A hall full of boxes and posts, so that there are many edges."""
    random = np.random.default_rng(seed)
    boxes: tuple[Segment, ...] = ()
    for angle in np.arange(0, 360, 12):
        away, width, depth = random.uniform((1.5, 0.1, 0.1), (8, 0.6, 0.6)).tolist()
        turn = math.radians(angle + random.uniform(-4, 4))
        x, y = away * math.cos(turn), away * math.sin(turn)
        boxes += _box(x, x + width, y, y + depth)
    return Plan(_HALL + boxes, _posts(*random.uniform((0.8, 0), (4, 360), (10, 2)).tolist()))


#: What the robot stands in.
PLANS = {
    "empty room": Plan(_ROOM),
    "empty corridor": Plan(_CORRIDOR),
    "empty hall": Plan(_HALL),
    "room with posts": Plan(_ROOM, _ALL_ROUND),
    "furnished room": Plan(_ROOM + _FURNITURE),
    "corridor with doors": Plan(_CORRIDOR + _DOORS, _posts((2.5, 10), (4, -172), (6.5, 6))),
    "store 1": _store(1),
    "store 2": _store(2),
    "store 3": _store(3),
    "hall with pillars": Plan(_HALL + _PILLARS, _posts((3, 80), (4.5, 200), (2.5, 330))),
}

LIDARS = {
    "16 rings": Lidar(tuple(np.linspace(-15, 15, 16).tolist()), 1800),
    "64 rings": Lidar(tuple(np.linspace(-22.5, 22.5, 64).tolist()), 1024),
    "1 ring": Lidar((0.5,), 1440),
}


def veiled(plan: str, lidar: str, *, noise: float = 0.0, mixed: bool = False, dust: bool = False) -> Veiled:
    """The returns of one turn; without ``mixed``, beams have no width."""
    random = np.random.default_rng(7)
    world, sensor = PLANS[plan], LIDARS[lidar]
    rings = np.radians(sensor.elevations)
    # The rings do not measure in the same directions.
    shifts = random.random(rings.size) / sensor.columns
    azimuth = 2 * math.pi * (np.arange(sensor.columns) / sensor.columns + shifts[:, None]).ravel()
    elevation = np.repeat(rings, sensor.columns)
    parts = _WIDTH * (np.arange(_PARTS) - _PARTS // 2) / _PARTS if mixed else np.zeros(1)
    segments = np.array(world.walls + world.posts)
    distance, segment = _cast(segments, (azimuth[:, None] + parts).ravel())
    distance, segment = distance.reshape(azimuth.size, -1), segment.reshape(azimuth.size, -1)
    measured = distance.mean(axis=1)
    nearest = np.abs(distance - measured[:, None]).argmin(axis=1)
    rows = np.arange(azimuth.size)
    kinds = np.where(segment[rows, nearest] < len(world.walls), Kind.WALL, Kind.POST)
    kinds[np.abs(distance[rows, nearest] - measured) > _APART] = Kind.MIXED
    if dust:
        floating = random.random(azimuth.size) < _DUST
        measured = np.where(floating, measured * random.uniform(0.1, 0.9, azimuth.size), measured)
        kinds[floating] = Kind.DUST
    slant = measured / np.cos(elevation) + random.normal(0, noise, azimuth.size)
    flat = np.cos(elevation)
    rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)
    # In the order of measurement: column by column.
    order = np.arange(azimuth.size).reshape(rings.size, -1).T.ravel()
    return Veiled((rays * slant[:, None]).astype(np.float32)[order], kinds[order])


def scan_of(cloud: Veiled, params: ProjectionParams) -> Scan:
    """A projection, and what its beams read; with ``mean`` and ``median`` any of their points."""
    project = Projector(params)
    x, y, z = cloud.points.T
    numbers, beams = project.read(x, y, z)
    ranges = project(x, y, z).ranges
    kinds = np.full(ranges.size, -1)
    # Of several points that are read, the one of this range.
    apart = np.abs(np.hypot(x, y)[numbers] - ranges[beams])
    order = np.lexsort((-apart, beams))
    kinds[beams[order]] = cloud.kinds[numbers[order]]
    return Scan(ranges, kinds)


def _cast(segments: NDArray[np.float64], angles: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The distance to the nearest segment in each direction, and which one it is."""
    nearest, which = np.full(angles.size, np.inf), np.full(angles.size, -1)
    dx, dy = np.cos(angles), np.sin(angles)
    for number, (x0, y0, x1, y1) in enumerate(segments):
        ex, ey = x1 - x0, y1 - y0
        with np.errstate(divide="ignore", invalid="ignore"):
            across = dx * ey - dy * ex
            distance = (x0 * ey - y0 * ex) / across
            along = (x0 * dy - y0 * dx) / across
            hit = (distance > 0) & (along >= 0) & (along <= 1) & (distance < nearest)
        nearest[hit], which[hit] = distance[hit], number
    return nearest, which
