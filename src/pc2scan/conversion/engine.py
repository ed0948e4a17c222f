"""The engine of every conversion: reads messages, converts them on several threads, and yields the items in order.

Recordings, Python's scans and clouds, exports and maps read the same items. Each decides which step is the last on a
thread, and what becomes of the items.

A thread that loads a chunk also works on its messages before it returns the chunk. So a cloud of 4 MB is still in the
core's own cache, and the memory of a chunk is released as soon as its scans exist.
"""

from __future__ import annotations

from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Any

from pc2scan.bags.loading import Chunk, merge_by_time
from pc2scan.bags.reader import Wanted
from pc2scan.errors import DecodeError, MessageError
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms
from pc2scan.model import RawMessage, StoredChunk, copied_message, own_data

from .combine.combiner import add_groups
from .items import Item
from .steps import ConvertedMessage

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Hashable, Iterable, Iterator, Mapping, Sequence

    from pc2scan.advice.survey import Span
    from pc2scan.bags.reader import Reader
    from pc2scan.model import ChunkRule, Connection
    from pc2scan.progress import Meter
    from pc2scan.threads import Threads

    from .combine.conversion import Contribution
    from .plan import Route


def items_of(
    reader: Reader,
    routes: Mapping[int, Route],
    span: Span,
    threads: Threads | None,
    *,
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
    wanted = [route.connection for route in routes.values()]
    work = partial(convert, routes)

    def items() -> Generator[Item | StoredChunk]:
        if meter is not None:
            meter.expect(reader.stored_bytes(wanted, span.start_ns, span.stop_ns))
        for chunks in _chunks_of_cut(reader, wanted, span, rule, threads):
            # Closed before the threads are joined, so that work that has not begun is cancelled after an error.
            with closing(merge_by_time(chunks, work, threads, window=window, path=reader.path, meter=meter)) as loaded:
                for item in loaded:
                    if meter is not None:
                        meter.messages += sum(map(len, item.index.values())) if isinstance(item, StoredChunk) else 1
                    yield item
                    # Frees the item before the next one is made.
                    del item
        if meter is not None:
            meter.finish()

    combiners = {each.combiner: None for route in routes.values() for each in route.outputs if each.combiner}
    return add_groups(items(), combiners, threads) if combiners else items()


def _chunks_of_cut(
    reader: Reader, wanted: Sequence[Connection], span: Span, rule: ChunkRule | None, threads: Threads | None
) -> Iterator[Iterable[Chunk]]:
    """Yield the chunk with what is latched at the beginning of the cut, then the chunks of the cut."""
    start, stop = span.start_ns, span.stop_ns
    lasting = [connection for connection in wanted if connection.is_latched]
    if start is not None and lasting:
        with closing(reader.messages(lasting, None, start, threads)) as earlier:
            yield [latched_at(earlier, start)]
    yield reader.chunks(Wanted(wanted, start, stop, rule))


def convert(routes: Mapping[int, Route], message: RawMessage) -> Item:
    """Decode a message, and for each conversion of its route place its points, select some, and project them."""
    route = routes[message.connection.id]
    results: list[ConvertedMessage | Contribution | MessageError] = []
    passing = error = None
    try:
        if route.handle >= 0:
            passing = own_data(message.data) if route.reencode is None else route.reencode(message.data)
        decoded = route.decode(message.data) if route.steps else None
        done: dict[Any, Any] = {}
        for steps in route.steps:
            try:
                result = decoded
                # Equal steps of several conversions are done once.
                for number, step in enumerate(steps[:-1], 1):
                    begun = steps[:number]
                    result = done[begun] = done.get(begun) or step(result)
                result = steps[-1](result)
                results.append(route.finish(result) if isinstance(result, ConvertedMessage) else result)
            except MessageError as err:
                if len(route.steps) == 1:
                    raise
                # The error of one does not stop the others.
                results.append(err)
    except MessageError as err:
        error = err
        results = [err] * len(route.steps)
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
        Those of latched connections from before the cut, in their order.
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
    try:
        if connection.ros_type in TF_TYPES:
            return {(connection.id, row[1]) for row in decode_transforms(message.data, connection.serialization)}
    except DecodeError:
        pass
    return [(connection.id, bytes(message.data))]
