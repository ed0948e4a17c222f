"""The steps of a conversion: decode, place, select and project, one message to one message; on any thread.

Clouds become scans, and scans become clouds. Steps neither read files nor change what they are given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

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
from pc2scan.errors import DecodeError, UnconnectedError, stamp_text
from pc2scan.messages.beams import unproject_scan
from pc2scan.messages.laserscan import LaserScan
from pc2scan.messages.pointcloud2 import structured_cloud
from pc2scan.messages.used_points import UsedPoints
from pc2scan.request.filters import Frame

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pc2scan.core.points import Points
    from pc2scan.core.project import ProjectedScan, Transform
    from pc2scan.core.rigid import MovingTransform
    from pc2scan.request.filters import Filter
    from pc2scan.request.spec import ScanSpec
    from pc2scan.transforms.placing import LevelFrame, LevelTransform, Placement, Placer

    from .deskew import Deskew, MovingCloud


# Neither frozen nor a named tuple, because creating those takes two to three times as long, for every message.
@dataclass(slots=True, eq=False)
class ConvertedMessage:
    """The result of a conversion: the new message, and what is counted of it.

    The steps make ``message`` and ``used`` of arrays; the consumer's last step may replace both by their serialised
    form, and says in ``size`` how many bytes they take. ``empty`` is whether the message has no return, or no point;
    ``gap_ns`` is the longest time over which transforms were interpolated, if it was deskewed. ``level`` is the
    transform of its frame, if that is made level. ``used`` are the points that beams read, if they are written.
    ``removed`` is how many beams had ``returns``, how many of these were too ``sparse`` for ``min_points`` or
    ``reduce``, and how many each beam filter removed; None without any of them.
    """

    message: Any
    counts: PointCounts
    empty: bool
    gap_ns: int = 0
    level: LevelTransform | None = None
    used: Any = None
    removed: Mapping[str, int] | None = None
    size: int = 0
    stamp_ns: int | None = None


def as_it_is(value: Any) -> Any:
    """Return a value: a step that does nothing."""
    return value


class Steps(NamedTuple):
    """What is done with a decoded message, on any thread: each step takes what the one before returns.

    Attributes
    ----------
    place
        Places a cloud.
    select
        Selects some of its points.
    project
        Makes the new message, or what a message contributes to a scan of several.
    """

    place: Callable[[Any], Any] = as_it_is
    select: Callable[[Any], Any] = as_it_is
    project: Callable[[Any], Any] = as_it_is


class Conversion(Protocol):
    """A conversion between two kinds of messages: clouds to scans, scans to clouds, or scans to scans.

    Attributes
    ----------
    placer
        The recording's transforms.
    """

    placer: Placer

    def steps(self, topic: str) -> Steps:
        """Return what is done with the decoded messages of one topic.

        They raise a `MessageError` if a message cannot be converted. Conversions that place and select alike, by equal
        steps, share this work on each message.
        """


def serialised(encode: Callable[[Any, str], bytes], serialization: str, result: ConvertedMessage) -> ConvertedMessage:
    """Do the last step of a consumer that writes: replace arrays by their form in ``ros1`` or ``cdr``."""
    result.message = encode(result.message, serialization)
    result.size = len(result.message)
    if result.used is not None:
        result.used = result.used.encode(serialization)
        result.size += len(result.used)
    return result


_NOTHING: Mapping[str, int] = {}


# Instances are never changed. They are neither frozen nor named tuples, because creating those takes two to three times
# as long, for every message.
@dataclass(slots=True, eq=False)
class PlacedCloud:
    """A cloud between its decoder and the projection.

    Attributes
    ----------
    points
        The points that were not rejected.
    stamp_ns
        The scan's stamp.
    place
        The frame that the cloud is converted in, and the transform to it.
    moving
        The motion of its sensor; None if it is not deskewed.
    transform
        The transform that is still to be applied to ``points``; of a deskewed cloud, to each at its own time.
    rejected
        How many points were rejected so far, by reason.
    whole
        All points of the message, as decoded.
    """

    points: Points
    stamp_ns: int
    place: Placement
    moving: MovingCloud | None
    transform: Rigid | MovingTransform | None
    rejected: Mapping[str, int]
    whole: Points


@dataclass(frozen=True, slots=True)
class PlaceStep:
    """Places clouds: looks up the frame and the transform of each. Instances with equal attributes are equal.

    Attributes
    ----------
    placer
        The recording's transforms.
    deskew
        Places points at their own times; None: all points of a cloud are placed at its stamp.
    """

    placer: Placer
    deskew: Deskew | None = None

    def __call__(self, points: Points) -> PlacedCloud:
        """Place a cloud.

        Raises
        ------
        DecodeError
            If it is deskewed, and its points have no times.
        TransformError
            If there is no transform.
        """
        moving = None if self.deskew is None else self.deskew(points)
        if moving is None:
            place = self.placer.place(points.frame_id, points.stamp_ns)
            return PlacedCloud(points, points.stamp_ns, place, None, place.target_from_source, _NOTHING, points)
        place = self.placer.place(points.frame_id, moving.stamp_ns)
        return PlacedCloud(moving.points, moving.stamp_ns, place, moving, moving.transform, _NOTHING, points)


#: The selected points, the transform that is still to be applied, and how many points each filter rejected.
Selected: TypeAlias = "tuple[Points, Rigid | MovingTransform | None, dict[str, int]]"


@dataclass(frozen=True, slots=True)
class SelectStep:
    """Applies filters one after the other. Each sees the points that those before it have kept.

    Instances with equal attributes are equal.

    Attributes
    ----------
    filters
        The filters in order.
    placer
        The recording's transforms.
    numbered
        Whether points get the field `NUMBER`.
    """

    filters: tuple[Filter, ...]
    placer: Placer
    numbered: bool = False

    def __hash__(self) -> int:
        # Filters of users may have no hash.
        return hash(tuple(chosen.name for chosen in self.filters))

    def __call__(self, placed: PlacedCloud) -> PlacedCloud:
        """Select points of a placed cloud; see `apply`."""
        points = placed.points
        if self.numbered:
            shape = points.xyz()[0].shape
            points = points.replace({NUMBER: np.arange(math.prod(shape)).reshape(shape)}, points.frame_id)
        points, transform, rejected = self.apply(points, placed.place, placed.moving)
        return replace(placed, points=points, transform=transform, rejected=rejected)

    def apply(self, points: Points, place: Placement, moving: MovingCloud | None = None) -> Selected:
        """Select points of a cloud.

        Parameters
        ----------
        place
            The frame that it is converted in.
        moving
            The motion of its sensor, if it is deskewed. Then filters in the target frame are applied last, to points
            that are placed at their own times. All others are applied to the recorded points, so that parts of the
            robot are at their fixed place.

        Raises
        ------
        DecodeError
            If a field is missing or cannot be decoded.
        TransformError
            If there is no transform to a filter's frame at the cloud's stamp.
        """
        rejected = {chosen.name: 0 for chosen in self.filters}
        # The points that are kept so far, in each frame that a filter needed.
        clouds: dict[Frame | str, Points] = {Frame.SOURCE: points}
        steps = [(chosen.frame, chosen) for chosen in self.filters]
        if moving is not None:
            steps.sort(key=lambda step: step[0] is Frame.TARGET)
        else:
            steps = [(Frame.TARGET if frame == place.frame_id else frame, chosen) for frame, chosen in steps]
        for frame, chosen in steps:
            if frame is Frame.TARGET and frame not in clouds and moving is not None:
                clouds[frame], placed, lost = moving.place(clouds[Frame.SOURCE])
                rejected.update(lost)
                clouds = clouds if placed is None else {name: own.select(placed) for name, own in clouds.items()}
            elif frame not in clouds:
                clouds[frame] = self._placed(clouds[Frame.SOURCE], frame, place, chosen.name)
            with np.errstate(all="ignore"):
                mask = chosen(clouds[frame])
            if mask.dtype != np.bool_:
                raise TypeError(f"the filter {chosen.name} returned {mask.dtype}, expected bool")
            if count := mask.size - int(np.count_nonzero(mask)):
                rejected[chosen.name] += count
                clouds = {name: own.select(mask) for name, own in clouds.items()}
        if Frame.TARGET in clouds:
            return clouds[Frame.TARGET], None, rejected
        kept = clouds[Frame.SOURCE]
        return kept, place.target_from_source if moving is None else moving.transform_of(kept), rejected

    def _placed(self, points: Points, frame: Frame | str, place: Placement, name: str) -> Points:
        """Return points in the frame of a filter."""
        frame_id, transform, _ = place
        if isinstance(frame, str):
            try:
                frame_id, transform = frame, self.placer.transform(frame, points.frame_id, points.stamp_ns)
            except UnconnectedError as err:
                err.message = f"the frame of `{name}`: {err.message}"
                raise
        return points if transform is None else points.transform(transform.as_float32(), frame_id)


class Beams:
    """The beams of all scans of a topic: points are projected to them, and their ranges become a message.

    Parameters
    ----------
    spec
        The request.
    measured
        What was measured in the topic's first clouds.

    Attributes
    ----------
    projector
        The projection to them.
    """

    __slots__ = ("_geometry", "_no_returns", "_remove", "projector")

    def __init__(self, spec: ScanSpec, measured: Measurements) -> None:
        params = spec.params
        self._remove = partial(remove_beams, spec.remove, params.empty_range) if spec.remove else None
        if params.beams == "auto":
            params = measured.resolve(params)
        layout = params.layout
        self.projector = Projector(params)
        self._no_returns = np.full(params.length, params.empty_range, np.float32).tobytes()
        with np.errstate(over="ignore"):
            # Rounded here once instead of for every scan; upstream's default is the largest float64.
            range_max = float(np.float32(params.range_max))
        angles = layout.angle_min, layout.angle_max, layout.angle_increment
        self._geometry = (*angles, measured.time_increment, measured.scan_time, params.range_min, range_max)

    def message(
        self,
        header: tuple[int, int, str],
        scan: ProjectedScan,
        counts: PointCounts,
        level: LevelFrame | None,
        gap_ns: int,
        stamp_ns: int,
        used: UsedPoints | None = None,
    ) -> ConvertedMessage:
        """Return the message of projected points with its counts; ``header`` has its number, stamp and frame."""
        message = LaserScan(*header, *self._geometry, scan.ranges, scan.intensities)
        made_level, empty = None if level is None else level.at(header[1]), scan.ranges.tobytes() == self._no_returns
        result = ConvertedMessage(message, counts, empty, gap_ns, made_level, used, scan.removed, stamp_ns=stamp_ns)
        return result if self._remove is None else self._remove(result)


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
        What places points at their own times, by topic. Other topics are placed at the cloud's stamp.

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
        self.spec, self.placer = spec, placer
        self.measurements, self.deskews = measurements or {}, deskews or {}
        self._default = Measurements.given(spec.params)
        self._select = SelectStep(spec.filters, placer, bool(spec.keep_used)) if spec.filters else as_it_is

    def steps(self, topic: str) -> Steps:
        """Return what is done with the clouds of one topic; see `Conversion`."""
        measured = self.measurements.get(topic, self._default)
        project = partial(self._make_scan, measured.first_beam_ns, Beams(self.spec, measured))
        place = PlaceStep(self.placer, self.deskews.get(topic))
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
        header = points.sequence, stamp_ns, placed.place.frame_id
        gap_ns = 0 if placed.moving is None else placed.moving.gap_ns
        used = self._gather_used(placed, beams.projector, transform) if self.spec.keep_used else None
        return beams.message(header, scan, counts, placed.place.level, gap_ns, placed.stamp_ns, used)

    def _gather_used(
        self, placed: PlacedCloud, projector: Projector, transform: Transform | MovingTransform | None
    ) -> UsedPoints:
        """Return which of the decoded points the beams read."""
        points = placed.points
        numbers, beams = projector.read(*points.xyz(), transform)
        if self.spec.filters:
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
        result.message = replace(scan, ranges=ranges, intensities=lit)
        result.empty = not np.isfinite(seen).any()
        if result.used is not None:
            kept = ~removed[result.used.beams]
            result.used = result.used._replace(numbers=result.used.numbers[kept], beams=result.used.beams[kept])
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
