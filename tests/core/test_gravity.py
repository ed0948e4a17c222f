"""Up by a simulated IMU, whose true attitude is known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.core.gravity import up_by_gravity
from support.worlds.inertial import GRAVITY, Simulated, errors, simulated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


def filtered(world: Simulated) -> Floats:
    return up_by_gravity(world.stamps_ns, world.turning, world.acceleration, GRAVITY)


@pytest.mark.parametrize(("seconds", "bias"), [(10.0, 0.0), (10.0, 0.05), (120.0, 0.01), (120.0, 0.05)])
def test_a_robot_that_tilts_with_noise_and_a_bias(seconds: float, bias: float) -> None:
    world = simulated(seconds, bias=bias)
    off = errors(filtered(world), world.ups)
    assert np.median(off) < 0.5
    assert off.max() < 0.8


def test_accelerations_of_driving_count_for_little() -> None:
    world = simulated(120, drive=1.0)
    off = errors(filtered(world), world.ups)
    shown = world.acceleration / np.linalg.norm(world.acceleration, axis=1)[:, np.newaxis]
    assert np.percentile(errors(shown, world.ups), 95) > 5.0
    assert np.median(off) < 0.3
    assert off.max() < 1.0


def test_after_a_gap_it_begins_again() -> None:
    world = simulated(60)
    # It is unknown how the robot turned while nothing was recorded.
    second = world.stamps_ns > 30_000_000_000
    turned = np.where(second[:, np.newaxis], np.array([-1.0, -1.0, 1.0]), 1.0)
    kept = ~((world.stamps_ns > 29_700_000_000) & (world.stamps_ns <= 30_000_000_000))
    found = up_by_gravity(
        world.stamps_ns[kept], (world.turning * turned)[kept], (world.acceleration * turned)[kept], GRAVITY
    )
    assert errors(found, (world.ups * turned)[kept]).max() < 0.7


@pytest.mark.parametrize("axis", range(3))
def test_at_first_up_is_the_mean_of_the_directions_also_after_a_gap(axis: int) -> None:
    leans = np.array([0.05, 0.05, -0.05, -0.05] * 2)
    shown = 1.05 * GRAVITY * np.roll(np.column_stack([np.cos(leans), np.sin(leans), 0 * leans]), axis, axis=1)
    found = up_by_gravity(np.array([0, 1, 2, 3, 100, 101, 102, 103]) * 10_000_000, 0 * shown, shown, GRAVITY)
    np.testing.assert_allclose(found, [np.eye(3)[axis]] * 8, atol=0.002)
