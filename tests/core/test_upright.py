"""The level frame of a frame: no roll, no pitch, the same yaw."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pc2scan.core.gravity import tilt, up_in, upright_rotation
from pc2scan.core.rigid import Rigid


def level_of(world_from_frame: Rigid) -> Rigid:
    """world_from_level."""
    return world_from_frame.compose(upright_rotation(up_in(world_from_frame.quaternion.tolist())))


@pytest.mark.parametrize("seed", range(50))
def test_roll_and_pitch_are_taken_out_and_yaw_and_position_kept(seed: int) -> None:
    rng = np.random.default_rng(seed)
    roll, yaw = rng.uniform(-math.pi, math.pi, 2)
    pitch = rng.uniform(-1.57, 1.57)
    world_from_frame = Rigid.from_rpy(roll, pitch, yaw, (1.0, 2.0, 3.0))
    level = level_of(world_from_frame)
    np.testing.assert_allclose(level.rpy[:2], 0, atol=1e-9)
    assert math.remainder(level.rpy[2] - yaw, math.tau) == pytest.approx(0, abs=1e-9)
    assert level.translation.tolist() == [1, 2, 3]
    up = up_in(world_from_frame.quaternion.tolist())
    assert tilt(up) == pytest.approx(math.acos(math.cos(roll) * math.cos(pitch)), abs=1e-9)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
@pytest.mark.parametrize("off", [0.0, 1e-9, 1e-7, 1e-5])
def test_near_the_vertical_the_level_frame_is_still_level(pitch: float, off: float) -> None:
    world_from_frame = Rigid.from_rpy(0.0, pitch - math.copysign(off, pitch), 0.7)
    level = level_of(world_from_frame)
    np.testing.assert_allclose(level.rpy[:2], 0, atol=1e-9)
    # Of roll 0, that of `Rigid.rpy` where roll and yaw are one.
    assert level.rpy[2] == pytest.approx(0.7, abs=1e-6)
