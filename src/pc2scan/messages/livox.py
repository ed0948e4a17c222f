"""Livox's own message type, CustomMsg of livox_ros_driver (ROS 1) and livox_ros_driver2 (both ROS versions).

Source of the layout: CustomMsg.msg and CustomPoint.msg of livox_ros_driver2. In ROS 1 points follow each other without
padding. In CDR each begins at a multiple of four bytes, so there is a byte of padding after each but the last one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.points import Points
from pc2scan.errors import DecodeError

from .wire import Cursor

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pc2scan.model import Buffer

#: The bytes of a point without padding, and its fields: type, and place in a point. ``offset_time`` is in nanoseconds
#: after the stamp.
_POINT = 19
_FIELDS = {
    "x": ("f4", 4),
    "y": ("f4", 8),
    "z": ("f4", 12),
    "offset_time": ("u4", 0),
    "reflectivity": ("u1", 16),
    "tag": ("u1", 17),
    "line": ("u1", 18),
}

#: The two lowest pairs of bits of a tag are about noise: particles in the air, and points between two objects. For
#: Horizon, Tele-15, Mid-70 and Avia 1 and 2 mean probably noise, for HAP and Mid-360 2 means so, and 1 perhaps; 0 is a
#: sound point everywhere. The next pair counts returns on the former, so it is not used.
_IS_NOISE = np.array([tag & 3 in (1, 2) or tag >> 2 & 3 in (1, 2) for tag in range(256)])


def livox_decoder(serialization: str) -> Callable[[Buffer], Points]:
    """Return the decoder of messages in a serialisation: ``ros1`` or ``cdr``."""

    def decode(data: Buffer) -> Points:
        return decode_livox(data, serialization)

    return decode


def decode_livox(data: Buffer, serialization: str) -> Points:
    """Decode a serialised CustomMsg.

    Parameters
    ----------
    data
        The whole message.
    serialization
        ``ros1`` or ``cdr``.

    Returns
    -------
    Points
        ``x``, ``y``, ``z`` in metres, ``offset_time``, ``reflectivity``, ``tag`` and ``line``: views of the message.
        Points at (0, 0, 0), and those whose tag says that they are noise, are no returns: their ``x`` is NaN, in a
        copy.

    Raises
    ------
    DecodeError
        If the message ends too early.

    Notes
    -----
    ``point_num`` is ignored: some programs that cut clouds do not change it. The array has a length of its own.
    """
    cursor = Cursor(data, serialization)
    sequence, stamp_ns, frame_id = cursor.header()
    # timebase; point_num, lidar_id, rsvd, and the number of points that follow.
    cursor.read("Q")
    *_, count = cursor.read("I4BI")
    step = _POINT if cursor.ros1 else _POINT + 1
    start, end = cursor.position, cursor.position + count * step - (step - _POINT) * (count > 0)
    if end > len(cursor.data):
        raise DecodeError(
            f"message ends after {len(cursor.data)} bytes, but {count:,} points take bytes {start} to {end}",
            stamp_ns=stamp_ns,
        )
    fields: dict[str, NDArray[Any]] = {
        name: np.ndarray((count,), cursor.byte_order + code, cursor.data, (start + offset) * bool(count), (step,))
        for name, (code, offset) in _FIELDS.items()
    }
    x, y, z = fields["x"], fields["y"], fields["z"]
    missing = _IS_NOISE[fields["tag"]]
    missing |= (x == 0) & (y == 0) & (z == 0)
    if missing.any():
        fields["x"] = np.where(missing, np.float32(np.nan), x)
    return Points(sequence, stamp_ns, frame_id, fields)
