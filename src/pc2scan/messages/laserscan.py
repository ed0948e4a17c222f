"""Decodes and encodes sensor_msgs/LaserScan."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.consumers import ConsumerScan

from .wire import Cursor, Packer

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.model import Buffer

#: The type in ROS 2's spelling.
LASERSCAN = "sensor_msgs/msg/LaserScan"

_FLOAT32 = np.dtype("<f4")
_COUNT = struct.Struct("<I")
_EMPTY = _COUNT.pack(0)


def _no_values() -> NDArray[np.float32]:
    return np.empty(0, np.float32)


# Not frozen, although it is never changed, because a frozen dataclass takes three times as long to make.
@dataclass(slots=True, eq=False)
class LaserScan:
    """A decoded scan. All angles, times and ranges are float32 in the message.

    Attributes
    ----------
    sequence
        ROS 1's ``header.seq``; 0 from ROS 2.
    stamp_ns
        ``header.stamp``, nanoseconds.
    angle_min, angle_max, angle_increment
        Radians.
    time_increment, scan_time
        Seconds between beams, and between scans.
    range_min, range_max
        Metres.
    ranges
        float32, shape (beams,), metres.
    intensities
        float32, empty or as long as ``ranges``.
    """

    sequence: int
    stamp_ns: int
    frame_id: str
    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    ranges: NDArray[np.float32]
    intensities: NDArray[np.float32] = field(default_factory=_no_values)


def decode_laserscan(data: Buffer, serialization: str) -> LaserScan:
    """Decode a serialised sensor_msgs/LaserScan.

    Parameters
    ----------
    data
        The whole message.
    serialization
        ``ros1`` or ``cdr``.

    Returns
    -------
    LaserScan
        Its arrays are views if the byte order allows.

    Raises
    ------
    DecodeError
        If the message ends too early.
    """
    cursor = Cursor(data, serialization)
    header, geometry = cursor.header(), cursor.read("7f")
    dtype = np.dtype(cursor.byte_order + "f4")
    arrays = []
    for _ in ("ranges", "intensities"):
        (count,) = cursor.read("I")
        arrays.append(np.frombuffer(cursor.take(count * 4), dtype).astype(np.float32, copy=False))
    return LaserScan(*header, *geometry, *arrays)


def encode_laserscan(scan: LaserScan, serialization: str) -> bytes:
    """Serialise a scan; values beyond float32 become infinite.

    Parameters
    ----------
    serialization
        ``ros1`` or ``cdr``.
    """
    packer = Packer(serialization)
    packer.header(scan.sequence, scan.stamp_ns, scan.frame_id)
    geometry = (
        *(scan.angle_min, scan.angle_max, scan.angle_increment, scan.time_increment, scan.scan_time),
        *(scan.range_min, scan.range_max),
    )
    try:
        packer.write("7f", *geometry)
    except OverflowError:
        # Their place is aligned by now.
        with np.errstate(over="ignore"):
            packer.raw(np.array(geometry).astype("<f4").tobytes())
    # From the geometry on, everything is aligned in both formats.
    for values in (scan.ranges, scan.intensities):
        if not len(values):
            packer.raw(_EMPTY)
            continue
        packer.raw(_COUNT.pack(len(values)))
        packer.raw((values if values.dtype is _FLOAT32 else values.astype(_FLOAT32)).tobytes())
    return packer.finish()


def scan_for_consumers(message: LaserScan) -> ConsumerScan:
    """Return a decoded scan in the form that the consumers' rules need."""
    names = ("angle_min", "angle_max", "angle_increment", "range_min", "range_max", "scan_time", "time_increment")
    header = {name: getattr(message, name) for name in names}
    return ConsumerScan.of(message.ranges, **header, intensities=len(message.intensities))
