"""Clouds in another unit than metres: their coordinates are multiplied as they are read, for everything else."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.bags.reader import ChangedReader
from pc2scan.errors import DecodeError, UsageError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.pointcloud2 import POINTCLOUD2, CloudFields, encode_cloud, pack_cloud
from pc2scan.messages.stamps import writable

if TYPE_CHECKING:
    from pc2scan.bags.reader import Reader
    from pc2scan.model import RawMessage

#: Messages that have the coordinates as numbers; those of others are compressed, or computed of packets.
_TYPES = (
    *(POINTCLOUD2, "sensor_msgs/msg/PointCloud"),
    *("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg"),
)


def scaled(reader: Reader, factor: float) -> Reader:
    """Return a recording with multiplied coordinates of clouds; the recording itself if the factor is 1.

    Raises
    ------
    UsageError
        If the factor is not positive, or no message has coordinates.
    """
    if factor == 1:
        return reader
    if not 0 < factor < math.inf:
        raise UsageError(
            f"`cloud_scale` is {factor:g}, it must be above 0", hint="for millimetres: `cloud_scale=0.001`"
        )
    clouds = [each for each in reader.connections if each.ros_type in _TYPES and each.ros_version is not None]
    if not clouds:
        raise UsageError("`cloud_scale` has no effect: no message has coordinates of points", path=reader.path)
    return ChangedReader(reader, {each.id: partial(_scaled, factor) for each in clouds})


def _scaled(factor: float, message: RawMessage) -> RawMessage:
    """Return a message with multiplied coordinates; one that cannot be decoded stays as it is."""
    connection, copy = message.connection, bytearray(message.data)
    try:
        points = CLOUDS[connection.ros_type](connection.serialization)(memoryview(copy))
        fields = points.fields
        axes = fields.cloud.xyz() if isinstance(fields, CloudFields) else points.xyz()
        with np.errstate(all="ignore"):
            if all(axis.dtype.kind == "f" for axis in axes):
                for axis in axes:
                    own = writable(copy, axis)
                    np.multiply(own, factor, out=own, dtype=np.float64, casting="same_kind")
            elif isinstance(fields, CloudFields):
                # Integers cannot hold metres.
                columns = {name: (axis * factor).astype(np.float32) for name, axis in zip("xyz", axes, strict=True)}
                cloud, width = pack_cloud(points.replace(columns, points.frame_id)), fields.cloud.width
                row_step = width * cloud.point_step
                cloud = replace(cloud, height=fields.cloud.height, width=width, row_step=row_step)
                return message._replace(data=encode_cloud(cloud, connection.serialization))
    except DecodeError:
        return message
    return message._replace(data=bytes(copy))
