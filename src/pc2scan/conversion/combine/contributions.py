"""Converts several messages to one scan: prepares each message by itself, then makes the scan of a group of messages.

The thread that loads a message decodes and filters it. If the transform to the scan is certain by then, it projects the
points at once, and only the ranges of the beams are held. Otherwise the points are held, and the pose of their sensor.
Messages are grouped in order. The held points are then placed as seen at the scan's time, and projected, on any thread.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from pc2scan.advice.clocks import MEASURES, are_doubtful
from pc2scan.advice.measurements import Measurements, measure, require_cloud_fields, require_fields
from pc2scan.conversion.steps import Beams, ConvertedMessage, SelectStep, Steps
from pc2scan.core.params import ProjectionParams
from pc2scan.core.points import Points
from pc2scan.core.project import PointsPart, ProjectedScan, contiguous
from pc2scan.core.rule import PointCounts
from pc2scan.core.timing import median_interval_ns
from pc2scan.errors import UsageError, name_list
from pc2scan.messages.beams import scan_points
from pc2scan.messages.clouds import SCANS
from pc2scan.messages.laserscan import LaserScan
from pc2scan.model import of_types
from pc2scan.request.filters import Frame
from pc2scan.transforms.placing import Placement

from .grouping import Grouper, Interval, Nearest, Recent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from pc2scan.advice.odometry import Surroundings
    from pc2scan.advice.survey import TopicFacts
    from pc2scan.conversion.deskew import Deskew, Track
    from pc2scan.conversion.plan import Output
    from pc2scan.core.project import Transform
    from pc2scan.core.rigid import MovingTransform, Rigid
    from pc2scan.request.filters import Filter
    from pc2scan.request.spec import ScanSpec
    from pc2scan.transforms.placing import LevelFrame, Placer

    from .grouping import Rule

#: Bytes that a message takes besides its arrays.
_OVERHEAD = 2_000

_DEFAULTS = ProjectionParams()
_AXES = frozenset("xyz")


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
        Over how long a time transforms of the robot's motion were interpolated at most, nanoseconds.
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
    size: int = 0


class MessagesToScan:
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
        What places points at their own times, by topic. Other topics are placed at the message's stamp.
    surroundings
        Samples some clouds that are not deskewed; None: nothing does.
    """

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
        params = spec.params
        self._beams = Beams(spec, measured)
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
        self._early: SelectStep | None = None
        self._late: SelectStep | None = None
        late: Sequence[Filter] = ()
        if spec.filters:
            late = tuple(chosen for chosen in spec.filters if chosen.frame is Frame.TARGET and not self._rigid)
            early = tuple(chosen for chosen in spec.filters if chosen not in late)
            self._early = SelectStep(early, placer) if early else None
            self._late = SelectStep(late, placer) if late else None
        self._intensity = params.intensity_field or ("intensity" if spec.combining.rebin else "")
        self._kept = {"x", "y", "z", self._intensity, *(field for chosen in late for field in chosen.fields)}
        #: Upstream's default minimum, the smallest positive number, is meant for clouds: it rejects all beams of scans.
        self._any_height = params.min_height == _DEFAULTS.min_height

    def steps(self, topic: str) -> Steps:
        """Return the step of one topic's messages, which makes a scan only if each message becomes one."""
        contribute = partial(self._contribute, self.topics.index(topic), self._deskews.get(topic))
        return Steps(project=contribute if self.grouper else lambda message: self.alone(contribute(message)))

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
            seen_in = Placement(target, mount) if self._rigid else Placement("", None)
            points, transform, by_filters = self._early.apply(points, seen_in)
            rejected |= by_filters
            mount = cast("Rigid | None", transform) if self._rigid else mount
        name = target if level is None else level.name
        poses = mount, target_from_fixed, fixed_from_source
        contribution = Contribution(
            number, stamp_ns, reference_ns, points, name, *poses, gap_ns, track, level, rejected, flat
        )
        # The place of these points does not depend on the time of a scan that another message leads.
        is_certain = self._rigid or (self._once and number == 0)
        if flat or self._intensity or not self._projector.reads_nearest or not is_certain:
            return self._keep_points(contribution)
        # They are in the processor's cache now; projecting them later takes twice as long.
        points, transform, lost, gap_ns = self._place(contribution, contribution)
        nearest = self._projector.nearest(PointsPart(*points.xyz(), _round_transform(transform)))
        if lost:
            nearest.counts += PointCounts.of_filters(lost)
        nothing = Points(points.sequence, stamp_ns, points.frame_id, {})
        size = _OVERHEAD + nearest.ranges.nbytes
        return contribution._replace(points=nothing, track=None, nearest=nearest, gap_ns=gap_ns, size=size)

    def _keep_points(self, contribution: Contribution) -> Contribution:
        """Return a message with the fields that its scan needs."""
        track, points = contribution.track, contribution.points
        if not contribution.flat and self._intensity:
            # A missing field is an error of this message, not of the scan.
            points.field(self._intensity)
        names = self._kept if track is None else self._kept | {track.time_field}
        views = {name: points.field(name) for name in dict.fromkeys(("x", "y", "z", *points.fields)) if name in names}
        size = _OVERHEAD + sum(view.nbytes for view in views.values())
        if self.grouper is not None:
            axes = contiguous(*(views[axis] for axis in "xyz"))
            copies = {name: np.array(values).reshape(-1) for name, values in views.items() if name not in _AXES}
            views = copies | dict(zip("xyz", axes, strict=True))
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
        longest_ns = 0
        for member in members:
            if member.nearest is not None:
                known.append(member.nearest)
                longest_ns = max(longest_ns, member.gap_ns)
                continue
            points, transform, rejected, gap_ns = self._place(lead, member)
            longest_ns = max(longest_ns, gap_ns)
            if rejected:
                others.append(PointCounts.of_filters(rejected))
            values = points.field(self._intensity) if self._intensity in points.fields else None
            by_height = not (member.flat and self._any_height)
            parts.append(PointsPart(*points.xyz(), _round_transform(transform), values, any_height=not by_height))
        if known:
            scan = self._projector.nearest_of([*known, *map(self._projector.nearest, parts)])
        else:
            scan = self._projector.together(parts)
        header, counts = (lead.points.sequence, lead.reference_ns, lead.frame_id), sum(others, scan.counts)
        return self._beams.message(header, scan, counts, lead.level, longest_ns, lead.reference_ns)

    def _place(
        self, lead: Contribution, member: Contribution
    ) -> tuple[Points, Rigid | MovingTransform | None, Mapping[str, int], int]:
        """Return a member's points, the transform still to apply, the rejection counts, and the longest gap."""
        mount = member.mount
        if lead.level is not None:
            level_from_target = lead.level.frame_from_level.inverse()
            mount = level_from_target if mount is None else level_from_target.compose(mount)
        transform, moving, gap_ns = mount, None, 0
        if lead.target_from_fixed is not None and member.track is not None:
            track = member.track._replace(points=member.points)
            moving = track.seen_from(lead.target_from_fixed, lead.frame_id, lead.reference_ns)
            gap_ns = moving.gap_ns
        # At the scan's own time, the transform between the two frames is used, so that the bits are the same.
        elif (
            lead.target_from_fixed is not None
            and member.stamp_ns != lead.reference_ns
            and member.fixed_from_source is not None
        ):
            transform = lead.target_from_fixed.product(member.fixed_from_source)
            gap_ns = max(lead.gap_ns, member.gap_ns)
        if self._late is None:
            return member.points, transform if moving is None else moving.transform, member.rejected, gap_ns
        points, still, rejected = self._late.apply(member.points, Placement(lead.frame_id, transform), moving)
        return points, still, {**member.rejected, **rejected}, gap_ns


def _round_transform(transform: Rigid | MovingTransform | None) -> Transform | MovingTransform | None:
    """Return a transform as it is applied to points."""
    return None if transform is None else transform.as_float32()


#: How many messages of a topic are read to measure its period, and to compare its clock.
_HEADERS = 6

#: The period of topics without two different stamps, nanoseconds.
_USUAL_PERIOD_NS = 100_000_000

#: Two topics have different clocks if the delays from their stamps to their log times differ by this.
_SURELY_ANOTHER_NS = 2_000_000_000

#: A window of more periods was probably meant in milliseconds; so are seconds of more messages in one scan.
_MOST_PERIODS = 5
_MOST_MESSAGES = 300

#: The fields that the beams of a LaserScan have.
_BEAM_FIELDS = ("x", "y", "z", "intensity", "index")


class SourceFacts:
    """What the messages of topics that become scans together show.

    Parameters
    ----------
    output
        The request, and the topics.
    facts
        What the survey shows of each topic.
    """

    def __init__(self, output: Output, facts: Mapping[str, TopicFacts]) -> None:
        self.output, self.facts = output, facts
        combining = output.spec.combining
        self.flat = [topic for topic in output.sources if of_types(facts[topic].connections, SCANS)]
        self._is_compared = len(facts) > 1 or combining.every_ns or combining.span_ns
        if self._is_compared:
            for topic_facts in facts.values():
                topic_facts.ask_headers(_HEADERS)

    def period_ns(self, topic: str) -> int:
        """Return the median interval of the first stamps of a topic; 0 if there are no two different ones."""
        headers = self.facts[topic].headers[:_HEADERS] if self._is_compared else ()
        return median_interval_ns(header.stamp_ns for header in headers) or 0


def measure_sources(
    sources: SourceFacts, placer: Placer
) -> tuple[Measurements, Callable[[], Grouper] | None, list[str], list[str]]:
    """Measure what scans of several messages need.

    Parameters
    ----------
    sources
        What was observed of its messages.

    Returns
    -------
    Measurements
        The measurements of the leading topic.
    callable
        Makes the grouper of messages; None: each message becomes a scan by itself.
    list of str, list of str
        Notes and warnings.

    Raises
    ------
    ParameterError
        If a field is missing, or a parameter that is ``auto`` cannot be measured.
    UsageError
        If the stamps of the topics are of different clocks.
    """
    output = sources.output
    spec, topics = output.spec, output.sources
    combining, lead = spec.combining, topics[0]
    measurements, notes = Measurements.given(spec.params), list[str]()
    if spec.needs_measuring:
        for topic, facts in sources.facts.items():
            if topic not in sources.flat:
                require_cloud_fields(facts, spec)
        measurements, notes = measure(sources.facts[lead], spec, placer)
    if sources.flat:
        hint = "the beams of a LaserScan have intensity, index, x and y"
        require_fields(spec, _BEAM_FIELDS, f"the scans on {name_list(sources.flat)}", hint)
    is_default = spec.origins.get("scan_time", "default") == "default"
    if combining.every_ns and (spec.params.scan_time == "auto" or is_default):
        measurements = Measurements(combining.every_ns / 1e9, measurements.time_increment, 0, measurements.azimuth_step)
    # The window of a topic: half its own period or half the leading topic's, whichever is longer.
    periods = [sources.period_ns(topic) or _USUAL_PERIOD_NS for topic in topics]
    windows = [combining.window_ns] * len(topics) if combining.window_ns is not None else None
    windows = windows or [max(period, periods[0]) // 2 for period in periods]
    warnings = [*_doubtful(sources), *_clocks(sources, [0] * len(topics) if combining.accumulates else windows)]
    # The first message is in the middle of an interval: near its edge, jitter would move messages to the next.
    half_ns = sources.period_ns(lead) // 2
    if combining.span_ns or combining.count:
        rule: Rule = Recent(combining.every_ns, half_ns, combining.span_ns, combining.count)
    elif combining.every_ns:
        rule = Interval(combining.every_ns, half_ns)
    elif len(topics) == 1:
        return measurements, None, notes, warnings
    else:
        rule = Nearest(windows_ns=tuple(windows))
        joined = (f"{topic} (within {window / 1e9:.4g} s)" for topic, window in zip(topics, windows, strict=True))
        notes.append(
            f"{output.target}: has the stamps of {lead}, and the nearest messages of {', '.join([*joined][1:])}"
        )
    return measurements, partial(Grouper, rule, len(topics), apart_ns=combining.window_ns or 0), notes, warnings


def _doubtful(sources: SourceFacts) -> Iterator[str]:
    """Yield warnings of times that were probably meant in milliseconds, or as a number of clouds."""
    combining, lead = sources.output.spec.combining, sources.output.sources[0]
    period_ns = sources.period_ns(lead)
    times = {"every": combining.every_ns, "accumulate": combining.span_ns, "window": combining.window_ns or 0}
    for name, value_ns in times.items() if period_ns else ():
        number, seconds = value_ns / period_ns, value_ns / 1e9
        meant = []
        if seconds >= 1 and number > (_MOST_PERIODS if name == "window" else _MOST_MESSAGES):
            meant.append(f"if milliseconds were meant: `{name}={seconds:g}ms`")
        if seconds >= 1 and number > 1 and name == "accumulate" and combining.is_bare:
            meant.append(f"if clouds were meant: `{name}={seconds:g}clouds`")
        if meant:
            every = f"messages of {lead} come every {period_ns / 1e9:.3g} s"
            yield f"`{name}` is {seconds:g} s, but {every}; {', '.join(meant)}"


def _clocks(sources: SourceFacts, windows: Sequence[int]) -> Iterator[str]:
    """Compare the clocks of the topics: yield warnings if they may differ, and raise if they do."""
    lead, *others = (sources.facts[topic] for topic in sources.output.sources)
    for other, window_ns in zip(others, windows[1:], strict=True):
        are_known = lead.headers and other.headers
        if not are_known or not are_doubtful(other.delay_ns, lead.delay_ns, window_ns):
            continue
        behind_ns = other.delay_ns - lead.delay_ns
        distance = f"{abs(behind_ns) / 1e9:.4g} s {'behind' if behind_ns > 0 else 'ahead of'}"
        difference = f"the stamps of {other.topic} are {distance} those of {lead.topic}, compared with their log times"
        if abs(behind_ns) > _SURELY_ANOTHER_NS:
            raise UsageError(
                f"{difference}: they are of different clocks",
                hint=f"{MEASURES}; or convert them to scans of their own: `topics={other.topic}:=/scan_2`",
            )
        yield f"{difference}: if their clocks differ, a scan has what was measured that far apart; {MEASURES}"
