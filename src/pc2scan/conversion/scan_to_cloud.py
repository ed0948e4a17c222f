"""Converts LaserScan to PointCloud2, one message to one message: pure, and safe on several threads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.core.rigid import Rigid
from pc2scan.core.rule import PointCounts
from pc2scan.core.timing import IN_SECONDS, LONGEST
from pc2scan.core.unproject import UnprojectParams, deskew, last_beam_ns
from pc2scan.errors import DecodeError, stamp_text
from pc2scan.messages.beams import unproject_scan
from pc2scan.messages.pointcloud2 import structured_cloud

from .steps import ConvertedMessage, Steps

if TYPE_CHECKING:
    from pc2scan.messages.laserscan import LaserScan
    from pc2scan.transforms.placing import Placer


class ScanToCloud:
    """Converts LaserScan to PointCloud2, as upstream's laserscan_to_pointcloud_node.cpp does with laser_geometry.

    Parameters
    ----------
    channels
        The fields of the cloud, and the range cutoff; None means the defaults.
    placer
        The recording's transforms.
    deskewed
        Whether every beam is transformed by the pose at its own time instead of the scan's stamp.
    """

    def __init__(self, channels: UnprojectParams | None, placer: Placer, *, deskewed: bool = False) -> None:
        self.channels = channels
        self.placer = placer
        self._deskewed = deskewed

    def steps(self, topic: str) -> Steps:  # noqa: ARG002
        """Return the only step, which is the same for all topics; see `Conversion`."""
        return (self._make_cloud,)

    def _make_cloud(self, scan: LaserScan) -> ConvertedMessage:
        points = unproject_scan(scan, self.channels)
        place = self.placer.place(scan.frame_id, scan.stamp_ns)
        sequence, stamp_ns, start = scan.sequence, scan.stamp_ns, place.target_from_source
        if self._deskewed:
            # laser_geometry looks up the identity if both frames are the same, and multiplies by it.
            identity = Rigid.identity()
            points = deskew(points, start or identity, self._end(scan) or identity)
        elif start is not None:
            # As tf2_sensor_msgs: a cloud gets the header of the transform, which has no sequence number.
            sequence, stamp_ns = 0, self.placer.transform_stamp(scan.frame_id, scan.stamp_ns)
            points = points.with_xyz(start.apply(points.xyz), start.translation)
        message = structured_cloud(sequence, stamp_ns, place.frame_id, points.points)
        counts = PointCounts(points.beam_count, len(points.points), **points.rejected)
        return ConvertedMessage(message, counts, empty=not len(points.points), stamp_ns=scan.stamp_ns)

    def _end(self, scan: LaserScan) -> Rigid | None:
        """Return the transform at the time of the last beam."""
        try:
            taken_ns = last_beam_ns(len(scan.ranges), scan.time_increment)
            if abs(taken_ns) > LONGEST * 1e9:
                raise DecodeError(
                    f"its beams span {abs(taken_ns) / 1e9:.6g} s by its time_increment, "
                    f"at most {LONGEST:g} s are possible",
                    hint=IN_SECONDS,
                )
            end_ns = scan.stamp_ns + taken_ns
            if end_ns < 0:
                raise DecodeError(
                    f"its last beam would be at {stamp_text(end_ns)}, which is before 1970",
                    hint="its time_increment is negative, and its stamp is 0 or close to 0",
                )
        except DecodeError as err:
            err.stamp_ns = scan.stamp_ns
            raise
        return self.placer.place(scan.frame_id, end_ns).target_from_source
