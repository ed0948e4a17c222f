"""Reads and replaces the stamps of serialised messages, and moves the points' own times of clouds along with them."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.timing import TIME_FIELDS, absolute_times

from .clouds import SCANS
from .imu import IMU
from .pointcloud2 import POINTCLOUD2, decode_pointcloud2
from .poses import POSES
from .wire import Cursor

if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Any

    from numpy.typing import NDArray

    from pc2scan.model import Buffer

#: Types besides clouds that begin with a header, in ROS 2's spelling.
STAMPED = frozenset({IMU, *SCANS, *POSES})

#: The layout of a stamp, and the largest number of its seconds.
_STAMPS = {"ros1": ("<II", 2**32 - 1), "<": ("<iI", 2**31 - 1), ">": (">iI", 2**31 - 1)}

#: Velodyne's packets, which have a time each, and the size of one.
_PACKETS = "velodyne_msgs/msg/VelodyneScan"
_PACKET_BYTES = 1206


def stamp_in(data: Buffer | bytearray, serialization: str) -> int:
    """Return the stamp of a message that begins with a header, nanoseconds.

    Raises
    ------
    DecodeError
        If it ends too early, or its encapsulation is unknown.
    """
    return Cursor(memoryview(data), serialization).stamp()[1]


def set_stamp(data: bytearray, serialization: str, stamp_ns: int) -> bool:
    """Replace the stamp of a message that begins with a header, in place; return whether the stamp fits.

    One that the message cannot hold becomes the nearest one that it can, except 0, which means the latest time.

    Raises
    ------
    DecodeError
        If the message ends too early, or its encapsulation is unknown.
    """
    cursor = Cursor(memoryview(data), serialization)
    cursor.stamp()
    layout, most = _STAMPS["ros1" if cursor.ros1 else cursor.byte_order]
    fitting_ns = min(max(stamp_ns, 1), most * 1_000_000_000 + 999_999_999)
    struct.pack_into(layout, data, cursor.position - 8, *divmod(fitting_ns, 1_000_000_000))
    return fitting_ns == stamp_ns


def move_times(data: bytearray, serialization: str, ros_type: str, shift_ns: int, names: Iterable[str] = ()) -> None:
    """Move the absolute times of points and packets in a message, in place; its stamp is left.

    Parameters
    ----------
    data
        The message, with its own stamp.
    shift_ns
        What is added, nanoseconds.
    names
        Fields with times besides `TIME_FIELDS`.

    Raises
    ------
    DecodeError
        If the message cannot be decoded.
    """
    if ros_type == POINTCLOUD2:
        move_point_times(data, serialization, shift_ns, names)
    elif ros_type == _PACKETS:
        _move_packet_times(data, serialization, shift_ns)


def _move_packet_times(data: bytearray, serialization: str, shift_ns: int) -> None:
    """Move the times of the packets of a VelodyneScan in place."""
    cursor = Cursor(memoryview(data), serialization)
    cursor.header()
    (count,) = cursor.read("I")
    layout, most = _STAMPS["ros1" if cursor.ros1 else cursor.byte_order]
    for _ in range(count):
        seconds, nanoseconds = cursor.read("II" if cursor.ros1 else "iI")
        moved_ns = min(max(seconds * 1_000_000_000 + nanoseconds + shift_ns, 0), most * 1_000_000_000)
        struct.pack_into(layout, data, cursor.position - 8, *divmod(moved_ns, 1_000_000_000))
        cursor.take(_PACKET_BYTES)


def move_point_times(data: bytearray, serialization: str, shift_ns: int, names: Iterable[str] = ()) -> None:
    """Move the points' own times of a PointCloud2 in place, where they are absolute.

    Times that count from the stamp stay as they are. Times that are 0 among absolute ones mean that there is none.

    Parameters
    ----------
    data
        The message, with its own stamp.
    shift_ns
        What is added, nanoseconds.
    names
        Fields with times besides `TIME_FIELDS`.

    Raises
    ------
    DecodeError
        If the message cannot be decoded.
    """
    cloud = decode_pointcloud2(memoryview(data), serialization)
    present = {field.name for field in cloud.fields}
    for name in dict.fromkeys((*TIME_FIELDS, *names)):
        if name in present:
            _move(data, cloud.field(name), cloud.stamp_ns, shift_ns)


def _move(data: bytearray, values: NDArray[Any], stamp_ns: int, shift_ns: int) -> None:
    """Move the values of one field, which is a view of the message."""
    # Neither a float32 nor an integer of 32 bits can tell moments since 1970 apart.
    absolute = absolute_times(values, stamp_ns) if values.dtype.itemsize == 8 else None
    if absolute is None:
        return
    _, unit = absolute
    own = writable(data, values)
    own[own != 0] += shift_ns / round(1e9 * unit)


def writable(data: bytearray, values: NDArray[Any]) -> NDArray[Any]:
    """Return the values of a field, a view of a message, as a view that changes the message."""
    begin = values.__array_interface__["data"][0] - np.frombuffer(data, np.uint8).__array_interface__["data"][0]
    return np.ndarray(values.shape, values.dtype, data, begin if values.size else 0, values.strides)
