"""Scans of several messages: what is done with each message by itself, and with those that belong together.

A message is decoded and filtered on whichever thread has it. It is projected at once where it is known by then from
where the scan sees it: what is left is what the beams read of it. Otherwise its points are left, and where its sensor
was. Which messages belong together is decided in their order. The points that are left are then placed, as seen at the
scan's time, and projected, again on any thread.
"""

from __future__ import annotations

import math
from operator import attrgetter, mul
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.core.counts import PointCounts
from pc2scan.core.layout import TURN
from pc2scan.core.params import ProjectionParams
from pc2scan.core.points import Points
from pc2scan.core.project import Part, ProjectedScan, Projector, compact
from pc2scan.core.rigid import Rigid
from pc2scan.errors import MessageError
from pc2scan.files.borrowed import Memory, keep
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan
from pc2scan.messages.outputs import OF_CLOUDS
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from pc2scan.pipeline.conversion import Conversion, Result
from pc2scan.pipeline.motion import Motion
from pc2scan.tf.placing import Placement

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.core.moving import MovingTransform
    from pc2scan.core.project import Transform
    from pc2scan.files.borrowed import Kept
    from pc2scan.model import Buffer
    from pc2scan.pipeline.conversion import Converted, Measured, Step
    from pc2scan.pipeline.first_clouds import Sample, TopicClouds
    from pc2scan.pipeline.scan_spec import ScanSpec
    from pc2scan.pipeline.stages.deskew import Deskew, Track
    from pc2scan.pipeline.stages.filters import Filter
    from pc2scan.pipeline.stages.select import Select
    from pc2scan.tf.placing import Frames, Level

    from .matching import Grouper
    from .rebinned import Rebinned

__all__ = ["CombineToScan", "Prepared", "kept_together"]

#: Bytes that a message takes besides its arrays.
_OVERHEAD = 2_000

_DEFAULTS = ProjectionParams()
_AXES = frozenset("xyz")

#: Messages of the leading topic that are remembered, and how few do not tell how often they come.
_LEADS = 16
_FEWEST_LEADS = 2

_NO_POINTS = Points(0, 0, "", {})

#: The transform that changes nothing.
_NOWHERE = Rigid.identity()


class Prepared(NamedTuple):
    """A message on its way to a scan that may have others in it.

    Attributes
    ----------
    source
        The number of its topic.
    stamp_ns, reference_ns
        Its stamp, and the time of the scan if it leads.
    points
        Those that were not rejected, in the sensor's frame; with `TIME` if ``track`` is there.
    frame_id
        The scan's frame, if it leads.
    mount
        target_from_source at its stamp; None if both are the same. The target frame is not made level.
    target_from_fixed, fixed_from_source
        The former at the scan's time, of a target frame that is made level, if it leads; None without a fixed frame.
    track
        Where its sensor was while it was measured; None if it is not deskewed.
    level
        The scan's frame, if it leads and that is made level.
    rejected
        How many points were rejected so far, by reason.
    flat
        Whether it is a LaserScan.
    nearest
        What beams read of it, if its points could be placed already.
    motion
        How far the sensor moved, if ``nearest`` has points that moved.
    assumed
        The reference and the frame of the scan that ``nearest`` was made for, with the points beside it for another
        scan; None: there is no other.
    sample
        For `FirstClouds`, while it wants any.
    size
        Bytes that it holds, in points that are copies.
    memory
        What the points are views of, if they are no copies: it stays as it is for as long as this is referred to.
    """

    source: int
    stamp_ns: int
    reference_ns: int
    points: Points
    frame_id: str
    mount: Rigid | None
    target_from_fixed: Rigid | None
    fixed_from_source: Rigid | None
    track: Track | None
    level: Level | None
    rejected: Mapping[str, int]
    flat: bool
    nearest: ProjectedScan | None
    motion: Motion | None
    assumed: tuple[int, str] | None
    sample: Sample | None
    size: int
    memory: object


class CombineToScan(Conversion):
    """Several messages to one scan.

    Parameters
    ----------
    spec
        What is asked for.
    topics
        The sources; the first one leads.
    frames
        The recording's transforms.
    measured
        What was measured of the leading topic.
    grouper
        Makes what decides which messages belong together; None: each message is a scan by itself.
    deskew
        What places points at their own times; None: all points of a message are placed at its stamp.
    first_clouds
        Returns what judges the first clouds of a topic; None if nobody does.
    """

    def __init__(
        self,
        spec: ScanSpec,
        topics: Sequence[str],
        frames: Frames,
        measured: Measured,
        grouper: Callable[[], Grouper[Prepared]] | None,
        deskew: Deskew | None = None,
        first_clouds: Callable[[str], TopicClouds] | None = None,
    ) -> None:
        params = measured.resolve(spec.params)
        super().__init__(spec.made_type, OF_CLOUDS[spec.made_type], 0)
        self.spec = spec
        self.topics = tuple(topics)
        self.grouper = grouper
        self._frames = frames
        self._measured = measured
        self._deskew = deskew
        self._first_clouds = first_clouds
        self._params = params
        self._projector = Projector(params)
        self._no_returns = np.full(params.length, params.empty_range, np.float32).tobytes()
        with np.errstate(over="ignore"):
            self._range_max = float(np.float32(params.range_max))
        #: Where it is known at once where points go, no message waits for the scan's time to be placed.
        self._rigid = not spec.fixed_frame and frames.up is None
        #: Whether a message is in one scan at most: that of its own time, if it leads.
        self._once = not (spec.combining.accumulates or spec.combining.every_ns)
        #: The last messages of the leading topic that were prepared, in whatever order; replaced, never changed.
        self._leads: list[Prepared] = []
        self._early: Select | None = None
        self._late: Select | None = None
        late: Sequence[Filter] = ()
        if spec.filters:
            from pc2scan.pipeline.stages.filters import Frame  # noqa: PLC0415  # most points are not filtered
            from pc2scan.pipeline.stages.select import Select  # noqa: PLC0415

            late = tuple(each for each in spec.filters if each.frame is Frame.TARGET and not self._rigid)
            early = tuple(each for each in spec.filters if each not in late)
            self._early = Select(early, frames) if early else None
            self._late = Select(late, frames) if late else None
        self._intensity = params.intensity_field or ("intensity" if spec.combining.rebin else "")
        self._remove: Callable[[Result], Result] | None = None
        if spec.remove:
            from pc2scan.pipeline.remove import Remove  # noqa: PLC0415  # few scans are filtered

            self._remove = Remove(spec.remove, params.empty_range)
        self._kept = {"x", "y", "z", self._intensity, *(field for each in late for field in each.fields)}
        #: The smallest positive number: upstream's default is meant for clouds, and would reject every beam of a scan.
        self._any_height = params.min_height == _DEFAULTS.min_height

    def decoder(self, source: str, source_type: str) -> Callable[[Buffer], Any]:
        """Return what decodes clouds or scans; see `Conversion`."""
        if source_type == LASERSCAN:
            return lambda data: decode_laserscan(data, source)
        return CLOUDS[source_type or POINTCLOUD2](source)

    def stages(self, topic: str) -> tuple[Step, ...]:
        """Return what prepares the messages of a topic; where each is a scan by itself, what projects it too."""
        firsts = None if self._first_clouds is None else self._first_clouds(topic)
        number = self.topics.index(topic)
        deskew = None if self._deskew is None else self._deskew.of(topic)

        def prepare(message: Points | LaserScan) -> Prepared:
            return self._prepared(number, firsts, deskew, message)

        return (prepare,) if self.grouper is not None else (prepare, self.alone)

    def encoder(self, target: str) -> Callable[[Any], Any]:
        """Return what serialises scans; nothing is serialised before messages are put together."""
        return super().encoder(target) if self.grouper is None else _as_it_is

    def encoded(self, lead: Prepared, members: Sequence[Prepared], target: str) -> Converted:
        """Make the scan of messages that belong together, and serialise it as ``ros1`` or ``cdr``."""
        return super().encoder(target)(self.scan(lead, members))

    def alone(self, prepared: Prepared) -> Result:
        """Make the scan of one message."""
        return self.scan(prepared, (prepared,))

    def _prepared(
        self, number: int, firsts: TopicClouds | None, deskew: Deskew | None, message: Points | LaserScan
    ) -> Prepared:
        flat = isinstance(message, LaserScan)
        rejected: dict[str, int] = {}
        if isinstance(message, LaserScan):
            from pc2scan.messages.beams import beams_of  # noqa: PLC0415  # most sources are clouds

            points, _, rejected = beams_of(message)
        else:
            points = message
        stamp_ns, frames = points.stamp_ns, self._frames
        source, frame_id = frames.source_frame or points.frame_id, points.frame_id
        target = frames.target_frame or source
        mount = frames.transform(target, frame_id, stamp_ns) if frames.target_frame else None
        sample = None
        if not flat and number == 0 and firsts is not None and not firsts.full:
            sample = firsts.sample(points, frames.place(frame_id, stamp_ns))
        track = None if deskew is None else deskew.track(points)
        reference_ns = stamp_ns if track is None else track.reference_ns
        points = points if track is None else track.points
        target_from_fixed = fixed_from_source = level = None
        fixed = self.spec.fixed_frame
        # Its own scan sees a message where it is mounted.
        if fixed and track is None and frames.buffer is not None and not (self._once and number == 0):
            fixed_from_source = frames.buffer.lookup(fixed, source, stamp_ns, frames.tolerance_ns)
        if number == 0:
            if fixed:
                _, target_from_fixed = frames.from_fixed(fixed, frame_id, reference_ns)
            level = frames.level(target, reference_ns)
        if self._early is not None:
            # Filters in the target frame see the points where the scan shows them.
            selected = self._early.apply(points, Placement(target, mount) if self._rigid else Placement("", None))
            points, rejected = selected.points, rejected | selected.rejected
            mount = selected.target_from_source if self._rigid else mount
        if not flat and self._intensity:
            points.field(self._intensity)
        prepared = Prepared(
            number,
            stamp_ns,
            reference_ns,
            points,
            target if level is None else level.name,
            mount,
            target_from_fixed,
            fixed_from_source,
            track,
            level,
            rejected,
            flat,
            None,
            None,
            None,
            sample,
            0,
            None,
        )
        if flat or self._intensity or not self._projector.reads_nearest:
            return self._held(prepared)
        if self._rigid or (self._once and number == 0):
            if number == 0 and not self._rigid:
                self._leads = [*self._leads[1 - _LEADS :], prepared._replace(points=_NO_POINTS, track=None)]
            return self._projected(prepared)
        return self._assumed(prepared) if self._once else self._held(prepared)

    def _projected(self, prepared: Prepared) -> Prepared:
        """Return a message without its points, but with what beams read of them."""
        nearest, motion = self._nearest(prepared, prepared)
        points = Points(prepared.points.sequence, prepared.stamp_ns, prepared.points.frame_id, {})
        size = _OVERHEAD + nearest.ranges.nbytes
        return prepared._replace(points=points, nearest=nearest, motion=motion, size=size)

    def _assumed(self, prepared: Prepared) -> Prepared:
        """Return a message as it will be needed if the scan is the one that it looks like by now.

        Its points are in the processor's cache now, and it takes twice as long to project them when it is certain.
        """
        held = self._held(prepared)
        leads = sorted(self._leads, key=attrgetter("stamp_ns"))
        if len(leads) < _FEWEST_LEADS:
            return held
        lead = min(leads, key=lambda lead: abs(lead.stamp_ns - prepared.stamp_ns))
        if 2 * abs(lead.stamp_ns - prepared.stamp_ns) > leads[-1].stamp_ns - leads[-2].stamp_ns:
            return held
        try:
            nearest, motion = self._nearest(lead, prepared)
        except MessageError:
            # It is one of the scan, if it is that.
            return held
        return held._replace(nearest=nearest, motion=motion, assumed=(lead.reference_ns, lead.frame_id))

    def _nearest(self, lead: Prepared, member: Prepared) -> tuple[ProjectedScan, Motion | None]:
        """What beams of a scan read of a message, all its points counted, and how far its sensor moved."""
        points, transform, rejected, motion = self._placed(lead, member)
        nearest = self._projector.nearest(Part(*points.xyz(), _rounded(transform)))
        if rejected:
            nearest.counts += PointCounts(sum(rejected.values()), **rejected)
        return nearest, motion

    def _held(self, prepared: Prepared) -> Prepared:
        """Return a message whose points stay as they are: it is there longer than what they are views of."""
        track, points = prepared.track, prepared.points
        if not prepared.flat and self._intensity:
            # That the field is missing is the error of this message, not of the scan.
            points.field(self._intensity)
        names = {*self._kept, *(("index",) if prepared.flat else ()), *(() if track is None else (track.time_field,))}
        views = {name: points.field(name) for name in dict.fromkeys(("x", "y", "z", *points.fields)) if name in names}
        size = _OVERHEAD + sum(each.nbytes for each in views.values())
        memory = None
        if self.grouper is not None:
            # Of a message that waits for long, or is in many scans, only what is needed is held.
            memory = kept_together(views.values()) if self._once else None
            views = views if memory is not None else _copied(views)
        held = Points(points.sequence, points.stamp_ns, points.frame_id, views)
        return prepared._replace(points=held, size=size, memory=memory)

    def is_projected(self, lead: Prepared, members: Iterable[Prepared]) -> bool:
        """Whether the points of all members are projected already, as this scan needs them."""
        return all(_fits(member, lead) for member in members)

    def scan(self, lead: Prepared, members: Sequence[Prepared]) -> Result:
        """Make the scan of messages that belong together.

        Parameters
        ----------
        lead
            Its reference is the scan's time.
        members
            In their order.

        Returns
        -------
        Result
            All points that were not rejected are in it, or behind closer ones.
        """
        others: list[PointCounts] = []
        parts: list[Part] = []
        known: list[ProjectedScan] = []
        motions: list[Motion] = []
        beams: list[tuple[Part, NDArray[np.int32]]] = []
        for member in members:
            if member.nearest is not None and _fits(member, lead):
                known.append(member.nearest)
                motions += [] if member.motion is None else [member.motion]
                continue
            points, transform, found, motion = self._placed(lead, member)
            if found:
                others.append(PointCounts(sum(found.values()), **found))
            if motion is not None:
                motions.append(motion)
            values = points.field(self._intensity) if self._intensity in points.fields else None
            by_height = not (member.flat and self._any_height)
            parts.append(Part(*points.xyz(), _rounded(transform), values, any_height=not by_height))
            if member.flat:
                beams.append((parts[-1], points.field("index")))
        if known:
            scan = self._projector.nearest_of([*known, *map(self._projector.nearest, parts)])
        else:
            scan = self._projector.together(parts)
        layout = self._params.layout
        message = LaserScan(
            lead.points.sequence,
            lead.reference_ns,
            lead.frame_id,
            layout.angle_min,
            layout.angle_max,
            layout.angle_increment,
            self._measured.time_increment,
            self._measured.scan_time,
            self._params.range_min,
            self._range_max,
            scan.ranges,
            scan.intensities,
        )
        empty = scan.ranges.tobytes() == self._no_returns
        largest = Motion(*map(max, zip(*motions, strict=True))) if motions else None
        shared = self._rebinned(beams) if len(beams) == len(members) else None
        level = None if lead.level is None else lead.level.at(lead.reference_ns)
        result = Result(message, sum(others, scan.counts), empty, largest, lead.sample, level, shared)
        return result if self._remove is None else self._remove(result)

    def _placed(
        self, lead: Prepared, member: Prepared
    ) -> tuple[Points, Rigid | MovingTransform | None, Mapping[str, int], Motion | None]:
        """The points of a member, the transform that is still to be applied, what was rejected, and the motion."""
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
            # At one time the transform is that between the two frames, to the bit.
            motion = Motion(0.0, 0.0)
        elif lead.target_from_fixed is not None and member.fixed_from_source is not None:
            transform = lead.target_from_fixed.product(member.fixed_from_source)
            motion = _moved(transform, mount)
        if self._late is None:
            return member.points, transform if moving is None else moving.transform, member.rejected, motion
        selected = self._late.apply(member.points, Placement(lead.frame_id, transform), moving)
        rejected = {**member.rejected, **selected.rejected}
        return selected.points, selected.motion or selected.target_from_source, rejected, motion

    def _rebinned(self, beams: Sequence[tuple[Part, NDArray[np.int32]]]) -> Rebinned:
        from .rebinned import rebinned  # noqa: PLC0415  # most sources are clouds

        found = []
        for part, numbers in beams:
            bins, used = self._projector.bins(part)
            found.append((bins, numbers[used]))
        layout = self._params.layout
        # Upstream's beams know nothing of neighbours at the ends of a circle, but its points do.
        around = layout.full_circle or layout.angle_max - layout.angle_min > TURN - 2 * layout.angle_increment
        return rebinned(found, layout.count, full_circle=around)


def _fits(member: Prepared, lead: Prepared) -> bool:
    """Whether a member is projected as the scan needs it."""
    return member.nearest is not None and member.assumed in {None, (lead.reference_ns, lead.frame_id)}


def _as_it_is(prepared: Prepared) -> Prepared:
    return prepared


def _rounded(transform: Rigid | MovingTransform | None) -> Transform | MovingTransform | None:
    """A transform as it is applied to points."""
    return transform.as_float32() if isinstance(transform, Rigid) else transform


def kept_together(arrays: Iterable[NDArray[Any]]) -> Kept | None:
    """Keep the memory that all these arrays are views of; None if they have to be copied."""
    memory: Kept | None = None
    whole: bytes | Memory | None = None
    for array in arrays:
        base: Any = array
        while isinstance(base, np.ndarray | memoryview) and not isinstance(base, Memory):
            base = base.obj if isinstance(base, memoryview) else base.base
        if whole is None and isinstance(base, bytes | Memory):
            whole = base
            # Of a large chunk with many messages, a copy of one takes less.
            spanned = sum(abs(step) * (count - 1) for step, count in zip(array.strides, array.shape, strict=True))
            memory = keep(whole) if 2 * spanned >= len(base) else None
        if memory is None or base is not whole:
            return None
    return memory


def _copied(fields: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Copies of fields: what they are views of may be used again."""
    axes = compact(*(fields[axis] for axis in "xyz"))
    copies = {name: np.array(values).reshape(-1) for name, values in fields.items() if name not in _AXES}
    return copies | dict(zip("xyz", axes, strict=True))


def _moved(transform: Rigid | None, mount: Rigid | None) -> Motion:
    """How far a sensor was from where it is mounted."""
    one, other = (transform or _NOWHERE).pose, (mount or _NOWHERE).pose
    distance = math.dist(one[:3], other[:3])
    turned = abs(sum(map(mul, one[3:], other[3:])))
    norms = math.hypot(*one[3:]) * math.hypot(*other[3:])
    return Motion(distance, 2 * math.acos(min(1.0, turned / norms)) if norms else 0.0)
