"""Converts clouds to scans, one message to one message: pure, and safe on several threads."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.advice.measurements import Measurements
from pc2scan.core.points import NUMBER
from pc2scan.core.project import Projector
from pc2scan.core.rule import PointCounts
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, encode_laserscan
from pc2scan.messages.pointcloud2 import POINTCLOUD2

from .stages.placement import PlaceStage
from .stages.removal import RemoveStage
from .steps import Conversion, ConvertedMessage

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pc2scan.advice.first_clouds import TopicClouds
    from pc2scan.core.moving import MovingTransform
    from pc2scan.core.params import ProjectionParams
    from pc2scan.core.points import Points
    from pc2scan.core.project import ProjectedScan, Transform
    from pc2scan.messages.used_points import UsedPoints
    from pc2scan.model import Buffer
    from pc2scan.request.beam_filters import BeamFilter
    from pc2scan.request.filters import Filter
    from pc2scan.transforms.placing import Placer

    from .stages.deskew import Deskew
    from .stages.placement import PlacedCloud
    from .steps import Step


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


class CloudToScan(Conversion):
    """Converts clouds to scans, as upstream's pointcloud_to_laserscan_node.cpp does, or as the parameters say.

    Parameters
    ----------
    params
        The projection's parameters.
    placer
        The recording's transforms.
    measurements
        The measured values of each source topic. Other topics use the parameters; a parameter that is ``auto`` is then
        0.
    filters
        Filters that select points before the projection, in order.
    deskew
        Places points at their own times; None: all points of a cloud are placed at its stamp.
    first_clouds
        Returns the checks of the first clouds of a topic; None for no checks.
    keeps_used
        Whether results include the points that beams read.
    remove
        Filters that remove beams of the scans, in order.

    Attributes
    ----------
    params, measurements, placer, deskew, filters
        As above.
    """

    made_type = LASERSCAN
    encode = encode_laserscan

    def __init__(
        self,
        params: ProjectionParams,
        placer: Placer,
        measurements: Mapping[str, Measurements] | None = None,
        filters: Sequence[Filter] = (),
        deskew: Deskew | None = None,
        first_clouds: Callable[[str], TopicClouds] | None = None,
        *,
        keeps_used: bool = False,
        remove: Sequence[BeamFilter] = (),
    ) -> None:
        self.measurements = measurements or {}
        # The size of a scan: the cloud's header, ranges and intensities. Its other fields take fewer bytes.
        longest = max([each.resolve(params).length for each in self.measurements.values()], default=params.length)
        self.shrinks_from = 1024 + 8 * longest
        self.params = params
        self.placer = placer
        self.deskew = deskew
        self.filters = filters
        self._first_clouds = first_clouds
        self._default = Measurements(
            0.0 if params.scan_time == "auto" else params.scan_time,
            0.0 if params.time_increment == "auto" else params.time_increment,
        )
        self._place = PlaceStage(placer, deskew)
        self._select: Callable[[PlacedCloud], PlacedCloud] | None = None
        if filters:
            from .stages.selection import SelectStage  # noqa: PLC0415  # only where something is selected

            self._select = SelectStage(filters, placer, numbered=keeps_used)
        self._keeps_used = keeps_used
        self._remove: tuple[Step, ...] = ()
        if remove:
            self._remove = (RemoveStage(remove, params.empty_range),)

    def decoder(self, source: str, source_type: str) -> Callable[[Buffer], Points]:
        """Return the decoder of clouds; see `Conversion`."""
        return CLOUDS[source_type or POINTCLOUD2](source)

    def stages(self, topic: str) -> tuple[Step, ...]:
        """Return the stages of one topic's messages: place, select, project, remove; see `Conversion`."""
        measured = self.measurements.get(topic, self._default)
        beams = Beams(self.params, measured)
        firsts = None if self._first_clouds is None else self._first_clouds(topic)
        project = partial(self._make_scan, measured.first_beam_ns, beams, firsts)
        select = () if self._select is None else (self._select,)
        return (self._place.of(topic), *select, project, *self._remove)

    def _make_scan(
        self, first_beam_ns: int, beams: Beams, firsts: TopicClouds | None, placed: PlacedCloud
    ) -> ConvertedMessage:
        points, stamp_ns, name = placed.points, placed.stamp_ns, self.params.intensity_field
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
        candidate = None if firsts is None or firsts.full else partial(firsts.sample, placed.whole, placed.place)
        motion = None if placed.moving is None else placed.moving.motion
        level = None if placed.place.level is None else placed.place.level.at(stamp_ns)
        used = self._gather_used(placed, beams.projector, transform) if self._keeps_used else None
        return ConvertedMessage(
            message,
            counts,
            empty,
            motion,
            candidate,
            level=level,
            used=used,
            removed=scan.removed,
            stamp_ns=placed.stamp_ns,
        )

    def _gather_used(
        self, placed: PlacedCloud, projector: Projector, transform: Transform | MovingTransform | None
    ) -> UsedPoints:
        """Return which of the decoded points the beams read."""
        from pc2scan.messages.used_points import UsedPoints  # noqa: PLC0415  # only where they are kept

        points = placed.points
        numbers, beams = projector.read(*points.xyz(), transform)
        if self._select is not None:
            numbers = points.field(NUMBER).reshape(-1)[numbers]
        return UsedPoints(placed.whole, numbers, beams)
