"""The tables of message types: clouds with their decoders to points, and 2D scans.

A new type is one entry, because everything that needs to know which topics can be converted uses these tables.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from importlib import import_module
from typing import TypeAlias

from pc2scan.core.points import Points
from pc2scan.model import Buffer, Connection, RawMessage

from .laserscan import LASERSCAN, LaserScan, decode_laserscan
from .pointcloud2 import POINTCLOUD2, as_pointcloud2, encode_cloud, point_decoder

#: A decoder: returns the points of a message's bytes, or raises a `DecodeError`. Threads may share one.
Decode: TypeAlias = Callable[[Buffer], Points]


def _imported(module: str, function: str, serialization: str) -> Decode:
    """Return the decoder of a module, which is imported here: few recordings have its messages."""
    return partial(getattr(import_module(f"{__package__}.{module}"), function), serialization=serialization)


_LIVOX = partial(_imported, "livox", "decode_livox")
_COMPRESSED = partial(_imported, "compressed_cloud", "decode_compressed_cloud")


#: By ROS type in ROS 2's spelling, the function that makes the decoder of a serialisation (``ros1`` or ``cdr``). A
#: decoder is fastest if it is used for only one topic.
CLOUDS: dict[str, Callable[[str], Decode]] = {
    POINTCLOUD2: point_decoder,
    "livox_ros_driver/msg/CustomMsg": _LIVOX,
    "livox_ros_driver2/msg/CustomMsg": _LIVOX,
    "point_cloud_interfaces/msg/CompressedPointCloud2": _COMPRESSED,
    "draco_point_cloud_transport/msg/CompressedPointCloud2": _COMPRESSED,
    "sensor_msgs/msg/PointCloud": partial(_imported, "pointcloud", "decode_pointcloud"),
    "velodyne_msgs/msg/VelodyneScan": partial(_imported, "velodyne", "decode_velodyne"),
}


#: A decoder of 2D scans.
DecodeScan: TypeAlias = Callable[[Buffer], LaserScan]


def _laserscan(serialization: str, _echo: str) -> DecodeScan:
    return partial(decode_laserscan, serialization=serialization)


def _multi_echo(serialization: str, echo: str) -> DecodeScan:
    from .multi_echo import decode_multi_echo  # noqa: PLC0415  # few recordings have them

    return partial(decode_multi_echo, serialization=serialization, echo=echo)


#: 2D scans by ROS type: the function that makes the decoder of a serialisation and an echo (``first``, ``last`` or
#: ``strongest``), which types with one range for each beam ignore.
SCANS: dict[str, Callable[[str, str], DecodeScan]] = {
    LASERSCAN: _laserscan,
    "sensor_msgs/msg/MultiEchoLaserScan": _multi_echo,
}


def decoded(message: RawMessage) -> Points | LaserScan:
    """Return the points of a message with a cloud, or its scan; of several echoes, the first."""
    msgtype, serialization = message.connection.ros_type, message.connection.serialization
    decode = SCANS[msgtype](serialization, "first") if msgtype in SCANS else CLOUDS[msgtype](serialization)
    return decode(message.data)


def written_as_pointcloud2(connection: Connection) -> bool:
    """Return whether the messages of a connection are clouds that another message type can hold, PointCloud2."""
    return connection.ros_version is not None and connection.ros_type in CLOUDS and connection.ros_type != POINTCLOUD2


def to_pointcloud2(connection: Connection, serialization: str) -> Callable[[Buffer], bytes]:
    """Return what makes serialised PointCloud2 messages of a connection's clouds; it raises a `DecodeError`.

    Parameters
    ----------
    serialization
        The serialisation of the new messages: ``ros1`` or ``cdr``.
    """
    decode = CLOUDS[connection.ros_type](connection.serialization)
    return lambda data: encode_cloud(as_pointcloud2(decode(data)), serialization)


#: Types of topics that are often recorded beside a PointCloud2 with the same points, or are no lidar's cloud.
SECONDARY = frozenset(CLOUDS) - {POINTCLOUD2, "livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg"} | {
    "sensor_msgs/msg/MultiEchoLaserScan"
}


def usual_topics(types: Mapping[str, Collection[str]], kinds: Collection[str]) -> list[str]:
    """Return the topics that are used if none is chosen: those with a type of ``kinds``.

    Topics of `SECONDARY` types are used only if there are no others.

    Parameters
    ----------
    types
        The types of each topic of a recording.
    """
    wanted = set(kinds)
    topics = [topic for topic, own in types.items() if not wanted.isdisjoint(own)]
    return [topic for topic in topics if not (wanted - SECONDARY).isdisjoint(types[topic])] or topics
