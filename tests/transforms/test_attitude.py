"""Up by the messages of IMUs: good ones, and those that drivers really send."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.bags.observers import observe
from pc2scan.errors import UsageError
from pc2scan.model import Connection
from pc2scan.transforms.attitude import ImuReading
from support.builders import imu_message
from support.memory_reader import MemoryReader
from support.worlds.inertial import Simulated, errors, simulated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.transforms.attitude import UpEstimate

EPOCH = 1_700_000_000_000_000_000
LEVEL = (0.0, 0.0, 0.0, 1.0)


def recording(*messages: dict[str, Any], ros_version: int = 2) -> MemoryReader:
    """A recording of an IMU; ``messages`` are arguments of `imu_message`."""
    kind, serialization = ("sensor_msgs/Imu", "ros1") if ros_version == 1 else ("sensor_msgs/msg/Imu", "cdr")
    rows = [
        (0, place, each["raw"] if "raw" in each else imu_message(ros_version, **each))
        for place, each in enumerate(messages)
    ]
    return MemoryReader(Path("made"), [Connection(0, "/imu", kind, serialization)], rows)


def of(world: Simulated, **further: Any) -> list[dict[str, Any]]:
    """Messages of an IMU that measures no orientation."""
    return [
        {"stamp_ns": EPOCH + stamp, "first": (-1.0, 0.0, 0.0), "turning": turning, "acceleration": acceleration}
        | further
        for stamp, turning, acceleration in zip(
            world.stamps_ns.tolist(), world.turning.tolist(), world.acceleration.tolist(), strict=True
        )
    ]


def orientations(ups: NDArray[np.float64]) -> list[tuple[float, ...]]:
    """Quaternions that take ups to z."""
    made = []
    for up in ups:
        axis = np.cross(up, (0.0, 0.0, 1.0))
        quaternion = np.array([*axis, 1 + up[2]])
        made.append(tuple((quaternion / np.linalg.norm(quaternion)).tolist()))
    return made


def read(recorded: MemoryReader) -> UpEstimate:
    reading = ImuReading([recorded], "/imu")
    observe((recorded, reading.observers(recorded)))
    return reading.up()


@pytest.mark.parametrize("ros_version", [1, 2])
def test_valid_orientations_are_up(ros_version: int) -> None:
    world = simulated(2)
    messages = [
        each | {"orientation": turned, "first": (0.0, 0.0, 0.0)}
        for each, turned in zip(of(world), orientations(world.ups), strict=True)
    ]
    found = read(recording(*messages, ros_version=ros_version))
    assert (found.topic, found.frame) == ("/imu", "imu_link")
    assert found.stamps_ns.tolist() == (EPOCH + world.stamps_ns).tolist()
    np.testing.assert_allclose(found.directions, world.ups, atol=1e-12)
    assert found.notes == ("/imu: up is computed from the orientations of 200 messages",)
    assert (found.warnings, found.is_felt) == ((), False)


@pytest.mark.parametrize(
    ("further", "why"),
    [
        ({}, "none has a valid orientation"),
        ({"first": (0.0, 0.0, 0.0), "orientation": (0, 0, 0, 0)}, "none has a valid orientation"),
        ({"first": (0.0, 0.0, 0.0), "orientation": LEVEL}, "its orientation never changes"),
    ],
)
def test_without_them_gyroscope_and_accelerometer_are(further: dict[str, Any], why: str) -> None:
    world = simulated(20)
    found = read(recording(*of(world, **further)))
    assert errors(found.directions, world.ups).max() < 0.8
    note = f"/imu: up is estimated from gyroscope and accelerometer of 2,000 messages: {why}"
    assert (found.notes, found.is_felt) == ((note,), True)


def test_messages_out_of_order_repeated_and_damaged() -> None:
    world = simulated(5)
    messages = of(world)
    whole = read(recording(*messages))
    messages[10:12] = [messages[11], messages[10]]
    found = read(recording(*messages, messages[7], {"raw": b"\0\1\0\0abc"}))
    assert found.directions.tobytes() == whole.directions.tobytes()
    assert any("1 message cannot be decoded" in warning for warning in found.warnings)


def test_an_orientation_in_a_world_whose_z_is_down_is_reported() -> None:
    world = simulated(2)
    messages = [
        each | {"orientation": turned, "first": (0.0, 0.0, 0.0)}
        for each, turned in zip(of(world), orientations(-world.ups), strict=True)
    ]
    (warning,) = read(recording(*messages)).warnings
    assert "is 179 degrees from up by its accelerometer" in warning


@pytest.mark.parametrize(
    ("messages", "message"),
    [
        (of(simulated(2), acceleration=(0.0, 0.0, 0.0)), "is 0 m/s\\^2, gravity is 9.807"),
        (of(simulated(2), acceleration=(0.0, 0.3, 0.4)), "is 0.5 m/s"),
        (of(simulated(2), acceleration=(0.0, 0.0, 9806.0)), "is 9.81e\\+03 m/s"),
        (of(simulated(2), turning=(0.0, 0.0, 0.0)), "the gyroscope always shows 0"),
        (of(simulated(2), first=(-1.0, -1.0, 0.0)), "none has both an angular velocity and an acceleration"),
    ],
)
def test_what_shows_no_up_is_refused(messages: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(UsageError, match=message) as refused:
        read(recording(*messages))
    assert "fixed_frame=odom" in (refused.value.hint or "")
