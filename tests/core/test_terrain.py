"""The ground in clouds, held to labelled ones."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from labelled_worlds import Labelled, labelled
from pc2scan.core.terrain import Terrain, on_ground

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: From here on a point is not the foot of an obstacle.
HIGH = 0.35


def ground_of(points: NDArray[np.float32], terrain: Terrain | None = None) -> NDArray[np.bool_]:
    return on_ground(points[:, 0], points[:, 1], points[:, 2], terrain)


def quality(cloud: Labelled) -> tuple[float, float, int, int]:
    """Precision and recall, how many beams of one degree have an obstacle, and how many of these lost it."""
    found = ground_of(cloud.points)
    obstacle = ~cloud.ground & (cloud.above > HIGH)
    right = int(np.count_nonzero(found & cloud.ground))
    precision = right / max(1, right + int(np.count_nonzero(found & obstacle)))
    beams = np.floor(np.degrees(np.arctan2(cloud.points[:, 1], cloud.points[:, 0]))).astype(int)
    had, kept = np.unique(beams[obstacle]), np.unique(beams[obstacle & ~found])
    return precision, right / max(1, int(np.count_nonzero(cloud.ground))), had.size, had.size - kept.size


@pytest.mark.parametrize("sensor", ["16 rings", "32 rings", "64 rings", "128 rings", "camera"])
@pytest.mark.parametrize("place", ["street", "hill", "valley", "hall", "hall from above", "ramp"])
def test_the_ground_is_found_and_nothing_that_stands_on_it(place: str, sensor: str) -> None:
    precision, recall, beams, lost = quality(labelled(place, sensor, pitch=10.0 if sensor == "camera" else 0.0))
    assert precision > 0.997
    assert recall > (0.86 if place == "hill" else 0.99)
    assert beams > 3
    assert lost <= 0.01 * beams


@pytest.mark.parametrize("sensor", ["16 rings", "64 rings", "camera"])
def test_stairs_are_climbed_by_three_steps_at_most(sensor: str) -> None:
    cloud = labelled("stairs", sensor, pitch=10.0 if sensor == "camera" else 0.0)
    found = ground_of(cloud.points)
    assert cloud.above[found & ~cloud.ground].max() < 3 * 0.17 + 0.14
    assert quality(cloud)[1] > 0.99


@pytest.mark.parametrize("sensor", ["16 rings", "64 rings", "128 rings", "camera", "scattering, all round"])
@pytest.mark.parametrize("place", ["street", "hall", "hall from above"])
def test_where_no_ground_is_seen_beams_keep_what_stands_there(place: str, sensor: str) -> None:
    _, _, beams, lost = quality(labelled(place, sensor, floor=False, pitch=-15.0 if sensor == "camera" else 0.0))
    assert lost <= 0.02 * beams


def test_a_planar_lidar_sees_no_ground() -> None:
    angles = np.linspace(-math.pi, math.pi, 1440)
    ranges = 4 + 2 * np.sin(3 * angles)
    x, y = ranges * np.cos(angles), ranges * np.sin(angles)
    for z in (np.zeros(1440), np.random.default_rng(1).normal(0, 0.02, 1440), np.full(1440, -0.4)):
        assert not on_ground(x, y, z).any()
    # Along a wall, too.
    assert not on_ground(np.linspace(-30, 30, 3000), np.full(3000, 0.7), np.zeros(3000)).any()


def test_the_same_cloud_has_the_same_ground_in_any_order_and_shape() -> None:
    points = labelled("street", "64 rings").points
    found = ground_of(points)
    order = np.random.default_rng(2).permutation(len(points))
    np.testing.assert_array_equal(ground_of(points[order]), found[order])
    rows = points[: len(points) // 4 * 4].reshape(4, -1, 3)
    in_rows = on_ground(rows[..., 0], rows[..., 1], rows[..., 2])
    assert in_rows.shape == rows.shape[:2]
    np.testing.assert_array_equal(in_rows.ravel(), ground_of(rows.reshape(-1, 3)))


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
    from mounted_worlds import mounted

    cloud = labelled("street", "64 rings")
    tilted = cloud._replace(points=(cloud.points @ mounted(roll, pitch)).astype(np.float32))
    precision, recall, _, _ = quality(tilted)
    assert precision > 0.99
    assert recall > 0.97


def test_a_steeper_limit_follows_a_steeper_hill() -> None:
    cloud = labelled("hill", "64 rings")
    uphill = cloud.ground & (cloud.points[:, 2] > 0.5)
    assert ground_of(cloud.points)[uphill].mean() > 0.9
    assert ground_of(cloud.points, Terrain(slope=math.radians(3)))[uphill].mean() < 0.6
