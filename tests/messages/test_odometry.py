"""Poses of nav_msgs/Odometry."""

from __future__ import annotations

import math

import pytest

from export.driving import START, by_odometry, odometry
from pc2scan.errors import DecodeError
from pc2scan.messages.odometry import decode_odometry

STAMP = START + 123_456_789


@pytest.mark.parametrize(("ros_version", "serialization"), [(1, "ros1"), (2, "cdr")])
# Names of every length, so that what follows is aligned in every way.
@pytest.mark.parametrize("child", ["", "a", "ab", "abc", "abcd", "base_link", "base_footprint"])
def test_the_pose_is_that_of_the_message(ros_version: int, serialization: str, child: str) -> None:
    data = odometry(STAMP, ros_version, child=child, parent="odom" * len(child))
    x, y, yaw = by_odometry(STAMP)
    expected = ("odom" * len(child), child, STAMP, x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    assert decode_odometry(data, serialization) == expected


@pytest.mark.parametrize(("ros_version", "serialization"), [(1, "ros1"), (2, "cdr")])
def test_a_message_that_ends_too_early(ros_version: int, serialization: str) -> None:
    data = odometry(STAMP, ros_version)
    whole = decode_odometry(data, serialization)
    for length in range(len(data)):
        try:
            # Covariances and velocities, which come last, are not read.
            assert decode_odometry(data[:length], serialization) == whole
        except DecodeError:
            assert length < 120
