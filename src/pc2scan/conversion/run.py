"""Runs one conversion from beginning to end: opens the sources, plans, streams, and writes the report."""

from __future__ import annotations

import shlex
import time
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.advice.checks import request_warnings
from pc2scan.advice.clocks import Clocks
from pc2scan.advice.survey import Survey
from pc2scan.bags.damage import mention
from pc2scan.bags.destinations import (
    check_to,
    default_destination,
    default_storage,
    open_writer,
    plan_destination,
    source_form,
)
from pc2scan.bags.folders import overlap_warnings
from pc2scan.bags.formats import destinations
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.bags.rosbag2.metadata import recorded_in
from pc2scan.errors import (
    DamageError,
    DestinationError,
    MissingError,
    OutputError,
    Pc2ScanError,
    TopicError,
    UsageError,
)
from pc2scan.files.outputs import check_file_output, file_output
from pc2scan.files.ownership import OutputPath, inputs_of, refuse_overlap
from pc2scan.files.places import output_folder
from pc2scan.files.source import changed_while_read, state_of
from pc2scan.files.staging import check_destination, staged_output
from pc2scan.files.system import copying_to
from pc2scan.files.urls import UrlPath, exists
from pc2scan.progress import Meter
from pc2scan.request.options import ConvertOptions
from pc2scan.result import BEGINNING, Result, tell_early
from pc2scan.threads import Threads, cores

from .cloud_scale import scaled
from .engine import items_of
from .first_clouds import count_by_index, judge_first
from .items import Tally
from .plan import make_plan
from .preparation import prepare, span_of
from .recording import open_output, write_items
from .report import Report
from .result_checks import compare_counts, refuse_nothing, refuse_unsatisfied, result_findings
from .source_checks import refuse_no_messages
from .stamps import corrected_for

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Writer
    from pc2scan.progress import Progress
    from pc2scan.result import Failure

    from .plan import Plan
    from .preparation import Preparation
    from .recording import OpenRecording


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


def run(
    sources: Sequence[Path],
    destination: Path | None,
    options: ConvertOptions,
    output: OutputOptions,
    *,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
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
    this = _Run(sources, destination, options, output)
    report, tell = this.report, partial(tell_early, this.report.warnings, warn)
    with ExitStack() as stack, this.reporting():
        reader, plan, target = this.open(stack, tell)
        with this.writing(target, stack) as writer:
            span = span_of(reader, options)
            refuse_no_messages(reader, plan.converted, span.start_ns, span.stop_ns)
            meter = None if progress is None else Meter(progress)
            prepared = prepare(reader, plan, options, span, stack, tell, meter=meter)
            report.add((), prepared.notes)
            recording = open_output(reader, plan, prepared, target, options, writer, report, tell)
            tally = Tally(recording.routes, strict=options.strict)
            report.skipped = tally.skipped
            judge_first(reader, recording.routes, prepared, report, tell, tally if writer is None else None)
            if writer is None:
                tally.finish()
                report.ways = [words for route in plan.routes for words in route.words]
                count_by_index(reader, recording, prepared, report)
                return report
            jobs = options.jobs or cores()
            threads = stack.enter_context(Threads(jobs)) if jobs > 1 else None
            if threads is not None:
                writer.compress_ahead(threads)
            items = items_of(
                reader, recording.routes, span, threads, rule=recording.rule, window=options.window, meter=meter
            )
            try:
                with closing(items):
                    write_items(items, writer, tally, recording)
            finally:
                report.messages_read = tally.messages
            tally.finish()
            tell(*(label + text for label, seen in prepared.surroundings for text in seen.warnings()))
            this.refuse_changed()
            _judge(reader, plan, prepared, recording, target, options, report)
    return report


def report_failure(
    failure: Failure, sources: Sequence[Path], output: OutputOptions, also_read: Mapping[str, Path]
) -> None:
    """Write the report of a run that failed before its options were known."""
    _Run(sources, None, ConvertOptions(files=also_read), output).deliver_failure(failure)


class _Run:
    """A run: its sources, its destination, which is None until it is known, its options and its report."""

    def __init__(
        self, sources: Sequence[Path], destination: Path | None, options: ConvertOptions, output: OutputOptions
    ) -> None:
        self.sources, self.destination = sources, destination
        self.options, self.output = options, output
        self.report = Report([str(source) for source in sources], str(destination or ""), options.scans)
        self.report.source_frame = options.frames.source_frame
        self.report.warnings += options.notes
        self._read = (*sources, *options.frames.tf_from)
        self._inputs = inputs_of(sources, options.frames.tf_from, options.files)
        self._states = [state_of(path) for path in self._read]
        self._write_report: Callable[[str], None] | None = None

    @contextmanager
    def reporting(self) -> Generator[None]:
        """Write the report at the end, also after an error. If that fails, the recording stays, with a warning."""
        report = self.report
        began = time.monotonic()
        try:
            yield
        except Exception as err:
            report.errors = [err if isinstance(err, Pc2ScanError) else Pc2ScanError(f"{type(err).__name__}: {err}")]
            report.seconds = round(time.monotonic() - began, 3)
            self.deliver_failure(report)
            raise
        report.seconds = round(time.monotonic() - began, 3)
        if self._write_report is not None:
            try:
                self._write_report(report.as_json())
            except (DestinationError, OutputError) as err:
                report.undelivered = True
                report.warnings.append(f"{err.path}: the report is not written: {err.message}; {report.destination} is")

    def deliver_failure(self, report: Result) -> None:
        """Write the report of a run that failed, if possible; the error itself is raised in any case."""
        path = self.output.report
        # The error may be that this file cannot be written.
        if path is None or self.output.dry_run or any(error.path == path for error in report.errors):
            return
        with suppress(DestinationError, OutputError), ExitStack() as stack:
            if self._write_report is None:
                self._open_report(stack)
            if self._write_report is not None:
                self._write_report(report.as_json())

    def open(self, stack: ExitStack, tell: Callable[..., None]) -> tuple[Reader, Plan, Destination]:
        """Open the sources, plan the conversion, and decide the destination; the report then has what they say.

        Errors about missing topics mention damage. ``stack`` closes the sources, and ``tell`` is called with warnings.
        """
        options, output, report = self.options, self.output, self.report
        places = (*self._read, self.destination, output.folder)
        if output.scratch is not None and not any(isinstance(path, UrlPath) for path in places):
            raise UsageError("`scratch` has no effect: no source and no destination is a URL")
        stack.enter_context(copying_to(output.scratch))
        if self.destination is not None and any(isinstance(path, UrlPath) for path in self._read):
            # Before anything is fetched.
            check_destination(self.destination, overwrite=output.overwrite, record_in=recorded_in)
        if len(self.sources) > 1 and self.destination is None and output.folder is None:
            _refuse_missing_destination(self.sources)
        readers = open_recordings(self.sources, stack, strict=options.strict)
        reader = scaled(as_one(readers), options.cloud_scale)
        damage = reader.damage
        if options.repair and damage and not reader.connections:
            raise DamageError(f"nothing of it can be recovered: {damage[0].what}", path=damage[0].path)
        try:
            plan = make_plan(reader.connections, options)
        except TopicError as err:
            mention(damage, err)
            raise
        reader, notes = corrected_for(reader, plan, options)
        report.add((), notes)
        target = self._target(reader, readers)
        report.destination = str(target.path)
        report.container, report.ros_version = target.format.name, target.ros_version
        report.bytes_read, report.dry_run = reader.summary.size_bytes, output.dry_run
        if readers[1:]:
            tell(*overlap_warnings(readers))
        tell(*plan.warnings, *request_warnings(options, reader.summary))
        return reader, plan, target

    def _target(self, reader: Reader, readers: Sequence[Reader]) -> Destination:
        """Decide the destination's name and format; a repaired recording has its source's if its name allows it."""
        options, output = self.options, self.output
        summaries = [opened.summary for opened in readers]
        is_named = self.destination is not None and not output.like_source
        if self.destination is None:
            mark = "_repaired" if options.repair else "_clouds" if options.no_scans else "_scan"
            first = self.sources[0], summaries[0].container
            self.destination = default_destination(*first, mark, folder=output.folder, to=output.to)
        path = self.destination
        if output.to is not None:
            check_to(path, output.to)
        # None for a source without ROS messages.
        ros_version = next((each.ros_version for each in reader.connections if each.ros_version is not None), None)
        storage = None if is_named else default_storage(path, summaries)
        compression = None
        if options.repair:
            storage, compression = source_form(path, summaries)
        names_directory = output.to is not None and destinations()[output.to].is_directory
        target = plan_destination(
            path,
            storage=output.storage or storage,
            compression=output.compression or (compression if output.storage in (None, storage) else None),
            profile=output.profile,
            source_ros_version=ros_version,
            is_directory=not is_named or output.storage is not None or names_directory,
        )
        # A recording without ROS messages has no ROS profile.
        if options.repair and ros_version is None and target.format.profiles and output.profile is None:
            return target._replace(profile=summaries[0].profile)
        return target

    @contextmanager
    def writing(self, target: Destination, stack: ExitStack) -> Generator[Writer | None]:
        """Open the destination's writer, and finish the recording, or abort it after an error; None in a dry run."""
        output = self.output
        if output.folder is not None and not output.dry_run:
            stack.enter_context(output_folder(output.folder))
        self._open_report(stack)
        if output.dry_run:
            check_destination(target.path, overwrite=output.overwrite, record_in=recorded_in, folder=output.folder)
            yield None
            return
        with staged_output(target.path, overwrite=output.overwrite, record_in=recorded_in) as unfinished:
            writer = open_writer(target, unfinished, target.path.name)
            try:
                yield writer
                writer.finish()
            except BaseException:
                writer.abort()
                raise
            self.report.bytes_written = _size_on_disk(unfinished)

    def _open_report(self, stack: ExitStack) -> None:
        """Open the report's file; raise if that cannot be done, or if an input would be overwritten.

        In a dry run, it is only checked that the file can be written.
        """
        output, path = self.output, self.output.report
        report = [] if path is None else [OutputPath(path, "`report`")]
        destination = [] if self.destination is None else [OutputPath(self.destination)]
        refuse_overlap(self._inputs, [*destination, *report])
        if path is None:
            return
        try:
            if output.dry_run:
                check_file_output(path, beginning=BEGINNING, overwrite=output.overwrite)
            else:
                written = file_output(path, beginning=BEGINNING, overwrite=output.overwrite)
                self._write_report = stack.enter_context(written)
        except (DestinationError, OutputError) as err:
            err.message = f"the report cannot be written there: {err.message}"
            raise

    def refuse_changed(self) -> None:
        """Raise if a source changed during the run: the result may mix its old and new bytes."""
        for source, state in zip(self._read, self._states, strict=True):
            if state_of(source) != state:
                raise changed_while_read(source)


def _judge(
    reader: Reader,
    plan: Plan,
    prepared: Preparation,
    recording: OpenRecording,
    target: Destination,
    options: ConvertOptions,
    report: Report,
) -> None:
    """Add to the report what the result and its sources show; raise if the result is of no use."""
    report.add(reader.remarks)
    report.damage += [damage for each in (reader, *prepared.others) for damage in each.damage]
    report.add(*result_findings(report, recording.first_scans, target.serialization))
    # With a fixed frame, an IMU or a corrected clock, clocks were compared before.
    far = {
        each.topic
        for each in report.topics
        if each.stamps.is_far and each.spec is not None and not (each.spec.fixed_frame or each.spec.imu)
    }
    if far and not options.clock:
        doubtful = [each for each in plan.converted if each.topic in far]
        survey = Survey(reader, (), options.frames, prepared.span)
        clocks = Clocks(survey, survey.topics(doubtful).values())
        survey.read()
        report.add(clocks.warnings())
    routes = recording.routes.values()
    report.messages_declared, difference = compare_counts(reader, routes, options, report)
    report.damage += difference
    if plan.specs:
        refuse_nothing(report)
    if not options.repair:
        refuse_unsatisfied(report, options)


def _refuse_missing_destination(sources: Sequence[Path]) -> None:
    """Raise if the last of several sources does not exist: it may be meant as the destination, as with `cp`."""
    *others, last = sources
    if exists(last) or not all(map(exists, others)):
        return
    raise MissingError("does not exist", path=last, hint=f"did you mean `destination={shlex.quote(str(last))}`?")


def _size_on_disk(path: Path) -> int:
    """Return the size in bytes of a file, or of all files in a folder."""
    try:
        if path.is_dir():
            return sum(file.stat().st_size for file in path.iterdir())
        return path.stat().st_size
    except OSError as err:
        raise OutputError(f"cannot be read after it was written: {err.strerror}", path=path) from err
