"""PointCloud2 to LaserScan, one message to one message: pure, and safe on several threads at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.project import Projector
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, encode_laserscan
from pc2scan.messages.pointcloud2 import POINTCLOUD2, decode_pointcloud2

from .conversion import Converted

if TYPE_CHECKING:
    from pc2scan.bags.model import Buffer
    from pc2scan.core.params import ProjectionParams

    from .frames import Frames

__all__ = ["CloudToScan"]


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
