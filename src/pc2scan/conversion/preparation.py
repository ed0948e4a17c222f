"""Prepares the conversions of a run: reads transforms, and measures what is ``auto``, before the first message."""

from __future__ import annotations

from contextlib import ExitStack, contextmanager, suppress
from functools import cache, partial
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.advice.first_clouds import FirstClouds
from pc2scan.advice.survey import Span
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.errors import Pc2ScanError, UsageError
from pc2scan.messages.tfmessage import TF_TYPES
from pc2scan.transforms.placing import Placer

from .cloud_to_scan import CloudToScan
from .items import Tally

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Mapping, Sequence

    from pc2scan.advice.clocks import Delays
    from pc2scan.advice.measurements import Measurements
    from pc2scan.advice.odometry import Odometry, Surroundings
    from pc2scan.advice.survey import Survey, TopicFacts
    from pc2scan.bags.observers import Observer
    from pc2scan.bags.reader import Reader
    from pc2scan.progress import Meter
    from pc2scan.request.options import ConvertOptions, ScanSpec
    from pc2scan.request.point_time import PointTime
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.placing import FrameOptions
    from pc2scan.transforms.reading import FoundTransforms

    from .combine.measurements import SourceFacts
    from .items import OpenRoute
    from .plan import Combination, Plan
    from .report import Report
    from .stages.deskew import Deskew
    from .steps import Conversion


class Preparation(NamedTuple):
    """The conversions of a run, and what was found out before them.

    Attributes
    ----------
    conversions
        Of each output, and of each combination.
    span
        The cut.
    firsts
        The warnings so far, and the first clouds, which are judged while they are converted.
    others
        The other recordings that transforms were read from.
    notes
        Texts for the user; `firsts` has the warnings.
    found
        All transforms; None if they were not read.
    """

    conversions: Mapping[ScanSpec | Combination, Conversion]
    span: Span
    firsts: FirstClouds
    others: Sequence[Reader] = ()
    notes: Sequence[str] = ()
    found: FoundTransforms | None = None

    @property
    def transforms(self) -> TransformBuffer | None:
        """All transforms, for lookups; None if they were not read."""
        return None if self.found is None else self.found.buffer

    @contextmanager
    def counting(self, routes: Mapping[int, OpenRoute], report: Report, *, strict: bool) -> Generator[Tally]:
        """Count the items of the conversion; the report then has what the first clouds show, also after an error.

        It has their warnings already: the preparation's ``warn`` was called with them.
        """
        tally = Tally(routes, self.firsts.warn, strict=strict)
        report.skipped = tally.skipped
        try:
            yield tally
            tally.finish()
            self.firsts.finish()
        finally:
            report.add((), self.firsts.notes, self.firsts.advice, self.firsts.no_returns)


def span_of(reader: Reader, options: ConvertOptions) -> Span:
    """Return the cut in log times; relative times count from the recording's beginning."""
    beginning = reader.summary.start_ns
    if beginning is None:
        first = next(reader.messages(), None)
        beginning = first.log_time_ns if first is not None else 0
    start = None if options.start is None else options.start.resolve(beginning)
    stop = None if options.end is None else options.end.resolve(beginning)
    if start is not None and stop is not None and start >= stop:
        raise UsageError("the cut is empty: start is not before end")
    return Span(start, stop, beginning if start is None else max(start, beginning))


def prepare(
    reader: Reader,
    plan: Plan,
    options: ConvertOptions,
    span: Span,
    stack: ExitStack,
    warn: Callable[[str], None] | None = None,
    *,
    transform_frames: Collection[str] | None = None,
    meter: Meter | None = None,
) -> Preparation:
    """Prepare the conversion of each output: read transforms, and measure what is ``auto``.

    Parameters
    ----------
    reader
        The recording.
    span
        The cut.
    stack
        Closes the other recordings.
    warn
        Called with each warning as soon as it is known, also of the first clouds, and if an error follows.
    transform_frames
        The frames that the caller needs transforms of, even if the conversion needs none; None: it needs no transforms.
    meter
        Counts the work of the preparation and of the conversion that follows; None: nothing is reported.
    """
    asked = options.frames
    # Added transforms are written to the output, even if it needs none.
    adds_transforms = asked.write_static or asked.odometry or asked.trajectory
    reads_transforms = transform_frames is not None or plan.needs_transforms or adds_transforms
    read_later = cache(partial(_robot_transforms, reader, options, span))
    firsts = FirstClouds(asked.source_frame, read_later, warn)
    needs_survey = reads_transforms or asked.static or asked.model or asked.source_frame or plan.combinations
    if not (needs_survey or any(spec.needs_measuring for spec in plan.specs if not spec.reverse)):
        placer = Placer()
        unmeasured: dict[ScanSpec | Combination, Conversion] = {
            spec: _to_clouds(spec, placer) if spec.reverse else _to_scans(spec, placer, None, None, firsts)
            for spec in plan.specs
        }
        return Preparation(unmeasured, span, firsts)
    from pc2scan.advice.survey import Survey  # noqa: PLC0415  # most conversions return above

    others: Sequence[Reader] = ()
    if reads_transforms:
        others = open_recordings(asked.tf_from, stack, strict=options.strict)
    survey = Survey(reader, others, asked, span)
    if reads_transforms:
        needed = (frame for spec in plan.specs if spec.needs_transforms for frame in spec.frames)
        survey.ask_transforms((*(transform_frames or ()), *needed))
    else:
        survey.ask_robot()
    return _prepare_by_facts(survey, plan, firsts, meter)


def _prepare_by_facts(survey: Survey, plan: Plan, firsts: FirstClouds, meter: Meter | None) -> Preparation:
    """Ask the survey for what each output needs besides transforms, let it read, and make conversions of the facts."""
    asked, reader, span = survey.frames, survey.reader, survey.span
    notes: list[str] = []
    gives_frames = bool(asked.static or asked.source_frame)
    given = [survey.facts([route.connection]) for route in plan.routes if gives_frames and route.tasks]
    for facts in given:
        facts.ask_headers(1)
    placed: Collection[TopicFacts] = ()
    if asked.trajectory is not None:
        from pc2scan.advice.clocks import CLOCK_HEADERS  # noqa: PLC0415  # few conversions add poses

        placed = survey.topics(route.connection for route in plan.routes if route.tasks).values()
        for facts in placed:
            facts.ask_headers(CLOCK_HEADERS)
    outputs = {spec: _OutputFacts(spec, plan, survey, asked) for spec in plan.specs if not spec.reverse}
    if meter is not None:
        connections = [route.connection for route in plan.routes]
        meter.following = reader.stored_bytes(connections, span.start_ns, span.stop_ns)
    survey.read(meter)
    transforms: TransformBuffer | None = None
    found: FoundTransforms | None = None
    if survey.transforms is not None:
        found = survey.transforms.finish()
        transforms = found.buffer
        firsts.warn(*found.warnings)
        notes += found.notes
    if asked.trajectory is not None:
        from pc2scan.advice.clocks import refuse_other_clock  # noqa: PLC0415  # few conversions add poses

        refuse_other_clock(asked.trajectory, placed, span, reader.summary.end_ns)
    buffer = transforms if plan.needs_transforms else None
    if buffer is not None:
        firsts.transforms.buffer, firsts.transforms.static = buffer, asked.static
    elif survey.robot is not None:
        firsts.transforms.read = survey.robot.finish
    if given:
        from .frame_checks import check_given_frames  # noqa: PLC0415  # few conversions add frames

        robot = transforms if survey.robot is None else survey.robot.finish()
        firsts.warn(*check_given_frames((facts.frame for facts in given), plan, asked, buffer, robot))
    ups = None
    if buffer is not None and any(spec.level for spec in plan.specs):
        from .levelling import UpSources  # noqa: PLC0415  # only where scans are level

        ups = UpSources(buffer, lambda request: survey.imu(request.topic).up(request.frame))
    conversions: dict[ScanSpec | Combination, Conversion] = {}
    for spec in plan.specs:
        placer = Placer(source_frame=asked.source_frame)
        if spec.needs_transforms:
            up = None
            if ups is not None and spec.level:
                up, estimate = ups.of(spec)
                notes += () if estimate is None else estimate.notes
                firsts.warn(*(() if estimate is None else estimate.warnings))
            placer = Placer(spec.params.target_frame, asked.source_frame, buffer, spec.params.tolerance_ns, up)
        if spec.reverse:
            conversions[spec] = _to_clouds(spec, placer)
            continue
        made, new_notes = outputs[spec].conversions(placer, firsts)
        conversions |= made
        notes += new_notes
    return Preparation(conversions, span, firsts, survey.others, notes, found)


class _OutputFacts:
    """The facts that one output to scans needs: asked for before the survey reads, and then made into conversions."""

    def __init__(self, spec: ScanSpec, plan: Plan, survey: Survey, frames: FrameOptions) -> None:
        self._spec, self._reader, self._span = spec, survey.reader, survey.span
        self._is_alone = bool(plan.sources_of(spec, None))
        self._topics: Mapping[str, TopicFacts] = {}
        self._alone: Mapping[str, TopicFacts] = {}
        self._where: PointTime | None = None
        self._motion: Mapping[str, Observer[Delays]] = {}
        self._sources: list[SourceFacts] = []
        if spec.fixed_frame or spec.imu or spec.deskew:
            self._topics = survey.topics(plan.sources_of(spec))
        if spec.fixed_frame or spec.imu:
            from pc2scan.advice.clocks import CLOCK_HEADERS, ask_motion  # noqa: PLC0415  # only where clocks are compared

            self._motion = ask_motion(survey, frames, spec)
            for facts in self._topics.values():
                facts.ask_headers(CLOCK_HEADERS)
            if spec.imu_request:
                survey.imu(spec.imu_request.topic)
        for combination in (each for each in plan.combinations if each.spec is spec):
            from .combine.measurements import SourceFacts  # noqa: PLC0415  # few scans are of several messages

            own = survey.topics(plan.sources_of(spec, combination))
            facts_of = {topic: own[topic] for topic in combination.sources}
            self._sources.append(SourceFacts(combination, facts_of, survey.reader, survey.span))
            survey.observers += self._sources[-1].observers
        if spec.needs_measuring:
            from pc2scan.advice.measurements import ask_measurements  # noqa: PLC0415  # only if something is to be measured

            self._alone = survey.topics(plan.sources_of(spec, None))
            for facts in self._alone.values():
                ask_measurements(facts, spec)
        if spec.deskew:
            from pc2scan.advice.point_times import ask_times  # noqa: PLC0415  # only with deskewing
            from pc2scan.request.point_time import PointTime  # noqa: PLC0415

            self._where = PointTime.parse(spec.point_time)
            for topics in (self._alone, *(each.facts for each in self._sources)):
                for facts in topics.values():
                    ask_times(facts, self._where)

    def conversions(
        self, placer: Placer, firsts: FirstClouds
    ) -> tuple[dict[ScanSpec | Combination, Conversion], list[str]]:
        """Return the conversions of the output and of its combinations, and notes; adds warnings to `firsts`.

        Raises
        ------
        Pc2ScanError
            If something that it needs cannot be measured, or does not exist.
        """
        spec = self._spec
        conversions: dict[ScanSpec | Combination, Conversion] = {}
        notes: list[str] = []
        if self._motion:
            from pc2scan.advice.clocks import clock_warnings  # noqa: PLC0415  # only where times of several topics are compared

            firsts.warn(*clock_warnings(self._topics.values(), self._motion))
        odometry = None
        if spec.fixed_frame and placer.buffer is not None:
            from pc2scan.advice.odometry import odometry_of, odometry_warnings, tilt_warnings  # noqa: PLC0415

            from .frame_checks import check_fixed_frame  # noqa: PLC0415  # few conversions have one

            # By log time.
            first = min((facts.headers[0] for facts in self._topics.values() if facts.headers), default=None)
            source = placer.source_frame or ("" if first is None else first.frame_id)
            with spec.naming_errors():
                doubts = check_fixed_frame(source, spec, placer.buffer)
            odometry = odometry_of(placer.buffer, spec.fixed_frame, source)
            doubts += odometry_warnings(spec, odometry)
            if placer.up is not None:
                doubts += tilt_warnings(spec, odometry, placer.up)
            firsts.warn(*(spec.label + doubt for doubt in doubts))
        for sources in self._sources:
            from .combine.conversion import MessagesToScan  # noqa: PLC0415  # few scans are made of several messages
            from .combine.measurements import measure_sources  # noqa: PLC0415

            with spec.naming_errors():
                timing, grouper, new_notes, doubts = measure_sources(self._reader, sources, placer)
            notes += (spec.label + note for note in new_notes)
            firsts.warn(*(spec.label + doubt for doubt in doubts))
            combination = sources.combination
            seen = self._surroundings(placer, firsts, odometry, combination.sources)
            deskew, new_notes = self._deskew(placer, firsts, sources.facts.values(), seen)
            notes += new_notes
            conversions[combination] = MessagesToScan(
                spec, combination.sources, placer, timing, grouper, deskew, partial(firsts.of, spec), seen
            )
        if self._is_alone or not self._sources:
            measurements = None
            if spec.needs_measuring:
                from pc2scan.advice.measurements import measure  # noqa: PLC0415  # only if something is to be measured

                with spec.naming_errors():
                    measurements, new_notes = measure(self._alone.values(), spec, placer)
                notes += (spec.label + note for note in new_notes)
            seen = self._surroundings(placer, firsts, odometry)
            deskew, new_notes = self._deskew(placer, firsts, self._alone.values(), seen)
            notes += new_notes
            conversions[spec] = _to_scans(spec, placer, measurements, deskew, firsts)
        return conversions, notes

    def _surroundings(
        self, placer: Placer, firsts: FirstClouds, odometry: Odometry | None, topics: Sequence[str] = ()
    ) -> Surroundings | None:
        """Return what samples the clouds of some topics, to compare them with the odometry; None where nothing does."""
        if placer.buffer is None or odometry is None or not odometry.links:
            return None
        if not (self._spec.deskew or len(topics) > 1):
            return None
        from pc2scan.advice.odometry import Surroundings  # noqa: PLC0415  # few conversions have a fixed frame

        first_ns, last_ns = self._span.first_ns, self._span.stop_ns or self._reader.summary.end_ns
        span = (first_ns, first_ns if last_ns is None else last_ns)
        seen = Surroundings(self._spec, placer.buffer, odometry, placer.source_frame, span, topics)
        firsts.surroundings.append((self._spec.label, seen))
        return seen

    def _deskew(
        self, placer: Placer, firsts: FirstClouds, topics: Collection[TopicFacts], surroundings: Surroundings | None
    ) -> tuple[Deskew | None, list[str]]:
        """Return what places points at their own times (None: nothing does), and notes."""
        spec, where = self._spec, self._where
        if where is None:
            return None, []
        from pc2scan.advice.point_times import duration_warning, measure_turns, time_warnings  # noqa: PLC0415  # only with deskewing

        from .stages.deskew import Deskew  # noqa: PLC0415

        firsts.warn(*(spec.label + each for facts in topics for each in time_warnings(facts, where)))
        with spec.naming_errors():
            turns, notes = measure_turns(topics, where)
        # Points at wrong times are where odometry that lags would put them.
        are_wrong = any(duration_warning(facts, where) for facts in topics)
        sample = None if surroundings is None or are_wrong else surroundings.add
        deskew = Deskew(placer, spec.fixed_frame, where, spec.stamp, turns, sample)
        return deskew, [spec.label + note for note in notes]


def _robot_transforms(reader: Reader, options: ConvertOptions, span: Span) -> TransformBuffer | None:
    """Read the transforms between the robot's frames, while the recording is converted."""
    from pc2scan.transforms.reading import read_robot_transforms  # noqa: PLC0415  # only where the first clouds leave a doubt

    frames = options.frames
    given = frames.static or frames.model or frames.tf_from
    if not given and all(each.ros_type not in TF_TYPES for each in reader.connections):
        return None
    with suppress(Pc2ScanError), ExitStack() as stack:
        others = open_recordings(frames.tf_from, stack)
        return read_robot_transforms(as_one([reader, *others]), frames, span.first_ns)
    return None


def _to_clouds(spec: ScanSpec, placer: Placer) -> Conversion:
    from .scan_to_cloud import ScanToCloud  # noqa: PLC0415  # each direction loads its own arithmetic

    return ScanToCloud(spec.channels, placer, deskewed=spec.deskew, echo=spec.echo)


def _to_scans(
    spec: ScanSpec,
    placer: Placer,
    measurements: Mapping[str, Measurements] | None,
    deskew: Deskew | None,
    firsts: FirstClouds,
) -> Conversion:
    return CloudToScan(
        spec.params,
        placer,
        measurements,
        spec.filters,
        deskew,
        partial(firsts.of, spec),
        keeps_used=bool(spec.keep_used),
        remove=spec.remove,
    )
