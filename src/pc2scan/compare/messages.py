"""Compares two messages, each in any wire format."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import DecodeError
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan
from pc2scan.messages.pointcloud2 import POINTCLOUD2, PointCloud2, decode_pointcloud2

from .clouds import cloud_changes, cloud_values
from .difference import Change, MessageDifference
from .scans import scan_changes, scan_values

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.model import RawMessage

    from .rules import Rules

#: The types that are compared field by field, in ROS 2's spelling.
DECODED = frozenset({LASERSCAN, POINTCLOUD2})


def compare_messages(a: RawMessage, b: RawMessage, rules: Rules) -> MessageDifference:
    """Compare two messages of one type of `DECODED`.

    Parameters
    ----------
    a, b
        ``a`` is the reference of relative tolerances. The stamps are equal, because messages are matched by them.
    rules
        Tolerances and exceptions.

    Notes
    -----
    Messages that cannot be decoded are the same if their bytes are the same.
    """
    times = [Change("log_time", str(a.log_time_ns), str(b.log_time_ns))] if a.log_time_ns != b.log_time_ns else []
    try:
        difference = _decoded(a, b, rules)
    except DecodeError as err:
        alike = a.connection.serialization == b.connection.serialization and a.data == b.data
        unreadable = Change("bytes", f"{len(a.data)} bytes", f"{len(b.data)} bytes; not decoded: {err.message}")
        difference = MessageDifference(0, () if alike else (unreadable,))
    changes = tuple(change for change in (*times, *difference.changes) if change.name not in rules.ignore)
    return MessageDifference(difference.elements, changes, difference.values)


def _decoded(a: RawMessage, b: RawMessage, rules: Rules) -> MessageDifference:
    numbered = a.connection.ros_version == b.connection.ros_version == 1
    if a.connection.ros_type == LASERSCAN:
        scan, other = (decode_laserscan(m.data, m.connection.serialization) for m in (a, b))
        changes = (*_header_changes(scan, other, numbered=numbered), *scan_changes(scan, other))
        values = tuple(scan_values(scan, other, rules))
        return MessageDifference(len(scan.ranges), changes, values)
    cloud, second = (decode_pointcloud2(m.data, m.connection.serialization) for m in (a, b))
    changes = (*_header_changes(cloud, second, numbered=numbered), *cloud_changes(cloud, second))
    return MessageDifference(cloud.points, changes, tuple(cloud_values(cloud, second, rules)))


def _header_changes(a: LaserScan | PointCloud2, b: LaserScan | PointCloud2, *, numbered: bool) -> Iterator[Change]:
    # Only ROS 1 has sequence numbers.
    if numbered and a.sequence != b.sequence:
        yield Change("seq", str(a.sequence), str(b.sequence))
    if a.frame_id != b.frame_id:
        yield Change("frame_id", repr(a.frame_id), repr(b.frame_id))
