"""Messages of IMUs as rosbags serialises them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pc2scan.messages.imu import decode_imu
from support.builders import IMU, header, serialized, typestore

STAMP = 1_700_000_000_123_456_789


def imu_message(
    ros_version: int,
    orientation: Any = (0.0, 0.6, 0.0, 0.8),
    first: tuple[float, float, float] = (0.01, 0.02, 0.03),
    frame_id: str = "imu_link",
    turning: Any = (1.0, 2.0, 3.0),
    acceleration: Any = (0.1, 0.2, 9.8),
    stamp_ns: int = STAMP,
) -> bytes:
    """A serialised message; ``first`` are the first numbers of its covariances."""
    store = typestore(ros_version)
    types = store.types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    covariances = [np.array([each, *[0.5] * 8]) for each in first]
    message = types[IMU](
        header(store, ros_version, 7, stamp_ns, frame_id),
        quaternion(*orientation), covariances[0],
        vector(*turning), covariances[1],
        vector(*acceleration), covariances[2],
    )  # fmt: skip
    return serialized(store, message, IMU, ros_version)


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
