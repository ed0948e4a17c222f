"""A floor at right angles to z, whose slope and distance are known."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.core.scene import LEVEL, find_ground

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
    # The smallest number below 0.
    flat = floor(0, 0, 0.0)
    flat[:, 2] = -5e-324
    assert height_of(flat) is None
    # A table, with more below it than above.
    assert height_of(np.concatenate([floor(0, 0, 0.5), floor(0, 0, 1.5)])) in (None, pytest.approx(1.5, abs=0.02))
