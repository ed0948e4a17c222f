"""The engine of every conversion: reads messages, converts them on several threads, and yields the items in order.

Recordings, Python's scans and clouds, exports, maps and dry runs read the same items. Each decides which step is the
last on a thread, and what becomes of the items.
"""

from __future__ import annotations

from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast

from pc2scan.bags.topics import NewestItems, is_static
from pc2scan.bags.units import Unit
from pc2scan.errors import DecodeError, MessageError
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms
from pc2scan.model import RawMessage, StoredChunk, own_data, own_message

from .conversion import ConvertedMessage
from .first_clouds import Candidate
from .items import Item
from .scheduler import schedule

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Hashable, Iterable, Iterator, Mapping, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.model import ChunkRule
    from pc2scan.threads import Threads

    from .combine.combiner import Combiner
    from .items import OpenRoute, Output, Span

    #: Called regularly with the bytes read so far, the bytes in all, and the messages read so far.
    Progress: TypeAlias = Callable[[int, int, int], None]

#: How many messages are between two calls of the progress function.
_PROGRESS_EVERY = 64


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
    progress: Progress | None = None,
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
    progress
        Called at the beginning, regularly, and at the end.

    Yields
    ------
    Item | StoredChunk
        By log time. A group follows the item of the message that completes it.
    """
    items = _messages(reader, routes, span, threads, rule, window, progress)
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
    progress: Progress | None,
) -> Generator[Item | StoredChunk]:
    """Yield the items of the messages in the cut, after those of latched messages from before it."""
    work, total = partial(_work, routes), reader.summary.size_bytes
    messages = steps = 0
    if progress is not None:
        progress(0, total, 0)
    for units in _units_of_cut(reader, routes, span, rule, threads):
        # Closed before the threads are joined, so that work that has not begun is cancelled after an error.
        with closing(schedule(units, work, threads, window=window, path=reader.path)) as items:
            for item in items:
                if progress is not None:
                    if isinstance(item, StoredChunk):
                        messages += sum(map(len, item.index.values()))
                        steps += _PROGRESS_EVERY
                    else:
                        messages += 1
                        steps += 1
                yield item.work(item.message) if isinstance(item, DeferredMessage) else item
                # Frees the item before the next one is made.
                del item
                if progress is not None and steps >= _PROGRESS_EVERY:
                    steps = 0
                    progress(min(reader.bytes_read, total), total, messages)
    if progress is not None:
        progress(total, total, messages)


def _units_of_cut(
    reader: Reader, routes: Mapping[int, OpenRoute], span: Span, rule: ChunkRule | None, threads: Threads | None
) -> Iterator[Iterable[Unit]]:
    """Yield the unit with what is latched at the beginning of the cut, then the units of the cut."""
    wanted = [route.connection for route in routes.values()]
    start, stop = span.start_ns, span.stop_ns
    lasting = [route.connection for route in routes.values() if route.lasts]
    if start is not None and lasting:
        with closing(schedule(reader.units(lasting, None, start), own_message, threads, path=reader.path)) as earlier:
            # No rule allows whole chunks here.
            yield [latched_at(cast("Iterator[RawMessage]", earlier), start)]
    yield reader.units(wanted, start, stop, rule)


def _work(routes: Mapping[int, OpenRoute], message: RawMessage, *, is_due: bool = False) -> Item | DeferredMessage:
    """Convert or re-encode a message; postpone it if the result takes more memory, and is not due. On any thread."""
    route = routes[message.connection.id]
    if route.convert is not None and len(message.data) < route.shrinks_from and not is_due:
        return DeferredMessage(own_message(message), partial(_work, routes, is_due=True))
    results: Sequence[tuple[Output, Any]] = ()
    passing = error = None
    try:
        if route.passing_handle >= 0:
            passing = own_data(message.data) if route.encode is None else route.encode(message.data)
        if route.convert is not None:
            made = route.convert(message.data)
            for result in made:
                if isinstance(result, ConvertedMessage) and isinstance(result.sample, Candidate):
                    result.sample = result.sample.sample(message.log_time_ns)
            results = [(output, made[output.place]) for output in route.outputs]
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
        # A view would keep a whole chunk in memory.
        newest.add(_names(message), message._replace(data=bytes(message.data)))
    found = [message._replace(log_time_ns=start_ns, publish_time_ns=start_ns) for message in newest]

    def load(callback: Callable[[RawMessage], Any], *, whole: bool) -> list[Any]:  # noqa: ARG001  # no chunk
        return [callback(message) for message in found]

    size = sum(message.size for message in found)
    return Unit(start_ns, (), size, load, is_quick=True, is_in_memory=True)


def _names(message: RawMessage) -> Collection[Hashable]:
    """Return the keys that a message supersedes in earlier ones."""
    connection = message.connection
    if not is_static(connection.topic):
        return [connection.id]
    try:
        if connection.ros_type in TF_TYPES:
            return {(connection.id, row[1]) for row in decode_transforms(message.data, connection.serialization)}
    except DecodeError:
        pass
    return [(connection.id, bytes(message.data))]
