"""Recordings of a simulated robot that drives through two rooms with a laser scanner, ray-cast without pc2scan."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pc2scan.core.rigid import Rigid
from pc2scan.messages.laserscan import LaserScan, encode_laserscan
from pc2scan.messages.tfmessage import encode_transforms
from support.builders import SCAN, SECOND, T0, TF, Item, Recording, Stream

Wall = tuple[float, float, float, float]

#: Two rooms, 6 m by 5 m and 4 m by 5 m, with a door of 1.2 m between them, and a pillar: x and y of both ends.
ROOMS: tuple[Wall, ...] = (
    (-2.02, -2.48, 8.03, -2.48),
    (8.03, -2.48, 8.03, 2.53),
    (8.03, 2.53, -2.02, 2.53),
    (-2.02, 2.53, -2.02, -2.48),
    (4.01, -2.48, 4.01, -0.61),
    (4.01, 0.62, 4.01, 2.53),
    (1.22, 1.02, 1.58, 1.02),
    (1.58, 1.02, 1.58, 1.38),
    (1.58, 1.38, 1.22, 1.38),
    (1.22, 1.38, 1.22, 1.02),
)


class Pose(NamedTuple):
    """Of the robot's base in the world."""

    x: float
    y: float
    heading: float


#: Where the scanner is on the robot: x, y, heading.
MOUNT = Pose(0.2, 0.0, 0.3)
#: Of the scanner.
_FROM, _TO = math.radians(-135), math.radians(135)


def cast(x: float, y: float, angle: float) -> float:
    """The distance to the nearest wall, one beam at a time."""
    ahead, left = math.cos(angle), math.sin(angle)
    nearest = math.inf
    for x0, y0, x1, y1 in ROOMS:
        ex, ey = x1 - x0, y1 - y0
        across = ahead * ey - left * ex
        if abs(across) < 1e-12:
            continue
        along = ((x0 - x) * ey - (y0 - y) * ex) / across
        share = ((x0 - x) * left - (y0 - y) * ahead) / across
        if along > 1e-9 and 0 <= share <= 1:
            nearest = min(nearest, along)
    return nearest


def distance_to_wall(x: float, y: float) -> float:
    """How far a place is from the nearest wall."""
    nearest = math.inf
    for x0, y0, x1, y1 in ROOMS:
        ex, ey = x1 - x0, y1 - y0
        share = min(1.0, max(0.0, ((x - x0) * ex + (y - y0) * ey) / (ex * ex + ey * ey)))
        nearest = min(nearest, math.hypot(x0 + share * ex - x, y0 + share * ey - y))
    return nearest


def is_inside(x: float, y: float) -> bool:
    """Whether a place is in one of the rooms, and not in the pillar."""
    in_pillar = 1.22 < x < 1.58 and 1.02 < y < 1.38
    return -2.02 < x < 8.03 and -2.48 < y < 2.53 and not in_pillar


def drive(seconds: float) -> Pose:
    """Where the robot is: through the door, with curves."""
    share = seconds / 8
    return Pose(-1 + 7 * share, -0.3 * math.sin(2 * math.pi * share) + 0.05, 0.6 * math.sin(5 * math.pi * share))


def composed(a: Pose, b: Pose) -> Pose:
    return Pose(
        a.x + b.x * math.cos(a.heading) - b.y * math.sin(a.heading),
        a.y + b.x * math.sin(a.heading) + b.y * math.cos(a.heading),
        a.heading + b.heading,
    )


def transform_message(parent: str, child: str, stamp_ns: int, pose: Pose) -> bytes:
    turned = Rigid.from_rpy(0.0, 0.0, pose.heading, (pose.x, pose.y, 0.0))
    return encode_transforms([(parent, child, stamp_ns, *turned.pose)], "cdr")


_SCANS, _MOTION, _MOUNTS = Stream("/scan", SCAN), Stream("/tf", TF), Stream("/tf_static", TF, latched=True)


def drive_recording(
    *,
    seconds: float = 8.0,
    beams: int = 361,
    time_increment: float = 0.0,
    said: float | None = None,
    odom: str = "odom",
    motion_from: float = 0.0,
) -> Recording:
    """Record the drive, with five scans a second.

    ``time_increment`` is that of the beams, in truth; ``said``: in the messages, if that is something else. ``odom`` is
    the frame of the odometry, which begins to be recorded at ``motion_from``.
    """
    items = [Item(_MOUNTS, T0, {2: transform_message("base_link", "laser", T0, MOUNT)})]
    for number in range(round(motion_from * 50), round(seconds * 50) + 20):
        stamp_ns = T0 + number * SECOND // 50
        items.append(Item(_MOTION, stamp_ns, {2: transform_message(odom, "base_link", stamp_ns, drive(number / 50))}))
    step = (_TO - _FROM) / (beams - 1)
    for number in range(round(seconds * 5)):
        ranges = np.empty(beams, np.float32)
        for beam in range(beams):
            if not beam or time_increment:
                pose = composed(drive(number / 5 + beam * time_increment), MOUNT)
            ranges[beam] = cast(pose.x, pose.y, pose.heading + _FROM + beam * step)
        stamp_ns, increment = T0 + number * SECOND // 5, time_increment if said is None else said
        scan = LaserScan(0, stamp_ns, "laser", _FROM, _TO, step, increment, 0.1, 0.1, 30.0, ranges)
        items.append(Item(_SCANS, stamp_ns + 1000, {2: encode_laserscan(scan, "cdr")}))
    return Recording((_SCANS, _MOTION, _MOUNTS), tuple(sorted(items, key=lambda item: item.log_time_ns)))
