"""Decodes nav_msgs/Odometry, as far as the pose goes."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from .wire import Cursor

if TYPE_CHECKING:
    from pc2scan.core.rigid import TransformRow
    from pc2scan.model import Buffer

#: The type in ROS 2's spelling.
ODOMETRY = "nav_msgs/msg/Odometry"


def decode_odometry(data: Buffer, serialization: str) -> TransformRow:
    """Return the pose of a serialised nav_msgs/Odometry as a transform.

    Parameters
    ----------
    data
        The whole message.
    serialization
        ``ros1`` or ``cdr``.

    Returns
    -------
    TransformRow
        ``header.frame_id``, ``child_frame_id``, ``header.stamp`` in nanoseconds, position, orientation x, y, z, w.

    Raises
    ------
    DecodeError
        If the message ends too early.
    """
    cursor = Cursor(data, serialization)
    _, stamp_ns, frame = cursor.header()
    child = cursor.string()
    return cast("TransformRow", (frame, child, stamp_ns, *cursor.read("7d")))
