"""The ground in clouds, held to labelled ones."""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.core.terrain import on_ground
from support import sampled
from support.worlds.labelled import Labelled, labelled

if TYPE_CHECKING:
    from numpy.typing import NDArray

RINGS = ["16 rings", "32 rings", "64 rings", "128 rings"]
HEIGHTS = [0.4, 1.0, 1.8]
#: From here on a point is not the foot of an obstacle.
HIGH = 0.35


def ground_of(points: NDArray[np.float32]) -> NDArray[np.bool_]:
    return on_ground(points[:, 0], points[:, 1], points[:, 2])


def quality(cloud: Labelled) -> tuple[float, float, int, int]:
    """Precision and recall, how many beams of one degree have an obstacle, and how many of these lost it."""
    found = ground_of(cloud.points)
    obstacle = ~cloud.ground & (cloud.above > HIGH)
    right = int(np.count_nonzero(found & cloud.ground))
    precision = right / max(1, right + int(np.count_nonzero(found & obstacle)))
    beams = np.floor(np.degrees(np.arctan2(cloud.points[:, 1], cloud.points[:, 0]))).astype(int)
    had, kept = np.unique(beams[obstacle]), np.unique(beams[obstacle & ~found])
    return precision, right / max(1, int(np.count_nonzero(cloud.ground))), had.size, had.size - kept.size


@pytest.mark.parametrize(
    ("place", "sensor"),
    sampled(product(["street", "hill", "hall", "hall from above", "ramp"], ["camera", *RINGS]), 8),
)
def test_the_ground_is_found_and_nothing_that_stands_on_it(place: str, sensor: str) -> None:
    precision, recall, beams, lost = quality(labelled(place, sensor, pitch=10.0 if sensor == "camera" else 0.0))
    assert precision > 0.997
    assert recall > (0.86 if place == "hill" else 0.99)
    assert beams > 3
    assert lost <= 0.01 * beams


def lost_beams(cloud: Labelled) -> tuple[int, int]:
    """How many beams of one degree have a return of an object, and how many lost the nearest by half a metre or more.

    Returns lower than the limit on the page, with noise, are no objects.
    """
    found = ground_of(cloud.points)
    distance = np.hypot(cloud.points[:, 0], cloud.points[:, 1])
    beams = np.floor(np.degrees(np.arctan2(cloud.points[:, 1], cloud.points[:, 0]))).astype(int) + 180
    high = ~cloud.ground & (cloud.above > 0.16 + 0.008 * distance)
    nearest, kept = np.full(361, np.inf), np.full(361, np.inf)
    np.minimum.at(nearest, beams[high], distance[high])
    np.minimum.at(kept, beams[high & ~found], distance[high & ~found])
    had = np.isfinite(nearest)
    return int(had.sum()), int(np.count_nonzero(kept[had] > nearest[had] + 0.5))


#: Places with objects, and the largest share of beams that may lose one. A box of 0.2 m is higher than the limit by so
#: little that few beams count.
OBJECTS = {
    **{f"boxes of {height} m": 0.05 for height in (0.2, 0.3, 0.4, 0.6)},
    **{f"{kind} {seed}": 0.02 for kind in ("scattered boxes", "boxes in a room") for seed in (1, 3)},
}


@pytest.mark.parametrize(("sensor", "lidar"), sampled(product(RINGS, HEIGHTS), 2))
def test_boxes_are_not_ground(sensor: str, lidar: float) -> None:
    total = missing = 0
    for place, share in OBJECTS.items():
        cloud = labelled(place, sensor, lidar=lidar)
        had, lost = lost_beams(cloud)
        assert lost <= max(1, share * had), place
        assert ground_of(cloud.points)[cloud.ground].mean() > 0.999, place
        total, missing = total + had, missing + lost
    assert missing <= 0.01 * total


#: The least share of its raised points that is found.
RAISED = {
    "kerbs of 0.1 m": 0.98, "kerbs of 0.15 m": 0.95, "kerbs of 0.2 m": 0.78, "narrow sidewalks": 0.90,
    **{f"slope of {degrees} degrees": 0.97 for degrees in (5, 10, 14)},
}  # fmt: skip


@pytest.mark.parametrize(("place", "sensor", "lidar"), sampled(product(RAISED, RINGS, HEIGHTS), 12))
def test_kerbs_and_slopes_are_ground(place: str, sensor: str, lidar: float) -> None:
    cloud = labelled(place, sensor, lidar=lidar)
    x, y, z = cloud.points.T
    # Level ground needs no test; between two rings the ground may rise by half a metre at most.
    raised = cloud.ground & (np.hypot(x, y) < 40) & (np.abs(z) > 0.04) & (z < 0.5)
    assert ground_of(cloud.points)[raised].mean() > RAISED[place]


def test_two_steps_within_a_metre_are_stairs() -> None:
    radius, angle = np.meshgrid(np.linspace(1, 20, 700), np.linspace(-math.pi, math.pi, 360, endpoint=False))
    height = 0.18 * ((radius > 2.0).astype(float) + (radius > 2.8))
    found = on_ground((radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel(), height.ravel())
    assert found[(radius < 2.7).ravel()].all()
    assert not found[((radius > 2.82) & (radius < 2.9)).ravel()].any()


def test_a_planar_lidar_sees_no_ground() -> None:
    angles = np.linspace(-math.pi, math.pi, 1440)
    ranges = 4 + 2 * np.sin(3 * angles)
    x, y = ranges * np.cos(angles), ranges * np.sin(angles)
    for z in (np.zeros(1440), np.random.default_rng(1).normal(0, 0.02, 1440), np.full(1440, -0.4)):
        assert not on_ground(x, y, z).any()
    # Along a wall, too.
    assert not on_ground(np.linspace(-30, 30, 3000), np.full(3000, 0.7), np.zeros(3000)).any()


def test_points_that_are_none_are_not_ground_and_change_nothing() -> None:
    points = labelled("hall", "32 rings").points
    none = np.array([[np.nan] * 3, [np.inf, 0, -1], [1, 2, np.nan], [3, 2, -np.inf], [500, 0, 0]], np.float32)
    found = ground_of(np.concatenate([none, points]))
    assert not found[:5].any()
    np.testing.assert_array_equal(found[5:], ground_of(points))
    assert on_ground(*np.empty((3, 0), np.float32)).shape == (0,)
    assert not ground_of(none).any()


@pytest.mark.parametrize(("roll", "pitch"), [(4, 0), (0, -5), (3, 3)])
def test_a_frame_may_be_tilted_a_little(roll: float, pitch: float) -> None:
    from support.worlds.mounted import mounted

    cloud = labelled("street", "64 rings")
    tilted = cloud._replace(points=(cloud.points @ mounted(roll, pitch)).astype(np.float32))
    precision, recall, _, _ = quality(tilted)
    assert precision > 0.99
    assert recall > 0.97
