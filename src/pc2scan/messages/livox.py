"""Livox's own message type, CustomMsg of livox_ros_driver (ROS 1) and livox_ros_driver2 (both ROS versions).

Source of the layout: CustomMsg.msg and CustomPoint.msg of livox_ros_driver2. In ROS 1 points follow each other without
padding. In CDR each begins at a multiple of four bytes, so there is a byte of padding after each but the last one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.points import Points
from pc2scan.errors import DecodeError

from .pointcloud2 import CloudFields, PointCloud2, PointField, structured_cloud
from .wire import Cursor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.model import Buffer

#: The bytes of a point without padding, and its fields: place in a point, and PointField's datatype. ``offset_time`` is
#: in nanoseconds after the stamp; reflectivity also has the name that programs know it by.
_POINT = 19
_FIELDS = {
    "x": (4, 7),
    "y": (8, 7),
    "z": (12, 7),
    "offset_time": (0, 6),
    "reflectivity": (16, 2),
    "tag": (17, 2),
    "line": (18, 2),
    "intensity": (16, 2),
}

#: A cloud in CDR begins with the byte before its first point instead of ending with padding after its last one, which
#: the message does not have. So its points are one byte further on.
_LAYOUTS = {
    lead: tuple(PointField(name, lead + offset, kind) for name, (offset, kind) in _FIELDS.items()) for lead in (0, 1)
}

_PACKED_POINT = np.dtype(
    [
        ("offset_time", "<u4"),
        *((axis, "<f4") for axis in "xyz"),
        *((name, "u1") for name in ("reflectivity", "tag", "line")),
    ]
)

#: The points of livox_ros_driver2's own PointCloud2 (``xfer_format`` 0), without padding; time in nanoseconds since
#: 1970. LIO packages read it.
_DRIVER_POINT = np.dtype(
    [
        *((axis, "<f4") for axis in "xyz"),
        *(("intensity", "<f4"), ("tag", "u1"), ("line", "u1"), ("timestamp", "<f8")),
    ]
)

#: The two lowest pairs of bits of a tag are about noise: particles in the air, and points between two objects. For
#: Horizon, Tele-15, Mid-70 and Avia 1 and 2 mean probably noise, for HAP and Mid-360 2 means so, and 1 perhaps; 0 is a
#: sound point everywhere. The next pair counts returns on the former, so it is not used. 1 in the highest pair is a
#: return near to the lens that is distorted (Mid-70); the others reserve it.
_IS_NOISE = bytes(tag & 3 in (1, 2) or tag >> 2 & 3 in (1, 2) or tag >> 6 == 1 for tag in range(256))
_NOISE_BITS = 0b11001111


class LivoxFields(CloudFields):
    """The fields of a CustomMsg."""

    __slots__ = ()

    def recorded(self) -> PointCloud2:
        """Return the points without padding, little-endian."""
        cloud = self.cloud
        if cloud.point_step == _POINT:
            return cloud
        points = np.empty(cloud.points, _PACKED_POINT)
        for name in _PACKED_POINT.names or ():
            points[name] = cloud.field(name)
        header = cloud.sequence, cloud.stamp_ns, cloud.frame_id
        return replace(structured_cloud(*header, points, is_dense=cloud.is_dense), fields=_LAYOUTS[0])

    def as_pointcloud2(self) -> PointCloud2:
        """Return the PointCloud2 that the driver would have published of the same points, also of those with noise."""
        cloud = self.cloud
        points = np.empty(cloud.points, _DRIVER_POINT)
        for name in _DRIVER_POINT.names or ():
            if name != "timestamp":
                points[name] = cloud.field(name)
        # In integers first, because float64 has steps of 256 ns at the present time.
        points["timestamp"] = cloud.field("offset_time").astype(np.int64) + cloud.stamp_ns
        return structured_cloud(cloud.sequence, cloud.stamp_ns, cloud.frame_id, points, is_dense=cloud.is_dense)


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
        ``x``, ``y``, ``z`` in metres, ``offset_time``, ``reflectivity`` (also as ``intensity``), ``tag`` and ``line``:
        views of the message. Points at (0, 0, 0), and those whose tag says that they are noise, are no returns: their
        ``x`` is NaN, in a copy.

    Raises
    ------
    DecodeError
        If the message ends too early.

    Notes
    -----
    The length of the array counts, not ``point_num``: some programs that cut clouds do not change it.
    """
    cursor = Cursor(data, serialization)
    sequence, stamp_ns, frame_id = cursor.header()
    (timebase,) = cursor.read("Q")
    # The last number is that of the points that follow.
    point_num, lidar_id, *reserved, count = cursor.read("I4BI")
    lead = 0 if cursor.ros1 else 1
    step = _POINT + lead
    start, end = cursor.position, cursor.position + count * step - lead * (count > 0)
    if end > len(cursor.data):
        raise DecodeError(
            f"message ends after {len(cursor.data)} bytes, but {count:,} points take bytes {start} to {end}",
            stamp_ns=stamp_ns,
        )
    points = cursor.data[start - lead : end] if count else cursor.data[:0]
    is_bigendian, size = cursor.byte_order == ">", count * step
    header = sequence, stamp_ns, frame_id
    cloud = PointCloud2(*header, 1, count, _LAYOUTS[lead], is_bigendian, step, size, points, True)
    missing = _missing(cloud)
    replaced: dict[str, NDArray[Any]] = {}
    if missing.size:
        # All bytes are copied, so that x, y and z still follow each other, which the projection reads fastest.
        copied = replace(cloud, data=memoryview(bytearray(points)))
        replaced = {axis: copied.field(axis) for axis in "xyz"}
        replaced["x"][missing] = np.nan
    further = {"timebase": timebase, "point_num": point_num, "lidar_id": lidar_id, "rsvd": tuple(reserved)}
    differs = f"its point_num is {point_num:,}, but it has {count:,} points: a program may have removed some"
    lossy = differs if point_num != count else ""
    return Points(sequence, stamp_ns, frame_id, LivoxFields(cloud, replaced, further), lossy=lossy)


def _missing(cloud: PointCloud2) -> NDArray[np.intp]:
    """Return the indices of the points that are no returns."""
    # Contiguous values are compared in a fifth of the time.
    missing = np.flatnonzero(np.ascontiguousarray(cloud.field("x"), np.float32) == 0)
    if missing.size:
        missing = missing[(cloud.field("y")[missing] == 0) & (cloud.field("z")[missing] == 0)]
    tag = cloud.field("tag")
    if np.bitwise_or.reduce(tag) & _NOISE_BITS:
        noise = np.frombuffer(tag.tobytes().translate(_IS_NOISE), np.bool_)
        missing = np.concatenate([missing, np.flatnonzero(noise)])
    return missing
