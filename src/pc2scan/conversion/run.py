"""Runs one conversion from beginning to end: reads the request, opens, plans, streams, and writes the report."""

from __future__ import annotations

import shlex
import time
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.advice.checks import request_warnings
from pc2scan.advice.clocks import Clocks
from pc2scan.advice.survey import Survey
from pc2scan.bags.damage import mention
from pc2scan.bags.destinations import (
    check_to,
    default_destination,
    open_writer,
    plan_destination,
    source_form,
)
from pc2scan.bags.folders import overlap_warnings
from pc2scan.bags.formats import destinations
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.bags.rosbag2.read import recorded_in
from pc2scan.errors import (
    DamageError,
    DestinationError,
    MissingError,
    OutputError,
    Pc2ScanError,
    TopicError,
    UsageError,
)
from pc2scan.files.outputs import (
    check_destination,
    files_output,
    inputs_of,
    output_folder,
    refuse_overlap,
    staged_output,
)
from pc2scan.files.paths import exists, is_url
from pc2scan.files.source_file import changed_while_read, state_of
from pc2scan.files.system import copying_to
from pc2scan.model import SERIALIZATIONS
from pc2scan.parsing import conversion_of, destination_of, named_files
from pc2scan.progress import Meter
from pc2scan.request.spec import Request
from pc2scan.result import BEGINNING, tell_early
from pc2scan.threads import Threads, cores

from .corrections import scaled
from .engine import Tally, items_of
from .plan import make_plan
from .preparation import count_by_index, judge_first, prepare, refuse_no_messages, span_of
from .recording import declare_output, write_items
from .report import Report
from .result_checks import compare_counts, refuse_nothing, refuse_unsatisfied, result_findings

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence
    from pathlib import Path

    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.files.outputs import InputPath
    from pc2scan.files.paths import PathText
    from pc2scan.model import Writer
    from pc2scan.options.call import Options
    from pc2scan.parsing import Warn
    from pc2scan.progress import Progress

    from .preparation import Preparation


#: No clock that is set differs by more from the log times, nanoseconds, unless a driver is slow.
_EARLY_NS, _LATE_NS = -100_000_000, 500_000_000


class OutputOptions(NamedTuple):
    """Options of the destination; None means the container's default.

    Attributes
    ----------
    storage
        The storage of a rosbag2 directory: ``mcap`` or ``sqlite3``.
    compression
        ``none``, ``lz4``, ``zstd`` or ``bz2``, as the container allows. With None, chunks that are copied
        whole keep their compression.
    profile
        The profile of an ``.mcap`` file: ``ros1`` or ``ros2``.
    overwrite
        Whether an existing destination, and an existing file at the report's path, are replaced.
    report
        Path of the report as JSON; None for no file.
    folder
        Folder of a destination that is named after the source; None: next to the source. It is created if it does not
        exist.
    to
        Format of the destination: ``bag``, ``mcap`` or ``rosbag2``; None: by its name, or the source's.
    dry_run
        Whether nothing is written, not even the report.
    like_source
        Whether a named destination has the storage of the source, like a destination that is named after the source.
    scratch
        Folder of the local copies of what is at URLs; None: the system's folder for temporary files.
    """

    storage: str | None = None
    compression: str | None = None
    profile: str | None = None
    overwrite: bool = False
    report: Path | None = None
    folder: Path | None = None
    to: str | None = None
    dry_run: bool = False
    like_source: bool = False
    scratch: Path | None = None


def convert(
    sources: Sequence[Path],
    destination: PathText | None,
    options: Options,
    *,
    warn: Warn | None = None,
    progress: Progress | None = None,
) -> Report:
    """Convert a recording; see `pc2scan.convert`. Options that contradict each other are in the report's file, too."""
    path, folder = destination_of(destination)
    output = OutputOptions(**options.among(OutputOptions._fields), folder=folder)
    try:
        conversion = conversion_of(options, warn)
    except Pc2ScanError as err:
        failure = Report([str(source) for source in sources], str(path or folder or ""), (), errors=[err])
        _deliver(failure, inputs_of(sources, (), named_files(options)), output)
        raise
    return run(sources, path, conversion, output, progress=progress, warn=warn)


def repair(source: Path, destination: PathText | None, options: Options, *, progress: Progress | None = None) -> Report:
    """Write what can be recovered of a recording; see `pc2scan.repair`."""
    path, folder = destination_of(destination)
    output = OutputOptions(**options.among(OutputOptions._fields), folder=folder)
    return run([source], path, Request(repair=True), output, progress=progress)


def run(
    sources: Sequence[Path],
    destination: Path | None,
    request: Request,
    output: OutputOptions,
    *,
    progress: Progress | None = None,
    warn: Warn | None = None,
) -> Report:
    """Convert recordings; see `pc2scan.convert`.

    Parameters
    ----------
    progress
        Called regularly; see `pc2scan.progress.Progress`.
    warn
        Called with each warning as soon as it is known, up to those about the first clouds; the report has all.
    """
    if not sources:
        raise UsageError("no source given")
    read = (*sources, *request.frames.tf_from)
    inputs, states = inputs_of(sources, request.frames.tf_from, request.files), [state_of(path) for path in read]
    report = Report([str(source) for source in sources], str(destination or ""), request.scans)
    report.dry_run = output.dry_run
    report.warnings += request.notes
    tell = partial(tell_early, report.warnings, warn)
    with copying_to(output.scratch), _reporting(report, inputs, output), ExitStack() as stack:
        readers = _open(stack, sources, destination, request, output)
        reader = scaled(as_one(readers), request.cloud_scale)
        if request.repair and reader.damage and not reader.connections:
            damage = reader.damage[0]
            raise DamageError(f"nothing of it can be recovered: {damage.what}", path=damage.path)
        try:
            plan = make_plan(reader.connections, request)
        except TopicError as err:
            mention(reader.damage, err)
            raise
        target = _target(reader, readers, sources[0], destination, request, output)
        report.destination = str(target.path)
        report.container, report.ros_version = target.format.name, target.ros_version
        report.bytes_read = reader.summary.size_bytes
        if readers[1:]:
            tell(*overlap_warnings(readers))
        tell(*plan.warnings, *request_warnings(request, reader.summary, reader.connections))
        with _writing(target, inputs, output, report) as writer:
            span = span_of(reader, request)
            refuse_no_messages(reader, plan.converted, span.start_ns, span.stop_ns)
            meter = None if progress is None else Meter(progress)
            prepared = prepare(reader, plan, request, span, stack, tell, meter=meter)
            report.add((), prepared.notes)
            declare_output(prepared, target, writer, report)
            tally = Tally(prepared.routes, strict=request.strict)
            report.skipped = tally.skipped
            judge_first(prepared, report, tally if writer is None else None)
            if writer is None:
                tally.finish()
                count_by_index(prepared, report)
                return report
            jobs = request.jobs or cores()
            threads = stack.enter_context(closing(Threads(jobs))) if jobs > 1 else None
            if threads is not None:
                writer.compress_ahead(threads)
            items = items_of(
                prepared.reader, prepared.routes, span, threads, rule=prepared.rule, window=request.window, meter=meter
            )
            try:
                with closing(items):
                    write_items(items, writer, tally, prepared)
            finally:
                report.messages_read = sum(route.messages for route in prepared.routes.values())
            tally.finish()
            tell(*(label + text for label, surroundings in prepared.surroundings for text in surroundings.warnings()))
            for path, state in zip(read, states, strict=True):
                # The result may mix its old and new bytes.
                if state_of(path) != state:
                    raise changed_while_read(path)
            _judge(prepared, target, report)
    return report


@contextmanager
def _reporting(report: Report, inputs: Sequence[InputPath], output: OutputOptions) -> Generator[None]:
    """Write the report at the end, also after an error. If that fails, the recording stays, with a warning."""
    began = time.monotonic()
    try:
        yield
    except Exception as err:
        report.errors = [err if isinstance(err, Pc2ScanError) else Pc2ScanError(f"{type(err).__name__}: {err}")]
        report.seconds = round(time.monotonic() - began, 3)
        _deliver(report, inputs, output)
        raise
    report.seconds = round(time.monotonic() - began, 3)
    if output.report is not None and (refusal := _deliver(report, inputs, output)) is not None:
        report.undelivered = True
        why = f"the report is not written: {refusal.message}; {report.destination} is{'; ' * bool(refusal.hint)}"
        report.warnings.append(f"{refusal.path}: {why}{refusal.hint or ''}")


def _deliver(report: Report, inputs: Sequence[InputPath], output: OutputOptions) -> Pc2ScanError | None:
    """Write the report; return the error if that fails. Nothing is written over an input."""
    path = output.report
    # The error of a failed run may be that this file cannot be written.
    if path is None or output.dry_run or any(error.path == path for error in report.errors):
        return None
    try:
        refuse_overlap(inputs, [path])
        with files_output([path], beginning=BEGINNING, overwrite=output.overwrite) as write:
            write([report.as_json()])
    except (DestinationError, OutputError) as err:
        return err
    return None


def _open(
    stack: ExitStack, sources: Sequence[Path], destination: Path | None, request: Request, output: OutputOptions
) -> Sequence[Reader]:
    """Open the sources, which ``stack`` closes; what forbids the destination is said before anything is fetched."""
    read = (*sources, *request.frames.tf_from)
    if destination is not None and any(map(is_url, read)):
        check_destination(destination, overwrite=output.overwrite, record_in=recorded_in)
    *others, last = sources
    if others and destination is output.folder is None and not exists(last) and all(map(exists, others)):
        # It may be meant as the destination, as with `cp`.
        hint = f"did you mean `destination={shlex.quote(str(last))}`?"
        raise MissingError("does not exist", path=last, hint=hint)
    return open_recordings(sources, stack, strict=request.strict)


def _target(
    reader: Reader,
    readers: Sequence[Reader],
    source: Path,
    path: Path | None,
    request: Request,
    output: OutputOptions,
) -> Destination:
    """Decide the destination's name and format; a repaired recording has its source's if its name allows it."""
    summaries = [opened.summary for opened in readers]
    is_named = path is not None and not output.like_source
    if path is None:
        mark = "_repaired" if request.repair else "_clouds" if request.no_scans else "_scan"
        path = default_destination(source, summaries[0].container, mark, folder=output.folder, to=output.to)
    if output.to is not None:
        check_to(path, output.to)
    # None for a source without ROS messages.
    ros_version = next((own.ros_version for own in reader.connections if own.ros_version is not None), None)
    storage, compression = source_form(path, summaries) if request.repair or not is_named else (None, None)
    keeps_compression = request.repair and output.storage in (None, storage)
    names_directory = output.to is not None and destinations()[output.to].is_directory
    target = plan_destination(
        path,
        storage=output.storage or storage,
        compression=output.compression or (compression if keeps_compression else None),
        profile=output.profile,
        source_ros_version=ros_version,
        is_directory=not is_named or output.storage is not None or names_directory,
    )
    # A recording without ROS messages has no ROS profile.
    if request.repair and ros_version is None and target.format.profiles and output.profile is None:
        return target._replace(profile=summaries[0].profile)
    return target


@contextmanager
def _writing(
    target: Destination, inputs: Sequence[InputPath], output: OutputOptions, report: Report
) -> Generator[Writer | None]:
    """Open the destination's writer, and finish the recording, or abort it after an error; None in a dry run."""
    refuse_overlap(inputs, filter(None, (target.path, output.report)))
    if output.report is not None:
        try:
            check_destination(output.report, beginning=BEGINNING, overwrite=output.overwrite)
        except (DestinationError, OutputError) as err:
            err.message = f"the report cannot be written there: {err.message}"
            raise
    if output.dry_run:
        check_destination(target.path, overwrite=output.overwrite, record_in=recorded_in, folder=output.folder)
        yield None
        return
    with ExitStack() as stack:
        if output.folder is not None:
            stack.enter_context(output_folder(output.folder))
        unfinished = stack.enter_context(staged_output(target.path, overwrite=output.overwrite, record_in=recorded_in))
        writer = open_writer(target, unfinished, target.path.name)
        try:
            yield writer
            writer.finish()
        except BaseException:
            writer.abort()
            raise
        files = unfinished.iterdir() if unfinished.is_dir() else [unfinished]
        report.bytes_written = sum(file.stat().st_size for file in files)


def _judge(prepared: Preparation, target: Destination, report: Report) -> None:
    """Add to the report what the result and its sources show; raise if the result is of no use."""
    reader, request = prepared.reader, prepared.request
    report.add(reader.remarks)
    report.damage += [damage for source in (reader, *prepared.others) for damage in source.damage]
    outputs = [output for route in prepared.routes.values() for output in route.outputs if output.first]
    first_scans = [(out.report, out.spec, out.first) for out in outputs if out.spec and not out.spec.reverse]
    report.add(*result_findings(report, first_scans, SERIALIZATIONS[target.ros_version]))
    # With a fixed frame, an IMU or a corrected clock, clocks were compared before.
    far = {
        topic.topic
        for topic in report.topics
        if not _EARLY_NS <= (topic.stamps.delay_ns or 0) <= _LATE_NS
        and topic.spec is not None
        and not (topic.spec.fixed_frame or topic.spec.imu)
    }
    if far and not request.clock:
        doubtful = [connection for connection in prepared.plan.converted if connection.topic in far]
        survey = Survey(reader, (), request.frames, prepared.span)
        clocks = Clocks(survey, doubtful)
        survey.read()
        report.add(clocks.warnings())
    compare_counts(reader, request, prepared.routes.values(), report)
    if prepared.plan.specs and not any(topic.messages_out for topic in report.converted):
        refuse_nothing(report)
    if request.fail_on or request.min_used:
        refuse_unsatisfied(report, request)
