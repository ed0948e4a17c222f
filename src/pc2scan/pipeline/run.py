"""Runs one conversion from beginning to end: opens the sources, plans, streams, and writes the report."""

from __future__ import annotations

import os
import shlex
import time
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from pc2scan.bags.destinations import (
    check_to,
    default_destination,
    default_storage,
    open_writer,
    plan_destination,
    recorded_in,
    source_form,
)
from pc2scan.bags.formats import chunk_format, destinations
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.errors import (
    DamageError,
    MissingError,
    OutputError,
    Pc2ScanError,
    TopicError,
    UsageError,
)
from pc2scan.files.places import output_folder
from pc2scan.files.staging import check_destination, staged_output
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.model import MAX_ROSBAG2_NS
from pc2scan.remote.urls import is_url, shown_path
from pc2scan.result import Failure
from pc2scan.tf.options import FrameOptions
from pc2scan.tf.reading import read_robot_transforms
from pc2scan.threads import Threads, cores

from .checks import cut_warnings, request_warnings, result_findings
from .engine import convert
from .first_clouds import FirstClouds
from .items import Span
from .plan import make_plan
from .preparation import prepare_conversions
from .recording import RecordingTopics, chunk_rule, copy_extras, static_connection, write_items, write_static
from .refusals import compare_counts, refuse_no_messages, refuse_nothing, refuse_unsatisfied, refuse_unusable
from .report import Report
from .routes import count_skipped, open_routes
from .run_files import OutputOptions, RunFiles, report_file
from .tally import Tally
from .topic_report import TopicReport

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection, Summary
    from pc2scan.tf.buffer import TransformBuffer

    from .conversion import Conversion, Step
    from .engine import Progress
    from .levelling import LevelFrames
    from .options import ConvertOptions
    from .plan import Plan
    from .preparation import Preparation


def run(
    sources: Sequence[Path],
    destination: Path | None,
    options: ConvertOptions,
    output: OutputOptions,
    *,
    also_read: Mapping[str, Path] | None = None,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
) -> Report:
    """Convert recordings; see `pc2scan.convert`.

    Parameters
    ----------
    also_read
        Files that were read for the request, by option: the destination must not overwrite them.
    warn
        Called immediately with warnings about the first clouds; the report has them, too.
    """
    if not sources:
        raise UsageError("no source given")
    if any(map(is_url, (*sources, *options.frames.tf_from, destination, output.folder, output.report))):
        if is_url(output.report):
            raise UsageError("`report` must be a local file", hint="such as `report=report.json`")
        return _run_at_urls(sources, destination, options, output, also_read=also_read, progress=progress, warn=warn)
    if output.scratch is not None or output.scratch_size is not None:
        raise UsageError("`scratch` and `scratch_size` have no effect: no source and no destination is a URL")
    began = time.monotonic()
    report = _new_report(sources, destination, options)
    with ExitStack() as stack:
        files = RunFiles(sources, destination, options.frames, also_read or {}, output)
        try:
            _run(files, options, output, stack, report, progress, warn)
        except Exception as err:
            report.errors = [err if isinstance(err, Pc2ScanError) else Pc2ScanError(f"{type(err).__name__}: {err}")]
            report.seconds = round(time.monotonic() - began, 3)
            files.deliver_failure(report)
            raise
        report.seconds = round(time.monotonic() - began, 3)
        files.deliver(report)
    return report


def _new_report(sources: Sequence[Path], destination: Path | None, options: ConvertOptions) -> Report:
    """Return a report without results yet."""
    report = Report([str(source) for source in sources], str(destination or ""), options.scans)
    report.source_frame = options.frames.source_frame
    return report


def open_plan(
    sources: Sequence[Path], options: ConvertOptions, stack: ExitStack
) -> tuple[Reader, Sequence[Reader], Plan]:
    """Open the sources, each and all as one, and plan the conversion.

    Parameters
    ----------
    stack
        Closes the sources.
    """
    refuse_unusable(options)
    readers = open_recordings(sources, stack, verify=options.verify, strict=options.strict)
    reader = as_one(readers)
    return reader, readers, _plan(reader, options)


def _run_at_urls(
    sources: Sequence[Path],
    destination: Path | None,
    options: ConvertOptions,
    output: OutputOptions,
    *,
    also_read: Mapping[str, Path] | None,
    progress: Progress | None,
    warn: Callable[[str], None] | None,
) -> Report:
    """Convert local copies of URLs, and upload the result."""
    from pc2scan.remote.staging import RemoteRequest, local_copies  # noqa: PLC0415  # loads fsspec

    request = RemoteRequest(
        sources,
        options.frames.tf_from,
        destination,
        output.folder,
        output.scratch,
        output.scratch_size,
        output.overwrite,
        output.dry_run,
        output.cut is not None,
    )
    with ExitStack() as stack:
        write_report = report_file(output, stack)
        try:
            with local_copies(request) as here:
                done = run(
                    here.sources,
                    here.destination,
                    replace(options, frames=replace(options.frames, tf_from=tuple(here.tf_from))),
                    output._replace(folder=here.folder, report=None, scratch=None, scratch_size=None),
                    also_read=also_read,
                    progress=progress if here.limit is None else here.limit.watching(progress),
                    warn=None if warn is None else lambda text: warn(here.names.text(text)),
                )
                done.warnings += here.upload()
                report: Report = here.names.of(done)
        except Pc2ScanError as err:
            if write_report is not None:
                to = None if destination is None else shown_path(destination)
                write_report(Failure([err], [shown_path(source) for source in sources], to).as_json())
            raise
        if write_report is not None:
            write_report(report.as_json())
    return report


def report_failure(
    failure: Failure, sources: Sequence[Path], output: OutputOptions, also_read: Mapping[str, Path]
) -> None:
    """Write the report of a run that failed before its options were known."""
    RunFiles(sources, None, FrameOptions(), also_read, output).deliver_failure(failure)


def _run(
    files: RunFiles,
    options: ConvertOptions,
    output: OutputOptions,
    stack: ExitStack,
    report: Report,
    progress: Progress | None,
    warn: Callable[[str], None] | None,
) -> None:
    """Convert, without writing the report's file."""
    _refuse_missing_destination(files.sources, files.destination, output)
    reader, readers, plan = open_plan(files.sources, options, stack)
    report.bytes_read = reader.summary.size_bytes
    converted = [route.connection for route in plan.routes if route.targets]
    summaries = [opened.summary for opened in readers]
    mark = "_repaired" if options.repair else "_scan"
    is_named = files.destination is not None and not output.like_source
    path = files.destination or default_destination(files.sources, summaries, mark, folder=output.folder, to=output.to)
    files.destination = path
    report.destination = str(path)
    check_to(path, output.to)
    target = _target(path, is_named, reader, summaries, options, output)
    report.container, report.ros_version = target.container, target.ros_version
    if readers[1:]:
        from pc2scan.bags.folders import overlap_warnings  # noqa: PLC0415  # most recordings are one

        report.warnings += overlap_warnings(readers)
    report.warnings += (*plan.warnings, *request_warnings(options))
    in_parts = files.numbered = output.cut is not None and not target.storage
    if in_parts:
        from pc2scan.files.parts import check_parts, staged_parts  # noqa: PLC0415  # most are one file
    if output.dry_run:
        report.dry_run = True
        files.open_report(stack)
        if in_parts and (output.folder is None or output.folder.is_dir()):
            check_parts(path, overwrite=output.overwrite)
        else:
            check_destination(path, overwrite=output.overwrite, record_in=recorded_in, folder=output.folder)
        _estimate(files, reader, plan, target, options, output, stack, report)
        return
    if output.folder is not None:
        stack.enter_context(output_folder(output.folder))
    files.open_report(stack)
    if in_parts:
        staging = staged_parts(path, overwrite=output.overwrite, owned=output.owned, warn=report.warnings.append)
    else:
        staging = staged_output(path, overwrite=output.overwrite, owned=output.owned, record_in=recorded_in)
    with staging as unfinished:
        span = span_of(reader, options)
        refuse_no_messages(reader, converted, span.start_ns, span.stop_ns)
        report.warnings += cut_warnings(reader, options)
        firsts = FirstClouds(report.source_frame, partial(robot_transforms, files.read, options, span), warn)
        prepared = _prepare(reader, plan, options, span, stack, report, firsts)
        cut = None if output.cut is None else replace(output.cut, begin_ns=span.first_ns)
        begin_ns = span.first_ns
        writer = open_writer(target, unfinished, path.name, cut)
        try:
            copying = target.chunks == chunk_format(reader.summary) != ""
            if copying:
                writer.keep_ids(reader.connections)
            topics = RecordingTopics(target, options, same_kind=target.same_kind(reader.summary))
            opened = open_routes(plan.routes, prepared.conversions, partial(_encoder, target), topics)
            report.topics += opened.entries
            added = topics.add(static_connection(target)) if options.frames.write_static else None
            levels = _level_frames(reader, plan, topics, options)
            handles = topics.declare(writer, opened.by_id.values())
            if levels is not None:
                levels.handle = handles[levels.handle]
                report.topics.append(levels.report)
            routes = count_skipped(opened.by_id, reader, span.start_ns, span.stop_ns)
            if not options.only_scans:
                report.warnings += copy_extras(reader, target, writer)
            if added is not None:
                earliest_ns, latest_ns = target.times_ns
                begin_ns = max(earliest_ns, min(begin_ns, latest_ns))
                report.topics.append(write_static(options.frames, begin_ns, handles[added], target, writer))
            pool = _threads(options, stack)
            if pool is not None:
                writer.compress_ahead(pool)
            rule = chunk_rule(routes, target, writer) if copying else None
            if rule is not None and cut is not None:
                from pc2scan.bags.splitting import narrow_rule  # noqa: PLC0415  # most recordings are one file

                rule = narrow_rule(rule, cut, reader.connections)
            tally = Tally(routes, options.on_error, firsts.warn)
            report.skipped = tally.skipped
            items = convert(
                reader,
                routes,
                span,
                pool,
                combiners=opened.combiners,
                rule=rule,
                window=_window(options),
                progress=progress,
            )
            try:
                with closing(items):
                    write_items(items, writer, tally, levels)
                report.messages_read = tally.messages
                tally.finish()
                firsts.finish()
            finally:
                report.add(firsts.warnings, firsts.notes, firsts.advice)
            files.refuse_changed()
            report.damage += [damage for each in (reader, *prepared.others) for damage in each.damage]
            outputs = [output for route in routes.values() for output in route.outputs]
            first_scans = [
                (output.report, output.sample)
                for output in outputs
                if output.sample and output.report.spec is not None and output.report.spec.made_type == LASERSCAN
            ]
            report.add(*result_findings(report, first_scans, target.serialization))
            report.messages_declared, difference = compare_counts(reader, routes.values(), options, report)
            report.damage += difference
            if not options.repair:
                refuse_nothing(report)
                refuse_unsatisfied(report, options)
            writer.finish()
        except BaseException:
            writer.abort()
            raise
        report.bytes_written = _size_on_disk(unfinished)
        if cut is not None:
            from .split import files_in  # noqa: PLC0415  # most recordings are one file

            report.files = files_in(unfinished, path)


def _estimate(
    files: RunFiles,
    reader: Reader,
    plan: Plan,
    target: Destination,
    options: ConvertOptions,
    output: OutputOptions,
    stack: ExitStack,
    report: Report,
) -> None:
    """Add to the report of a dry run what the conversion would write."""
    from .forecast import forecast  # noqa: PLC0415  # dry runs only

    span = span_of(reader, options)
    converted = [route.connection for route in plan.routes if route.targets]
    refuse_no_messages(reader, converted, span.start_ns, span.stop_ns)
    report.warnings += cut_warnings(reader, options)
    firsts = FirstClouds(report.source_frame, partial(robot_transforms, files.read, options, span))
    prepared = _prepare(reader, plan, options, span, stack, report, firsts)
    topics = RecordingTopics(target, options, same_kind=target.same_kind(reader.summary))
    opened = open_routes(plan.routes, prepared.conversions, partial(_encoder, target), topics)
    report.topics += opened.entries
    levels = _level_frames(reader, plan, topics, options)
    if levels is not None:
        report.topics.append(levels.report)
    size = forecast(reader, target, opened, options, span, report, firsts)
    if levels is not None:
        made = (each.messages_out for each in report.topics if each.spec is not None and each.spec.level)
        levels.report.messages_out = max(made, default=0)
    if output.cut is not None:
        from .split import expected_files  # noqa: PLC0415  # most recordings are one file

        last_ns = min(span.stop_ns or MAX_ROSBAG2_NS, reader.summary.end_ns or span.first_ns)
        report.files = expected_files(replace(output.cut, begin_ns=span.first_ns), target, last_ns, size)
        if files.numbered:
            from pc2scan.files.parts import unrecorded_warning  # noqa: PLC0415
            from pc2scan.files.places import parts_beside  # noqa: PLC0415

            there = [part.name for part in parts_beside(target.path) if str(part) not in report.files]
            report.warnings += unrecorded_warning(target.path.name, there)


def _prepare(
    reader: Reader,
    plan: Plan,
    options: ConvertOptions,
    span: Span,
    stack: ExitStack,
    report: Report,
    firsts: FirstClouds,
) -> Preparation:
    """Prepare the conversions, and report what was found out."""
    prepared = prepare_conversions(reader, plan, options, span, stack, firsts.of)
    report.notes += prepared.notes
    report.warnings += prepared.warnings
    if prepared.buffer is not None:
        firsts.transforms.buffer, firsts.transforms.static = prepared.buffer, options.frames.static
    return prepared


def robot_transforms(sources: Sequence[Path], options: ConvertOptions, span: Span) -> TransformBuffer | None:
    """Read the transforms between the robot's frames, with readers that are separate from the running conversion."""
    with suppress(Pc2ScanError), ExitStack() as stack:
        reader = as_one(open_recordings(sources, stack, verify=options.verify))
        return read_robot_transforms(reader, options.frames, span.first_ns)
    return None


def _refuse_missing_destination(sources: Sequence[Path], destination: Path | None, output: OutputOptions) -> None:
    """Raise if the last of several sources does not exist: it may be meant as the destination, as with `cp`."""
    *others, last = sources
    if not others or destination or output.folder or os.path.lexists(last) or not all(map(os.path.lexists, others)):
        return
    raise MissingError("does not exist", path=last, hint=f"did you mean `destination={shlex.quote(str(last))}`?")


def _plan(reader: Reader, options: ConvertOptions) -> Plan:
    """Plan the conversion; if a recording is damaged, errors about missing topics mention it."""
    damage = reader.damage
    if options.repair and damage and not reader.connections:
        raise DamageError(f"nothing of it can be recovered: {damage[0].what}", path=damage[0].path)
    try:
        return make_plan(reader.connections, options)
    except TopicError as err:
        if damage:
            note = f"the recording is damaged, and topics may be missing: {damage[0].path}: {damage[0].what}"
            err.hint = f"{err.hint}; {note}" if err.hint else note
        raise


def _target(
    path: Path,
    is_named: bool,
    reader: Reader,
    summaries: Sequence[Summary],
    options: ConvertOptions,
    output: OutputOptions,
) -> Destination:
    """Decide the destination's format; a repaired recording has its source's format if its name allows it."""
    # None for a source without ROS messages.
    ros_version = next((each.ros_version for each in reader.connections if each.ros_version is not None), None)
    storage, compression = default_storage(path, summaries) if not is_named else None, None
    if options.repair:
        storage, compression = source_form(path, summaries)
    names_directory = output.to is not None and destinations()[output.to].is_directory
    target = plan_destination(
        path,
        storage=output.storage or storage,
        compression=output.compression or (compression if output.storage in (None, storage) else None),
        profile=output.profile,
        metadata_version=output.metadata_version,
        source_ros_version=ros_version,
        is_directory=not is_named or output.storage is not None or names_directory,
    )
    # A recording without ROS messages has no ROS profile.
    if options.repair and ros_version is None and target.format.profiles and output.profile is None:
        return target._replace(profile=summaries[0].profile)
    return target


def _level_frames(reader: Reader, plan: Plan, topics: RecordingTopics, options: ConvertOptions) -> LevelFrames | None:
    """Declare and return the writer of the level frames' transforms; None if no scan is level."""
    if not any(spec.level for spec in plan.specs):
        return None
    from .levelling import LevelFrames, tf_connection  # noqa: PLC0415  # only where scans are level

    connection = tf_connection(reader, options.frames, topics.target)
    entry = TopicReport(connection.topic, connection.ros_type, connection.topic, "added", "from `level`")
    return LevelFrames(topics.add(connection), topics.target.serialization, entry)


def _encoder(target: Destination, conversion: Conversion, _: Connection) -> Step:
    """Return the last step of results that are written to a recording."""
    return conversion.encoder(target.serialization)


def _window(options: ConvertOptions) -> int | None:
    """Return how many units may be loaded ahead, the node's `queue_size`; None: as many as memory allows."""
    return min((spec.params.queue_size for spec in options.scans if spec.params.queue_size), default=None)


def _threads(options: ConvertOptions, stack: ExitStack) -> Threads | None:
    """Return the threads of the conversion, closed with the stack; None for one job."""
    jobs = options.jobs or cores()
    return stack.enter_context(Threads(jobs)) if jobs > 1 else None


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


def _size_on_disk(path: Path) -> int:
    """Return the size in bytes of a file, or of all files in a folder."""
    try:
        if path.is_dir():
            return sum(file.stat().st_size for file in path.iterdir())
        return path.stat().st_size
    except OSError as err:
        raise OutputError(f"cannot be read after it was written: {err.strerror}", path=path) from err
