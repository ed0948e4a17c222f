from __future__ import annotations

import pytest

from pc2scan.bags.topics import find_topic, matches

CLOUD = "sensor_msgs/msg/PointCloud2"
TYPES = {"/points": {CLOUD}, "camera/points": {CLOUD}, "/imu": {"sensor_msgs/msg/Imu"}}
CLOUDS = ["/points", "camera/points"]


@pytest.mark.parametrize(
    ("asked", "found"), [("/points", "/points"), ("points", "/points"), ("/camera/points", "camera/points")]
)
def test_a_leading_slash_is_no_difference(asked: str, found: str) -> None:
    assert find_topic(asked, TYPES, CLOUDS, CLOUD) == found


@pytest.mark.parametrize(
    ("pattern", "found"),
    [("/cam/points", True), ("cam/*", True), ("/cam/[p]oints", True), ("cam", False), ("*/scan", False)],
)
def test_topics_match_names_and_globs(pattern: str, found: bool) -> None:
    assert matches("/cam/points", ["/other", pattern]) is found
