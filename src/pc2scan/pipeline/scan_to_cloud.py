"""LaserScan to PointCloud2, one message to one message: pure, and safe on several threads at once."""

from __future__ import annotations

import sys
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.core.project import PointCounts
from pc2scan.core.unproject import UnprojectedScan, UnprojectParams, deskew, last_beam_ns, unproject
from pc2scan.errors import DecodeError, stamp_text
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan
from pc2scan.messages.pointcloud2 import DATATYPES, POINTCLOUD2, PointField, encode_pointcloud2

from .conversion import Converted

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from pc2scan.core.rigid import Rigid
    from pc2scan.model import Buffer
    from pc2scan.tf.placing import Frames

__all__ = ["ScanToCloud"]

#: NumPy's names to sensor_msgs/PointField's constants.
_DATATYPE_CODES = {name: code for code, name in DATATYPES.items()}


class ScanToCloud:
    """LaserScan to PointCloud2, as upstream's laserscan_to_pointcloud_node.cpp does it with laser_geometry.

    Parameters
    ----------
    channels
        Which fields the cloud has, and the range cutoff; None means the defaults.
    frames
        The recording's transforms.
    deskewed
        Whether every beam is transformed by the pose at its own time instead of the scan's stamp.
    """

    source_type = LASERSCAN
    target_type = POINTCLOUD2
    target_name = "cloud"
    shrinks_from = sys.maxsize

    def __init__(self, channels: UnprojectParams | None, frames: Frames, *, deskewed: bool = False) -> None:
        self.channels = channels
        self._frames = frames
        self._deskewed = deskewed

    def for_topic(self, topic: str, source: str, target: str) -> Callable[[Buffer], Converted]:  # noqa: ARG002
        """Return the conversion of a topic's messages, which is the same for all; see `Conversion`."""
        return partial(self._convert, source, target)

    def _convert(self, source: str, target: str, data: Buffer) -> Converted:
        scan = decode_laserscan(data, source)
        try:
            points = unproject(
                scan.ranges,
                scan.intensities,
                angle_min=scan.angle_min,
                angle_increment=scan.angle_increment,
                range_min=scan.range_min,
                range_max=scan.range_max,
                time_increment=scan.time_increment,
                params=self.channels,
            )
        except DecodeError as err:
            err.stamp_ns = scan.stamp_ns
            raise
        header, points = self._placed(scan, points)
        message = encode_pointcloud2(
            serialization=target,
            sequence=header.sequence,
            stamp_ns=header.stamp_ns,
            frame_id=header.frame_id,
            fields=_fields(points.points.dtype),
            point_step=points.points.dtype.itemsize,
            data=points.points.tobytes(),
            is_dense=False,
        )
        rejected = points.rejected
        counts = PointCounts(
            total=points.beam_count,
            used=len(points.points),
            nan=rejected.nan,
            range=rejected.infinite + rejected.below_min + rejected.beyond_max,
        )
        return Converted(message, counts, empty=not len(points.points))

    def _placed(self, scan: LaserScan, points: UnprojectedScan) -> tuple[_Header, UnprojectedScan]:
        """The cloud's header, and the points in its frame."""
        place = self._frames.place(scan.frame_id, scan.stamp_ns)
        own = _Header(scan.sequence, scan.stamp_ns, place.frame_id)
        start = place.target_from_source
        if start is None:
            return own, points
        if self._deskewed:
            return own, deskew(points, start, self._end(scan) or start)
        # Source of the rule: tf2_sensor_msgs gives a cloud the header of the transform, which has no sequence number.
        stamp_ns = self._frames.transform_stamp(scan.frame_id, scan.stamp_ns)
        moved = points.with_xyz(start.apply(points.xyz), start.translation)
        return _Header(0, stamp_ns, place.frame_id), moved

    def _end(self, scan: LaserScan) -> Rigid | None:
        """Where the sensor was when the last beam was measured."""
        try:
            end_ns = scan.stamp_ns + last_beam_ns(len(scan.ranges), scan.time_increment)
            if end_ns < 0:
                raise DecodeError(
                    f"its last beam would be at {stamp_text(end_ns)}, before ROS's time begins",
                    hint="its time_increment is negative and its stamp is 0 or nearly so",
                )
        except DecodeError as err:
            err.stamp_ns = scan.stamp_ns
            raise
        return self._frames.place(scan.frame_id, end_ns).target_from_source


class _Header(NamedTuple):
    """The header of a cloud."""

    sequence: int
    stamp_ns: int
    frame_id: str


def _fields(dtype: np.dtype[np.void]) -> list[PointField]:
    """Describe a structured type as sensor_msgs/PointField does."""
    fields = []
    for name in dtype.names or ():
        kind, offset = dtype[name], dtype.fields[name][1]  # type: ignore[index]  # a type with names has fields
        fields.append(PointField(name, offset, _DATATYPE_CODES[kind.str[1:]]))
    return fields
