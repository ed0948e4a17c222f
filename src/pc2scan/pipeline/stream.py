"""The stream of a conversion: messages are read, worked on by several threads, and written in the order of reading."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple, cast

from pc2scan.bags.model import RawMessage, StoredChunk, kept
from pc2scan.errors import MessageError, UnwritableError

from .lanes import Lane
from .ordered import map_in_order
from .report import Report, Skipped

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pc2scan.bags.model import Buffer, ChunkRule, Reader, Writer
    from pc2scan.bags.threads import Threads

    from .conversion import Converted
    from .options import ConvertOptions

__all__ = ["Progress", "Span", "cores", "stream"]

#: Called now and then with bytes read so far, bytes in all, and messages read so far.
Progress = Callable[[int, int, int], None]

#: Messages between two calls of the progress function.
_PROGRESS_EVERY = 64

#: To hand a smaller message to another thread, and to wait for the interpreter, takes longer than to work on it.
_WORTH_A_THREAD = 1 << 20


class _Outcome(NamedTuple):
    """What became of a message; an error takes the place of what could not be made.

    ``times`` are those of recording and of publishing (ns), and the sequence number.
    """

    lane: Lane
    times: tuple[int, int, int]
    converted: Converted | None
    passing: Buffer | None
    error: MessageError | None


class Span(NamedTuple):
    """The cut in log times: ``start_ns <= t < stop_ns`` (None: no limit), and the first time that matters."""

    start_ns: int | None
    stop_ns: int | None
    first_ns: int


def stream(
    reader: Reader,
    lanes: Mapping[int, Lane],
    options: ConvertOptions,
    span: Span,
    rule: ChunkRule | None,
    pool: Threads | None,
    writer: Writer,
    report: Report,
    progress: Progress | None,
) -> None:
    """Read, work on several threads, and write in the order of reading."""
    reader.read_ahead(pool, partial(_at_once, lanes))
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
        window=options.params.queue_size or 2 * (options.jobs or cores()),
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


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _cut(
    reader: Reader, lanes: Mapping[int, Lane], span: Span, rule: ChunkRule | None
) -> Iterator[RawMessage | StoredChunk]:
    """The wanted messages of the cut, after the latched ones from before it; in whole chunks where ``rule`` allows."""
    wanted = [lane.connection for lane in lanes.values()]
    start, stop = span.start_ns, span.stop_ns
    items: Iterator[RawMessage | StoredChunk] = (
        reader.messages(wanted, start, stop) if rule is None else reader.messages_or_chunks(rule, wanted, start, stop)
    )
    lasting = [lane.connection for lane in lanes.values() if lane.lasts]
    if start is None or not lasting:
        return items
    return chain(reader.messages(lasting, None, start), items)


#: A message with its lane, or a chunk to be copied.
_Item = tuple[Lane, RawMessage] | StoredChunk


def _is_heavy(item: _Item) -> bool:
    if isinstance(item, StoredChunk) or item[1].result is not None:
        return False
    lane, message = item
    return (lane.convert is not None or lane.encode is not None) and len(message.data) >= _WORTH_A_THREAD


def _work(item: _Item) -> _Outcome | StoredChunk:
    """All the work on one message, unless it is done, and none on a chunk; runs on any thread."""
    if isinstance(item, StoredChunk):
        return item
    lane, message = item
    return _outcome(lane, message) if message.result is None else cast("_Outcome", message.result)


def _outcome(lane: Lane, message: RawMessage) -> _Outcome:
    converted = passing = error = None
    try:
        if lane.passing_handle >= 0:
            passing = message.data if lane.encode is None else lane.encode(message.data)
        if lane.convert is not None:
            converted = lane.convert(message.data)
    except MessageError as err:
        error = err
    return _Outcome(lane, (message.log_time_ns, message.publish_time_ns, message.sequence), converted, passing, error)


def _at_once(lanes: Mapping[int, Lane], message: RawMessage) -> RawMessage:
    """Work on a message where it was read if what it becomes takes less memory until its turn."""
    lane = lanes[message.connection.id]
    if len(message.data) < lane.shrinks_from:
        return message
    outcome = _outcome(lane, message)
    if outcome.passing is not None:
        outcome = outcome._replace(passing=kept(outcome.passing))
    # What passes through as well is still held, and counts as that.
    times = outcome.times
    return RawMessage(message.connection, times[0], outcome.passing or b"", times[1], times[2], outcome)


def _write_chunk(chunk: StoredChunk, lanes: Mapping[int, Lane], writer: Writer) -> int:
    """Copy a chunk and account for its messages; returns how many they are."""
    writer.write_chunk(chunk)
    for connection_id, entries in chunk.index.items():
        lanes[connection_id].report.messages_in += len(entries)
        lanes[connection_id].report.messages_out += len(entries)
    return sum(map(len, chunk.index.values()))


def _write(outcome: _Outcome, writer: Writer, report: Report, on_error: str) -> None:
    """Write what a message became, and account for it."""
    lane, (log_time_ns, publish_time_ns, sequence), converted, passing, error = outcome
    entry = lane.report
    if not lane.writes:
        entry.skip(1)
        return
    entry.messages_in += 1
    try:
        if passing is not None:
            writer.write(lane.passing_handle, log_time_ns, passing, publish_time_ns, sequence)
        if converted is not None:
            writer.write(lane.converted_handle, log_time_ns, converted.data, publish_time_ns, sequence)
            lane.sample = lane.sample or converted.data
            entry.points += converted.counts
            entry.empty_scans += converted.empty
    except UnwritableError as err:
        error = err
    if error is not None:
        error.topic = lane.connection.topic
        if on_error == "fail":
            raise error
        report.skip(
            entry,
            Skipped(lane.connection.topic, log_time_ns, error.stamp_ns, error.message, error.hint or ""),
        )
    else:
        entry.messages_out += 1
