"""Converts clouds to scans and scans to clouds, one message to one message: pure, and safe on several threads."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.advice.measurements import Measurements
from pc2scan.core.beam_filters import BEAM_FILTERS
from pc2scan.core.layout import TURN
from pc2scan.core.points import NUMBER
from pc2scan.core.project import Projector
from pc2scan.core.rigid import Rigid
from pc2scan.core.rule import PointCounts
from pc2scan.core.timing import IN_SECONDS, LONGEST
from pc2scan.core.unproject import UnprojectParams, deskew, last_beam_ns
from pc2scan.errors import DecodeError, stamp_text
from pc2scan.messages.beams import unproject_scan
from pc2scan.messages.laserscan import LaserScan
from pc2scan.messages.pointcloud2 import structured_cloud
from pc2scan.messages.used_points import UsedPoints

from .stages import ConvertedMessage, PlacedCloud, PlaceStage, SelectStage, Steps

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pc2scan.core.params import ProjectionParams
    from pc2scan.core.project import ProjectedScan, Transform
    from pc2scan.core.rigid import MovingTransform
    from pc2scan.request.options import ScanSpec
    from pc2scan.transforms.placing import Placer

    from .deskew import Deskew


class Beams:
    """The beams of all scans of a topic: points are projected to them, and their ranges become a message.

    Parameters
    ----------
    params
        The projection's parameters.
    measured
        What was measured in the topic's first clouds.

    Attributes
    ----------
    layout
        Their directions.
    projector
        The projection to them.
    """

    __slots__ = ("_geometry", "_no_returns", "layout", "projector")

    def __init__(self, params: ProjectionParams, measured: Measurements) -> None:
        if params.beams == "auto":
            params = measured.resolve(params)
        layout = self.layout = params.layout
        self.projector = Projector(params)
        self._no_returns = np.full(params.length, params.empty_range, np.float32).tobytes()
        with np.errstate(over="ignore"):
            # Rounded here once instead of for every scan; upstream's default is the largest float64.
            range_max = float(np.float32(params.range_max))
        angles = layout.angle_min, layout.angle_max, layout.angle_increment
        self._geometry = (*angles, measured.time_increment, measured.scan_time, params.range_min, range_max)

    def message(self, sequence: int, stamp_ns: int, frame_id: str, scan: ProjectedScan) -> tuple[LaserScan, bool]:
        """Return the message of projected points, and whether no beam has a return."""
        message = LaserScan(sequence, stamp_ns, frame_id, *self._geometry, scan.ranges, scan.intensities)
        return message, scan.ranges.tobytes() == self._no_returns


class CloudToScan:
    """Converts clouds to scans, as upstream's pointcloud_to_laserscan_node.cpp does, or as the parameters say.

    Parameters
    ----------
    spec
        The request.
    placer
        The recording's transforms.
    measurements
        The measured values of each source topic. Other topics use the parameters; a parameter that is ``auto`` is then
        0.
    deskews
        What places the points of a topic at their own times, by topic. Those of others are placed at the cloud's stamp.

    Attributes
    ----------
    spec, placer, measurements, deskews
        As above.
    """

    def __init__(
        self,
        spec: ScanSpec,
        placer: Placer,
        measurements: Mapping[str, Measurements] | None = None,
        deskews: Mapping[str, Deskew] | None = None,
    ) -> None:
        params = spec.params
        self.spec, self.placer = spec, placer
        self.measurements, self.deskews = measurements or {}, deskews or {}
        self._default = Measurements(
            0.0 if params.scan_time == "auto" else params.scan_time,
            0.0 if params.time_increment == "auto" else params.time_increment,
        )
        self._select = SelectStage(spec.filters, placer, bool(spec.keep_used)) if spec.filters else None
        self._remove = partial(remove_beams, spec.remove, params.empty_range) if spec.remove else None

    def steps(self, topic: str) -> Steps:
        """Return what is done with the clouds of one topic; see `Conversion`."""
        measured = self.measurements.get(topic, self._default)
        project = partial(self._make_scan, measured.first_beam_ns, Beams(self.spec.params, measured))
        place = PlaceStage(self.placer, self.deskews.get(topic))
        return Steps(place, self._select, project)

    def _make_scan(self, first_beam_ns: int, beams: Beams, placed: PlacedCloud) -> ConvertedMessage:
        points, stamp_ns, name = placed.points, placed.stamp_ns, self.spec.params.intensity_field
        intensities = points.field(name) if name else None
        # A transform that is not applied yet is applied in the same loop.
        transform = None if placed.transform is None else placed.transform.as_float32()
        scan = beams.projector(*points.xyz(), transform, intensities)
        counts = scan.counts
        if placed.rejected:
            counts += PointCounts.of_filters(placed.rejected)
        if first_beam_ns:
            # Simulated time begins at 0, and ROS 1 cannot represent a time before it.
            stamp_ns = max(0, stamp_ns + first_beam_ns)
        message, empty = beams.message(points.sequence, stamp_ns, placed.place.frame_id, scan)
        gap_ns = 0 if placed.moving is None else placed.moving.gap_ns
        level = None if placed.place.level is None else placed.place.level.at(stamp_ns)
        used = self._gather_used(placed, beams.projector, transform) if self.spec.keep_used else None
        result = ConvertedMessage(message, counts, empty, gap_ns, level, used, scan.removed, stamp_ns=placed.stamp_ns)
        return result if self._remove is None else self._remove(result)

    def _gather_used(
        self, placed: PlacedCloud, projector: Projector, transform: Transform | MovingTransform | None
    ) -> UsedPoints:
        """Return which of the decoded points the beams read."""
        points = placed.points
        numbers, beams = projector.read(*points.xyz(), transform)
        if self._select is not None:
            numbers = points.field(NUMBER).reshape(-1)[numbers]
        return UsedPoints(placed.whole, numbers, beams)


def remove_beams(filters: Sequence[str], empty_range: float, result: ConvertedMessage) -> ConvertedMessage:
    """Remove beams of a scan: a removed beam has no return.

    Parameters
    ----------
    filters
        Names of filters in order; each one sees the result of those before it.
    empty_range
        The range of a beam without a return, metres.
    """
    empty = np.float32(empty_range)
    scan = result.message
    seen = np.array(scan.ranges)
    # Beams without a return may have a finite range, which filters must not take for a return.
    seen[seen == empty] = np.inf
    returns = np.isfinite(seen)
    counts = dict(result.removed or {"returns": int(np.count_nonzero(returns))})
    closed = abs(seen.size * float(scan.angle_increment) - TURN) < abs(float(scan.angle_increment)) / 2
    for name in filters:
        gone = BEAM_FILTERS[name](seen, float(scan.angle_increment), closed=closed) & np.isfinite(seen)
        counts[name] = counts.get(name, 0) + int(np.count_nonzero(gone))
        seen[gone] = np.inf
    removed = returns & ~np.isfinite(seen)
    if removed.any():
        ranges = np.where(removed, empty, scan.ranges)
        lit = np.where(removed, np.float32(0), scan.intensities) if len(scan.intensities) else scan.intensities
        result.message = dataclasses.replace(scan, ranges=ranges, intensities=lit)
        result.empty = not np.isfinite(seen).any()
        if result.used is not None:
            kept = ~removed[result.used.beams]
            result.used = dataclasses.replace(
                result.used, numbers=result.used.numbers[kept], beams=result.used.beams[kept]
            )
    result.removed = counts
    return result


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
        return Steps(project=self._make_cloud)

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
