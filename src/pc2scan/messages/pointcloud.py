"""Decodes sensor_msgs/PointCloud, which was used before PointCloud2.

Source of the layout: PointCloud.msg, geometry_msgs/Point32.msg and ChannelFloat32.msg: an array of points of three
float32, and for each channel its name and an array of float32, one for each point.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.points import Points
from pc2scan.errors import DecodeError

from .pointcloud2 import MAX_FIELDS
from .wire import Cursor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.model import Buffer

_AXES = ("x", "y", "z")


def decode_pointcloud(data: Buffer, serialization: str) -> Points:
    """Decode a serialised sensor_msgs/PointCloud.

    Parameters
    ----------
    data
        The whole message.
    serialization
        ``ros1`` or ``cdr``.

    Returns
    -------
    Points
        ``x``, ``y`` and ``z`` in metres, and a field for each channel, all of float32: views of the message. Channels
        without a name, or without one value for each point, are no fields; of several with one name, the first is.

    Raises
    ------
    DecodeError
        If the message ends too early or declares more than `MAX_FIELDS` channels.
    """
    cursor = Cursor(data, serialization)
    sequence, stamp_ns, frame_id = cursor.header()
    kind = cursor.byte_order + "f4"
    try:
        (count,) = cursor.read("I")
        table = np.frombuffer(cursor.take(count * 12), kind).reshape(count, 3)
        fields: dict[str, NDArray[Any]] = dict(zip(_AXES, table.T, strict=True))
        (channels,) = cursor.read("I")
        if channels > MAX_FIELDS:
            raise DecodeError(f"the cloud declares {channels} channels, at most {MAX_FIELDS} are allowed")
        for _ in range(channels):
            name = cursor.string()
            (size,) = cursor.read("I")
            values = np.frombuffer(cursor.take(size * 4), kind)
            if size == count and name:
                fields.setdefault(name, values)
    except DecodeError as err:
        err.stamp_ns = stamp_ns
        raise
    return Points(sequence, stamp_ns, frame_id, fields)
