"""PointCloud2 to LaserScan, one message to one message: pure, and safe on several threads at once."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.project import Projector
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, encode_laserscan
from pc2scan.messages.pointcloud2 import POINTCLOUD2, CloudDecoder

from .conversion import Converted, Timing

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pc2scan.core.params import ProjectionParams
    from pc2scan.core.project import ProjectedScan
    from pc2scan.messages.pointcloud2 import PointCloud2
    from pc2scan.model import Buffer
    from pc2scan.tf.placing import Frames, Placement

__all__ = ["CloudToScan"]


class CloudToScan:
    """PointCloud2 to LaserScan, as upstream's pointcloud_to_laserscan_node.cpp does it, or as the parameters say.

    Parameters
    ----------
    params
        The projection's parameters.
    frames
        The recording's transforms.
    timings
        What was measured of each source topic. Elsewhere the parameters tell, and what they leave to be measured is 0.
    """

    source_type = POINTCLOUD2
    target_type = LASERSCAN
    target_name = "scan"

    def __init__(self, params: ProjectionParams, frames: Frames, timings: Mapping[str, Timing] | None = None) -> None:
        self.params = params
        self._frames = frames
        self._timings = timings or {}
        self._default = Timing(
            0.0 if params.scan_time == "auto" else params.scan_time,
            0.0 if params.time_increment == "auto" else params.time_increment,
        )
        self._layout = params.layout
        with np.errstate(over="ignore"):
            # Upstream's default is a float64's largest: once here, it need not be rounded for every scan.
            self._range_max = float(np.float32(params.range_max))
        self._project = Projector(params)
        # A scan repeats the cloud's header; what else it has besides ranges and intensities takes less.
        self.shrinks_from = 1024 + 8 * params.length
        self._no_returns = np.full(params.length, params.empty_range, np.float32).tobytes()

    def for_topic(self, topic: str, source: str, target: str) -> Callable[[Buffer], Converted]:
        """Return the conversion of one topic's messages, with its timing; see `Conversion`."""
        return partial(self._convert, self._timings.get(topic, self._default), CloudDecoder(source), target)

    def _convert(self, timing: Timing, decode: CloudDecoder, target: str, data: Buffer) -> Converted:
        cloud = decode(data)
        place = self._frames.place(cloud.frame_id, cloud.stamp_ns)
        scan = self._projected(cloud, place)
        params, layout = self.params, self._layout
        stamp_ns = cloud.stamp_ns
        if timing.first_beam_ns:
            # A simulation's time begins at 0, and ROS 1 has none before.
            stamp_ns = max(0, stamp_ns + timing.first_beam_ns)
        message = LaserScan(
            cloud.sequence,
            stamp_ns,
            place.frame_id,
            layout.angle_min,
            layout.angle_max,
            layout.angle_increment,
            timing.time_increment,
            timing.scan_time,
            params.range_min,
            self._range_max,
            scan.ranges,
            scan.intensities,
        )
        return Converted(encode_laserscan(message, target), scan.counts, scan.ranges.tobytes() == self._no_returns)

    def _projected(self, cloud: PointCloud2, place: Placement) -> ProjectedScan:
        moved = place.target_from_source
        transform = None if moved is None else moved.as_float32()
        name = self.params.intensity_field
        return self._project(*cloud.xyz(), transform, cloud.field(name) if name else None)
