"""The stream of a conversion: messages are read, worked on by several threads, and written in the order of reading."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.model import StoredChunk, own, owned
from pc2scan.errors import MessageError, UnwritableError

from .report import Report, Skipped
from .scheduler import Later, schedule

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator, Mapping

    from pc2scan.bags.model import Buffer, ChunkRule, RawMessage, Writer
    from pc2scan.bags.reader import Reader
    from pc2scan.bags.threads import Threads
    from pc2scan.bags.units import Unit

    from .conversion import Converted
    from .lanes import Lane
    from .options import ConvertOptions

__all__ = ["Progress", "Span", "stream"]

#: Called now and then with bytes read so far, bytes in all, and messages read so far.
Progress = Callable[[int, int, int], None]

#: Messages between two calls of the progress function.
_PROGRESS_EVERY = 64


class _Outcome(NamedTuple):
    """What became of a message; an error takes the place of what could not be made."""

    lane: Lane
    log_time_ns: int
    publish_time_ns: int
    sequence: int
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
    total = reader.summary.size_bytes
    outcomes = _outcomes(reader, lanes, options, span, rule, pool)
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


def _outcomes(
    reader: Reader,
    lanes: Mapping[int, Lane],
    options: ConvertOptions,
    span: Span,
    rule: ChunkRule | None,
    pool: Threads | None,
) -> Generator[_Outcome | StoredChunk]:
    """What becomes of the messages of the cut, after the latched ones from before it."""
    work = partial(_outcome_or_later, lanes)
    window = options.params.queue_size or None
    for units in _cut(reader, lanes, span, rule):
        yield from schedule(units, work, pool, window=window, path=reader.path)


def _cut(reader: Reader, lanes: Mapping[int, Lane], span: Span, rule: ChunkRule | None) -> Iterator[Iterable[Unit]]:
    """The units of the cut, after those with the latched messages from before it."""
    wanted = [lane.connection for lane in lanes.values()]
    start, stop, _ = span
    lasting = [lane.connection for lane in lanes.values() if lane.lasts]
    if start is not None and lasting:
        yield reader.units(lasting, None, start)
    yield reader.units(wanted, start, stop, rule)


def _outcome_or_later(lanes: Mapping[int, Lane], message: RawMessage) -> _Outcome | Later:
    """Work on a message, unless its result takes more memory until its turn; runs on any thread."""
    lane = lanes[message.connection.id]
    if lane.convert is not None and len(message.data) < lane.shrinks_from:
        return Later(owned(message), partial(_outcome, lane))
    return _outcome(lane, message)


def _outcome(lane: Lane, message: RawMessage) -> _Outcome:
    """All the work on one message."""
    converted = passing = error = None
    try:
        if lane.passing_handle >= 0:
            passing = own(message.data) if lane.encode is None else lane.encode(message.data)
        if lane.convert is not None:
            converted = lane.convert(message.data)
    except MessageError as err:
        error = err
    return _Outcome(lane, message.log_time_ns, message.publish_time_ns, message.sequence, converted, passing, error)


def _write_chunk(chunk: StoredChunk, lanes: Mapping[int, Lane], writer: Writer) -> int:
    """Copy a chunk and account for its messages; returns how many they are."""
    writer.write_chunk(chunk)
    for connection_id, entries in chunk.index.items():
        lanes[connection_id].report.messages_in += len(entries)
        lanes[connection_id].report.messages_out += len(entries)
    return sum(map(len, chunk.index.values()))


def _write(outcome: _Outcome, writer: Writer, report: Report, on_error: str) -> None:
    """Write what a message became, and account for it."""
    lane, log_time_ns, publish_time_ns, sequence, converted, passing, error = outcome
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
