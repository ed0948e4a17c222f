"""Combines messages to scans in the stream of a conversion.

Messages are grouped in order, scans are made on any thread, and they are written in order. A scan has the log time of
the message that completed its group, which is when a node would have published it. A group that nothing completes has
that of the last message of its topics, whatever else was recorded later.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

from pc2scan.conversion.items import Item
from pc2scan.conversion.steps import as_it_is
from pc2scan.errors import MessageError
from pc2scan.model import StoredChunk
from pc2scan.threads import InOrder

from .conversion import Contribution

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable

    from pc2scan.conversion.plan import Output, Route
    from pc2scan.conversion.report import TopicReport
    from pc2scan.conversion.steps import ConvertedMessage
    from pc2scan.threads import Threads

    from .conversion import MessagesToScan
    from .grouping import Group, Grouper

#: Bytes that may wait for each thread to be written.
_AHEAD_BYTES = 6 << 20


#: What another thread may do, or the caller's: the function that makes an item, its size in bytes, and whether it takes
#: longer than handing it to another thread.
Work: TypeAlias = tuple[Callable[[], "Item | StoredChunk"], int, bool]

#: A message for a scan: its route, the output of the scan if this message leads it, itself, and the sequence number.
Arrival: TypeAlias = tuple["Route", "Output", Contribution, int]


class Combiner:
    """Combines the messages of several topics to scans.

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

    def __init__(
        self, conversion: MessagesToScan, grouper: Grouper, last: Callable[[ConvertedMessage], ConvertedMessage]
    ) -> None:
        self.reports: dict[int, TopicReport] = {}
        self._conversion = conversion
        self._last = last
        self._grouper = grouper
        self._last_ns = 0

    def add(self, arrival: Arrival, log_time_ns: int) -> list[Work]:
        """Take a message, and return how the scans are made that are complete now."""
        self._last_ns, message = log_time_ns, arrival[2]
        groups = self._grouper.add(message.source, message.stamp_ns, log_time_ns, message.size, arrival)
        return list(map(self._work, groups))

    def finish(self) -> list[Work]:
        """Return how the scans are made that are still open, and add the counts to the report."""
        groups = self._grouper.finish()
        for number, entry in self.reports.items():
            entry.joined = self._grouper.counts[number]
            if number:
                entry.messages_out = entry.joined.used
        return list(map(self._work, groups))

    def alone(self, contribution: Contribution) -> ConvertedMessage:
        """Make the scan of one message alone, for dry runs."""
        return self._last(self._conversion.alone(contribution))

    def _work(self, group: Group) -> Work:
        # Points that are projected already are soon a scan.
        takes_long = any(member.item[2].nearest is None for member in group.members)
        size = sum(member.size for member in group.members)
        return partial(self._make, group, self._last_ns), size, takes_long

    def _make(self, group: Group, log_time_ns: int) -> Item:
        route, output, contribution, sequence = group.lead.item
        result: ConvertedMessage | MessageError
        try:
            result = self._last(self._conversion.scan(contribution, [member.item[2] for member in group.members]))
        except MessageError as err:
            result = err
            err.stamp_ns = err.stamp_ns or contribution.stamp_ns
        return Item(route, log_time_ns, log_time_ns, sequence, [(output, result)], is_group=True)


def add_groups(
    items: Generator[Item | StoredChunk], combiners: Iterable[Combiner], threads: Threads | None
) -> Generator[Item | StoredChunk]:
    """Add the scans of several messages to the items of single messages.

    Parameters
    ----------
    items
        Those of single messages, in the order of writing.
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
                done = work()
                # The next message is read into the buffer that this scan's points were in.
                del work
                yield done
        return
    # Of scans with very many points, only one may wait.
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
