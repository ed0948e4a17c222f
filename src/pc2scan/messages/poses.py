"""Decodes messages that say where a frame is: odometry, poses and single transforms, as far as the pose goes."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from pc2scan.errors import DecodeError

from .wire import Cursor

if TYPE_CHECKING:
    from pc2scan.core.rigid import TransformRow
    from pc2scan.model import Buffer

#: The type of odometry in ROS 2's spelling.
ODOMETRY = "nav_msgs/msg/Odometry"

#: The types in ROS 2's spelling, and whether their messages name the frame that has the pose. In all of them seven
#: float64 follow the frames: translation x, y, z and rotation x, y, z, w.
POSES = {
    ODOMETRY: True,
    "geometry_msgs/msg/TransformStamped": True,
    "geometry_msgs/msg/PoseStamped": False,
    "geometry_msgs/msg/PoseWithCovarianceStamped": False,
}


def decode_pose(data: Buffer, serialization: str, ros_type: str = ODOMETRY) -> TransformRow:
    """Return the pose of a serialised message as a transform.

    Parameters
    ----------
    data
        The whole message.
    serialization
        ``ros1`` or ``cdr``.
    ros_type
        A key of `POSES`.

    Returns
    -------
    TransformRow
        ``header.frame_id``, ``child_frame_id`` (empty if the type has none), ``header.stamp`` in nanoseconds, position,
        orientation x, y, z, w; as the message has them (NaN and zero quaternions included).

    Raises
    ------
    DecodeError
        If the message ends too early, or its encapsulation is unknown.
    """
    cursor = Cursor(data, serialization)
    _, stamp_ns, frame = cursor.header()
    try:
        child = cursor.string() if POSES[ros_type] else ""
        return cast("TransformRow", (frame, child, stamp_ns, *cursor.read("7d")))
    except DecodeError as err:
        err.stamp_ns = stamp_ns
        raise
