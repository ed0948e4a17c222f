"""Recordings of a robot that drives: scans, transforms and odometry messages whose poses are known at any time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.messages.laserscan import LaserScan, encode_laserscan
from support.builders import SCAN, SECOND, TF, Item, Recording, Stream, header, item, serialized, transforms, typestore

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

ODOMETRY_TYPE = "nav_msgs/msg/Odometry"

START = 1_700_000_000_000_000_000

#: What transforms and odometry have samples at: 0, 0.5 and 1 s.
SAMPLES = tuple(START + i * SECOND // 2 for i in range(3))

#: Stamps of scans: before the first sample, between samples, at one, at the last one, behind it.
STAMPS = tuple(START + round(t * SECOND) for t in (-0.1, 0.125, 0.5, 0.75, 1.0, 1.1))
POSED = STAMPS[1:5]

#: Where the laser is on the robot.
MOUNT = (0.2, 0.0, 0.3)

PATTERN = LaserScan(
    0,
    0,
    "laser",
    angle_min=-1.0,
    angle_max=1.0,
    angle_increment=0.25,
    time_increment=0.001,
    scan_time=0.1,
    range_min=0.5,
    range_max=30.0,
    ranges=np.array([1.1, 2.2, np.inf, np.nan, 0.1, 5.5, 31.0, -np.inf, 9.9], np.float32),
    intensities=np.linspace(0, 3, 9, dtype=np.float32),
)


def by_tf(stamp_ns: int) -> tuple[float, float, float]:
    """The robot's pose by the transforms: x, y, yaw."""
    return 2.0 * (stamp_ns - START) / SECOND, -1.0, 0.0


def by_odometry(stamp_ns: int) -> tuple[float, float, float]:
    """The robot's pose by the odometry messages: x, y, yaw."""
    seconds = (stamp_ns - START) / SECOND
    return seconds, 3 * seconds, 0.8 * seconds - 0.3


def odometry(stamp_ns: int, ros_version: int, *, seq: int = 0, parent: str = "odom", child: str = "base_link") -> bytes:
    """A serialised nav_msgs/Odometry."""
    store = typestore(ros_version)
    types = store.types
    x, y, yaw = by_odometry(stamp_ns)
    zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    message = types[ODOMETRY_TYPE](
        header(store, ros_version, seq, stamp_ns, parent),
        child,
        types["geometry_msgs/msg/PoseWithCovariance"](
            types["geometry_msgs/msg/Pose"](
                types["geometry_msgs/msg/Point"](x, y, 0.0),
                types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
            ),
            np.arange(36, dtype=np.float64),
        ),
        types["geometry_msgs/msg/TwistWithCovariance"](
            types["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36, np.float64)
        ),
    )
    return serialized(store, message, ODOMETRY_TYPE, ros_version)


def scan_items(stream: Stream, scans: Iterable[LaserScan]) -> list[Item]:
    """Scans, logged a millisecond after their stamps."""
    return [
        Item(stream, scan.stamp_ns + 1_000_000, {version: encode_laserscan(scan, name) for version, name in _WIRE})
        for scan in scans
    ]


_WIRE = ((1, "ros1"), (2, "cdr"))


def drive(
    topics: Mapping[str, Sequence[LaserScan]] | None = None, *, with_tf: bool = True, child: str = "base_link"
) -> Recording:
    """A drive of one second with scans on /scan, transforms odom <- base_link <- laser, and /odom."""
    pattern = [
        replace(PATTERN, stamp_ns=stamp, ranges=PATTERN.ranges + np.float32(i)) for i, stamp in enumerate(STAMPS)
    ]
    topics = {"/scan": pattern} if topics is None else topics
    items: list[Item] = []
    streams = [Stream(topic, SCAN) for topic in topics]
    for stream, scans in zip(streams, topics.values(), strict=True):
        items += scan_items(stream, scans)
    moved = Stream("/odom", ODOMETRY_TYPE)
    streams.append(moved)
    items += (
        item(moved, stamp, lambda version, seq, stamp=stamp: odometry(stamp, version, seq=seq, child=child))  # type: ignore[misc]
        for stamp in SAMPLES
    )
    if with_tf:
        moving, mount = Stream("/tf", TF), Stream("/tf_static", TF, latched=True)
        streams += [moving, mount]
        rows = [("odom", "base_link", stamp, (by_tf(stamp)[0], by_tf(stamp)[1], 0.0)) for stamp in SAMPLES]
        items += (Item(moving, row[2], {version: transforms([row], version) for version in (1, 2)}) for row in rows)
        fixed = [("base_link", "laser", START, MOUNT)]
        items.append(Item(mount, START - SECOND, {version: transforms(fixed, version) for version in (1, 2)}))
    return Recording(tuple(streams), tuple(sorted(items, key=lambda entry: entry.log_time_ns)))
