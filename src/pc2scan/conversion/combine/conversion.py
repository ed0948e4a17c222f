"""Converts several messages to one scan: prepares each message by itself, then makes the scan of a group of messages.

The thread that loads a message decodes and filters it. If the transform to the scan is certain by then, it projects the
points at once, and only the ranges of the beams are held. Otherwise the points are held, and the pose of their sensor.
Messages are grouped in order. The held points are then placed as seen at the scan's time, and projected, on any thread.
"""

from __future__ import annotations

import math
from functools import partial
from operator import mul
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from pc2scan.conversion.cloud_to_scan import Beams
from pc2scan.conversion.stages.removal import remove_beams
from pc2scan.conversion.stages.selection import SelectStage
from pc2scan.conversion.steps import Conversion, ConvertedMessage, Motion, Steps
from pc2scan.core.params import ProjectionParams
from pc2scan.core.points import Points
from pc2scan.core.project import PointsPart, ProjectedScan, contiguous
from pc2scan.core.rigid import Rigid
from pc2scan.core.rule import PointCounts
from pc2scan.messages.beams import scan_points
from pc2scan.messages.clouds import CLOUDS, SCANS
from pc2scan.messages.laserscan import LaserScan, encode_laserscan
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from pc2scan.request.filters import Frame
from pc2scan.transforms.placing import Placement

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.advice.measurements import Measurements
    from pc2scan.advice.odometry import Surroundings
    from pc2scan.conversion.stages.deskew import Deskew, Track
    from pc2scan.core.moving import MovingTransform
    from pc2scan.core.project import Transform
    from pc2scan.model import Buffer
    from pc2scan.request.filters import Filter
    from pc2scan.request.options import ScanSpec
    from pc2scan.transforms.placing import LevelFrame, Placer

    from .grouping import Grouper

#: Bytes that a message takes besides its arrays.
_OVERHEAD = 2_000

_DEFAULTS = ProjectionParams()
_AXES = frozenset("xyz")

#: The transform that changes nothing.
_NOWHERE = Rigid.identity()


class Contribution(NamedTuple):
    """What one message contributes to a scan of several messages.

    Attributes
    ----------
    source
        The number of its topic.
    stamp_ns, reference_ns
        Its stamp, and the time of the scan if it leads.
    points
        The points that were not rejected, in the sensor's frame; with `TIME` if ``track`` is not None.
    frame_id
        The scan's frame, if the message leads.
    mount
        target_from_source at the message's stamp, of a target frame that is not made level; None if both frames are
        the same.
    target_from_fixed, fixed_from_source
        Transforms from and to the fixed frame; None without one. The first is that of the scan's frame at the scan's
        time, if the message leads; the second is that at the message's stamp.
    gap_ns
        Over how long a time the two were interpolated, nanoseconds.
    track
        The poses of the sensor during the measurement; None if the points are not deskewed.
    level
        The scan's frame, if the message leads and the frame is made level.
    rejected
        How many points were rejected so far, by reason.
    flat
        Whether the message is a LaserScan.
    nearest
        The ranges of the beams, if the points are projected already.
    motion
        How far the sensor moved, if ``nearest`` is of points that were moved.
    size
        Bytes that the message holds.
    """

    source: int
    stamp_ns: int
    reference_ns: int
    points: Points
    frame_id: str
    mount: Rigid | None
    target_from_fixed: Rigid | None
    fixed_from_source: Rigid | None
    gap_ns: int
    track: Track | None
    level: LevelFrame | None
    rejected: Mapping[str, int]
    flat: bool
    nearest: ProjectedScan | None = None
    motion: Motion | None = None
    size: int = 0


class MessagesToScan(Conversion):
    """Converts several messages to one scan.

    Parameters
    ----------
    spec
        The request.
    topics
        The source topics; the first one leads.
    placer
        The recording's transforms.
    measured
        The measurements of the leading topic.
    grouper
        Makes the grouper of messages; None: each message becomes a scan by itself.
    deskews
        What places the points of a topic at their own times, by topic. Those of others are placed at the
        message's stamp.
    surroundings
        Samples some clouds that are not deskewed; None: nothing does.
    """

    encode = encode_laserscan
    shrinks_from = 0

    def __init__(
        self,
        spec: ScanSpec,
        topics: Sequence[str],
        placer: Placer,
        measured: Measurements,
        grouper: Callable[[], Grouper] | None,
        deskews: Mapping[str, Deskew] | None = None,
        surroundings: Surroundings | None = None,
    ) -> None:
        params = measured.resolve(spec.params)
        self._beams = Beams(params, measured)
        self.spec = spec
        self.topics = tuple(topics)
        self.grouper = grouper
        self.placer = placer
        self._deskews = deskews or {}
        self._surroundings = None if deskews else surroundings
        self._projector = self._beams.projector
        #: Whether the transform of points does not depend on the scan's time, so that no message waits for that.
        self._rigid = not spec.fixed_frame and placer.up is None
        #: Whether a message is in at most one scan. A leading message is in the scan of its own time.
        self._once = not spec.combining.accumulates
        self._early: SelectStage | None = None
        self._late: SelectStage | None = None
        late: Sequence[Filter] = ()
        if spec.filters:
            late = tuple(each for each in spec.filters if each.frame is Frame.TARGET and not self._rigid)
            early = tuple(each for each in spec.filters if each not in late)
            self._early = SelectStage(early, placer) if early else None
            self._late = SelectStage(late, placer) if late else None
        self._intensity = params.intensity_field or ("intensity" if spec.combining.rebin else "")
        self._remove = partial(remove_beams, spec.remove, params.empty_range) if spec.remove else None
        self._kept = {"x", "y", "z", self._intensity, *(field for each in late for field in each.fields)}
        #: Upstream's default minimum, the smallest positive number, is meant for clouds: it rejects all beams of scans.
        self._any_height = params.min_height == _DEFAULTS.min_height

    def decoder(self, source: str, source_type: str) -> Callable[[Buffer], Any]:
        """Return the decoder of clouds or scans; see `Conversion`."""
        if source_type in SCANS:
            return SCANS[source_type](source, self.spec.echo)
        return CLOUDS[source_type or POINTCLOUD2](source)

    def steps(self, topic: str) -> Steps:
        """Return the step of one topic's messages, which makes a scan only if each message becomes one."""
        contribute = partial(self._contribute, self.topics.index(topic), self._deskews.get(topic))
        return Steps(None, None, contribute if self.grouper else lambda message: self.alone(contribute(message)))

    def alone(self, contribution: Contribution) -> ConvertedMessage:
        """Make the scan of one message."""
        return self.scan(contribution, (contribution,))

    def _contribute(self, number: int, deskew: Deskew | None, message: Points | LaserScan) -> Contribution:
        flat = isinstance(message, LaserScan)
        rejected: dict[str, int] = {}
        if isinstance(message, LaserScan):
            points, rejected = scan_points(message)
        else:
            points = message
        stamp_ns, placer = points.stamp_ns, self.placer
        source, frame_id = placer.source_frame or points.frame_id, points.frame_id
        target = placer.target_frame or source
        mount = placer.transform(target, frame_id, stamp_ns) if placer.target_frame else None
        if self._surroundings is not None and not flat:
            self._surroundings.add(self.topics[number], points)
        track = None if deskew is None else deskew.track(points)
        reference_ns = stamp_ns if track is None else track.reference_ns
        points = points if track is None else track.points
        target_from_fixed = fixed_from_source = level = None
        gap_ns, fixed = 0, self.spec.fixed_frame
        # For its own scan, the place of a leading message does not depend on the fixed frame.
        if fixed and track is None and placer.buffer is not None and not (self._once and number == 0):
            fixed_from_source = placer.buffer.lookup(fixed, source, stamp_ns, placer.tolerance_ns)
            gap_ns = placer.buffer.between_ns(fixed, source, stamp_ns, placer.tolerance_ns)
        if number == 0:
            if fixed:
                _, target_from_fixed = placer.from_fixed(fixed, frame_id, reference_ns)
            level = placer.level(target, reference_ns)
        if self._early is not None:
            # Filters in the target frame see the points where the scan shows them.
            selected = self._early.apply(points, Placement(target, mount) if self._rigid else Placement("", None))
            points, rejected = selected.points, rejected | selected.rejected
            mount = cast("Rigid | None", selected.transform) if self._rigid else mount
        contribution = Contribution(
            number,
            stamp_ns,
            reference_ns,
            points,
            target if level is None else level.name,
            mount,
            target_from_fixed,
            fixed_from_source,
            gap_ns,
            track,
            level,
            rejected,
            flat,
        )
        # The place of these points does not depend on the time of a scan that another message leads.
        is_certain = self._rigid or (self._once and number == 0)
        if flat or self._intensity or not self._projector.reads_nearest or not is_certain:
            return self._keep_points(contribution)
        # They are in the processor's cache now; projecting them later takes twice as long.
        nearest, motion = self._find_nearest(contribution, contribution)
        nothing = Points(points.sequence, stamp_ns, points.frame_id, {})
        size = _OVERHEAD + nearest.ranges.nbytes
        return contribution._replace(points=nothing, track=None, nearest=nearest, motion=motion, size=size)

    def _find_nearest(self, lead: Contribution, member: Contribution) -> tuple[ProjectedScan, Motion | None]:
        """Return the ranges and counts of one message in a scan, and how far its sensor moved."""
        points, transform, rejected, motion = self._place(lead, member)
        nearest = self._projector.nearest(PointsPart(*points.xyz(), _round_transform(transform)))
        if rejected:
            nearest.counts += PointCounts.of_filters(rejected)
        return nearest, motion

    def _keep_points(self, contribution: Contribution) -> Contribution:
        """Return a message with the fields that its scan needs."""
        track, points = contribution.track, contribution.points
        if not contribution.flat and self._intensity:
            # A missing field is an error of this message, not of the scan.
            points.field(self._intensity)
        names = {
            *self._kept,
            *(() if track is None else (track.time_field,)),
        }
        views = {name: points.field(name) for name in dict.fromkeys(("x", "y", "z", *points.fields)) if name in names}
        size = _OVERHEAD + sum(each.nbytes for each in views.values())
        if self.grouper is not None:
            views = _copy_fields(views)
        held = Points(points.sequence, points.stamp_ns, points.frame_id, views)
        return contribution._replace(points=held, size=size)

    def scan(self, lead: Contribution, members: Sequence[Contribution]) -> ConvertedMessage:
        """Make the scan of a group of messages.

        Parameters
        ----------
        lead
            The leading message, whose reference is the scan's time.
        members
            All messages of the group, in order.

        Returns
        -------
        ConvertedMessage
            The scan, with the counts of all points.
        """
        others: list[PointCounts] = []
        parts: list[PointsPart] = []
        known: list[ProjectedScan] = []
        motions: list[Motion] = []
        for member in members:
            if member.nearest is not None:
                known.append(member.nearest)
                motions += [] if member.motion is None else [member.motion]
                continue
            points, transform, found, motion = self._place(lead, member)
            if found:
                others.append(PointCounts.of_filters(found))
            if motion is not None:
                motions.append(motion)
            values = points.field(self._intensity) if self._intensity in points.fields else None
            by_height = not (member.flat and self._any_height)
            parts.append(PointsPart(*points.xyz(), _round_transform(transform), values, any_height=not by_height))
        if known:
            scan = self._projector.nearest_of([*known, *map(self._projector.nearest, parts)])
        else:
            scan = self._projector.together(parts)
        message, empty = self._beams.message(lead.points.sequence, lead.reference_ns, lead.frame_id, scan)
        largest = Motion(*map(max, zip(*motions, strict=True))) if motions else None
        level = None if lead.level is None else lead.level.at(lead.reference_ns)
        counts = sum(others, scan.counts)
        result = ConvertedMessage(
            *(message, counts, empty, largest, level, None, scan.removed),
            stamp_ns=lead.reference_ns,
        )
        return result if self._remove is None else self._remove(result)

    def _place(
        self, lead: Contribution, member: Contribution
    ) -> tuple[Points, Rigid | MovingTransform | None, Mapping[str, int], Motion | None]:
        """Return a member's points, the transform still to apply, the rejection counts, and the sensor's motion."""
        mount = member.mount
        if lead.level is not None:
            level_from_target = lead.level.frame_from_level.inverse()
            mount = level_from_target if mount is None else level_from_target.compose(mount)
        transform, moving = mount, None
        motion: Motion | None = None
        if lead.target_from_fixed is not None and member.track is not None:
            track = member.track._replace(points=member.points)
            moving = track.seen_from(lead.target_from_fixed, (mount or _NOWHERE,), lead.frame_id, lead.reference_ns)
            motion = moving.motion
        elif lead.target_from_fixed is not None and member.stamp_ns == lead.reference_ns:
            # At the scan's own time, the transform between the two frames is used, so that the bits are the same.
            motion = Motion(0.0, 0.0)
        elif lead.target_from_fixed is not None and member.fixed_from_source is not None:
            transform = lead.target_from_fixed.product(member.fixed_from_source)
            motion = _motion_of(transform, mount)._replace(gap=max(lead.gap_ns, member.gap_ns) / 1e9)
        if self._late is None:
            return member.points, transform if moving is None else moving.transform, member.rejected, motion
        selected = self._late.apply(member.points, Placement(lead.frame_id, transform), moving)
        rejected = {**member.rejected, **selected.rejected}
        return selected.points, selected.transform, rejected, motion


def _round_transform(transform: Rigid | MovingTransform | None) -> Transform | MovingTransform | None:
    """Return a transform as it is applied to points."""
    return None if transform is None else transform.as_float32()


def _copy_fields(fields: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return copies of fields."""
    axes = contiguous(*(fields[axis] for axis in "xyz"))
    copies = {name: np.array(values).reshape(-1) for name, values in fields.items() if name not in _AXES}
    return copies | dict(zip("xyz", axes, strict=True))


def _motion_of(transform: Rigid | None, mount: Rigid | None) -> Motion:
    """Return how far a sensor moved from the pose at which it is mounted."""
    one, other = (transform or _NOWHERE).pose, (mount or _NOWHERE).pose
    distance = math.dist(one[:3], other[:3])
    turned = abs(sum(map(mul, one[3:], other[3:])))
    norms = math.hypot(*one[3:]) * math.hypot(*other[3:])
    return Motion(distance, 2 * math.acos(min(1.0, turned / norms)) if norms else 0.0)
