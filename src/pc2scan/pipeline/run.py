"""Stream a recording through a conversion: read, work, write in order."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.damage import RECOVER, Damage
from pc2scan.bags.files import state_of
from pc2scan.bags.merged import MergedReader
from pc2scan.bags.model import StoredChunk
from pc2scan.bags.registry import (
    default_destination,
    default_storage,
    kept_form,
    open_recording,
    open_writer,
    plan_destination,
)
from pc2scan.bags.staging import staged
from pc2scan.errors import (
    DamageError,
    MessageError,
    OutputError,
    ParameterError,
    RecordingError,
    TopicError,
    UsageError,
)
from pc2scan.messages.laserscan import LASERSCAN

from .acceptance import refusal
from .frames import Frames, is_static, read_transforms
from .lanes import Lane, carry_extras, chunk_rule, open_lanes, write_static
from .memory import keep_freed_memory
from .ordered import map_in_order
from .plan import make_plan
from .report import Report, Skipped

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.model import Buffer, ChunkRule, Connection, RawMessage, Reader, Summary, Writer
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
        ``none``, ``lz4``, ``zstd`` or ``bz2``, as the container allows. With None, chunks that are copied whole keep
        theirs.
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
            span = _span(reader, options)
            conversion, others = _conversion(reader, plan, options, span, stack, report)
            writer = open_writer(target, partial, path.name)
            try:
                copying = target.chunks == reader.summary.chunks != ""
                if copying:
                    writer.keep_ids(reader.connections)
                lanes = open_lanes(plan.routes, conversion, target, options, writer, report)
                if not options.only_scans:
                    carry_extras(reader, target, writer, report)
                if options.frames.write_static:
                    write_static(options.frames, span.first_ns, target, writer, report)
                pool = _threads(options, stack)
                if pool is not None:
                    reader.read_ahead(pool)
                    writer.compress_ahead(pool)
                rule = chunk_rule(lanes, target, writer) if copying else None
                _stream(reader, lanes, options, span, rule, pool, writer, report, progress)
                if conversion.target_type == LASERSCAN:
                    report.warnings += _refusals(lanes.values(), "ros1" if target.generation == 1 else "cdr")
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
    reader: Reader, plan: Plan, options: ConvertOptions, span: _Span, stack: ExitStack, report: Report
) -> tuple[Conversion, Sequence[Reader]]:
    """The direction asked for, with all that has to be known before the first message is converted.

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

    if "auto" not in (params.scan_time, params.time_increment) and not params.intensity_field:
        return CloudToScan(params, frames), others
    from .measure import measure  # noqa: PLC0415  # only where something is left to be measured

    converted = [route.connection for route in plan.routes if route.target]
    try:
        timings, notes = measure(reader, converted, params, frames, span.start_ns, span.stop_ns)
    except ParameterError as err:
        if origin := report.origins.get(err.name):
            err.message += f" (from {origin})"
        raise
    report.notes += notes
    return CloudToScan(params, frames, timings), others


def _generation(connections: Iterable[Connection]) -> int | None:
    """The source's ROS generation; None for a source without any message of ROS."""
    return next((c.generation for c in connections if c.generation is not None), None)


def _threads(options: ConvertOptions, stack: ExitStack) -> ThreadPoolExecutor | None:
    """The threads that read, decompress, convert and compress, until the stack is left; None for one job."""
    jobs = options.jobs or _cores()
    return stack.enter_context(ThreadPoolExecutor(jobs, thread_name_prefix="pc2scan")) if jobs > 1 else None


def _stream(
    reader: Reader,
    lanes: Mapping[int, Lane],
    options: ConvertOptions,
    span: _Span,
    rule: ChunkRule | None,
    pool: ThreadPoolExecutor | None,
    writer: Writer,
    report: Report,
    progress: Progress | None,
) -> None:
    """Read, work on several threads, and write in the order of reading."""
    total = reader.summary.size_bytes
    outcomes = map_in_order(
        _work,
        (
            item if isinstance(item, StoredChunk) else (lanes[item.connection.id], item)
            for item in _cut(reader, lanes, span, rule)
        ),
        is_heavy=_is_heavy,
        size=_KeptBytes(),
        pool=pool,
        window=options.params.queue_size or 2 * (options.jobs or _cores()),
    )
    done = told = 0
    # Closed before the pool is waited for, so that an error gives up what has not begun.
    with closing(outcomes):
        for outcome in outcomes:
            if isinstance(outcome, StoredChunk):
                done += _write_chunk(outcome, lanes, writer)
            else:
                _write(outcome, writer, report, options.on_error)
                done += 1
            if progress is not None and done - told >= _PROGRESS_EVERY:
                progress(reader.bytes_read, total, done)
                told = done
    if progress is not None:
        progress(total, total, sum(entry.messages_in for entry in report.topics))


class _KeptBytes:
    """How many bytes an item keeps in memory: its chunk, unless the message before it already does."""

    def __init__(self) -> None:
        # Its address: a reference would keep it.
        self._chunk = 0

    def __call__(self, item: _Item) -> int:
        data = item.stored if isinstance(item, StoredChunk) else item[1].data
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


def _cut(
    reader: Reader, lanes: Mapping[int, Lane], span: _Span, rule: ChunkRule | None
) -> Iterator[RawMessage | StoredChunk]:
    """The wanted messages of the cut, after the latched ones from before it; in whole chunks where ``rule`` allows."""
    wanted = [lane.connection for lane in lanes.values()]
    start, stop = span.start_ns, span.stop_ns
    items: Iterator[RawMessage | StoredChunk] = (
        reader.messages(wanted, start, stop) if rule is None else reader.messages_or_chunks(rule, wanted, start, stop)
    )
    lasting = [c for c in wanted if c.latching or is_static(c.topic)]
    if start is None or not lasting:
        return items
    return chain(reader.messages(lasting, None, start), items)


#: A message with its lane, or a chunk to be copied.
_Item = tuple[Lane, "RawMessage"] | StoredChunk


def _is_heavy(item: _Item) -> bool:
    return not isinstance(item, StoredChunk) and (item[0].convert is not None or item[0].encode is not None)


def _work(item: _Item) -> _Outcome | StoredChunk:
    """All the work on one message, and none on a chunk; runs on any thread."""
    if isinstance(item, StoredChunk):
        return item
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


def _write_chunk(chunk: StoredChunk, lanes: Mapping[int, Lane], writer: Writer) -> int:
    """Copy a chunk and account for its messages; returns how many they are."""
    writer.write_chunk(chunk)
    for connection_id, entries in chunk.index.items():
        lanes[connection_id].report.messages_in += len(entries)
        lanes[connection_id].report.messages_out += len(entries)
    return sum(map(len, chunk.index.values()))


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
        lane.sample = lane.sample or converted.data
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


def _refusals(lanes: Iterable[Lane], serialization: str) -> list[str]:
    """Who would refuse the scans that were written, topics of one answer together."""
    topics: dict[str, dict[str, None]] = {}
    for lane in lanes:
        if lane.sample and (text := refusal(lane.sample, serialization)):
            topics.setdefault(text, {})[lane.report.target or ""] = None
    return [f"{', '.join(names)}: {text}" for text, names in topics.items()]


def _size(path: Path) -> int:
    """Bytes of a file, or of the files in a folder."""
    try:
        if path.is_dir():
            return sum(file.stat().st_size for file in path.iterdir())
        return path.stat().st_size
    except OSError as err:
        raise OutputError(f"is gone: {err.strerror}", path=path) from err
