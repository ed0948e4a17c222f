"""Checks whether scans are level, by the ground in the clouds of the same recording."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.core.level import thin_points
from pc2scan.errors import DecodeError, TransformError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.tf.mounting import mounting

from .findings import Finding

if TYPE_CHECKING:
    from collections.abc import Iterable

    import numpy as np
    from numpy.typing import NDArray

    from pc2scan.bags.reader import Reader
    from pc2scan.tf.buffer import TransformBuffer

#: How many clouds of a topic are searched for the ground.
_CLOUDS = 3


class _Cloud(NamedTuple):
    frame_id: str
    stamp_ns: int
    points: NDArray[np.float64]


def mounting_findings(reader: Reader, buffer: TransformBuffer, frames: Iterable[str]) -> dict[str, Finding]:
    """Look for frames of scans that are tilted, upside down or optical.

    Parameters
    ----------
    frames
        The frames of the scans.

    Returns
    -------
    dict
        A defect for each frame in which the ground of the first clouds is not level.
    """
    topics: dict[str, list[_Cloud]] = {}
    wanted = [c for c in reader.connections if c.ros_type in CLOUDS and c.ros_version is not None]
    for name in dict.fromkeys(connection.topic for connection in wanted):
        clouds = topics.setdefault(name, [])
        for message in islice(reader.messages([c for c in wanted if c.topic == name]), _CLOUDS):
            try:
                cloud = CLOUDS[message.connection.ros_type](message.connection.serialization)(message.data)
                # Some points are copied, because the buffer of the message is reused.
                clouds.append(_Cloud(cloud.frame_id, cloud.stamp_ns, thin_points(*cloud.xyz())))
            except DecodeError:
                clouds.clear()
                break
    findings: dict[str, Finding] = {}
    for frame in dict.fromkeys(frames):
        for topic, clouds in topics.items():
            found = _finding(topic, clouds, buffer, frame)
            if found is not None:
                findings.setdefault(frame, found)
    return findings


def _finding(topic: str, clouds: list[_Cloud], buffer: TransformBuffer, frame: str) -> Finding | None:
    """Return the defect that a topic's clouds show in a scan's frame; None if there is none, or no transform."""
    samples: list[NDArray[np.float64]] = []
    for cloud in clouds:
        points = cloud.points
        if cloud.frame_id.removeprefix("/") != frame.removeprefix("/"):
            try:
                points = buffer.lookup(frame, cloud.frame_id, cloud.stamp_ns).rotation.apply(points)
            except TransformError:
                return None
        samples.append(points)
    if not samples:
        return None
    first = clouds[0]
    there = mounting(topic, first.frame_id, samples, buffer, judged_in=frame, stamp_ns=first.stamp_ns)
    if not there.fault:
        return None
    hint = f"for scans made from clouds: pc2scan convert with {there.options}" if there.options else ""
    return Finding(
        "not-level", "defect", f"the scan's frame {frame!r} is {there.fault}, by the clouds on {topic}", hint
    )
