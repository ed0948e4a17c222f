"""Which way is up: by a frame, and by an IMU's messages; and level placements."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pc2scan.core.rigid import Rigid
from pc2scan.errors import TransformError
from pc2scan.transforms.attitude import UpEstimate
from pc2scan.transforms.placing import Placer, UpByFrame, UpByImu
from transforms.trees import EPOCH, SECOND, built, row

TILTED = Rigid.from_rpy(0.2, -0.1, 1.3, (4.0, 5.0, 0.0))
MOUNT = Rigid.from_rpy(0.0, 0.0, math.pi / 2, (0.5, 0.0, 1.0))


def frames(target: str = "base") -> Placer:
    rows = [
        (row("odom", "base", EPOCH, Rigid.identity().pose), False),
        (row("odom", "base", EPOCH + SECOND, TILTED.pose), False),
        (row("base", "lidar", 0, MOUNT.pose), True),
        (row("base", "imu", 0, Rigid.from_rpy(math.pi, 0, 0).pose), True),
    ]
    buffer = built(rows)
    return Placer(target, "", buffer, 0, UpByFrame("odom", buffer))


def by_imu(up: tuple[float, float, float] = (0.0, 0.6, -0.8), frame: str = "imu", tolerance_ns: int = 0) -> UpByImu:
    stamps = EPOCH + np.array([0, 100, 200, 1000], np.int64) * 1_000_000
    ups = np.array([up, up, (0.0, 0.0, -1.0), up])
    buffer = frames().buffer
    assert buffer is not None
    return UpByImu(UpEstimate("/imu", frame, stamps, ups), buffer, tolerance_ns)


@pytest.mark.parametrize("frame", ["base", "/base"])
def test_points_are_in_the_level_frame_of_the_target_frame(frame: str) -> None:
    known = frames(frame)
    place = known.place("lidar", EPOCH + SECOND)
    assert place.frame_id == f"{frame}_stabilized"
    assert place.target_from_source is not None
    assert place.level is not None
    point = np.array([[1.0, 2.0, 3.0]])
    in_odom = TILTED.compose(MOUNT).apply(point)
    # The level frame has the position and the yaw of base.
    expected = Rigid.from_rpy(0, 0, 1.3, TILTED.translation).inverse().apply(in_odom)
    np.testing.assert_allclose(place.target_from_source.apply(point), expected, atol=1e-12)
    # And is connected with it.
    np.testing.assert_allclose(place.level.frame_from_level.apply(expected), MOUNT.apply(point), atol=1e-12)
    assert place.level.tilt == pytest.approx(math.acos(math.cos(0.2) * math.cos(0.1)))


def test_up_by_an_imu_is_turned_to_the_frame_and_interpolated() -> None:
    up = by_imu()
    # The IMU is mounted upside down.
    np.testing.assert_allclose(up("base", EPOCH), (0, -0.6, 0.8), atol=1e-12)
    np.testing.assert_allclose(up("base", EPOCH + 50_000_000), (0, -0.6, 0.8), atol=1e-12)
    np.testing.assert_allclose(up("base", EPOCH + 150_000_000), (0, -0.3, 0.9), atol=1e-12)
    np.testing.assert_allclose(up("imu", EPOCH + 200_000_000), (0, 0, -1), atol=1e-12)
    np.testing.assert_allclose(up("/imu", EPOCH + SECOND), (0, 0.6, -0.8), atol=1e-12)


def test_outside_of_the_imu_and_in_its_gaps_nothing_is_known() -> None:
    up = by_imu(tolerance_ns=10_000_000)
    assert up("imu", EPOCH - 10_000_000) == (0.0, 0.6, -0.8)
    for stamp_ns in (EPOCH - 10_000_001, 5):
        with pytest.raises(TransformError, match=r"the nearest messages on /imu are at 1\d+\.0+, the tolerance"):
            up("imu", stamp_ns)
    with pytest.raises(TransformError, match=r"at 1\d+\.20+ and 1\d+\.0+, the tolerance"):
        up("imu", EPOCH + 500_000_000)
