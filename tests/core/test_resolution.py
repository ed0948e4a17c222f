"""How finely a lidar samples azimuth, of clouds made with a known step."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.resolution import azimuth_step

if TYPE_CHECKING:
    from numpy.typing import NDArray

ELEVATIONS = np.radians(np.linspace(-15, 15, 16))


def spinning(columns: int, seed: int = 0, elevations: NDArray[np.float64] = ELEVATIONS) -> NDArray[np.float32]:
    """Coordinates of a turn of a lidar, (3, rings, columns), with walls at different distances."""
    random = np.random.default_rng(seed)
    azimuths = (np.arange(columns) * 2 * math.pi / columns)[None, :] + random.uniform(0, 6)
    ranges = random.uniform(2, 50, (elevations.size, columns))
    up = elevations[:, None]
    parts = (np.cos(up) * np.cos(azimuths), np.cos(up) * np.sin(azimuths), np.sin(up) * np.ones_like(azimuths))
    return np.stack([ranges * part for part in parts]).astype(np.float32)


def in_any_order(cloud: NDArray[np.float32], seed: int = 1) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """The points one after the other in any order, and the ring of each."""
    flat = cloud.reshape(3, -1)
    order = np.random.default_rng(seed).permutation(flat.shape[1])
    return flat[:, order], np.repeat(np.arange(cloud.shape[1]), cloud.shape[2])[order]


def step(cloud: NDArray[np.float32], rings: NDArray[np.intp]) -> float | None:
    x, y, z = cloud
    return azimuth_step(x, y, z, rings)


@pytest.mark.parametrize("columns", [90, 240, 512, 1024, 1800, 2048])
def test_structured_or_not_with_ring_numbers_or_without(columns: int) -> None:
    cloud = spinning(columns)
    expected = pytest.approx(2 * math.pi / columns, rel=1e-3)
    assert azimuth_step(*cloud) == expected
    assert azimuth_step(*cloud.transpose(0, 2, 1)) == expected
    flat, rings = in_any_order(cloud)
    assert step(flat, rings) == expected
    assert azimuth_step(*flat) == expected
    assert azimuth_step(*flat[:, None, :]) == expected


@given(st.floats(0, 0.45), st.integers(0, 99), st.booleans())
def test_holes_are_no_steps(share: float, seed: int, zero: bool) -> None:
    cloud = spinning(720, seed)
    holes = np.random.default_rng(seed).random(cloud.shape[1:]) < share
    cloud[:, holes] = 0.0 if zero else math.nan
    assert azimuth_step(*cloud) == pytest.approx(math.radians(0.5), rel=1e-2)


def test_lasers_that_look_to_the_side_and_two_returns_a_shot() -> None:
    cloud = spinning(900)
    offsets = np.radians(np.tile([3.0, 1.0, -1.0, -3.0], 4))[:, None]
    x, y, z = cloud
    turned = np.stack([x * np.cos(offsets) - y * np.sin(offsets), x * np.sin(offsets) + y * np.cos(offsets), z])
    twice = np.concatenate([turned, 1.5 * turned], axis=2)
    rings = np.repeat(np.arange(16), 1800)
    assert step(twice.reshape(3, -1), rings) == pytest.approx(math.radians(0.4), rel=1e-3)
