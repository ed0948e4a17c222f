from __future__ import annotations

import pytest

from pc2scan.text import did_you_mean, nearest

TOPICS = ["/imu", "/lidar/points", "/velodyne_points", "/tf", "/tf_static"]


@pytest.mark.parametrize(
    ("asked", "found"),
    [
        ("/velodyne_point", "/velodyne_points"),
        ("velodyne-points", "/velodyne_points"),
        ("/VELODYNE_POINTS", "/velodyne_points"),
        ("points", "/lidar/points"),
        ("/robot/lidar/points", "/lidar/points"),
        ("tf_statc", "/tf_static"),
        ("/camera", None),
        ("", None),
        ("/", None),
    ],
)
def test_nearest(asked: str, found: str | None) -> None:
    assert nearest(asked, TOPICS) == found
    assert did_you_mean(asked, TOPICS) == (f"did you mean {found}?" if found else "")


def test_names_of_any_number_and_length_take_no_time() -> None:
    assert nearest("a" * 100_000, (f"{number}" * 1_000 for number in range(10**9))) is None
