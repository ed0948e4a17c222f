"""Prepares the conversions of a run: asks a survey for what they need, lets it read, and makes them of its facts.

Before anything is written, the first clouds of each topic are converted and judged; a dry run counts them.
"""

from __future__ import annotations

from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from pc2scan.advice.checks import judge
from pc2scan.advice.checks.first_clouds import CloudFacts, KnownTransforms
from pc2scan.advice.checks.plausibility import in_another_unit
from pc2scan.advice.clocks import CLOCK_HEADERS, Clocks, moving, refuse_other_clock
from pc2scan.advice.measurements import (
    ask_measurements,
    ask_times,
    measure,
    measured_times,
    require_cloud_fields,
    time_warnings,
)
from pc2scan.advice.odometry import Surroundings, odometry_of
from pc2scan.advice.survey import Span, Survey, placed_sample
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.bags.topics import by_topic
from pc2scan.core.points import Points
from pc2scan.core.scene import JUDGED_CLOUDS, PARTS, CloudSample, are_enough
from pc2scan.errors import Pc2ScanError, TopicError, UnconnectedError, UsageError, name_list
from pc2scan.messages.tfmessage import TF_TYPES
from pc2scan.request.point_time import PointTime
from pc2scan.text import stamp
from pc2scan.transforms.placing import Placer, UpByFrame, UpByImu
from pc2scan.transforms.reading import read_robot_transforms

from .combine.contributions import MessagesToScan, SourceFacts, measure_sources
from .corrections import corrected
from .deskew import Deskew
from .engine import convert_message
from .frame_checks import check_fixed_frame, check_given_frames
from .result_checks import result_findings
from .steps import CloudToScan, ConvertedMessage, ScanToCloud

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

    from pc2scan.advice.measurements import Measurements
    from pc2scan.advice.odometry import Odometry
    from pc2scan.advice.survey import TopicFacts
    from pc2scan.bags.reader import Reader
    from pc2scan.core.rule import PointCounts
    from pc2scan.model import ChunkRule, Connection, RawMessage
    from pc2scan.progress import Meter
    from pc2scan.request.spec import Request, ScanSpec
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.placing import UpSource
    from pc2scan.transforms.reading import RecordedTransforms

    from .added_transforms import AddedTransforms
    from .engine import Item, Items, Tally
    from .plan import Plan, Route
    from .report import Report
    from .steps import Conversion


@dataclass(slots=True, eq=False)
class Preparation:
    """What a run reads and does, and what was found out before the first message.

    Attributes
    ----------
    reader, plan, options
        The recording, the routes, and the options of the conversion.
    span
        The cut.
    known
        The transforms that checks of the first clouds may use.
    tell
        Called with warnings as soon as they are known, also if an error follows.
    others
        The other recordings that transforms were read from.
    recorded
        All transforms; None if they were not read.
    conversions
        By the request of their outputs, and the topic of scans that are made of several messages.
    routes
        As for `pc2scan.conversion.engine.items_of`, without those that are counted already.
    levels, trajectory
        What writes the frames of level scans, and `between`, which writes the transforms of a file; None without any.
    rule
        Which of the source's chunks can be copied whole; None: none.
    surroundings
        What is seen where the robot moves most, with the labels of the outputs.
    notes
        Texts for the user.
    """

    reader: Reader
    plan: Plan
    request: Request
    span: Span
    known: KnownTransforms
    tell: Callable[..., None]
    others: Sequence[Reader] = ()
    recorded: RecordedTransforms | None = None
    conversions: dict[tuple[Any, str], Conversion] = field(default_factory=dict)
    routes: Mapping[int, Route] = field(default_factory=dict)
    levels: AddedTransforms | None = None
    trajectory: Callable[..., Items] | None = None
    rule: ChunkRule | None = None
    surroundings: list[tuple[str, Surroundings]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, spec: ScanSpec, warnings: Iterable[str], notes: Iterable[str] = ()) -> None:
        """Add warnings and notes about an output."""
        self.tell(*(spec.label + text for text in warnings))
        self.notes += (spec.label + text for text in notes)


def span_of(reader: Reader, request: Request) -> Span:
    """Return the cut in log times; relative times count from the recording's beginning."""
    beginning = reader.summary.start_ns
    if beginning is None:
        first = next(reader.messages(), None)
        beginning = first.log_time_ns if first is not None else 0
    start = None if request.start is None else request.start.resolve(beginning)
    stop = None if request.end is None else request.end.resolve(beginning)
    if start is not None and stop is not None and start >= stop:
        raise UsageError("the cut is empty: start is not before end")
    return Span(start, stop, beginning if start is None else max(start, beginning))


def refuse_no_messages(
    reader: Reader, converted: Sequence[Connection], start_ns: int | None, stop_ns: int | None
) -> None:
    """Raise if the topics to convert have no messages, or none in the cut.

    The index is read first. If it lists no messages, the recording is read as well, because an index may be wrong.

    Raises
    ------
    UsageError
        If the cut lies outside of the recording.
    TopicError
        If there are no messages in it.
    """
    if not converted:
        return
    counts = reader.counts(converted, start_ns, stop_ns)
    is_cut = start_ns is not None or stop_ns is not None
    outside = _outside(reader, start_ns, stop_ns) if is_cut else None
    if outside is None and any(counts.get(connection.id) != 0 for connection in converted):
        return
    with closing(reader.messages(converted, start_ns, stop_ns)) as messages:
        if next(messages, None) is not None:
            return
    # If the recording is damaged, this is reported instead.
    if reader.damage:
        return
    if outside is not None:
        raise outside
    topics = name_list(sorted({connection.topic for connection in converted}))
    raise TopicError(
        f"there is nothing to convert: no messages on {topics}{' in the cut' if is_cut else ''}",
        hint="check `start` and `end`" if is_cut else "pc2scan info lists the topics, and how many messages they have",
    )


def refuse_outside(reader: Reader, start_ns: int | None, stop_ns: int | None) -> None:
    """Raise if the cut lies outside of the recording, unless this is damaged, which is reported instead.

    Raises
    ------
    UsageError
        If it does.
    """
    if not reader.damage and (outside := _outside(reader, start_ns, stop_ns)) is not None:
        raise outside


def _outside(reader: Reader, start_ns: int | None, stop_ns: int | None) -> UsageError | None:
    """Return the error for a cut outside of the recording; None if the cut is inside, or the times are unknown."""
    first_ns, last_ns = reader.summary.start_ns, reader.summary.end_ns
    if first_ns is None or last_ns is None or not reader.summary.message_count:
        return None
    late = start_ns is not None and start_ns > last_ns
    early = stop_ns is not None and stop_ns <= first_ns
    if not late and not early:
        return None
    name, time_ns = ("start", start_ns) if late else ("end", stop_ns)
    seconds = (last_ns - first_ns) / 1e9
    meant = in_another_unit(name, time_ns or 0, first_ns, last_ns)
    return UsageError(
        f"the cut is outside of the recording: `{name}` is {stamp(time_ns or 0)}, the recording is from "
        f"{stamp(first_ns)} to {stamp(last_ns)}",
        path=reader.path,
        hint=(f"{meant}; " if meant else "") + f"its {seconds:.3f} s are `start=0` to `end={seconds + 0.001:.3f}`",
    )


def prepare(
    reader: Reader,
    plan: Plan,
    request: Request,
    span: Span,
    stack: ExitStack,
    tell: Callable[..., None],
    *,
    transform_frames: Collection[str] | None = None,
    meter: Meter | None = None,
) -> Preparation:
    """Prepare the conversion of each output: correct stamps, read transforms, and measure what is ``auto``.

    Parameters
    ----------
    reader
        The recording.
    span
        The cut.
    stack
        Closes the other recordings.
    tell
        Called with warnings as soon as they are known, also if an error follows.
    transform_frames
        The frames that the caller needs transforms of, even if the conversion needs none; None: it needs no transforms.
    meter
        Counts the work of the preparation and of the conversion that follows; None: nothing is reported.
    """
    frames = request.frames
    notes: list[str] = []
    if request.clock:
        fields = [spec.point_time.field for spec in plan.specs if spec.point_time and spec.point_time.field]
        reader, notes = corrected(reader, plan.converted, request.clock, frames.tf_topics, span, fields)
    if meter is not None:
        connections = [route.connection for route in plan.routes]
        meter.following = reader.stored_bytes(connections, span.start_ns, span.stop_ns)
    known = KnownTransforms(frames.source_frame, cache(partial(_robot_transforms, reader, request, span)))
    prepared = Preparation(reader, plan, request, span, known, tell, notes=notes)
    # Added transforms are written to the output, even if it needs none.
    uses_frames = frames.source_frame or frames.static or frames.adds_poses or frames.write_static
    measures = (spec.needs_measuring or spec.may_combine for spec in plan.specs if not spec.reverse)
    places = (spec.needs_transforms for spec in plan.specs)
    if transform_frames is not None or uses_frames or any(places) or any(measures):
        _look_ahead(prepared, transform_frames, stack, meter)
        return prepared
    for spec in plan.specs:
        own = ScanToCloud(spec.channels, Placer()) if spec.reverse else CloudToScan(spec, Placer())
        prepared.conversions[spec, ""] = own
    return prepared


def _look_ahead(
    prepared: Preparation, transform_frames: Collection[str] | None, stack: ExitStack, meter: Meter | None
) -> None:
    """Ask a survey for what the outputs need, let it read, and make their conversions of its facts; see `prepare`."""
    reader, plan, request, span = prepared.reader, prepared.plan, prepared.request, prepared.span
    frames, known, tell = request.frames, prepared.known, prepared.tell
    survey = Survey(reader, (), frames, span)
    placed_specs = [spec for spec in plan.specs if spec.needs_transforms]
    if transform_frames is not None or placed_specs or frames.write_static or frames.adds_poses:
        survey.others = prepared.others = open_recordings(frames.tf_from, stack, strict=request.strict)
        survey.ask_transforms((*(transform_frames or ()), *(frame for spec in placed_specs for frame in spec.frames)))
    given = [survey.facts([connection]) for connection in plan.converted if frames.static or frames.source_frame]
    for facts in given:
        facts.ask_headers(1)
    placed = survey.topics(plan.converted if frames.trajectory else ()).values()
    for facts in placed:
        facts.ask_headers(CLOCK_HEADERS)
    outputs = {spec: _OutputFacts(spec, plan, survey) for spec in plan.specs if not spec.reverse}
    survey.read(meter)
    prepared.recorded = transforms = None if survey.transforms is None else survey.transforms.finish()
    known.buffer = buffer = transforms.buffer if transforms is not None and placed_specs else None
    if transforms is not None:
        tell(*transforms.warnings)
        prepared.notes += (*transforms.notes, *transforms.replaced)
    if frames.trajectory is not None:
        refuse_other_clock(frames.trajectory, placed, span, reader.summary.end_ns)
    if given:
        robot = known.read() if transforms is None else transforms.buffer
        tell(*check_given_frames((facts.frame for facts in given), plan, frames, buffer, robot))
    for spec in plan.specs:
        placer = Placer(source_frame=frames.source_frame)
        if spec in placed_specs:
            up = None if buffer is None or not spec.level else _up_source(spec, buffer, survey, prepared)
            placer = Placer(spec.params.target_frame, frames.source_frame, buffer, spec.params.tolerance_ns, up)
        if spec.reverse:
            prepared.conversions[spec, ""] = ScanToCloud(spec.channels, placer, deskewed=spec.deskew)
        else:
            with spec.naming_errors():
                outputs[spec].convert_with(placer, prepared)


def _up_source(spec: ScanSpec, buffer: TransformBuffer, survey: Survey, prepared: Preparation) -> UpSource:
    """Return the source of the direction of up for a level output.

    Raises
    ------
    UsageError
        If the messages of an IMU do not show the direction of up.
    """
    tolerance_ns, request = spec.params.tolerance_ns, spec.imu
    if request is None:
        return UpByFrame(spec.fixed_frame, buffer, tolerance_ns)
    up = survey.imu(request.topic).up(request.frame)
    prepared.notes += up.notes
    prepared.tell(*up.warnings)
    return UpByImu(up, buffer, tolerance_ns)


class _OutputFacts:
    """The facts that one output to scans needs: requested before the survey reads, and used to make conversions."""

    def __init__(self, spec: ScanSpec, plan: Plan, survey: Survey) -> None:
        self._spec = spec
        self._where = (spec.point_time or PointTime()) if spec.deskew else None
        self._topics = survey.topics(plan.sources_of(spec)).values()
        references: list[Sequence[Connection]] = []
        if spec.fixed_frame:
            for facts in self._topics:
                facts.ask_headers(1)
            references.append(moving(survey.reader.connections, survey.frames.tf_topics))
        if spec.imu:
            observers = survey.imu(spec.imu.topic).observers(survey.reader)
            references.append([connection for observer in observers for connection in observer.connections])
        self._clocks = [Clocks(survey, plan.sources_of(spec), reference) for reference in references]
        self._alone = survey.topics(plan.sources_of(spec, ""))
        joined = {out.joined: out for route in plan.routes for out in route.outputs if out.joined and out.spec is spec}
        self._sources = [SourceFacts(out, survey.topics(plan.sources_of(spec, out.joined))) for out in joined.values()]
        for topics in (self._alone, *(sources.facts for sources in self._sources)):
            for facts in topics.values():
                if spec.needs_measuring:
                    ask_measurements(facts, spec)
                if self._where is not None:
                    ask_times(facts, self._where)

    def convert_with(self, placer: Placer, prepared: Preparation) -> None:
        """Make the conversions of the output.

        Raises
        ------
        Pc2ScanError
            If something that it needs cannot be measured, or does not exist.
        """
        spec = self._spec
        for clocks in self._clocks:
            prepared.tell(*clocks.warnings())
        odometry = None
        if spec.fixed_frame and placer.buffer is not None:
            # By log time.
            first = min((facts.headers[0] for facts in self._topics if facts.headers), default=None)
            source = placer.source_frame or ("" if first is None else first.frame_id)
            doubts = check_fixed_frame(source, spec, placer.buffer)
            odometry = odometry_of(placer.buffer, spec.fixed_frame, source)
            prepared.add(spec, [*doubts, *([odometry.doubt] if odometry.doubt else [])])
        for sources in self._sources:
            timing, grouper, notes, doubts = measure_sources(sources, placer)
            prepared.add(spec, doubts, notes)
            topics = sources.output.sources
            surroundings = self._surroundings(placer, odometry, prepared, topics)
            deskews = self._deskews(placer, prepared, sources.facts, surroundings)
            scan = MessagesToScan(spec, topics, placer, timing, grouper, deskews, surroundings)
            prepared.conversions[spec, sources.output.joined] = scan
        if self._alone or not self._sources:
            measurements: dict[str, Measurements] = {}
            for topic, facts in self._alone.items() if spec.needs_measuring else ():
                require_cloud_fields(facts, spec)
                measurements[topic], notes = measure(facts, spec, placer)
                prepared.add(spec, (), notes)
            surroundings = self._surroundings(placer, odometry, prepared)
            deskews = self._deskews(placer, prepared, self._alone, surroundings)
            prepared.conversions[spec, ""] = CloudToScan(spec, placer, measurements, deskews)

    def _surroundings(
        self, placer: Placer, odometry: Odometry | None, prepared: Preparation, topics: Sequence[str] = ()
    ) -> Surroundings | None:
        """Return what samples the clouds of some topics, to compare them with the odometry; None where nothing does."""
        moves = odometry is not None and odometry.links and (self._spec.deskew or len(topics) > 1)
        if placer.buffer is None or odometry is None or not moves:
            return None
        first_ns = prepared.span.first_ns
        times = (first_ns, prepared.span.stop_ns or prepared.reader.summary.end_ns or first_ns)
        surroundings = Surroundings(self._spec, placer.buffer, odometry, placer.source_frame, times, topics)
        prepared.surroundings.append((self._spec.label, surroundings))
        return surroundings

    def _deskews(
        self, placer: Placer, prepared: Preparation, topics: Mapping[str, TopicFacts], surroundings: Surroundings | None
    ) -> dict[str, Deskew]:
        """Return what places points at their own times, by topic; nothing without deskewing."""
        spec, where = self._spec, self._where
        if where is None:
            return {}
        doubts = [text for own in topics.values() for text in time_warnings(own, where)]
        prepared.add(spec, doubts)
        if doubts:
            # Points at wrong times are where odometry that lags would put them.
            surroundings = None
        deskews = {}
        for topic, facts in topics.items():
            times, notes = measured_times(facts, where)
            prepared.add(spec, (), notes)
            sample = None if surroundings is None else partial(surroundings.add, topic)
            deskews[topic] = Deskew(placer, spec.fixed_frame, times, spec.stamp, sample)
        return deskews


def _robot_transforms(reader: Reader, request: Request, span: Span) -> TransformBuffer | None:
    """Read the transforms between the robot's frames, for checks of the first clouds."""
    frames = request.frames
    given = frames.static or frames.model or frames.tf_from
    if not given and all(connection.ros_type not in TF_TYPES for connection in reader.connections):
        return None
    with suppress(Pc2ScanError), ExitStack() as stack:
        others = open_recordings(frames.tf_from, stack)
        return read_robot_transforms(as_one([reader, *others]), frames, span.first_ns)
    return None


#: How many messages of a topic must lack transforms before a user is warned.
_UNCONNECTED = 10

#: How many topics are judged, each of which is read by itself: more than any robot has, fewer than a file can declare.
_MOST_TOPICS = 30


def judge_first(prepared: Preparation, report: Report, tally: Tally | None = None) -> None:
    """Add to the report what the first clouds of each topic show.

    Parameters
    ----------
    tally
        Counts these clouds, in a dry run: all are read until one is connected with the target frame.
    """
    reader, tell, routes = prepared.reader, prepared.tell, prepared.routes
    converted = [route.connection for route in routes.values() if any(output.spec for output in route.outputs)]
    for topic, connections in list(by_topic(converted).items())[:_MOST_TOPICS]:
        specs = {output.spec for own in connections for output in routes[own.id].outputs}
        specs = {spec for spec in specs if spec and not spec.reverse}
        clouds: dict[ScanSpec, CloudFacts] = {}
        judged: set[ScanSpec] = set()
        if tally is None and not specs:
            continue
        read = successes = 0
        unconnected: list[UnconnectedError] = []
        with closing(reader.messages(connections, prepared.span.start_ns, prepared.span.stop_ns)) as messages:
            for message in messages:
                item = convert_message(routes, message)
                alone = [(out, out.combiner.alone(result) if out.combiner else result) for out, result in item.results]
                item, read, successes = item._replace(results=alone), read + 1, successes + (item.failure is None)
                unconnected += [item.failure] if isinstance(item.failure, UnconnectedError) else []
                if tally is not None:
                    tally.count(item)
                if read == len(unconnected) == _UNCONNECTED:
                    why = f"{unconnected[0].message}{'; ' * bool(unconnected[0].hint)}{unconnected[0].hint or ''}"
                    tell(f"none of the first {read} messages can be converted: {topic}: {why}")
                for spec, sample, counts in _samples(item, message, specs - judged, prepared):
                    own = clouds.setdefault(spec, CloudFacts(topic, spec, prepared.known))
                    own.samples.append(sample)
                    own.counts.append(counts)
                judged = {spec for spec, own in clouds.items() if are_enough(own.samples)}
                # Scans of 2D lidars have nothing to judge.
                is_enough = judged == specs or (successes and not clouds) or read == PARTS
                if tally is not None:
                    is_enough = successes == JUDGED_CLOUDS or (read >= PARTS and tally.is_connected)
                if is_enough:
                    break
        for spec, own in clouds.items():
            judgement = judge(own)
            tell(*judgement.warnings)
            for entry in report.topics:
                if entry.topic == topic and entry.spec is spec:
                    entry.advice, entry.no_returns = judgement.advice, judgement.no_returns
                    entry.is_level = judgement.is_level


def _samples(
    item: Item, message: RawMessage, specs: Collection[ScanSpec], prepared: Preparation
) -> Iterator[tuple[ScanSpec, CloudSample, PointCounts]]:
    """Yield a sample of a cloud, and its points, for each of these outputs that it became a scan of."""
    scans = {
        output.spec: (output, result)
        for output, result in item.results
        if output.spec in specs and isinstance(result, ConvertedMessage)
    }
    points = item.route.decode(message.data) if scans else None
    if isinstance(points, Points):
        sample = CloudSample.of(points)
        for spec, (output, scan) in scans.items():
            placer, stamp_ns = prepared.conversions[spec, output.joined].placer, scan.stamp_ns or points.stamp_ns
            yield spec, placed_sample(sample, placer.place(points.frame_id, stamp_ns)), scan.counts


def count_by_index(prepared: Preparation, report: Report) -> None:
    """Fill in the report of a dry run: its points are those of the first messages, its counts those of the index."""
    reader, span, routes = prepared.reader, prepared.span, prepared.routes
    report.ways = [words for route in prepared.plan.routes for words in route.words]
    report.add(reader.remarks)
    report.damage += reader.damage
    report.add(*result_findings(report))
    for entry in (entry for route in routes.values() for entry in route.reports):
        entry.messages_in = entry.messages_out = entry.skipped = 0
    counts = reader.counts([route.connection for route in routes.values()], span.start_ns, span.stop_ns)
    uncounted = set()
    for key, route in routes.items():
        count = counts.get(key, route.connection.message_count)
        if count is None:
            uncounted.add(route.connection.topic)
        for entry in route.reports:
            entry.messages_in += count or 0
            # How many intervals have a leading message is not known.
            if route.writes and not (entry.spec is not None and entry.spec.combining.every_ns):
                entry.messages_out += count or 0
    if uncounted:
        report.notes.append(f"no index counts the messages on {', '.join(sorted(uncounted))}")
