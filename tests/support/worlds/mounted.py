"""Clouds of simulated sensors in simulated places, mounted in any way, to tune and to test the fit of the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.messages.tfmessage import encode_transforms
from support import builders
from support.containers import write_rows

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.core.rigid import TransformRow

_FAR = 120.0


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A piece of a plane: a corner, and two edges at right angles to each other; what it is a part of."""

    corner: tuple[float, float, float]
    one: tuple[float, float, float]
    other: tuple[float, float, float]
    part: str = ""


@dataclass(frozen=True, slots=True)
class Place:
    """Surfaces that reflect, and where the robot stands in it: x, y, heading."""

    surfaces: tuple[Rectangle, ...]
    stands: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.3), (0.4, 0.1, 0.7), (0.9, 0.3, 1.2))
    rough: float = 0.0
    heights: tuple[float, ...] = (0.3, 0.6, 1.0)


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float, part: str = "clutter") -> list[Rectangle]:
    """The six sides of a box."""
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    return [
        Rectangle((x0, y0, z0), (dx, 0, 0), (0, dy, 0), part),
        Rectangle((x0, y0, z1), (dx, 0, 0), (0, dy, 0), part),
        Rectangle((x0, y0, z0), (dx, 0, 0), (0, 0, dz), part),
        Rectangle((x0, y1, z0), (dx, 0, 0), (0, 0, dz), part),
        Rectangle((x0, y0, z0), (0, dy, 0), (0, 0, dz), part),
        Rectangle((x1, y0, z0), (0, dy, 0), (0, 0, dz), part),
    ]


def room(x0: float, x1: float, y0: float, y1: float, height: float) -> list[Rectangle]:
    """Floor, ceiling and four walls."""
    floor, ceiling, *walls = box(x0, x1, y0, y1, 0.0, height, "wall")
    return [
        Rectangle(floor.corner, floor.one, floor.other, "floor"),
        Rectangle(ceiling.corner, ceiling.one, ceiling.other, "ceiling"),
        *walls,
    ]


def ground(size: float = 150.0) -> list[Rectangle]:
    """Level ground under the open sky."""
    return [Rectangle((-size, -size, 0), (2 * size, 0, 0), (0, 2 * size, 0), "floor")]


def ramp(begin: float, degrees: float) -> list[Rectangle]:
    """Ground that is level up to x = begin, and rises from there."""
    slope = math.radians(degrees)
    return [
        Rectangle((-150, -150, 0), (150 + begin, 0, 0), (0, 300, 0), "floor"),
        Rectangle((begin, -150, 0), (100 * math.cos(slope), 0, 100 * math.sin(slope)), (0, 300, 0), "floor"),
    ]


def _scattered(seed: int, count: int, reach: float, least: float, largest: float, clear: float) -> list[Rectangle]:
    """Boxes on the floor, none within ``clear`` of the robot's places."""
    random = np.random.default_rng(seed)
    found: list[Rectangle] = []
    while len(found) < 6 * count:
        x, y = random.uniform(-reach, reach, 2)
        dx, dy, dz = random.uniform(least, largest, 3)
        if math.hypot(x, y) > clear + largest:
            found += box(x, x + dx, y, y + dy, 0.0, dz)
    return found


_TABLE = [
    *box(-1.5, -0.3, 1.4, 2.2, 0.70, 0.75),
    *box(-1.45, -1.4, 1.45, 1.5, 0.0, 0.70),
    *box(-0.4, -0.35, 2.1, 2.15, 0.0, 0.70),
]
_PILLARS = [*box(1.8, 2.2, 1.3, 1.7, 0, 2.5), *box(-2.6, -2.2, -1.9, -1.5, 0, 2.5), *box(3.4, 3.8, -2.2, -1.8, 0, 2.5)]

_TALL = (0.6, 1.2, 1.8)

#: Where the simulated robot stands.
PLACES = {
    "hall": Place(tuple(room(-5, 6, -4, 4, 3.0) + _PILLARS + _TABLE)),
    "office": Place(tuple(room(-2, 2.5, -1.8, 2.2, 2.5) + _scattered(3, 4, 1.8, 0.2, 0.6, 0.4))),
    "corridor": Place(tuple(room(-12, 20, -0.9, 1.2, 2.5)), stands=((0, 0, 0.05), (1, 0.1, -0.05), (2, 0.1, 0.1))),
    "warehouse": Place(
        tuple(
            room(-20, 25, -15, 15, 8.0)
            + [r for y in (-9, -4, 3, 8) for r in box(-15, 20, y, y + 1.2, 0, 5, "clutter")]
            + _scattered(5, 10, 2.5, 0.2, 0.8, 0.8)
        ),
        heights=(0.3, 0.8, 1.6),
    ),
    "garage": Place(
        tuple(
            room(-30, 30, -25, 25, 2.3)
            + [r for x in (-20, -10, 5, 15) for y in (-15, -5, 5, 15) for r in box(x, x + 0.5, y, y + 0.5, 0, 2.3)]
            + [r for x in (-8, 8, 12) for r in box(x, x + 1.8, 8, 12, 0.2, 1.5)]
        ),
        heights=(0.3, 0.6, 0.8),
    ),
    "field": Place(
        tuple(ground() + [r for x, y in ((12, 5), (-9, 14), (20, -8)) for r in box(x, x + 0.4, y, y + 0.4, 0, 6)]),
        rough=0.03,
        heights=_TALL,
    ),
    "street": Place(
        tuple(
            ground()
            + box(-40, 60, 9, 20, 0, 12)
            + box(-40, 60, -20, -8, 0, 9)
            + [r for x in (-15, -6, 7, 14) for r in box(x, x + 4.2, 5, 6.8, 0.15, 1.5)]
        ),
        heights=(0.6, 1.8, 2.2),
    ),
    "ramp up": Place(tuple(ramp(6, 9) + _scattered(11, 6, 12, 0.3, 1.5, 2.0)), heights=_TALL),
    "ramp down": Place(tuple(ramp(5, -8)), heights=_TALL),
}


def without(place: Place, part: str) -> Place:
    """A place without its floor, its ceiling or its walls."""
    return replace(place, surfaces=tuple(surface for surface in place.surfaces if surface.part != part))


def _spinning(rings: int, low: float, high: float, columns: int) -> NDArray[np.float64]:
    azimuth = np.arange(columns) * (2 * math.pi / columns)
    elevation = np.radians(np.linspace(low, high, rings))
    angle, tilt = (grid.ravel() for grid in np.meshgrid(azimuth, elevation, indexing="ij"))
    return np.stack([np.cos(tilt) * np.cos(angle), np.cos(tilt) * np.sin(angle), np.sin(tilt)], axis=1)


def _scattering(low: float, high: float, half: float, count: int) -> NDArray[np.float64]:
    """A lidar whose rays never follow the same lines."""
    random = np.random.default_rng(7)
    tilt = np.arcsin(random.uniform(math.sin(math.radians(low)), math.sin(math.radians(high)), count))
    angle = np.radians(random.uniform(-half, half, count))
    return np.stack([np.cos(tilt) * np.cos(angle), np.cos(tilt) * np.sin(angle), np.sin(tilt)], axis=1)


def _camera(width: int, height: int, across: float, up: float, *, optical: bool) -> NDArray[np.float64]:
    y, z = np.meshgrid(
        np.linspace(1, -1, width) * math.tan(math.radians(across / 2)),
        np.linspace(1, -1, height) * math.tan(math.radians(up / 2)),
    )
    rays = np.stack([np.ones(y.size), y.ravel(), z.ravel()], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    # REP 103: x to the right, y down, z forward.
    return np.stack([-rays[:, 1], -rays[:, 2], rays[:, 0]], axis=1) if optical else rays


@cache
def _rays(sensor: str) -> NDArray[np.float64]:
    return SENSORS[sensor]()


#: Rays in the sensor's own frame, unit vectors.
SENSORS: dict[str, Callable[[], NDArray[np.float64]]] = {
    "16 rings": lambda: _spinning(16, -15, 15, 360),
    "32 rings": lambda: _spinning(32, -25, 15, 240),
    "64 rings": lambda: _spinning(64, -24.8, 2, 160),
    "128 rings": lambda: _spinning(128, -45, 45, 100),
    "scattering, all round": lambda: _scattering(-7, 52, 180, 8000),
    "scattering, ahead": lambda: _scattering(-12.5, 12.5, 40, 8000),
    "camera": lambda: _camera(110, 70, 87, 58, optical=False),
    "camera, optical": lambda: _camera(110, 70, 87, 58, optical=True),
}

OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def mounted(roll: float, pitch: float, yaw: float = 0.0, *, optical: bool = False) -> NDArray[np.float64]:
    """The rotation world_from_sensor, degrees; of an optical frame that of its body."""
    r, p, y = (math.radians(angle) for angle in (roll, pitch, yaw))
    around_x = np.array([[1, 0, 0], [0, math.cos(r), -math.sin(r)], [0, math.sin(r), math.cos(r)]])
    around_y = np.array([[math.cos(p), 0, math.sin(p)], [0, 1, 0], [-math.sin(p), 0, math.cos(p)]])
    around_z = np.array([[math.cos(y), -math.sin(y), 0], [math.sin(y), math.cos(y), 0], [0, 0, 1]])
    turned = around_z @ around_y @ around_x
    return np.asarray(turned @ OPTICAL if optical else turned)


def up_in_sensor(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where up is, in the sensor's frame."""
    return np.asarray(rotation.T @ np.array([0.0, 0.0, 1.0]))


def cloud(
    place: Place, sensor: str, rotation: NDArray[np.float64], height: float, stand: int = 0, *, noise: float = 0.02
) -> NDArray[np.float32]:
    """The returns of one sweep in the sensor's frame, (N, 3) metres."""
    random = np.random.default_rng(100 + stand)
    x, y, heading = place.stands[stand % len(place.stands)]
    turn = mounted(0, 0, math.degrees(heading)) @ rotation
    rays = _rays(sensor)
    origin = np.array([x, y, height])
    distance, _ = cast(place.surfaces, origin, rays @ turn.T)
    hit = (distance > 0.1) & (distance < _FAR)
    rays, distance = rays[hit], distance[hit]
    distance = distance + random.normal(0, noise, distance.size) * (distance / 3 if "camera" in sensor else 1)
    points = rays * distance[:, None]
    if place.rough:
        points += random.normal(0, place.rough, points.shape)
    return points.astype(np.float32)


@cache
def _planes(surfaces: tuple[Rectangle, ...]) -> list[tuple[NDArray[Any], ...]]:
    """The corner, the edges and the normal of each surface."""
    planes = [[np.array(part, float) for part in (each.corner, each.one, each.other)] for each in surfaces]
    return [(corner, one, other, np.cross(one, other)) for corner, one, other in planes]


def cast(
    surfaces: tuple[Rectangle, ...], origin: NDArray[np.float64], rays: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the distance to the first surface on each ray, and its number; infinity and -1 if there is none."""
    nearest, met = np.full(len(rays), np.inf), np.full(len(rays), -1)
    for number, (corner, one, other, normal) in enumerate(_planes(surfaces)):
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = ((corner - origin) @ normal) / (rays @ normal)
            (first,) = np.nonzero((distance > 0) & (distance < nearest))
            at = origin - corner + distance[first, None] * rays[first]
            u, v = at @ one / (one @ one), at @ other / (other @ other)
        first = first[(u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)]
        nearest[first], met[first] = distance[first], number
    return nearest, met


def write_clouds(
    path: Path, clouds: Sequence[NDArray[np.float32]], *, frame: str = "lidar", tf: Sequence[TransformRow] = ()
) -> Path:
    """An MCAP file of clouds on /points, ten a second, and static transforms."""
    begin_ns = 1_700_000_000_000_000_000
    rows = [(begin_ns, "/tf_static", encode_transforms(list(tf), "cdr"))] if tf else []
    for number, points in enumerate(clouds):
        stamp_ns = begin_ns + number * 100_000_000
        rows.append((stamp_ns, "/points", builders.cloud(points, 2, seq=number, stamp_ns=stamp_ns, frame_id=frame)))
    return write_rows(path, {"/tf_static": builders.TF, "/points": builders.CLOUD}, rows)
