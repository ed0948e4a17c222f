"""Simulated clouds of which each point is known to be ground or not: streets, hills, ramps, halls, boxes, kerbs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from support.worlds.mounted import SENSORS, Rectangle, box, cast, mounted, room

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray


class Labelled(NamedTuple):
    """A cloud in the robot's frame: (N, 3), whether points are ground, and how high above the ground they are."""

    points: NDArray[np.float32]
    ground: NDArray[np.bool_]
    above: NDArray[np.float64]


class Scene(NamedTuple):
    """Surfaces, the ground's height at x and y, the height of the lidar, and the robot's heading, degrees."""

    surfaces: list[Rectangle]
    height_at: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
    lidar: float
    heading: float = 20.0


def _floor(x0: float, x1: float, z: float, degrees: float = 0.0) -> Rectangle:
    rise = (x1 - x0) * math.tan(math.radians(degrees))
    return Rectangle((x0, -150, z), (x1 - x0, 0, rise), (0, 300, 0), "floor")


def _posts(places: list[tuple[float, float]], height_at: Callable[[float], float]) -> list[Rectangle]:
    return [side for x, y in places for side in box(x, x + 0.6, y, y + 0.6, height_at(x) - 0.2, height_at(x) + 1.6)]


def _street() -> Scene:
    kerb = 0.15
    found = [Rectangle((-120, -4, 0), (240, 0, 0), (0, 8, 0), "floor")]
    for side in (1, -1):
        found.append(Rectangle((-120, 4 * side, kerb), (240, 0, 0), (0, 5 * side, 0), "floor"))
        found.append(Rectangle((-120, 4 * side, 0), (240, 0, 0), (0, 0, kerb), "kerb"))
    found += box(-120, 120, 9, 20, 0, 12) + box(-120, 120, -20, -9, 0, 9)
    for x in (-25, -12, 8, 17, 40):
        found += box(x, x + 4.2, 2.0, 3.8, 0.2, 1.5)
    for x, y in ((5, -6), (11, 6.5), (-7, -7), (22, -5)):
        found += box(x, x + 0.4, y, y + 0.4, kerb, kerb + 1.7)
    for x in range(-60, 60, 15):
        found += box(x, x + 0.2, 4.5, 4.7, kerb, 6)
    return Scene(found, lambda _, y: np.where(np.abs(y) > 4, kerb, 0.0), 1.8, 3.0)


def _hill() -> Scene:
    slope = math.tan(math.radians(10))
    places = [(10.0, 3.0), (14.0, -4.0), (20.0, 2.0), (-8.0, 5.0), (-12.0, -6.0)]
    surfaces = [_floor(-150, 6, 0), _floor(6, 36, 0, 10), _floor(36, 96, 30 * slope)]
    surfaces += _posts(places, lambda x: max(0.0, (x - 6) * slope))
    return Scene(surfaces, lambda x, _: np.clip((x - 6) * slope, 0, 30 * slope), 1.8)


def _hall(lidar: float = 0.4, *more: Rectangle) -> Scene:
    found = [*room(-8, 10, -6, 7, 3.0), *more]
    for x, y in ((2, 2), (-3, 3), (4, -3)):
        found += box(x, x + 1.4, y, y + 0.8, 0.72, 0.75)
        for dx in (0, 1.35):
            for dy in (0, 0.75):
                found += box(x + dx, x + dx + 0.05, y + dy, y + dy + 0.05, 0, 0.72)
    found += box(-5, -4, -4, -3, 0, 0.4) + box(6, 6.5, 0, 0.5, 0, 1.8) + box(-2, -1.6, -2, -1.6, 0, 3)
    return Scene(found, lambda x, _: np.zeros_like(x), lidar)


def _ramp() -> Scene:
    slope = math.tan(math.radians(6))
    ramp = Rectangle((5, -6, 0), (5, 0, 5 * slope), (0, 13, 0), "floor")
    return _hall(1.0, ramp)._replace(height_at=lambda x, _: np.maximum(0, (x - 5) * slope))


def _boxes(height: float) -> Scene:
    """Boxes of one height all round, of 0.3 to 1.2 m, from 2 to 16 m away."""
    found = [_floor(-150, 150, 0)]
    sizes = ((2, 0.3), (2.8, 0.5), (3.7, 0.4), (5, 0.6), (6.5, 0.5), (8, 0.8), (10, 1.0), (13, 0.8), (16, 1.2))
    for number, (away, size) in enumerate(sizes):
        angle, half = math.radians(15 + 40 * number), size / 2
        x, y = away * math.cos(angle), away * math.sin(angle)
        found += box(x - half, x + half, y - half, y + half, 0, height)
    return Scene(found, lambda x, _: np.zeros_like(x), 1.0, 7.0)


def _scattered(seed: int, walls: list[Rectangle]) -> Scene:
    """Boxes of 0.25 to 2 m at any place, 0.25 to 1 m high."""
    random, found = np.random.default_rng(seed), list(walls)
    taken: list[tuple[float, float, float, float]] = []
    while len(taken) < 10:
        away, angle = random.uniform(1.8, 14), random.uniform(-math.pi, math.pi)
        x, y = away * math.cos(angle), away * math.sin(angle)
        width, depth = random.uniform(0.25, 2.0, 2).tolist()
        height = float(random.choice([0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.8, 1.0]))
        free = all(abs(x - a) > (width + c) / 2 + 0.3 or abs(y - b) > (depth + d) / 2 + 0.3 for a, b, c, d in taken)
        if free and abs(x) < 11 and abs(y) < 8 and math.hypot(x, y) > 1 + math.hypot(width, depth) / 2:
            taken.append((x, y, width, depth))
            found += box(x - width / 2, x + width / 2, y - depth / 2, y + depth / 2, 0, height)
    return Scene(found, lambda x, _: np.zeros_like(x), 1.0, 7.0)


def _sidewalks(kerb: float, width: float = 3.0) -> Scene:
    """A road of 6 m with sidewalks and walls."""
    found = [Rectangle((-60, -3, 0), (120, 0, 0), (0, 6, 0), "floor")]
    for side in (1, -1):
        found.append(Rectangle((-60, 3 * side, kerb), (120, 0, 0), (0, width * side, 0), "floor"))
        found.append(Rectangle((-60, 3 * side, 0), (120, 0, 0), (0, 0, kerb), "kerb"))
    found += box(-60, 60, 3 + width, 15, 0, 8) + box(-60, 60, -15, -3 - width, 0, 8)
    return Scene(found, lambda _, y: np.where(np.abs(y) > 3, kerb, 0.0), 1.0, 3.0)


def _slope(degrees: float) -> Scene:
    slope = math.tan(math.radians(degrees))
    surfaces = [_floor(-150, 5, 0), _floor(5, 65, 0, degrees)]
    return Scene(surfaces, lambda x, _: np.maximum(0, (x - 5) * slope), 1.0)


PLACES = {
    "street": _street(),
    "hill": _hill(),
    "hall": _hall(),
    "hall from above": _hall(1.0),
    "ramp": _ramp(),
    **{f"boxes of {height} m": _boxes(height) for height in (0.2, 0.3, 0.4, 0.6)},
    **{f"scattered boxes {seed}": _scattered(seed, [_floor(-150, 150, 0)]) for seed in (1, 3)},
    **{f"boxes in a room {seed}": _scattered(seed, room(-12, 15, -9, 10, 4.0)) for seed in (1, 3)},
    **{f"kerbs of {kerb} m": _sidewalks(kerb) for kerb in (0.1, 0.15, 0.2)},
    "narrow sidewalks": _sidewalks(0.15, 1.5),
    **{f"slope of {degrees} degrees": _slope(degrees) for degrees in (5, 10, 14)},
}


def labelled(place: str, sensor: str, *, pitch: float = 0.0, lidar: float | None = None) -> Labelled:
    """The returns of one sweep, in a frame on the floor beneath the lidar whose z axis points up.

    ``lidar`` is its height, if it is not the place's own.
    """
    random = np.random.default_rng(5)
    scene = PLACES[place]
    tilt = mounted(0, pitch)
    turn = mounted(0, 0, scene.heading)
    rays = SENSORS[sensor]() @ tilt.T
    origin = np.array([0.0, 0.0, scene.lidar if lidar is None else lidar])
    nearest, label = cast(tuple(scene.surfaces), origin, rays @ turn.T)
    seen = (nearest > 0.3) & (nearest < 100)
    distance = nearest[seen]
    distance = distance + random.normal(0, 0.02, distance.size) * (distance / 3 if "camera" in sensor else 1)
    points = rays[seen] * distance[:, None] + origin
    parts = np.array([surface.part for surface in scene.surfaces])[label[seen]]
    placed = points @ turn.T
    above = points[:, 2] - scene.height_at(placed[:, 0], placed[:, 1])
    return Labelled(points.astype(np.float32), np.isin(parts, ["floor", "kerb"]), above)
