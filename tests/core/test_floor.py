"""A floor at right angles to z, whose slope and distance are known."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.core.scene import LEVEL, are_ground, cells_of, find_ground, outermost

if TYPE_CHECKING:
    from numpy.typing import NDArray


def floor(slope_x: float, slope_y: float, height: float, walls: int = 300) -> NDArray[np.float64]:
    """Points of a floor all round, and of walls on it."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-8, 8, (2, 900))
    ground = np.stack([x, y, slope_x * x + slope_y * y - height], axis=1)
    around = np.stack([np.full(walls, 8.0), *rng.uniform(0, 3, (2, walls))], axis=1)
    return np.concatenate([ground, around])


def height_of(points: NDArray[np.float64]) -> float | None:
    """The height above a level floor, if there is one."""
    ground = find_ground(points)
    return ground.height if ground.kind == "level" else None


def test_what_is_no_level_floor() -> None:
    assert height_of(floor(math.tan(LEVEL + 0.01), 0, 1.0)) is None
    assert height_of(floor(0, 0, -1.0)) is None
    assert height_of(floor(0, 0, 0.02)) is None
    # A table, with more below it than above.
    assert height_of(np.concatenate([floor(0, 0, 0.5), floor(0, 0, 1.5)])) in (None, pytest.approx(1.5, abs=0.02))


def patch(height: float, near: float, far: float, slope: float = 0.0) -> NDArray[np.float64]:
    """Points of a plane that begins so far ahead."""
    random = np.random.default_rng(3)
    x, y = random.uniform(near, far, 2500), random.uniform(-4, 4, 2500)
    return np.stack([x, y, height + slope * (x - near)], axis=1)


LOWER, FAR = patch(-1.6, -4, 4), patch(-0.92, 3, 7, 0.04)
TWO = np.concatenate([patch(-1.0, -4, 2), patch(-1.6, 2, 12), patch(-1.6, 2, 12)])


@pytest.mark.parametrize(("points", "height", "is_other"), [(LOWER, 1.0, True), (TWO, 1.0, False), (FAR, 0.88, False)])
def test_what_contradicts_a_recorded_mount(points: NDArray[np.float64], height: float, is_other: bool) -> None:
    ground = find_ground(points)
    assert (ground.height > height + 0.12, bool(ground.believed(points, height).height)) == (True, is_other)


@pytest.mark.parametrize(("height", "near"), [(1.0, -4), (0.2, -4), (1.0, 14)])
def test_what_is_overhead_is_not_just_above_the_sensor_and_not_far_away(height: float, near: float) -> None:
    found = outermost(cells_of(np.concatenate([patch(-1.0, -4, 4), patch(height, near, near + 8)])), 1)
    assert (None if found is None else found.height) == (pytest.approx(1.0) if (height, near) == (1.0, -4) else None)
    # Nor is one ring alone.
    assert outermost(cells_of(patch(height, near, near + 8)), 1) is None


def test_ramps_and_grass_are_ground_and_neither_walls_nor_tables_are() -> None:
    flat, far = patch(-0.5, -4, 2), patch(-0.5, 2, 60, slope=0.12)
    parts = [flat, far, np.add(flat[::80], (0, 0, 0.2)), patch(-9.0, 0, 2)[:, [2, 1, 0]], patch(0.3, -6, -4)[:200]]
    lies = np.split(are_ground(np.concatenate(parts), -0.4, np.zeros(3)), np.cumsum([len(part) for part in parts[:-1]]))
    _, on_ramp, on_grass, on_wall, on_table = (part.mean() for part in lies)
    assert (on_ramp > 0.97, on_grass > 0.9, on_wall < 0.02, on_table < 0.02) == (True, True, True, True)
    # What is as high as the sensor is a ring, wherever its points are.
    on_level = [are_ground(patch(0.2, -9, 9), -0.4, np.array([0.0, 0.0, up])).mean() for up in (0.2, 1.0)]
    assert (on_level[0], on_level[1] > 0.9) == (0.0, True)
