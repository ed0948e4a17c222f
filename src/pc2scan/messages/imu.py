"""Decodes sensor_msgs/Imu, in ROS 1's wire format and in CDR."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from .wire import Cursor

if TYPE_CHECKING:
    from pc2scan.model import Buffer

#: The type in ROS 2's spelling.
IMU = "sensor_msgs/msg/Imu"

#: How far the length of an orientation's quaternion may be from 1.
_UNIT = 0.01


class Imu(NamedTuple):
    """A decoded message; quantities without an estimate are None.

    Source of the rule: REP 145 and the comments of the message: -1 as the first number of a covariance means that
    there is no estimate. An orientation that is not a rotation counts as none, too: some drivers never set it.

    Attributes
    ----------
    stamp_ns
        ``header.stamp``, nanoseconds.
    orientation
        x, y, z, w: ``world_from_imu``, with the world's z up.
    angular_velocity
        Radians per second.
    linear_acceleration
        m/s^2; at rest it points up.
    """

    stamp_ns: int
    frame_id: str
    orientation: tuple[float, ...] | None
    angular_velocity: tuple[float, ...] | None
    linear_acceleration: tuple[float, ...] | None


def decode_imu(data: Buffer, serialization: str) -> Imu:
    """Decode a serialised sensor_msgs/Imu.

    Parameters
    ----------
    data
        The whole message.
    serialization
        ``ros1`` or ``cdr``.

    Raises
    ------
    DecodeError
        If the message ends too early, or its encapsulation is unknown.
    """
    cursor = Cursor(data, serialization)
    _, stamp_ns, frame_id = cursor.header()
    numbers: tuple[float, ...] = cursor.read("37d")
    orientation = _if_known(numbers[:4], numbers[4])
    if orientation is not None and not abs(math.hypot(*orientation) - 1) < _UNIT:
        orientation = None
    turning, acceleration = _if_known(numbers[13:16], numbers[16]), _if_known(numbers[25:28], numbers[28])
    return Imu(stamp_ns, frame_id, orientation, turning, acceleration)


def _if_known(values: tuple[float, ...], first_covariance: float) -> tuple[float, ...] | None:
    return values if first_covariance != -1 and all(map(math.isfinite, values)) else None
