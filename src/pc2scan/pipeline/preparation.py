"""Prepares the conversions of a run: reads transforms, and measures what is ``auto``, before the first message."""

from __future__ import annotations

from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from pc2scan.bags.latching import is_static
from pc2scan.bags.opening import open_recordings
from pc2scan.errors import ParameterError, UsageError
from pc2scan.tf.placing import Placer
from pc2scan.tf.reading import read_transforms, tf_connections

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Mapping, Sequence
    from contextlib import ExitStack

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection
    from pc2scan.tf.buffer import TransformBuffer
    from pc2scan.tf.options import FrameOptions

    from .conversion import Conversion, Measurements
    from .first_clouds import FirstClouds
    from .items import Span
    from .options import ConvertOptions
    from .plan import Combination, Plan
    from .report import Report
    from .scan_spec import ScanSpec
    from .stages.deskew import Deskew
    from .stages.turn import Turn


def prepare_conversions(
    reader: Reader,
    plan: Plan,
    options: ConvertOptions,
    span: Span,
    stack: ExitStack,
    report: Report,
    firsts: FirstClouds,
) -> tuple[Mapping[ScanSpec | Combination, Conversion], Sequence[Reader]]:
    """Prepare the conversion of each output: read transforms, and measure what is ``auto``.

    Returns the conversions, and the other recordings that transforms were read from.
    """
    asked = options.frames
    others: list[Reader] = []
    buffer: TransformBuffer | None = None
    if any(spec.needs_transforms for spec in plan.specs):
        others = open_recordings(asked.tf_from, stack, verify=options.verify, strict=options.strict)
        buffer, warnings = read_transforms([reader, *others], asked)
        report.warnings += warnings
        firsts.transforms.buffer, firsts.transforms.static = buffer, asked.static
    if asked.static or asked.source_frame:
        from .frame_checks import check_given_frames  # noqa: PLC0415  # few conversions add frames

        report.warnings += check_given_frames(reader, plan, asked, buffer, firsts.transforms.read, span)
    ups = None
    if buffer is not None and any(spec.level for spec in plan.specs):
        from .levelling import UpSources  # noqa: PLC0415  # only where scans are level

        ups = UpSources([reader, *others], buffer, report)
    conversions: dict[ScanSpec | Combination, Conversion] = {}
    for spec in plan.specs:
        frames = Placer(source_frame=asked.source_frame)
        if spec.needs_transforms:
            tolerance_ns = spec.params.tolerance_ns
            up = ups.of(spec, tolerance_ns) if ups is not None and spec.level else None
            frames = Placer(spec.params.target_frame, asked.source_frame, buffer, tolerance_ns, up)
        if spec.reverse:
            from .scan_to_cloud import ScanToCloud  # noqa: PLC0415  # each direction loads its own arithmetic

            conversions[spec] = ScanToCloud(spec.channels, frames, deskewed=spec.deskew)
            continue
        own = [route.connection for route in plan.routes if any(task.spec is spec for task in route.tasks)]
        if spec.fixed_frame or spec.imu:
            from .clocks import clock_warnings  # noqa: PLC0415  # only where times of several topics are compared

            differ = clock_warnings(reader, own, _motion_connections(reader, spec, asked), span)
            report.warnings += (each for each in differ if each not in report.warnings)
        if spec.fixed_frame and buffer is not None:
            from .frame_checks import check_fixed_frame  # noqa: PLC0415  # few conversions have one

            with _naming_output(spec):
                doubts = check_fixed_frame(reader, own, spec, asked.source_frame, buffer, span)
            report.warnings += (spec.label + doubt for doubt in doubts)
        combined = [each for each in plan.combinations if each.spec is spec]
        for combination in combined:
            conversions[combination] = _prepare_combination(reader, plan, combination, frames, span, report, firsts)
        if not combined or any(task.key is spec for route in plan.routes for task in route.tasks):
            converted = [route.connection for route in plan.routes if any(task.key is spec for task in route.tasks)]
            timings = _measure(reader, converted, spec, frames, span, report) if spec.needs_measuring else None
            deskew = _deskew(reader, converted, spec, frames, span, report)
            conversions[spec] = _to_scans(spec, frames, timings, deskew, firsts)
    return conversions, others


def _motion_connections(reader: Reader, spec: ScanSpec, frames: FrameOptions) -> Iterator[Connection]:
    """Yield the connections with moving transforms, and those of the IMU, that the spec uses."""
    if spec.fixed_frame:
        yield from (c for c in tf_connections(reader.connections, frames.tf_topics) if not is_static(c.topic))
    if spec.imu:
        from pc2scan.messages.imu import IMU  # noqa: PLC0415  # few scans are level
        from pc2scan.tf.imu import ImuRequest  # noqa: PLC0415

        topic = ImuRequest.parse(spec.imu).topic.strip("/")
        yield from (c for c in reader.connections if c.ros_type == IMU and c.topic.strip("/") == topic)


def _deskew(
    reader: Reader, sources: Sequence[Connection], spec: ScanSpec, frames: Placer, span: Span, report: Report
) -> Deskew | None:
    if not spec.deskew:
        return None
    from .stages.deskew import Deskew, PointTime  # noqa: PLC0415  # only with deskewing

    where = PointTime.parse(spec.point_time) if spec.point_time else PointTime()
    turns: Mapping[str, Turn] = {}
    if where.turn is None:
        from .point_times import time_warnings  # noqa: PLC0415  # only with deskewing

        report.warnings += (spec.label + doubt for doubt in time_warnings(reader, sources, where, span))
    else:
        from .point_times import measure_turns  # noqa: PLC0415  # few points have no times

        with _naming_output(spec):
            turns, notes = measure_turns(reader, sources, spec.point_time, span.start_ns, span.stop_ns)
        report.notes += (spec.label + note for note in notes)
    return Deskew(frames, spec.fixed_frame, where, spec.stamp, turns)


def _to_scans(
    spec: ScanSpec,
    frames: Placer,
    timings: Mapping[str, Measurements] | None,
    deskew: Deskew | None,
    firsts: FirstClouds,
) -> Conversion:
    from .cloud_to_scan import CloudToScan  # noqa: PLC0415  # each direction loads its own arithmetic

    judges = partial(firsts.of, spec)
    return CloudToScan(
        spec.params,
        frames,
        timings,
        spec.filters,
        deskew,
        judges,
        keeps_used=bool(spec.keep_used),
        remove=spec.remove,
    )


def _prepare_combination(
    reader: Reader,
    plan: Plan,
    combination: Combination,
    frames: Placer,
    span: Span,
    report: Report,
    firsts: FirstClouds,
) -> Conversion:
    from .combine.conversion import MessagesToScan  # noqa: PLC0415  # few scans are made of several messages
    from .combine.measurements import measure_sources  # noqa: PLC0415

    spec = combination.spec
    sources = [
        route.connection for route in plan.routes if any(task.combination is combination for task in route.tasks)
    ]
    with _naming_output(spec):
        timing, grouper, notes, warnings = measure_sources(
            reader, combination, sources, frames, span.start_ns, span.stop_ns
        )
    report.notes += (spec.label + note for note in notes)
    report.warnings += (spec.label + warning for warning in warnings)
    judges = partial(firsts.of, spec)
    deskew = _deskew(reader, sources, spec, frames, span, report)
    return MessagesToScan(spec, combination.sources, frames, timing, grouper, deskew, judges)


def _measure(
    reader: Reader, converted: Sequence[Connection], spec: ScanSpec, frames: Placer, span: Span, report: Report
) -> Mapping[str, Measurements]:
    from .measurements import measure  # noqa: PLC0415  # only if something is to be measured

    with _naming_output(spec):
        timings, notes = measure(reader, converted, spec, frames, span.start_ns, span.stop_ns)
    report.notes += (spec.label + note for note in notes)
    return timings


@contextmanager
def _naming_output(spec: ScanSpec) -> Generator[None]:
    """Add the name of an output, and the origin of a parameter, to errors."""
    try:
        yield
    except UsageError as err:
        if isinstance(err, ParameterError) and (origin := spec.origins.get(err.name)):
            err.message += f" (from {origin})"
        err.message = spec.label + err.message
        raise
