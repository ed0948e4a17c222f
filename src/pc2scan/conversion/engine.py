"""The engine of every conversion: reads messages, converts them on several threads, and yields the items in order.

Recordings, Python's scans and clouds, exports, maps and dry runs read the same items. Each decides which step is the
last on a thread, and what becomes of the items.

A thread that loads a unit also works on its messages before it returns the unit. So a cloud of 4 MB is still in the
core's own cache, and the memory of a chunk is released as soon as its scans exist.
"""

from __future__ import annotations

from collections import deque
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

from pc2scan.bags.topics import NewestItems
from pc2scan.bags.units import Handle, LazyItems, Unit, load_when_due, merge_by_time
from pc2scan.errors import DecodeError, MessageError
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms
from pc2scan.model import RawMessage, StoredChunk, copied_message, own_data, own_message
from pc2scan.threads import InOrder

from .items import Item
from .steps import ConvertedMessage

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Hashable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.advice.survey import Span
    from pc2scan.bags.reader import Reader
    from pc2scan.bags.units import Loaded, TimedItem
    from pc2scan.model import ChunkRule
    from pc2scan.progress import Meter
    from pc2scan.threads import Threads

    from .combine.combiner import Combiner
    from .items import OpenRoute, Output

    Made = TypeVar("Made", bound=TimedItem)

#: How many bytes are loaded ahead for every thread. Of units up to the second size, always one more than threads is
#: loaded.
AHEAD_BYTES = 6 << 20
LARGEST_AHEAD = 20 << 20

#: How many bytes of messages are passed to another thread together. For fewer bytes, passing them takes longer than the
#: work.
_PIECE_BYTES = 1 << 20


class DeferredMessage(NamedTuple):
    """A message that a callback postpones until its turn, because its result takes more memory."""

    message: RawMessage
    work: Callable[[RawMessage], Any]

    @property
    def log_time_ns(self) -> int:
        """The log time of the message."""
        return self.message.log_time_ns

    @property
    def size(self) -> int:
        """The size of the message in bytes."""
        return self.message.size


def items_of(
    reader: Reader,
    routes: Mapping[int, OpenRoute],
    span: Span,
    threads: Threads | None,
    *,
    combiners: Mapping[Output, Combiner] | None = None,
    rule: ChunkRule | None = None,
    window: int | None = None,
    meter: Meter | None = None,
) -> Generator[Item | StoredChunk]:
    """Yield what became of all messages of the cut.

    Parameters
    ----------
    reader
        The recording.
    routes
        What is done with the messages of each connection; messages of others are not read.
    span
        The cut. Messages of latched topics from before it are valid in it, and come first.
    threads
        The threads; None for the caller's alone. The items do not depend on it.
    combiners
        What makes scans of several messages, by the outputs of these; None: there are no such scans.
    rule
        Which chunks pass as a whole; None: none.
    window
        How many units may be loaded ahead; None: as many as memory allows.
    meter
        Counts the bytes, and reports them at the beginning, regularly, and at the end; None: nothing is reported.

    Yields
    ------
    Item | StoredChunk
        By log time. A group follows the item of the message that completes it.
    """
    items = _messages(reader, routes, span, threads, rule, window, meter)
    if not combiners:
        return items
    from .combine.combiner import add_groups  # noqa: PLC0415  # few scans are made of several messages

    return add_groups(items, combiners, threads)


def _messages(
    reader: Reader,
    routes: Mapping[int, OpenRoute],
    span: Span,
    threads: Threads | None,
    rule: ChunkRule | None,
    window: int | None,
    meter: Meter | None,
) -> Generator[Item | StoredChunk]:
    """Yield the items of the messages in the cut, after those of latched messages from before it."""
    work = partial(_work, routes)
    if meter is not None:
        wanted = [route.connection for route in routes.values()]
        meter.expect(reader.stored_bytes(wanted, span.start_ns, span.stop_ns))
    for units in _units_of_cut(reader, routes, span, rule, threads):
        # Closed before the threads are joined, so that work that has not begun is cancelled after an error.
        with closing(schedule(units, work, threads, window=window, path=reader.path, meter=meter)) as items:
            for item in items:
                if meter is not None:
                    meter.messages += sum(map(len, item.index.values())) if isinstance(item, StoredChunk) else 1
                yield item.work(item.message) if isinstance(item, DeferredMessage) else item
                # Frees the item before the next one is made.
                del item
    if meter is not None:
        meter.finish()


def _units_of_cut(
    reader: Reader, routes: Mapping[int, OpenRoute], span: Span, rule: ChunkRule | None, threads: Threads | None
) -> Iterator[Iterable[Unit]]:
    """Yield the unit with what is latched at the beginning of the cut, then the units of the cut."""
    wanted = [route.connection for route in routes.values()]
    start, stop = span.start_ns, span.stop_ns
    lasting = [route.connection for route in routes.values() if route.connection.is_latched]
    if start is not None and lasting:
        with closing(schedule(reader.units(lasting, None, start), own_message, threads, path=reader.path)) as earlier:
            # No rule allows whole chunks here.
            yield [latched_at(cast("Iterator[RawMessage]", earlier), start)]
    yield reader.units(wanted, start, stop, rule)


def _work(routes: Mapping[int, OpenRoute], message: RawMessage, *, is_due: bool = False) -> Item | DeferredMessage:
    """Convert or re-encode a message; postpone it if the result takes more memory, and is not due. On any thread."""
    route = routes[message.connection.id]
    if (route.steps or route.unpacks) and len(message.data) < route.shrinks_from and not is_due:
        return DeferredMessage(own_message(message), partial(_work, routes, is_due=True))
    results: Sequence[tuple[Output, Any]] = ()
    passing = error = None
    try:
        if route.passing_handle >= 0:
            passing = own_data(message.data) if route.reencode is None else route.reencode(message.data)
        if route.steps:
            value: Any = message.data
            for step in route.steps:
                value = step(value)
            made = value if isinstance(value, list) else (value,)
            for result in made:
                if isinstance(result, ConvertedMessage) and result.candidate is not None:
                    result.sample = result.candidate(message.log_time_ns)
                    result.candidate = None
            results = [(output, made[output.index]) for output in route.outputs]
    except MessageError as err:
        error = err
        results = [(output, err) for output in route.outputs]
    return Item(
        route,
        message.log_time_ns,
        message.publish_time_ns,
        message.sequence,
        len(message.data),
        results,
        passing,
        error,
    )


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
        newest.add(_names(message), copied_message(message))
    found = [message._replace(log_time_ns=start_ns, publish_time_ns=start_ns) for message in newest]

    def load(callback: Callable[[RawMessage], Any], *, whole: bool) -> list[Any]:  # noqa: ARG001  # no chunk
        return [callback(message) for message in found]

    size = sum(message.size for message in found)
    return Unit(start_ns, (), size, load, is_quick=True, is_in_memory=True)


def _names(message: RawMessage) -> Collection[Hashable]:
    """Return the keys that a message supersedes in earlier ones."""
    connection = message.connection
    if not connection.is_static:
        return [connection.id]
    try:
        if connection.ros_type in TF_TYPES:
            return {(connection.id, row[1]) for row in decode_transforms(message.data, connection.serialization)}
    except DecodeError:
        pass
    return [(connection.id, bytes(message.data))]


def schedule(
    units: Iterable[Unit],
    work: Callable[[RawMessage], Made],
    threads: Threads | None,
    *,
    window: int | None = None,
    path: Path | None = None,
    meter: Meter | None = None,
) -> Generator[Made | StoredChunk]:
    """Work on the messages of a recording.

    Parameters
    ----------
    units
        The units to load, sorted by start.
    work
        Makes an item of a message. The reader calls it as it loads a unit, on any thread; see
        `pc2scan.bags.units.Load`.
    threads
        All threads, or None for the caller's alone. The items do not depend on it.
    window
        How many units may be loaded ahead; None: as many as memory allows.
    path
        The recording, for error messages.
    meter
        Gets the bytes of each unit when the next one is due.

    Yields
    ------
    Made | StoredChunk
        Sorted by log time, whatever the number of threads. An exception of the work is raised in the place of its
        item.
    """
    loading = load_when_due if threads is None else partial(_load_ahead, threads, window)
    if meter is not None:
        loading = partial(_count_bytes, meter, loading)
    return merge_by_time(units, work, loading=loading, path=path)


def _count_bytes(
    meter: Meter,
    loading: Callable[[Iterable[Unit], Callable[[RawMessage], Made]], Generator[Handle]],
    units: Iterable[Unit],
    work: Callable[[RawMessage], Made],
) -> Generator[Handle]:
    """Count each unit as done when the next one is asked for."""
    with closing(loading(units, work)) as handles:
        for handle in handles:
            size = handle.unit.stored
            yield handle
            # Frees the unit before the next one is made.
            del handle
            meter.add(size)


def _load_ahead(
    threads: Threads, window: int | None, units: Iterable[Unit], work: Callable[[RawMessage], Made]
) -> Generator[Handle]:
    """Load units ahead, on other threads."""
    waiting: deque[Unit] = deque()
    results: InOrder[Loaded[Any]] = InOrder(threads, AHEAD_BYTES, threads.jobs + 1, window)
    try:
        for unit in units:
            too_large = unit.size > LARGEST_AHEAD
            while waiting and (too_large or not _may_wait(unit, results, threads.jobs)):
                yield Handle(waiting.popleft(), results.take)
            if too_large:
                yield Handle(unit, partial(_load_together, threads, unit, work))
            else:
                load = partial(unit.load, work, whole=unit.may_be_whole)
                results.put(load, unit.size, at_its_turn=unit.is_quick)
                waiting.append(unit)
        while waiting:
            yield Handle(waiting.popleft(), results.take)
    finally:
        results.cancel()


def _may_wait(unit: Unit, results: InOrder[Loaded[Any]], jobs: int) -> bool:
    """Whether one more unit may be loaded ahead; of units that are already in memory, one per thread is enough."""
    return results.has_room(unit.size) and (len(results) < jobs or not unit.is_in_memory)


def _load_together(threads: Threads, unit: Unit, work: Callable[[RawMessage], Made]) -> Loaded[Made]:
    """Load a unit on this thread, and work on its messages on all threads."""
    found = unit.load(own_message, whole=unit.may_be_whole)
    if isinstance(found, StoredChunk):
        return found
    if isinstance(found, LazyItems):
        return found.map(work)
    tasks = [threads.submit(list[Any], map(work, piece)) for piece in _pieces(found)]
    return [item for task in tasks for item in task.result()]


def _pieces(messages: Iterable[RawMessage]) -> Iterator[list[RawMessage]]:
    piece: list[RawMessage] = []
    size = 0
    for message in messages:
        piece.append(message)
        size += len(message.data)
        if size >= _PIECE_BYTES:
            yield piece
            piece, size = [], 0
    if piece:
        yield piece
