from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.advice.measurements import Measurements
from pc2scan.conversion.steps import CloudToScan, ScanToCloud
from pc2scan.core.params import ProjectionParams
from pc2scan.errors import DecodeError
from pc2scan.messages.laserscan import LaserScan, decode_laserscan, encode_laserscan
from pc2scan.request.spec import ScanSpec
from pc2scan.transforms.builder import TransformBuilder
from pc2scan.transforms.placing import Placer
from support import builders
from support.conversions import serialized_by
from support.tables import rows

if TYPE_CHECKING:
    from pc2scan.conversion.steps import Conversion, ConvertedMessage

TABLES = Path(__file__).parent / "times.txt"
SECOND = 1_000_000_000


def cloud(points: Any, ros_version: int = 1, stamp_ns: int = 5 * SECOND) -> bytes:
    return builders.cloud(np.array(points, np.float32), ros_version, seq=9, stamp_ns=stamp_ns)


def scan(ranges: Any, stamp_ns: int = 5 * SECOND, **changes: Any) -> bytes:
    values = {
        "sequence": 9,
        "stamp_ns": stamp_ns,
        "frame_id": "laser",
        "angle_min": -1.0,
        "angle_max": 1.0,
        "angle_increment": 0.5,
        "time_increment": 0.0,
        "scan_time": 0.1,
        "range_min": 0.1,
        "range_max": 30.0,
        "ranges": np.asarray(ranges, np.float32),
    }
    return encode_laserscan(LaserScan(**{**values, **changes}), "ros1")


def frames(target: str, *rows: tuple[str, str, int, float, float]) -> Placer:
    """Frames that move along x and turn about z: parent, child, stamp, x, yaw."""
    builder = TransformBuilder()
    builder.add(
        (
            (parent, child, stamp, x, 0.0, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
            for parent, child, stamp, x, yaw in rows
        ),
        static=False,
    )
    return Placer(target, "", builder.build(), 0)


def once(
    conversion: Conversion, message: bytes, source: str = "ros1", target: str = "ros1", topic: str = "/topic"
) -> ConvertedMessage:
    made: ConvertedMessage = serialized_by(conversion, topic, source, target)(message)
    return made


@pytest.mark.parametrize(
    ("stamp_ns", "first_beam_ns", "expected"),
    [(5 * SECOND, -7, 5 * SECOND - 7), (5 * SECOND, 7, 5 * SECOND + 7), (5, -7, 0), (-SECOND, 0, -SECOND)],
)
def test_a_timed_topic_has_its_own_stamps(stamp_ns: int, first_beam_ns: int, expected: int) -> None:
    params = ProjectionParams(scan_time="auto", time_increment="auto")
    conversion = CloudToScan(ScanSpec(params=params), Placer(), {"/front": Measurements(0.125, -0.25, first_beam_ns)})
    ros_version, serialization = (1, "ros1") if stamp_ns >= 0 else (2, "cdr")
    message = cloud(np.empty((0, 3)), ros_version, stamp_ns)
    read = decode_laserscan(once(conversion, message, serialization, serialization, "/front").message, serialization)
    assert (read.stamp_ns, read.scan_time, read.time_increment) == (expected, 0.125, -0.25)
    other = decode_laserscan(once(conversion, message, serialization, serialization, "/rear").message, serialization)
    assert (other.stamp_ns, other.scan_time, other.time_increment) == (stamp_ns, 0, 0)


@pytest.mark.parametrize(("stamp_ns", "increment", "message"), rows(TABLES, "last beams"))
def test_last_beams_beyond_ros_time_are_an_error(stamp_ns: int, increment: float, message: str) -> None:
    known = frames("odom", ("odom", "laser", SECOND, 1.0, 0.0))
    with pytest.raises(DecodeError, match=message) as caught:
        once(ScanToCloud(None, known, deskewed=True), scan([2.0] * 3, stamp_ns, time_increment=increment))
    assert caught.value.stamp_ns == stamp_ns
