"""The stream of a conversion: reads messages, works on them on several threads, and writes in the order of reading."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from pc2scan.bags.latching import NewestItems, is_static
from pc2scan.bags.units import Unit
from pc2scan.errors import DecodeError, MessageError, UnwritableError
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms
from pc2scan.model import StoredChunk, own_data, own_message
from pc2scan.result import Skipped

from .conversion import EncodedMessage
from .first_clouds import Candidate, SharedSample
from .scheduler import DeferredMessage, schedule

if TYPE_CHECKING:
    from collections.abc import Collection, Generator, Hashable, Iterable, Iterator, Mapping, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.bags.units import Item
    from pc2scan.model import Buffer, ChunkRule, RawMessage, Writer
    from pc2scan.threads import Threads

    from .combine.combiner import Arrival, CombinedScan
    from .levelling import LevelFrames
    from .options import ConvertOptions
    from .refusals import TransformCheck
    from .report import Report
    from .routes import OpenRoute, TargetTopic
    from .topic_report import TopicReport

#: Called regularly with the bytes read so far, the bytes in all, and the messages read so far.
Progress = Callable[[int, int, int], None]

#: How many messages are between two calls of the progress function.
_PROGRESS_EVERY = 64


class _MessageOutcome(NamedTuple):
    """The results of a message; a result that could not be made is replaced by its error."""

    route: OpenRoute
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    converted: Sequence[EncodedMessage | MessageError]
    passing: Buffer | None
    error: MessageError | None

    @property
    def size(self) -> int:
        """The size of the results in bytes."""
        size = len(self.passing or b"")
        for made in self.converted:
            if not isinstance(made, MessageError):
                size += made.size
        return size

    @property
    def failure(self) -> MessageError | None:
        """The error of a message without any result; None if it has one."""
        errors = [made for made in self.converted if isinstance(made, MessageError)]
        return errors[0] if errors and len(errors) == len(self.converted) else self.error


class Span(NamedTuple):
    """The cut in log times: ``start_ns <= t < stop_ns`` (None: no limit), and its first time."""

    start_ns: int | None
    stop_ns: int | None
    first_ns: int


def stream(
    reader: Reader,
    routes: Mapping[int, OpenRoute],
    options: ConvertOptions,
    span: Span,
    rule: ChunkRule | None,
    pool: Threads | None,
    writer: Writer,
    report: Report,
    progress: Progress | None,
    levels: LevelFrames | None = None,
    unconnected: TransformCheck | None = None,
) -> None:
    """Convert all messages of the cut, and write them in the order of reading.

    ``levels`` writes the frames of level scans; ``unconnected`` receives each message until one is converted.
    """
    total = reader.summary.size_bytes
    outcomes: Generator[_MessageOutcome | StoredChunk | CombinedScan] = _outcomes(
        reader, routes, options, span, rule, pool
    )
    combiners = list(
        dict.fromkeys(o.combiner for route in routes.values() for o in route.outputs if o.combiner is not None)
    )
    if combiners:
        from .combine.combiner import add_scans  # noqa: PLC0415  # few scans are made of several messages

        outcomes = add_scans(outcomes, _arrivals, combiners, pool)
    steps = 0
    # Closed before the threads are joined, so that work that has not begun is cancelled after an error.
    with closing(outcomes):
        for outcome in outcomes:
            if isinstance(outcome, StoredChunk):
                _write_chunk(outcome, routes, writer)
            elif not isinstance(outcome, _MessageOutcome):
                _write_scan(outcome, writer, report, options.on_error, levels)
            else:
                _write(outcome, writer, report, options.on_error, levels)
                if unconnected is not None and outcome.route.convert is not None:
                    unconnected.note(outcome.route.connection.topic, outcome.failure)
                    unconnected = unconnected if unconnected.is_possible else None
            if progress is not None:
                steps += _PROGRESS_EVERY if isinstance(outcome, StoredChunk) else 1
                if steps >= _PROGRESS_EVERY:
                    steps = 0
                    progress(reader.bytes_read, total, sum(route.messages for route in routes.values()))
    report.messages_read = sum(route.messages for route in routes.values())
    if progress is not None:
        progress(total, total, report.messages_read)


def _outcomes(
    reader: Reader,
    routes: Mapping[int, OpenRoute],
    options: ConvertOptions,
    span: Span,
    rule: ChunkRule | None,
    pool: Threads | None,
) -> Generator[_MessageOutcome | StoredChunk]:
    """Return the results of the messages in the cut, after those of latched messages from before it."""
    work = partial(_outcome_or_deferral, routes)
    window = min((spec.params.queue_size for spec in options.scans if spec.params.queue_size), default=None)
    for units in _units_of_cut(reader, routes, span, rule, pool):
        yield from schedule(units, work, pool, window=window, path=reader.path)


def _units_of_cut(
    reader: Reader, routes: Mapping[int, OpenRoute], span: Span, rule: ChunkRule | None, pool: Threads | None
) -> Iterator[Iterable[Unit]]:
    """Return the units of the cut, after the one with what is latched at its beginning."""
    wanted = [route.connection for route in routes.values()]
    start, stop = span.start_ns, span.stop_ns
    lasting = [route.connection for route in routes.values() if route.lasts]
    if start is not None and lasting:
        with closing(schedule(reader.units(lasting, None, start), own_message, pool, path=reader.path)) as earlier:
            # No rule allows whole chunks here.
            yield [latched_at(cast("Iterator[RawMessage]", earlier), start)]
    yield reader.units(wanted, start, stop, rule)


def _outcome_or_deferral(routes: Mapping[int, OpenRoute], message: RawMessage) -> _MessageOutcome | DeferredMessage:
    """Work on a message; postpone it if its result takes more memory than itself. Runs on any thread."""
    route = routes[message.connection.id]
    if route.convert is not None and len(message.data) < route.shrinks_from:
        return DeferredMessage(own_message(message), partial(_outcome, route))
    return _outcome(route, message)


def _outcome(route: OpenRoute, message: RawMessage) -> _MessageOutcome:
    """Convert or re-encode one message."""
    converted: Sequence[EncodedMessage | MessageError] = ()
    passing = error = None
    try:
        if route.passing_handle >= 0:
            passing = own_data(message.data) if route.encode is None else route.encode(message.data)
        if route.convert is not None:
            converted = route.convert(message.data)
            for made in converted:
                if isinstance(made, EncodedMessage) and isinstance(made.sample, Candidate):
                    made.sample = made.sample.sample(message.log_time_ns)
    except MessageError as err:
        error = err
    return _MessageOutcome(
        route, message.log_time_ns, message.publish_time_ns, message.sequence, converted, passing, error
    )


def _write_chunk(chunk: StoredChunk, routes: Mapping[int, OpenRoute], writer: Writer) -> None:
    """Copy a chunk, and count its messages."""
    writer.write_chunk(chunk)
    for connection_id, entries in chunk.index.items():
        route = routes[connection_id]
        route.messages += len(entries)
        (entry,) = route.reports
        entry.messages_in += len(entries)
        entry.messages_out += len(entries)


def _write(outcome: _MessageOutcome, writer: Writer, report: Report, on_error: str, levels: LevelFrames | None) -> None:
    """Write the results of a message, and count them."""
    route, log_time_ns, publish_time_ns, sequence, converted, passing, error = outcome
    if not route.writes:
        for entry in route.reports:
            entry.skip(1)
        return
    route.messages += 1
    try:
        if passing is not None:
            writer.write(route.passing_handle, log_time_ns, passing, publish_time_ns, sequence)
    except UnwritableError as err:
        error = err
    failed: list[tuple[MessageError, TopicReport]] = []
    if route.report is not None:
        _count(route.report, error)
        if error is not None:
            failed.append((error, route.report))
    for output in route.outputs:
        reason = error
        if reason is None:
            made = converted[output.place]
            if isinstance(made, MessageError):
                reason = made
            elif output.combiner is None:
                reason = _write_one(made, output, outcome, writer, levels)
        _count(output.report, reason, is_written=output.combiner is None)
        if reason is not None:
            failed.append((reason, output.report))
    for made in converted:
        if isinstance(made, EncodedMessage) and isinstance(made.sample, SharedSample):
            made.sample.add(made.counts)
    if failed:
        _skip(route.connection.topic, log_time_ns, failed, report, on_error)


def _skip(
    topic: str,
    log_time_ns: int,
    failed: Sequence[tuple[MessageError, TopicReport]],
    report: Report,
    on_error: str,
) -> None:
    """Report the errors of a message, or raise the first one if errors are not skipped."""
    # Equal errors are reported once, with all topics that miss the message.
    errors: dict[str, tuple[MessageError, list[str]]] = {}
    for error, entry in failed:
        errors.setdefault(error.message, (error, []))[1].append(entry.target or "")
    for each, targets in errors.values():
        each.topic = topic
        if on_error == "fail":
            raise each
        report.list_skipped(
            Skipped(topic, log_time_ns, each.stamp_ns, each.message, each.hint or "", tuple(filter(None, targets)))
        )


def _arrivals(outcome: _MessageOutcome | StoredChunk | CombinedScan) -> tuple[int, int, list[Arrival]]:
    """Return the log time of an outcome, its bytes, and its parts of scans of several messages."""
    from .combine.combiner import Arrival  # noqa: PLC0415  # few scans are made of several messages

    if isinstance(outcome, StoredChunk):
        return outcome.span_ns()[1], len(outcome.stored), []
    assert isinstance(outcome, _MessageOutcome)
    found = []
    for output in outcome.route.outputs:
        if output.combiner is not None and not output.used and outcome.error is None:
            made: Any = outcome.converted[output.place]
            if not isinstance(made, MessageError):
                found.append(Arrival(output.combiner, output, made, outcome.sequence))
    return outcome.log_time_ns, outcome.size, found


def _write_scan(scan: CombinedScan, writer: Writer, report: Report, on_error: str, levels: LevelFrames | None) -> None:
    """Write a scan of several messages, and count it."""
    output, log_time_ns, stamp_ns, sequence, made = scan
    error = made if isinstance(made, MessageError) else None
    if not isinstance(made, MessageError):
        try:
            if levels is not None and made.level is not None:
                levels.write(made.level, log_time_ns, log_time_ns, writer)
            writer.write(output.handle, log_time_ns, made.data, log_time_ns, sequence)
            if output.points is not None and made.used is not None:
                writer.write(output.points.handle, log_time_ns, made.used, log_time_ns, sequence)
                output.points.report.messages_out += 1
        except UnwritableError as err:
            error = err
        else:
            _account(made, output)
            output.report.messages_out += 1
            if isinstance(made.sample, SharedSample):
                made.sample.add(made.counts)
    if error is None:
        return
    error.topic = output.report.topic
    if on_error == "fail":
        raise error
    output.report.skipped += 1
    report.list_skipped(Skipped(error.topic, log_time_ns, error.stamp_ns or stamp_ns, error.message, error.hint or ""))


def _write_one(
    made: EncodedMessage, output: TargetTopic, outcome: _MessageOutcome, writer: Writer, levels: LevelFrames | None
) -> MessageError | None:
    """Write the result of a message to one topic, and count it; return the error if that fails."""
    try:
        if output.used:
            if made.used is not None:
                writer.write(output.handle, outcome.log_time_ns, made.used, outcome.publish_time_ns, outcome.sequence)
            return None
        if levels is not None and made.level is not None:
            # Before the scan, so that its frame is known when the recording is replayed.
            levels.write(made.level, outcome.log_time_ns, outcome.publish_time_ns, writer)
        writer.write(output.handle, outcome.log_time_ns, made.data, outcome.publish_time_ns, outcome.sequence)
    except UnwritableError as err:
        return err
    _account(made, output)
    return None


def _account(made: EncodedMessage, output: TargetTopic) -> None:
    """Count a message that was written."""
    output.sample = output.sample or made.data
    output.report.count(made)


def _count(entry: TopicReport, error: MessageError | None, *, is_written: bool = True) -> None:
    entry.messages_in += 1
    entry.messages_out += error is None and is_written
    entry.skipped += error is not None


def latched_at(messages: Iterable[RawMessage], start_ns: int) -> Unit:
    """Return the messages that are valid when a cut begins, with its time.

    These are the newest message of each connection, and of static transforms the newest message with each child frame:
    publishers send frames one by one or all again. Several connections of a topic, which are publishers of their own,
    each have theirs.

    Parameters
    ----------
    messages
        Those of latched connections from before the cut, in their order.
    start_ns
        The beginning of the cut: at their own log times, they would make the recording begin when they were logged.
    """
    newest: NewestItems[RawMessage] = NewestItems()
    for message in messages:
        # A view would keep a whole chunk in memory.
        newest.add(_names(message), message._replace(data=bytes(message.data)))
    found = [message._replace(log_time_ns=start_ns, publish_time_ns=start_ns) for message in newest]

    def load(callback: Callable[[RawMessage], Item], *, whole: bool) -> list[Item]:  # noqa: ARG001  # no chunk
        return [callback(message) for message in found]

    size = sum(message.size for message in found)
    return Unit(start_ns, (), size, load, is_quick=True, is_in_memory=True)


def _names(message: RawMessage) -> Collection[Hashable]:
    """Return what a message is the newest one of."""
    connection = message.connection
    if not is_static(connection.topic):
        return [connection.id]
    try:
        if connection.ros_type in TF_TYPES:
            return {(connection.id, row[1]) for row in decode_transforms(message.data, connection.serialization)}
    except DecodeError:
        pass
    return [(connection.id, bytes(message.data))]
