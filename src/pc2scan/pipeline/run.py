"""Stream a recording through a conversion: read, work, write in order."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.damage import RECOVER, Damage
from pc2scan.bags.files import state_of
from pc2scan.bags.merged import MergedReader
from pc2scan.bags.registry import (
    default_destination,
    default_storage,
    kept_form,
    open_recording,
    open_writer,
    plan_destination,
)
from pc2scan.bags.staging import staged
from pc2scan.errors import DamageError, MessageError, OutputError, RecordingError, TopicError, UsageError

from .frames import Frames, is_static, read_transforms
from .lanes import Lane, carry_extras, open_lanes, write_static
from .memory import keep_freed_memory
from .ordered import map_in_order
from .plan import make_plan
from .report import Report, Skipped

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.model import Buffer, Connection, RawMessage, Reader, Summary, Writer
    from pc2scan.bags.registry import Destination

    from .conversion import Conversion, Converted
    from .options import ConvertOptions
    from .plan import Plan

__all__ = ["OutputOptions", "Progress", "run"]

#: Called now and then with bytes read so far, bytes in all, and messages read so far.
Progress = Callable[[int, int, int], None]

#: Messages between two calls of the progress function.
_PROGRESS_EVERY = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputOptions:
    """How the destination is written; None means that container's default.

    Attributes
    ----------
    storage
        Of a rosbag2 directory: ``mcap`` or ``sqlite3``.
    compression
        ``none``, ``lz4``, ``zstd`` or ``bz2``, as the container allows.
    profile
        Of an ``.mcap`` file: ``ros1`` or ``ros2``.
    metadata_version
        Of a rosbag2 directory.
    overwrite
        Whether an existing destination is replaced.
    """

    storage: str | None = None
    compression: str | None = None
    profile: str | None = None
    metadata_version: int = 8
    overwrite: bool = False


class _Outcome(NamedTuple):
    """What became of a message; an error takes the place of what could not be made."""

    lane: Lane
    message: RawMessage
    converted: Converted | None
    passing: Buffer | None
    error: MessageError | None


def run(
    sources: Sequence[Path],
    destination: Path | None,
    options: ConvertOptions,
    output: OutputOptions,
    *,
    origins: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> Report:
    """Convert recordings; see `pc2scan.convert`."""
    began = time.monotonic()
    keep_freed_memory()
    if not sources:
        raise UsageError("no source given")
    with ExitStack() as stack:
        states = [state_of(source) for source in sources]
        readers = _open(sources, stack, options)
        reader = _merged(readers)
        plan = _plan(reader, options)
        summaries = [opened.summary for opened in readers]
        path = destination or default_destination(sources, summaries, "_repaired" if options.repair else "_scan")
        target = _target(path, destination is not None, reader, summaries, options, output)
        report = Report([str(source) for source in sources], str(path), options.params, dict(origins or {}))
        report.warnings += plan.warnings
        with staged(path, overwrite=output.overwrite, sources=sources) as partial:
            conversion, others = _conversion(reader, options, stack, report)
            writer = open_writer(target, partial, path.name)
            try:
                lanes = open_lanes(plan.routes, conversion, target, options, writer, report)
                if not options.only_scans:
                    carry_extras(reader, target, writer, report)
                span = _span(reader, options)
                if options.frames.write_static:
                    write_static(options.frames, span.first_ns, target, writer, report)
                _stream(reader, lanes, options, span, writer, report, progress)
                _refuse_changed(sources, states)
                report.damage += [damage for each in (reader, *others) for damage in each.damage]
                _compare_counts(reader, lanes, options, report)
                writer.finish()
            except BaseException:
                writer.abort()
                raise
            report.bytes_written = _size(partial)
        report.bytes_read = reader.summary.size_bytes
    report.conclude()
    report.seconds = time.monotonic() - began
    return report


def _open(sources: Sequence[Path], stack: ExitStack, options: ConvertOptions) -> list[Reader]:
    """Open the sources, to be closed with the stack."""
    readers = []
    for source in sources:
        reader = open_recording(source, verify=options.verify, strict=options.strict)
        stack.callback(reader.close)
        readers.append(reader)
    return readers


def _refuse_changed(sources: Sequence[Path], states: Sequence[object]) -> None:
    """What was read while it was written may be a bit of both."""
    for source, state in zip(sources, states, strict=True):
        if state_of(source) != state:
            raise RecordingError(
                "was changed while it was read", path=source, hint="wait until the recording is complete, or copy it"
            )


def _plan(reader: Reader, options: ConvertOptions) -> Plan:
    """Decide what goes where; of a damaged recording it may be the damage that leaves nothing to convert."""
    damage = reader.damage
    if options.repair and damage and not reader.connections:
        raise DamageError(f"nothing of it can be recovered: {damage[0].what}", path=damage[0].path)
    try:
        return make_plan(reader.connections, options)
    except TopicError as err:
        if damage:
            told = f"the recording is damaged, and topics may be missing: {damage[0].path}: {damage[0].what}"
            err.hint = f"{err.hint}; {told}" if err.hint else told
        raise


def _target(
    path: Path,
    is_named: bool,
    reader: Reader,
    summaries: Sequence[Summary],
    options: ConvertOptions,
    output: OutputOptions,
) -> Destination:
    """Decide the destination's form; that of a repaired recording is its source's where its name allows."""
    generation = _generation(reader.connections)
    storage, compression = default_storage(summaries) if not is_named else None, None
    if options.repair:
        storage, compression = kept_form(path, summaries)
    target = plan_destination(
        path,
        storage=output.storage or storage,
        compression=output.compression or (compression if output.storage in (None, storage) else None),
        profile=output.profile,
        metadata_version=output.metadata_version,
        source_generation=generation,
    )
    # A recording without any message of ROS is of neither profile.
    if options.repair and generation is None and target.container == "mcap" and output.profile is None:
        return replace(target, profile=summaries[0].profile)
    return target


def _compare_counts(reader: Reader, lanes: Mapping[int, Lane], options: ConvertOptions, report: Report) -> None:
    """Compare how many messages were read with how many there should be: no loss goes unnoticed."""
    counts = [lane.connection.message_count for lane in lanes.values()]
    if options.start is not None or options.end is not None or None in counts:
        return
    report.messages_declared = sum(filter(None, counts))
    if report.messages_read < report.messages_declared and not report.damage:
        missing = f"declares {report.messages_declared} messages, {report.messages_read} were found"
        if options.strict:
            raise DamageError(missing, path=reader.path, hint=RECOVER)
        lost = report.messages_declared - report.messages_read
        report.damage.append(Damage(missing, reader.path, messages_lost=lost))


def _merged(readers: list[Reader]) -> Reader:
    return MergedReader(readers) if len(readers) > 1 else readers[0]


def _conversion(
    reader: Reader, options: ConvertOptions, stack: ExitStack, report: Report
) -> tuple[Conversion, Sequence[Reader]]:
    """The direction asked for, with every transform known before the first message is converted.

    The other recordings that transforms were taken from are returned too.
    """
    params, asked = options.params, options.frames
    others: list[Reader] = []
    frames = Frames(source_frame=asked.source_frame)
    if params.target_frame:
        others = _open(asked.tf_from, stack, options)
        buffer, warnings = read_transforms([reader, *others], asked)
        report.warnings += warnings
        tolerance_ns = round(params.transform_tolerance * 1e9)
        frames = Frames(params.target_frame, asked.source_frame, buffer, tolerance_ns)
    if options.reverse:
        from .scan_to_cloud import ScanToCloud  # noqa: PLC0415  # each direction loads its own arithmetic

        return ScanToCloud(options.channels, frames, deskewed=options.deskew), others
    from .cloud_to_scan import CloudToScan  # noqa: PLC0415

    return CloudToScan(params, frames), others


def _generation(connections: Iterable[Connection]) -> int | None:
    """The source's ROS generation; None for a source without any message of ROS."""
    return next((c.generation for c in connections if c.generation is not None), None)


def _stream(
    reader: Reader,
    lanes: Mapping[int, Lane],
    options: ConvertOptions,
    span: _Span,
    writer: Writer,
    report: Report,
    progress: Progress | None,
) -> None:
    """Read, work on several threads, and write in the order of reading."""
    total = reader.summary.size_bytes
    jobs = options.jobs or _cores()
    with ExitStack() as stack:
        pool = None
        if jobs > 1:
            pool = stack.enter_context(ThreadPoolExecutor(jobs, thread_name_prefix="pc2scan"))
            reader.read_ahead(pool)
        outcomes = map_in_order(
            _work,
            ((lanes[message.connection.id], message) for message in _cut(reader, lanes, span)),
            is_heavy=lambda item: item[0].convert is not None or item[0].encode is not None,
            size=_KeptBytes(),
            pool=pool,
            window=options.params.queue_size or 2 * jobs,
        )
        # Closed before the pool is waited for, so that an error gives up what has not begun.
        stack.callback(outcomes.close)
        for count, outcome in enumerate(outcomes, 1):
            _write(outcome, writer, report, options.on_error)
            if progress is not None and count % _PROGRESS_EVERY == 0:
                progress(reader.bytes_read, total, count)
    if progress is not None:
        progress(total, total, sum(entry.messages_in for entry in report.topics))


class _KeptBytes:
    """How many bytes a message keeps in memory: its chunk, unless the message before it already does."""

    def __init__(self) -> None:
        # Its address: a reference would keep it.
        self._chunk = 0

    def __call__(self, item: tuple[Lane, RawMessage]) -> int:
        data = item[1].data
        if not isinstance(data, memoryview):
            return len(data)
        known, self._chunk = self._chunk, id(data.obj)
        return 0 if self._chunk == known else len(data.obj)  # type: ignore[arg-type]  # chunks are bytes


def _cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Span(NamedTuple):
    """The cut in log times: ``start_ns <= t < stop_ns`` (None: no limit), and the first time that matters."""

    start_ns: int | None
    stop_ns: int | None
    first_ns: int


def _span(reader: Reader, options: ConvertOptions) -> _Span:
    """Resolve the cut against the recording's beginning."""
    beginning = reader.summary.start_ns
    if beginning is None:
        first = next(reader.messages(), None)
        beginning = first.log_time_ns if first is not None else 0
    start = None if options.start is None else options.start.resolve(beginning)
    stop = None if options.end is None else options.end.resolve(beginning)
    if start is not None and stop is not None and start >= stop:
        raise UsageError("the cut is empty: start is not before end")
    return _Span(start, stop, beginning if start is None else max(start, beginning))


def _cut(reader: Reader, lanes: Mapping[int, Lane], span: _Span) -> Iterator[RawMessage]:
    """The wanted messages of the cut, after the latched ones from before it."""
    wanted = [lane.connection for lane in lanes.values()]
    start, stop = span.start_ns, span.stop_ns
    messages = reader.messages(wanted, start, stop)
    lasting = [c for c in wanted if c.latching or is_static(c.topic)]
    if start is None or not lasting:
        return messages
    return chain(reader.messages(lasting, None, start), messages)


def _work(item: tuple[Lane, RawMessage]) -> _Outcome:
    """All the work on one message; runs on any thread."""
    lane, message = item
    converted = passing = error = None
    try:
        if lane.passing_handle >= 0:
            passing = message.data if lane.encode is None else lane.encode(message.data)
        if lane.convert is not None:
            converted = lane.convert(message.data)
    except MessageError as err:
        error = err
    return _Outcome(lane, message, converted, passing, error)


def _write(outcome: _Outcome, writer: Writer, report: Report, on_error: str) -> None:
    """Write what a message became, and account for it."""
    lane, message, converted, passing, error = outcome
    entry = lane.report
    entry.messages_in += 1
    when = (message.log_time_ns, message.publish_time_ns, message.sequence)
    if passing is not None:
        writer.write(lane.passing_handle, when[0], passing, when[1], when[2])
    if converted is not None:
        writer.write(lane.converted_handle, when[0], converted.data, when[1], when[2])
        entry.points += converted.counts
        entry.empty_scans += converted.empty
    if error is not None:
        error.topic = lane.connection.topic
        if on_error == "fail":
            raise error
        report.skip(
            entry,
            Skipped(lane.connection.topic, message.log_time_ns, error.stamp_ns, error.message, error.hint or ""),
        )
    else:
        entry.messages_out += 1


def _size(path: Path) -> int:
    """Bytes of a file, or of the files in a folder."""
    try:
        if path.is_dir():
            return sum(file.stat().st_size for file in path.iterdir())
        return path.stat().st_size
    except OSError as err:
        raise OutputError(f"is gone: {err.strerror}", path=path) from err
