"""A simulated IMU on a robot that pitches and rolls, whose true attitude is known."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

GRAVITY = 9.81


class Simulated(NamedTuple):
    """What an IMU measures, and which way is up in its frame."""

    stamps_ns: NDArray[np.int64]
    turning: Floats
    acceleration: Floats
    ups: Floats


def simulated(seconds: float, *, bias: float = 0.01, drive: float = 0.0) -> Simulated:
    """A robot that pitches and rolls, and now and then accelerates for a second (``drive``, m/s^2)."""
    rng = np.random.default_rng(5)
    t = np.arange(0, seconds, 0.01)
    amplitude = np.radians(3.0)
    pitch, roll = amplitude * np.sin(np.pi * t), amplitude * np.sin(2.3 * t + 1)
    pitching, rolling = amplitude * np.pi * np.cos(np.pi * t), amplitude * 2.3 * np.cos(2.3 * t + 1)
    yawing = 0.5 * np.cos(0.4 * t)
    turning = [
        rolling - yawing * np.sin(pitch),
        pitching * np.cos(roll) + yawing * np.cos(pitch) * np.sin(roll),
        -pitching * np.sin(roll) + yawing * np.cos(pitch) * np.cos(roll),
    ]
    ups = np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1)
    ahead = np.stack([np.cos(pitch), np.sin(pitch) * np.sin(roll), np.sin(pitch) * np.cos(roll)], axis=1)
    wave = np.sin(2 * np.pi * t / 7)
    acceleration = GRAVITY * ups + (drive * np.sign(wave) * (np.abs(wave) > 0.7))[:, np.newaxis] * ahead
    measured = np.stack(turning, axis=1) + bias * np.array([1, -1, 0.5])
    measured += rng.normal(scale=0.005, size=measured.shape)
    acceleration += rng.normal(scale=0.1, size=acceleration.shape)
    return Simulated((t * 1e9).astype(np.int64), measured, acceleration, ups)


def errors(found: Floats, ups: Floats) -> Floats:
    """Degrees between directions."""
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-9)
    between: Floats = np.degrees(2 * np.arcsin(np.linalg.norm(found - ups, axis=1) / 2))
    return between
