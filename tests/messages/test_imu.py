"""Messages of IMUs as rosbags serialises them."""

from __future__ import annotations

from typing import Any

import pytest

from pc2scan.messages.imu import decode_imu
from support.builders import imu_message


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_covariance_of_minus_1_means_that_it_is_not_known(place: int) -> None:
    first = [0.0, 0.0, 0.0]
    first[place] = -1.0
    imu = decode_imu(imu_message(2, first=(first[0], first[1], first[2])), "cdr")
    assert [part is None for part in imu[2:]] == [place == each for each in range(3)]


@pytest.mark.parametrize("orientation", [(0, 0, 0, 0), (0, 0, 0, 2), (0, float("nan"), 0, 1), (0.7, 0.7, 0.7, 0.7)])
def test_an_orientation_that_is_no_rotation_is_none(orientation: Any) -> None:
    imu = decode_imu(imu_message(2, orientation), "cdr")
    assert imu.orientation is None
    assert imu.angular_velocity is not None


def test_numbers_that_are_not_finite_are_none() -> None:
    assert decode_imu(imu_message(1, turning=(0, float("inf"), 0)), "ros1").angular_velocity is None
