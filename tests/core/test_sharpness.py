"""How well odometry fits what a lidar sees."""

from __future__ import annotations

import math

import numpy as np

from pc2scan.core.sharpness import Window, busiest, spread

SECOND = 1_000_000_000


def poses(times: np.ndarray, yaw: np.ndarray, x: np.ndarray | float = 0.0) -> np.ndarray:
    found = np.zeros((len(times), 7))
    found[:, 0], found[:, 5], found[:, 6] = x, np.sin(yaw / 2), np.cos(yaw / 2)
    return found


def test_spread_grows_with_the_width_of_a_wall() -> None:
    random = np.random.default_rng(1)
    along = random.uniform(-5, 5, 4000)
    for direction in np.linspace(0, math.pi, 7):
        turn = np.array([[math.cos(direction), math.sin(direction)], [-math.sin(direction), math.cos(direction)]])
        found = [spread(np.stack([along, random.normal(0, width, 4000)], axis=1) @ turn) for width in (0.02, 0.1, 0.4)]
        assert 40 < found[0] < 0.9 * found[1] < 0.6 * found[2]
    assert spread(np.empty((0, 2))) == 0.0


def test_the_busiest_seconds_are_those_in_which_the_velocity_changes() -> None:
    times = np.arange(0, 60, 0.02)
    stamps = (times * SECOND).astype(np.int64)
    turning = np.where((times > 20) & (times < 22), np.sin(3 * (times - 20)), 0.0)
    moving, turned, still = (poses(times, *each) for each in ((turning, times), (turning,), (0 * times,)))
    found = busiest(stamps, moving, Window(0, 60 * SECOND), SECOND, 2)
    assert len(found) == 2
    assert all(19 * SECOND < begin < 22.5 * SECOND and end - begin == SECOND for begin, end in found)
    assert abs(found[0].begin_ns - found[1].begin_ns) >= SECOND - 60_000_000
    # Poses closer together are as often noise.
    assert {begin % 50_000_000 for begin, _ in found} == {0}
    # Not outside of the recording; none of a robot that stands still, or for too short a time.
    assert all(end <= 15 * SECOND for _, end in busiest(stamps, turned, Window(0, 15 * SECOND), SECOND, 2))
    assert busiest(stamps, still, Window(0, 60 * SECOND), SECOND, 2) == []
    assert busiest(stamps, turned, Window(0, SECOND // 2), SECOND, 2) == []
