"""One message to one message: the pure middle of the pipeline, safe on several threads at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from pc2scan.core.project import PointCounts, Projector
from pc2scan.core.unproject import UnprojectedScan, UnprojectParams, deskew, unproject
from pc2scan.errors import DecodeError
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan, encode_laserscan
from pc2scan.messages.pointcloud2 import (
    DATATYPES,
    POINTCLOUD2,
    PointField,
    decode_pointcloud2,
    encode_pointcloud2,
)

if TYPE_CHECKING:
    from pc2scan.bags.model import Buffer
    from pc2scan.core.params import ProjectionParams

    from .frames import Frames

__all__ = ["CloudToScan", "Conversion", "Converted", "ScanToCloud"]

#: NumPy's names to sensor_msgs/PointField's constants.
_DATATYPE_CODES = {name: code for code, name in DATATYPES.items()}


class Converted(NamedTuple):
    """A converted message, serialised, and what became of its points (or beams)."""

    data: bytes
    counts: PointCounts
    empty: bool


class Conversion(Protocol):
    """A direction of conversion.

    Attributes
    ----------
    source_type, target_type
        ROS types in ROS 2's spelling.
    target_name
        The last part of the default output topic.
    """

    source_type: str
    target_type: str
    target_name: str

    def __call__(self, data: Buffer, source: str, target: str) -> Converted:
        """Convert one message from the serialisation ``source`` to ``target`` (``ros1`` or ``cdr``).

        Raises
        ------
        MessageError
            If this message cannot be converted.
        """
        ...


class CloudToScan:
    """PointCloud2 to LaserScan, as upstream's pointcloud_to_laserscan_node.cpp does it.

    Parameters
    ----------
    params
        The projection's parameters.
    frames
        The recording's transforms.
    """

    source_type = POINTCLOUD2
    target_type = LASERSCAN
    target_name = "scan"

    def __init__(self, params: ProjectionParams, frames: Frames) -> None:
        self.params = params
        self._frames = frames
        self._project = Projector(params)

    def __call__(self, data: Buffer, source: str, target: str) -> Converted:
        """Convert one message; see `Conversion`."""
        cloud = decode_pointcloud2(data, source)
        place = self._frames.place(cloud.frame_id, cloud.stamp_ns)
        moved = place.target_from_source
        scan = self._project(*cloud.xyz(), None if moved is None else (moved.matrix, moved.translation))
        params = self.params
        message = LaserScan(
            cloud.sequence,
            cloud.stamp_ns,
            place.frame_id,
            params.angle_min,
            params.angle_max,
            params.angle_increment,
            0.0,
            params.scan_time,
            params.range_min,
            params.range_max,
            scan.ranges,
        )
        empty = bool(np.all(scan.ranges == np.float32(params.no_return)))
        return Converted(encode_laserscan(message, target), scan.counts, empty)


class ScanToCloud:
    """LaserScan to PointCloud2, as upstream's laserscan_to_pointcloud_node.cpp does it with laser_geometry.

    Parameters
    ----------
    channels
        Which fields the cloud has, and the range cutoff.
    frames
        The recording's transforms.
    deskewed
        Whether every beam is transformed by the pose at its own time instead of the scan's stamp.
    """

    source_type = LASERSCAN
    target_type = POINTCLOUD2
    target_name = "cloud"

    def __init__(self, channels: UnprojectParams, frames: Frames, *, deskewed: bool = False) -> None:
        self.channels = channels
        self._frames = frames
        self._deskewed = deskewed

    def __call__(self, data: Buffer, source: str, target: str) -> Converted:
        """Convert one message; see `Conversion`."""
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
        frame_id, points = self._moved(scan, points)
        message = encode_pointcloud2(
            serialization=target,
            sequence=scan.sequence,
            stamp_ns=scan.stamp_ns,
            frame_id=frame_id,
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

    def _moved(self, scan: LaserScan, points: UnprojectedScan) -> tuple[str, UnprojectedScan]:
        """The points in the target frame, and that frame's name."""
        place = self._frames.place(scan.frame_id, scan.stamp_ns)
        start = place.target_from_source
        if start is None:
            return place.frame_id, points
        if not self._deskewed:
            return place.frame_id, points.with_xyz(start.apply(points.xyz), start.translation)
        # Source of the rule: laser_geometry takes the last beam's time as stamp + (beams - 1) * time_increment.
        lasts = max(points.beam_count - 1, 0) * scan.time_increment
        end = self._frames.place(scan.frame_id, scan.stamp_ns + int(lasts * 1e9)).target_from_source
        return place.frame_id, deskew(points, start, end or start)


def _fields(dtype: np.dtype[np.void]) -> list[PointField]:
    """Describe a structured type as sensor_msgs/PointField does."""
    fields = []
    for name in dtype.names or ():
        kind, offset = dtype[name], dtype.fields[name][1]  # type: ignore[index]  # a type with names has fields
        fields.append(PointField(name, offset, _DATATYPE_CODES[kind.str[1:]]))
    return fields
