"""Prepares the conversions of a run: reads transforms, and measures what is ``auto``, before the first message."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.errors import Pc2ScanError, UsageError
from pc2scan.tf.placing import Placer
from pc2scan.tf.reading import read_robot_transforms

from .first_clouds import FirstClouds
from .items import Span

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.reader import Reader
    from pc2scan.tf.buffer import TransformBuffer
    from pc2scan.tf.reading import FoundTransforms

    from .conversion import Conversion, Measurements
    from .options import ConvertOptions, ScanSpec
    from .plan import Combination, Plan
    from .stages.deskew import Deskew
    from .survey import DeskewObservers, Survey


class Preparation(NamedTuple):
    """The conversions of a run, and what was found out before them.

    Attributes
    ----------
    conversions
        Of each output, and of each combination.
    span
        The cut.
    firsts
        The first clouds, which are judged while they are converted.
    others
        The other recordings that transforms were read from.
    notes, warnings
        Texts for the user.
    found
        All transforms; None if they were not read.
    """

    conversions: Mapping[ScanSpec | Combination, Conversion]
    span: Span
    firsts: FirstClouds
    others: Sequence[Reader] = ()
    notes: Sequence[str] = ()
    warnings: Sequence[str] = ()
    found: FoundTransforms | None = None

    @property
    def transforms(self) -> TransformBuffer | None:
        """All transforms, for lookups; None if they were not read."""
        return None if self.found is None else self.found.buffer


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
    sources: Sequence[Path],
    plan: Plan,
    options: ConvertOptions,
    span: Span,
    stack: ExitStack,
    warn: Callable[[str], None] | None = None,
    *,
    transform_frames: Collection[str] | None = None,
) -> Preparation:
    """Prepare the conversion of each output: read transforms, and measure what is ``auto``.

    Parameters
    ----------
    reader, sources
        The recording, and its files, which are read again in the few cases that need it.
    span
        The cut.
    stack
        Closes the other recordings.
    warn
        Called immediately with warnings about the first clouds.
    transform_frames
        The frames that the caller needs transforms of, even if the conversion needs none; None: it needs no transforms.
    """
    asked = options.frames
    reads_transforms = transform_frames is not None or plan.needs_transforms or asked.adds_poses or asked.write_static
    read_later = partial(_robot_transforms, sources, options, span)
    firsts = FirstClouds(asked.source_frame, read_later, warn)
    needs_survey = reads_transforms or asked.static or asked.model or asked.source_frame or plan.combinations
    if not (needs_survey or any(spec.needs_measuring for spec in plan.specs if not spec.reverse)):
        placer = Placer()
        unmeasured: dict[ScanSpec | Combination, Conversion] = {
            spec: _to_clouds(spec, placer) if spec.reverse else _to_scans(spec, placer, None, None, firsts)
            for spec in plan.specs
        }
        return Preparation(unmeasured, span, firsts)
    from .survey import Survey  # noqa: PLC0415  # most conversions return above

    notes: list[str] = []
    warnings: list[str] = []
    others: list[Reader] = []
    if reads_transforms:
        others = open_recordings(asked.tf_from, stack, verify=options.verify, strict=options.strict)
    survey = Survey(reader, others, plan, asked, span, reads_transforms=reads_transforms)
    survey.read(transform_frames or ())
    transforms: TransformBuffer | None = None
    found: FoundTransforms | None = None
    if survey.transforms is not None:
        found = survey.transforms.finish()
        transforms = found.buffer
        warnings += found.warnings
        notes += found.notes
    if asked.trajectory is not None:
        from pc2scan.tf.clocks import refuse_other_clock  # noqa: PLC0415  # few conversions add poses

        last_ns = reader.summary.end_ns if span.stop_ns is None else span.stop_ns
        refuse_other_clock(asked.trajectory, survey.stamps, span.first_ns, last_ns or span.first_ns)
    buffer = transforms if plan.needs_transforms else None
    if buffer is not None:
        firsts.transforms.buffer, firsts.transforms.static = buffer, asked.static
    elif survey.robot is not None:
        firsts.transforms.read = survey.robot.finish
    if asked.static or asked.source_frame:
        from .frame_checks import check_given_frames, first_frame  # noqa: PLC0415  # few conversions add frames

        robot = transforms if survey.robot is None else survey.robot.finish()
        warnings += check_given_frames(map(first_frame, survey.given_frames), plan, asked, buffer, robot)
    ups = None
    if buffer is not None and any(spec.level for spec in plan.specs):
        from .levelling import UpSources  # noqa: PLC0415  # only where scans are level

        ups = UpSources(buffer, survey.up)
    conversions: dict[ScanSpec | Combination, Conversion] = {}
    for spec in plan.specs:
        placer = Placer(source_frame=asked.source_frame)
        if spec.needs_transforms:
            up = None
            if ups is not None and spec.level:
                up, estimate = ups.of(spec)
                notes += () if estimate is None else estimate.notes
                warnings += () if estimate is None else estimate.warnings
            placer = Placer(spec.params.target_frame, asked.source_frame, buffer, spec.params.tolerance_ns, up)
        if spec.reverse:
            conversions[spec] = _to_clouds(spec, placer)
            continue
        made, new_notes, doubts = _prepare_output(spec, reader, survey, plan, placer, firsts)
        conversions |= made
        notes += new_notes
        # Several outputs of one topic have the same doubts about its clock.
        warnings += (each for each in doubts if each not in warnings)
    return Preparation(conversions, span, firsts, others, notes, warnings, found)


def _prepare_output(
    spec: ScanSpec, reader: Reader, survey: Survey, plan: Plan, placer: Placer, firsts: FirstClouds
) -> tuple[dict[ScanSpec | Combination, Conversion], list[str], list[str]]:
    """Return the conversions of an output to scans, with notes and warnings, from what the survey observed."""
    observed = survey.outputs[spec]
    conversions: dict[ScanSpec | Combination, Conversion] = {}
    notes, warnings = list[str](), list[str]()
    if observed.delays is not None:
        from pc2scan.tf.clocks import clock_warnings  # noqa: PLC0415  # only where times of several topics are compared

        warnings += clock_warnings(*observed.delays)
    if observed.frame is not None and placer.buffer is not None:
        from .frame_checks import check_fixed_frame, first_frame  # noqa: PLC0415  # few conversions have one

        with spec.naming_errors():
            doubts = check_fixed_frame(placer.source_frame or first_frame(observed.frame), spec, placer.buffer)
        warnings += (spec.label + doubt for doubt in doubts)
    for combination, observers in observed.combinations.items():
        from .combine.conversion import MessagesToScan  # noqa: PLC0415  # few scans are made of several messages
        from .combine.measurements import measure_sources  # noqa: PLC0415

        with spec.naming_errors():
            timing, grouper, new_notes, doubts = measure_sources(reader, combination, observers, placer)
        notes += (spec.label + note for note in new_notes)
        warnings += (spec.label + doubt for doubt in doubts)
        deskew, new_notes, doubts = _deskew(spec, placer, observed.deskew[combination])
        notes += new_notes
        warnings += doubts
        conversions[combination] = MessagesToScan(
            spec, combination.sources, placer, timing, grouper, deskew, partial(firsts.of, spec)
        )
    from .survey import converted_alone  # noqa: PLC0415  # most conversions need none

    if not observed.combinations or converted_alone(plan, spec):
        measurements = None
        if spec.needs_measuring:
            from .measurements import measure  # noqa: PLC0415  # only if something is to be measured

            with spec.naming_errors():
                measurements, new_notes = measure(observed.clouds, spec, placer)
            notes += (spec.label + note for note in new_notes)
        deskew, new_notes, doubts = _deskew(spec, placer, observed.deskew.get(None))
        notes += new_notes
        warnings += doubts
        conversions[spec] = _to_scans(spec, placer, measurements, deskew, firsts)
    return conversions, notes, warnings


def _deskew(
    spec: ScanSpec, placer: Placer, observers: DeskewObservers | None
) -> tuple[Deskew | None, list[str], list[str]]:
    """Return what places points at their own times (None: nothing does), notes and warnings."""
    if not spec.deskew:
        return None, [], []
    from .point_times import measure_turns, time_warnings  # noqa: PLC0415  # only with deskewing
    from .stages.deskew import Deskew, PointTime  # noqa: PLC0415

    where = PointTime.parse(spec.point_time)
    doubts = [] if observers is None else [spec.label + each for each in time_warnings(observers.times)]
    with spec.naming_errors():
        turns, notes = measure_turns({} if observers is None else observers.turns, spec.point_time)
    deskew = Deskew(placer, spec.fixed_frame, where, spec.stamp, turns)
    return deskew, [spec.label + note for note in notes], doubts


def _robot_transforms(sources: Sequence[Path], options: ConvertOptions, span: Span) -> TransformBuffer | None:
    """Read the transforms between the robot's frames, with readers that are separate from the running conversion."""
    with suppress(Pc2ScanError), ExitStack() as stack:
        reader = as_one(open_recordings(sources, stack, verify=options.verify))
        return read_robot_transforms(reader, options.frames, span.first_ns)
    return None


def _to_clouds(spec: ScanSpec, placer: Placer) -> Conversion:
    from .scan_to_cloud import ScanToCloud  # noqa: PLC0415  # each direction loads its own arithmetic

    return ScanToCloud(spec.channels, placer, deskewed=spec.deskew)


def _to_scans(
    spec: ScanSpec,
    placer: Placer,
    measurements: Mapping[str, Measurements] | None,
    deskew: Deskew | None,
    firsts: FirstClouds,
) -> Conversion:
    from .cloud_to_scan import CloudToScan  # noqa: PLC0415  # each direction loads its own arithmetic

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
