"""The engine of every conversion: reads messages, converts them on several threads, and yields the items in order.

Recordings, Python's scans and clouds, exports and maps read the same items. Each decides which step is the last on a
thread, and what becomes of the items.

A thread that loads a chunk also works on its messages before it returns the chunk. So a cloud of 4 MB is still in the
core's own cache, and the memory of a chunk is released as soon as its scans exist.

Messages of one scan are grouped in order; their scan is made on any thread, and follows the message that completes it.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from pc2scan.bags.reader import Chunk, Wanted, merge_by_time
from pc2scan.errors import DecodeError, MessageError, TransformError, UnconnectedError
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms
from pc2scan.model import RawMessage, StoredChunk, copied_message, own_data
from pc2scan.result import MAX_LISTED, Skipped
from pc2scan.threads import InOrder

from .combine.contributions import Contribution
from .steps import ConvertedMessage, as_it_is

if TYPE_CHECKING:
    from collections.abc import Collection, Generator, Hashable, Iterable, Mapping, Sequence

    from pc2scan.advice.survey import Span
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Buffer, ChunkRule
    from pc2scan.progress import Meter
    from pc2scan.threads import Threads

    from .combine.contributions import MessagesToScan
    from .combine.grouping import Group, Grouper
    from .plan import Output, Route
    from .report import TopicReport


def items_of(
    reader: Reader,
    routes: Mapping[int, Route],
    span: Span,
    threads: Threads | None,
    *,
    rule: ChunkRule | None = None,
    window: int | None = None,
    meter: Meter | None = None,
) -> Items:
    """Yield what became of all messages of the cut: for each chunk, on a thread, each message is converted.

    Parameters
    ----------
    reader
        The recording.
    routes
        The route of each connection's messages; other messages are not read.
    span
        The cut. Messages of latched topics from before it are valid in it, and come first.
    threads
        The threads; None for the caller's alone. The items do not depend on it.
    rule
        Which chunks pass as a whole; None: none.
    window
        How many chunks may be loaded ahead; None: as many as memory allows.
    meter
        Counts the bytes, and reports them at the beginning, regularly, and at the end; None: nothing is reported.

    Yields
    ------
    Item | StoredChunk
        By log time. A group follows the item of the message that completes it.
    """
    connections, (start, stop, _) = [route.connection for route in routes.values()], span

    def items() -> Items:
        if meter is not None:
            meter.expect(reader.stored_bytes(connections, start, stop))
        parts: list[Iterable[Chunk]] = [reader.chunks(Wanted(connections, start, stop, rule))]
        if start is not None and (lasting := [connection for connection in connections if connection.is_latched]):
            with closing(reader.messages(lasting, None, start, threads)) as earlier:
                parts.insert(0, [latched_at(earlier, start)])
        for chunks in parts:
            load = merge_by_time(
                chunks, partial(convert_message, routes), threads, window=window, path=reader.path, meter=meter
            )
            # Closed before the threads are joined, so that work that has not begun is cancelled after an error.
            with closing(load) as loaded:
                for item in loaded:
                    if meter is not None:
                        meter.messages += sum(map(len, item.index.values())) if isinstance(item, StoredChunk) else 1
                    yield item
                    # Frees the item before the next one is made.
                    del item
        if meter is not None:
            meter.finish()

    combiners = {output.combiner: None for route in routes.values() for output in route.outputs if output.combiner}
    return add_groups(items(), combiners, threads) if combiners else items()


def convert_message(routes: Mapping[int, Route], message: RawMessage) -> Item:
    """Decode a message, and for each conversion of its route place its points, select some, and project them."""
    route = routes[message.connection.id]
    results: list[ConvertedMessage | Contribution | MessageError] = []
    cloud = passing = error = None
    try:
        if route.handle >= 0:
            passing = own_data(message.data) if route.reencode is None else route.reencode(message.data)
        if route.steps:
            cloud = route.decode(message.data)
    except MessageError as err:
        error = err
        results = [err] * len(route.steps)
    done: dict[Any, Any] = {}

    def once(step: Callable[[Any], Any], points: Any) -> Any:
        """Return what a step makes of points; equal steps of several conversions are done once."""
        key = step, id(points)
        if key not in done:
            done[key] = step(points)
        return done[key]

    for steps in route.steps if error is None else ():
        try:
            placed = once(steps.place, cloud)
            selected = once(steps.select, placed)
            scan = steps.project(selected)
            results.append(route.encode(scan) if isinstance(scan, ConvertedMessage) else scan)
        except MessageError as err:
            # It does not stop the other conversions.
            results.append(err)
    return Item(
        route,
        message.log_time_ns,
        message.publish_time_ns,
        message.sequence,
        [(output, results[output.index]) for output in route.outputs],
        passing,
        error,
    )


def latched_at(messages: Iterable[RawMessage], start_ns: int) -> Chunk:
    """Return the messages that are valid when a cut begins, with its time.

    These are the newest message of each connection, and of static transforms the newest message with each child frame:
    publishers send frames one by one or all again. Several connections of a topic, which are publishers of their own,
    each have theirs.

    Parameters
    ----------
    messages
        The messages of latched connections from before the cut, in their order.
    start_ns
        The beginning of the cut: at their own log times, they would make the recording begin when they were logged.
    """
    newest: dict[Hashable, tuple[int, RawMessage]] = {}
    for number, message in enumerate(messages):
        newest |= dict.fromkeys(_names(message), (number, copied_message(message)))
    by_number = dict(newest.values())
    latched = [
        by_number[number]._replace(log_time_ns=start_ns, publish_time_ns=start_ns) for number in sorted(by_number)
    ]

    def load(callback: Callable[[RawMessage], Any]) -> list[Any]:
        return [callback(message) for message in latched]

    size = sum(message.size for message in latched)
    return Chunk(start_ns, (), size, load, is_quick=True)


def _names(message: RawMessage) -> Collection[Hashable]:
    """Return the keys that a message supersedes in earlier ones."""
    connection = message.connection
    if not connection.is_static:
        return [connection.id]
    with suppress(DecodeError):
        if connection.ros_type in TF_TYPES:
            return {(connection.id, row[1]) for row in decode_transforms(message.data, connection.serialization)}
    return [(connection.id, bytes(message.data))]


#: The destination stores everything.
NOTHING_REFUSED: Mapping[int, MessageError] = {}


class Item(NamedTuple):
    """What a message became, or what a group of messages became together.

    Attributes
    ----------
    route
        The route of the message; of a group, that of its leading message.
    log_time_ns, publish_time_ns, sequence
        The message's. A group has the log time of the message that completes it, and the leading one's sequence.
    results
        Each output with its result, or with the error in its place. The message of an output that makes one scan of
        several waits for its group.
    passing
        The message as it is written to its own topic; None if it is not.
    error
        Why nothing could be made of the message, or why it cannot pass.
    is_group
        Whether it is a group.
    """

    route: Route
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    results: Sequence[tuple[Output, ConvertedMessage | Contribution | MessageError]] = ()
    passing: Buffer | None = None
    error: MessageError | None = None
    is_group: bool = False

    @property
    def size(self) -> int:
        """The size of what was made, in bytes."""
        results = (result for output, result in self.results if not (output.used or isinstance(result, MessageError)))
        return len(self.passing or b"") + sum(result.size for result in results)

    @property
    def errors(self) -> Sequence[MessageError]:
        """Why results are missing; each error once."""
        return list({result.message: result for _, result in self.results if isinstance(result, MessageError)}.values())

    @property
    def failure(self) -> MessageError | None:
        """The error of a message without any result; None if it has one."""
        errors = [result for _, result in self.results if isinstance(result, MessageError)]
        return errors[0] if errors and len(errors) == len(self.results) else self.error


@dataclass(slots=True, eq=False)
class Tally:
    """The counts of a conversion: those of the routes, and those of the entries that the report has for each topic.

    Parameters
    ----------
    routes
        The routes by the id of their connection.
    strict
        Whether a message that cannot be converted is an error; otherwise it is skipped.

    Attributes
    ----------
    skipped
        The first `MAX_LISTED` messages that were not converted; the last of them is the one that is farthest from any
        transform, if that came later.
    failures
        How many messages, or groups, have an error.
    is_connected
        Whether transforms connect at least one message with the target frame, or none are needed. Frames may differ
        from message to message, so that it is certain only after the last one.
    """

    routes: Mapping[int, Route]
    strict: bool
    skipped: list[Skipped] = field(default_factory=list)
    failures: int = 0
    is_connected: bool = False
    _farthest_ns: int = 0
    _first_unconnected: tuple[str, UnconnectedError] | None = None

    def count(self, item: Item, refused: Mapping[int, MessageError] = NOTHING_REFUSED) -> None:
        """Count an item.

        Parameters
        ----------
        refused
            Why the destination cannot store a result, by the number of its output among the item's results; -1 is the
            message as it passes.

        Raises
        ------
        MessageError
            With ``strict``: the first error.
        """
        route = item.route
        failed: list[tuple[MessageError, TopicReport]] = []
        if not item.is_group:
            if not route.writes:
                for entry in route.reports:
                    entry.skip(1)
                return
            route.messages += 1
            if route.report is not None:
                error = item.error or refused.get(-1)
                route.report.messages_in += 1
                if error is None:
                    route.report.messages_out += 1
                else:
                    route.report.skipped += 1
                    failed.append((error, route.report))
        for number, (output, result) in enumerate(item.results):
            entry = output.report
            entry.messages_in += not item.is_group
            if isinstance(result, ConvertedMessage) and number not in refused:
                entry.messages_out += 1
                if not output.used:
                    if output.first is None:
                        output.first = result.message
                    entry.count(result)
                    if result.stamp_ns is not None:
                        entry.stamps.add(result.stamp_ns, item.log_time_ns)
            elif isinstance(result, MessageError) or number in refused:
                entry.skipped += 1
                failed.append((result if isinstance(result, MessageError) else refused[number], entry))
        if failed:
            self._skip(item, failed)
        if not (self.is_connected or item.is_group) and route.outputs and route.outputs[0].spec is not None:
            error = item.failure
            self.is_connected = not isinstance(error, UnconnectedError)
            if self._first_unconnected is None and isinstance(error, UnconnectedError):
                self._first_unconnected = route.connection.topic, error

    def count_chunk(self, chunk: StoredChunk) -> None:
        """Count the messages of a chunk that passes as a whole."""
        for connection_id, entries in chunk.index.items():
            route = self.routes[connection_id]
            route.messages += len(entries)
            (entry,) = route.reports
            entry.messages_in += len(entries)
            entry.messages_out += len(entries)

    def finish(self) -> None:
        """Raise if no message could be converted because no transforms connect any with the target frame.

        Raises
        ------
        TransformError
            The first error.
        """
        if not self.is_connected and self._first_unconnected is not None:
            topic, first = self._first_unconnected
            raise UnconnectedError(f"nothing can be converted: {first.message}", topic=topic, hint=first.hint)

    def _skip(self, item: Item, failed: Sequence[tuple[MessageError, TopicReport]]) -> None:
        """List the errors of an item, or raise the first one."""
        topic = item.route.connection.topic
        self.failures += 1
        # Equal errors are listed once, with all topics that miss the message.
        errors: dict[str, tuple[MessageError, list[str]]] = {}
        for error, entry in failed:
            errors.setdefault(error.message, (error, []))[1].append(entry.target or "")
        for error, targets in errors.values():
            error.topic = topic
            if self.strict:
                raise error
            gap_ns = error.gap_ns if isinstance(error, TransformError) else 0
            if len(self.skipped) >= MAX_LISTED:
                if gap_ns <= self._farthest_ns:
                    continue
                del self.skipped[-1]
            self._farthest_ns = max(self._farthest_ns, gap_ns)
            fields = (topic, item.log_time_ns, error.stamp_ns, error.message, error.hint or "")
            self.skipped.append(Skipped(*fields, tuple(filter(None, targets)), gap_ns=gap_ns))


#: Bytes that may wait for each thread to be written.
_AHEAD_BYTES = 6 << 20


#: What becomes of messages, and chunks that pass as a whole, in the order of writing.
Items: TypeAlias = "Generator[Item | StoredChunk]"

#: What another thread may do, or the caller's: the function that makes an item, its size in bytes, and whether it takes
#: longer than handing it to another thread.
Work: TypeAlias = tuple[Callable[[], "Item | StoredChunk"], int, bool]

#: A message for a scan: its route, the output of the scan if this message leads it, itself, and the sequence number.
Arrival: TypeAlias = tuple["Route", "Output", Contribution, int]


@dataclass(slots=True, eq=False)
class Combiner:
    """Combines the messages of several topics to scans.

    A scan has the log time of the message that completed its group, which is when a node would have published it. A
    group that nothing completes has that of the last message of its topics, whatever else was recorded later.

    Parameters
    ----------
    conversion
        The conversion of the messages.
    grouper
        Groups them.
    last
        The consumer's last step with each scan.

    Attributes
    ----------
    reports
        The report's entry of each topic, by the topic's number. All publishers of a topic share one.
    """

    conversion: MessagesToScan
    grouper: Grouper
    last: Callable[[ConvertedMessage], ConvertedMessage]
    reports: dict[int, TopicReport] = field(default_factory=dict)
    _last_ns: int = 0

    def add(self, arrival: Arrival, log_time_ns: int) -> list[Work]:
        """Take a message, and return how the scans are made that are complete now."""
        self._last_ns, message = log_time_ns, arrival[2]
        groups = self.grouper.add(message.source, message.stamp_ns, log_time_ns, message.size, arrival)
        return list(map(self._work, groups))

    def finish(self) -> list[Work]:
        """Return how the scans are made that are still open, and add the counts to the report."""
        groups = self.grouper.finish()
        for number, entry in self.reports.items():
            entry.joined = self.grouper.counts[number]
            if number:
                entry.messages_out = entry.joined.used
        return list(map(self._work, groups))

    def alone(self, result: Any) -> Any:
        """Return the scan of a message alone, if it leads a scan: first clouds are judged so."""
        if not isinstance(result, Contribution) or result.source:
            return result
        try:
            return self.last(self.conversion.alone(result))
        except MessageError as err:
            return err

    def _work(self, group: Group) -> Work:
        # Points that are projected already are soon a scan.
        takes_long = any(member.item[2].nearest is None for member in group.members)
        size = sum(member.size for member in group.members)
        return partial(self._make, group, self._last_ns), size, takes_long

    def _make(self, group: Group, log_time_ns: int) -> Item:
        route, output, contribution, sequence = group.lead.item
        result: ConvertedMessage | MessageError
        try:
            result = self.last(self.conversion.scan(contribution, [member.item[2] for member in group.members]))
        except MessageError as err:
            result = err
            err.stamp_ns = err.stamp_ns or contribution.stamp_ns
        return Item(route, log_time_ns, log_time_ns, sequence, [(output, result)], is_group=True)


def add_groups(items: Items, combiners: Iterable[Combiner], threads: Threads | None) -> Items:
    """Add the scans of several messages to the items of single messages.

    Parameters
    ----------
    items
        The items of single messages, in the order of writing.
    combiners
        All combiners of the outputs.
    threads
        The threads that make the scans, or None for the caller's alone. The scans do not depend on it.

    Yields
    ------
    Item | StoredChunk
        Each group follows the item that completes it.
    """
    if threads is None:
        with closing(items):
            for work, _, _ in _work(items, combiners):
                result = work()
                # The next message is read into the buffer that this scan's points were in.
                del work
                yield result
        return
    # Scans may have very many points, so only one may wait.
    queue: InOrder[Any] = InOrder(threads, _AHEAD_BYTES, 1)
    try:
        for work, size, takes_long in _work(items, combiners):
            while len(queue) and not queue.has_room(size):
                yield queue.take()
            queue.put(work, size, at_its_turn=not takes_long)
            # Only the queue refers to the points, so that their buffer is free as soon as the scan is made.
            del work
            while queue.is_ready():
                yield queue.take()
        while len(queue):
            yield queue.take()
    finally:
        queue.cancel()
        # Stops loading ahead.
        items.close()


def _work(items: Iterable[Item | StoredChunk], combiners: Iterable[Combiner]) -> Generator[Work]:
    """Yield the work in order."""
    for item in items:
        arrivals: list[tuple[Combiner, Arrival]] = []
        if isinstance(item, StoredChunk):
            log_time_ns, size = 0, len(item.stored)
        else:
            log_time_ns, size = item.log_time_ns, item.size
            arrivals = [
                (output.combiner, (item.route, output, result, item.sequence))
                for output, result in item.results
                if output.combiner is not None and isinstance(result, Contribution)
            ]
        yield partial(as_it_is, item), size, False
        # This frame must hold neither the item nor its points while the next message is read.
        del item
        for combiner, arrival in arrivals:
            yield from combiner.add(arrival, log_time_ns)
        arrivals.clear()
    for combiner in combiners:
        yield from combiner.finish()
