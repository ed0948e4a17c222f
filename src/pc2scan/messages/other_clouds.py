"""What a recording without clouds has instead, such as depth images or packets, and what makes clouds of it."""

from __future__ import annotations

import re
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import name_list

from .clouds import CLOUDS, SCANS

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from pc2scan.model import Connection


class _Kind(NamedTuple):
    """A kind of messages: a pattern of its types, without ``msg/``, its name, and how to make clouds or scans of it."""

    types: str
    name: str
    advice: str


#: What makes clouds of messages, by the name of a tool.
_WITH = "play the recording into {}, and record the PointCloud2 that it makes"


_DEPTH = _Kind(
    "sensor_msgs/(Compressed)?Image",
    "depth images",
    "play the recording into depthimage_to_laserscan, which makes scans, or depth_image_proc, which makes clouds",
)

#: In the order in which errors name them. Types that can be converted are skipped, so a row may stay when one can.
_KINDS = (
    _Kind("velodyne_msgs/VelodynePacket", "Velodyne packets", _WITH.format("velodyne_pointcloud")),
    _Kind(r"ouster\w*/PacketMsg", "Ouster packets", f"{_WITH.format('the replay of ouster_ros')}, or use ouster-cli"),
    _Kind(
        r"(hesai\w*|pandar\w*)/(Udp|Pandar|Hesai)\w*", "Hesai packets", _WITH.format("Hesai's driver, hesai_ros_driver")
    ),
    _Kind(r"(rslidar\w*|robosense\w*)/\w+", "RoboSense packets", _WITH.format("RoboSense's driver, rslidar_sdk")),
    _Kind(r"nebula\w*/\w*Packets?", "packets of Nebula's drivers", _WITH.format("Nebula")),
    _Kind(
        r"(foxglove(_msgs)?|sensor_msgs)[/.](\w*PointCloud2?|LaserScan)",
        "clouds or scans in an encoding that is not ROS's",
        "record PointCloud2 with rosbag2, or convert them: mcap's Protobuf and ROS support read and write both",
    ),
    _DEPTH,
    _Kind("stereo_msgs/DisparityImage", "disparity images", _WITH.format("stereo_image_proc")),
    _Kind(
        r"(\w*radar\w*|\w*mmwave\w*|continental_\w+|ars\d\w*|delphi_esr\w*|umrr\w*)"
        r"/\w*(Radar|Detection|Target|Track|Return)\w*",
        "radar detections",
        "the radar's driver may also have a topic with PointCloud2; record that",
    ),
    _Kind("sensor_msgs/Range", "single ranges", "nav2's range_sensor_layer reads them; they make no scan"),
    _Kind(r"\w+/Voxel(Map|Grid)\w*|foxglove[/.]VoxelGrid", "maps of voxels", "record the lidar's own PointCloud2"),
    _Kind("octomap_msgs/Octomap(WithPose)?", "OctoMaps", _WITH.format("octomap_server")),
    _Kind(
        r"\w*(lidar|laser)\w*/\w*(Packet|Udp|Raw)\w*",
        "packets of a lidar",
        _WITH.format("the driver that has these messages"),
    ),
)

#: How many topics an error lists.
_MOST_TOPICS = 5


def instead_of_clouds(connections: Sequence[Connection]) -> tuple[str, str] | None:
    """Return what a recording has instead of clouds and scans, and what makes clouds of it; None for nothing.

    >>> from pc2scan.model import Connection
    >>> instead_of_clouds([Connection(0, "/map", "octomap_msgs/msg/Octomap", "cdr")])[0]
    'OctoMaps: /map'
    """
    others = [
        connection
        for connection in connections
        if connection.ros_version is None or connection.ros_type not in (*CLOUDS, *SCANS)
    ]
    topics: dict[_Kind, dict[str, None]] = {}
    for connection in sorted(others, key=attrgetter("topic")):
        if kind := _kind_of(connection.topic, _type(connection)):
            topics.setdefault(kind, {})[connection.topic] = None
    kinds = [kind for kind in _KINDS if kind in topics][:3]
    if not kinds:
        return None
    what = "; ".join(f"{kind.name}: {name_list(list(topics[kind]), _MOST_TOPICS)}" for kind in kinds)
    if len(kinds) == 1:
        return what, kinds[0].advice
    return what, "; ".join(f"{kind.name}: {kind.advice}" for kind in kinds)


def instead_of_topic(topic: str, types: Collection[str]) -> str:
    """Return what makes clouds of the messages of a topic; empty if nothing is known."""
    kind = next(filter(None, (_kind_of(topic, name) for name in types)), None)
    return f"these are {kind.name}: {kind.advice}" if kind else ""


def _kind_of(topic: str, msgtype: str) -> _Kind | None:
    """Return the kind of a topic's messages; images are depth images if the topic's name says so."""
    name = msgtype.replace("/msg/", "/")
    kind = next((kind for kind in _KINDS if re.fullmatch(kind.types, name)), None)
    return None if kind is _DEPTH and "depth" not in topic.lower() else kind


def without(wanted: str, connections: Sequence[Connection]) -> tuple[str, str]:
    """Return the message that a recording has no topic of a type, and the hint; the hint may be empty.

    Parameters
    ----------
    wanted
        The types, without their packages.
    connections
        All connections of the recording.
    """
    if not connections:
        return "the recording has no topics", ""
    missing = f"the recording has no {wanted} topic"
    scans = sorted(
        {
            connection.topic
            for connection in connections
            if connection.ros_version is not None and connection.ros_type in SCANS
        }
    )
    if scans and "LaserScan" not in wanted:
        return f"{missing}, but 2D scans: {name_list(scans, _MOST_TOPICS)}", ""
    if scans:
        many = f"{missing}, but scans with several echoes: {name_list(scans, _MOST_TOPICS)}"
        return many, "pc2scan convert `rebin=True` makes LaserScans of them"
    if instead := instead_of_clouds(connections):
        return f"{missing}, but {instead[0]}", instead[1]
    types = {f"{connection.topic} ({connection.kind})" for connection in connections}
    if len(types) > _MOST_TOPICS:
        return f"{missing} among its {len({connection.topic for connection in connections})}", "pc2scan info lists them"
    return f"{missing}; its topics are: {name_list(sorted(types))}", ""


def _type(connection: Connection) -> str:
    """Return the type; for messages in other encodings than ROS's, the name of the schema."""
    return connection.ros_type if connection.ros_version is not None else connection.msgtype
