"""What holds for each type of message that is decoded: it is rosbags' message, in any byte order and any buffer."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

from exports.driving import ODOMETRY_TYPE, START, by_odometry, odometry
from pc2scan.errors import DecodeError
from pc2scan.messages.imu import decode_imu
from pc2scan.messages.laserscan import decode_laserscan
from pc2scan.messages.pointcloud2 import PointField, decode_pointcloud2
from pc2scan.messages.poses import decode_pose
from pc2scan.messages.tfmessage import decode_transforms, encode_transforms
from support.builders import CLOUD, IMU, SCAN, T0, TF, cloud, deserialized, imu_message, scan, typestore

if TYPE_CHECKING:
    from collections.abc import Callable

POINTS = np.arange(6, dtype=np.float32).reshape(2, 3)
RANGES = np.array([1.5, math.inf, math.nan, 0.0], np.float32)
XYZ = tuple(PointField(name, 4 * place, 7) for place, name in enumerate("xyz"))
POSE = (1.0, -2.5, 1e-300, 0.0, 0.0, 0.6, 0.8)
HALF = by_odometry(START)[2] / 2


FORMAT = {1: "ros1", 2: "cdr"}


class Kind(NamedTuple):
    """A type of message, and how one is decoded.

    A message of a ROS version and a frame, its decoder, what it decodes to, and how many bytes are needed if not all.
    """

    msgtype: str
    make: Callable[[int, str], bytes]
    decode: Callable[..., Any]
    content: Callable[[str], tuple[Any, ...]]
    needed: int = 0


KINDS = {
    "cloud": Kind(
        CLOUD,
        lambda version, frame: cloud(POINTS, version, stamp_ns=T0, frame_id=frame),
        decode_pointcloud2,
        lambda frame: (T0, frame, 1, 2, XYZ, False, 12, 24, POINTS.tobytes(), False),
    ),
    "scan": Kind(
        SCAN,
        lambda version, frame: scan(RANGES, version, stamp_ns=T0, frame_id=frame),
        decode_laserscan,
        lambda frame: (T0, frame, *f32(-1.5, 1.5, 1.0, 0.0, 0.1, 0.1, 30.0), RANGES.tobytes(), b""),
    ),
    "transforms": Kind(
        TF,
        lambda version, frame: encode_transforms([(frame, f"{frame}'s child", T0, *POSE)] * 2, FORMAT[version]),
        decode_transforms,
        lambda frame: ((frame, f"{frame}'s child", T0, *POSE),) * 2,
    ),
    # Covariances and velocities, which come last, are not read.
    "odometry": Kind(
        ODOMETRY_TYPE,
        lambda version, frame: odometry(START, version, parent=2 * frame, child=frame),
        decode_pose,
        lambda frame: (2 * frame, frame, START, *by_odometry(START)[:2], 0.0, 0.0, 0.0, math.sin(HALF), math.cos(HALF)),
        needed=120,
    ),
    "imu": Kind(
        IMU,
        lambda version, frame: imu_message(version, frame_id=frame),
        decode_imu,
        lambda frame: (T0, frame, (0.0, 0.6, 0.0, 0.8), (1.0, 2.0, 3.0), (0.1, 0.2, 9.8)),
    ),
}


def f32(*values: float) -> list[float]:
    return [float(value) for value in np.array(values, np.float32)]


def content_of(decoded: Any) -> tuple[Any, ...]:
    """All that a message says, but for ROS 1's sequence numbers."""
    if not is_dataclass(decoded):
        return tuple(decoded)
    names = [field.name for field in fields(decoded) if field.name != "sequence" and not field.name.startswith("_")]
    return tuple(
        bytes(value) if isinstance(value, (np.ndarray, memoryview)) else value
        for value in (getattr(decoded, name) for name in names)
    )


@pytest.mark.parametrize("kind", KINDS)
# Names of every length, so that what follows is aligned in every way.
@pytest.mark.parametrize("frame", ["", "a", "ab", "abc", "abcd", "läser"])
def test_what_rosbags_writes_is_decoded(kind: str, frame: str) -> None:
    msgtype, make, decode, content, _ = KINDS[kind]
    for version, serialization in FORMAT.items():
        data = make(version, frame)
        # rosbags writes the same bytes.
        store, message = typestore(version), deserialized(data, msgtype, version)
        again = store.serialize_ros1(message, msgtype) if version == 1 else store.serialize_cdr(message, msgtype)
        assert bytes(again) == data
        assert content_of(decode(data, serialization)) == content(frame)
        inside = memoryview(b"before" + data + b"behind")[6:-6]
        assert content_of(decode(inside, serialization)) == content(frame)
        if version == 2:
            big = bytes(store.serialize_cdr(message, msgtype, little_endian=False))
            assert content_of(decode(big, serialization)) == content(frame)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("version", FORMAT)
def test_a_message_cut_anywhere_is_an_error(kind: str, version: int) -> None:
    _, make, decode, content, needed = KINDS[kind]
    data = make(version, "map")
    for length in range(len(data)):
        try:
            found = decode(data[:length], FORMAT[version])
        except DecodeError:
            assert not needed or length < needed
        else:
            assert needed
            assert content_of(found) == content("map")


@pytest.mark.parametrize("kind", KINDS)
def test_an_unknown_encapsulation_is_refused(kind: str) -> None:
    data = KINDS[kind].make(2, "map")
    with pytest.raises(DecodeError, match="encapsulation"):
        KINDS[kind].decode(b"\0\7" + data[2:], "cdr")
