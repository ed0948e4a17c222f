"""A robot that drives, with clouds of its lidar, and its poses as any kind of message or file; made by rosbags."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from support.builders import (
    MOUNT,
    POINTS,
    SECOND,
    T0,
    TF,
    Item,
    Recording,
    Stream,
    fixed,
    header,
    item,
    points,
    serialized,
    typestore,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

#: The types of messages with poses.
KINDS = {
    "odometry": "nav_msgs/msg/Odometry",
    "transform": "geometry_msgs/msg/TransformStamped",
    "pose": "geometry_msgs/msg/PoseStamped",
    "covariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "tf": TF,
}

#: The stamps of the poses: every 40 ms, from before the first cloud until after the last one.
SAMPLES = [T0 + step * 40_000_000 for step in range(-2, 14)]


def pose_at(stamp_ns: int) -> tuple[float, ...]:
    """The robot's pose: x, y, z, and x, y, z, w of its rotation."""
    t = (stamp_ns - T0) / SECOND
    yaw, roll = 0.9 * t + 0.2, 0.1 * math.sin(7 * t)
    q = (
        math.sin(roll / 2) * math.cos(yaw / 2),
        math.sin(roll / 2) * math.sin(yaw / 2),
        math.cos(roll / 2) * math.sin(yaw / 2),
        math.cos(roll / 2) * math.cos(yaw / 2),
    )
    return (1.7 * t, 0.3 * t * t - 1, 0.05, *q)


def message(
    kind: str, ros_version: int, seq: int, stamp_ns: int, frames: tuple[str, str], pose: Sequence[float]
) -> bytes:
    """A serialised message of one of `KINDS`."""
    store = typestore(ros_version)
    types, head = store.types, header(store, ros_version, seq, stamp_ns, frames[0])
    quaternion = types["geometry_msgs/msg/Quaternion"](*pose[3:])
    here = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](*pose[:3]), quaternion)
    spread = types["geometry_msgs/msg/PoseWithCovariance"](here, np.arange(36, dtype=np.float64))
    vector = types["geometry_msgs/msg/Vector3"]
    moved = types["geometry_msgs/msg/Transform"](vector(*pose[:3]), quaternion)
    still = types["geometry_msgs/msg/Twist"](vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0))
    one = types["geometry_msgs/msg/TransformStamped"](head, frames[1], moved)
    made: Any = {
        "odometry": lambda: types[KINDS["odometry"]](
            head, frames[1], spread, types["geometry_msgs/msg/TwistWithCovariance"](still, np.zeros(36))
        ),
        "transform": lambda: one,
        "pose": lambda: types[KINDS["pose"]](head, here),
        "covariance": lambda: types[KINDS["covariance"]](head, spread),
        "tf": lambda: types[TF]([one]),
    }[kind]()
    return serialized(store, made, KINDS[kind], ros_version)


def recording(
    *kinds: str,
    frames: tuple[str, str] = ("odom", "base_link"),
    topic: str = "",
    mounted: bool = True,
    offset_ns: int = 0,
    pose: Callable[[int], Sequence[float]] = pose_at,
    extra: Sequence[Item] = (),
) -> Recording:
    """Five clouds of a lidar, and poses of these kinds, on ``/tf`` or on a topic named like the kind.

    ``offset_ns`` is what the lidar's clock is ahead of all others.
    """
    streams, items = [POINTS], []
    if mounted:
        streams.append(MOUNT)
        items.append(fixed(MOUNT, SAMPLES[0] - 5, "lidar", 0.5))
    for kind in kinds:
        stream = Stream("/tf" if kind == "tf" else topic or f"/{kind}", KINDS[kind])
        streams.append(stream)
        items += (
            item(
                stream,
                stamp_ns + 2_000_003,
                lambda version, seq, kind=kind, stamp_ns=stamp_ns: message(  # type: ignore[misc]
                    kind, version, seq, stamp_ns, frames, pose(stamp_ns)
                ),
                seq=number,
            )
            for number, stamp_ns in enumerate(SAMPLES)
        )
    for step in range(5):
        stamp_ns = T0 + step * SECOND // 10
        items.append(points(stamp_ns + 5_000_003, stamp_ns + offset_ns, step))
    items += extra
    streams += dict.fromkeys(each.stream for each in extra if each.stream not in streams)
    return Recording(tuple(streams), tuple(sorted(items, key=lambda entry: entry.log_time_ns)))
