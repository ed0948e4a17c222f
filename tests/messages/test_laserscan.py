from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rosbags.typesys import Stores, get_typestore

from pc2scan.messages.laserscan import LASERSCAN, LaserScan, encode_laserscan

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_JAZZY)

FLOATS = arrays(np.float32, st.integers(0, 20), elements=st.floats(width=32))


def floats(*values: float) -> Any:
    return np.array(values, np.float32)


def scan(ranges: Any, intensities: Any, frame: str = "laser", stamp_ns: int = 5_000_000_006) -> LaserScan:
    return LaserScan(3, stamp_ns, frame, -1.5, 1.5, 0.25, 0.0, 0.1, 0.2, 30.0, ranges, intensities)


@pytest.mark.parametrize(("serialization", "store"), [("ros1", ROS1), ("cdr", ROS2)])
@given(ranges=FLOATS, intensities=FLOATS, frame=st.sampled_from(["", "a", "ab", "abc", "abcd", "läser"]))
def test_rosbags_reads_and_writes_the_same_bytes(
    serialization: str, store: Any, ranges: Any, intensities: Any, frame: str
) -> None:
    encoded = encode_laserscan(scan(ranges, intensities, frame), serialization)
    if serialization == "ros1":
        read = store.deserialize_ros1(encoded, LASERSCAN)
        assert bytes(store.serialize_ros1(read, LASERSCAN)) == encoded
        assert read.header.seq == 3
    else:
        read = store.deserialize_cdr(encoded, LASERSCAN)
        assert bytes(store.serialize_cdr(read, LASERSCAN)) == encoded
    assert read.header.frame_id == frame
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == (5, 6)
    assert read.ranges.tobytes() == ranges.tobytes()
    assert read.intensities.tobytes() == intensities.tobytes()
    assert (read.angle_min, read.angle_increment, read.range_max) == (-1.5, 0.25, 30.0)
    assert read.scan_time == pytest.approx(0.1, abs=1e-8)  # rounded to float32
