"""Combines messages to scans in the stream of a conversion.

Messages are grouped in order, scans are made on any thread, and they are written in order. A scan has the log time of
the message that completed its group, which is when a node would have published it. A group that nothing completes has
that of the last message of its topics, whatever else was recorded later.
"""

from __future__ import annotations

from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.conversion.items import Item
from pc2scan.errors import MessageError
from pc2scan.model import StoredChunk
from pc2scan.threads import InOrder

from .conversion import Contribution

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable

    from pc2scan.conversion.plan import Output, Route
    from pc2scan.conversion.report import TopicReport
    from pc2scan.conversion.steps import ConvertedMessage
    from pc2scan.threads import Threads

    from .conversion import MessagesToScan
    from .grouping import Group
    from .rules import SourceMessage

#: Bytes that may wait for each thread to be written.
_AHEAD_BYTES = 6 << 20


class Arrival(NamedTuple):
    """A message for a scan: its route, the output of the scan if this message leads it, and the sequence number."""

    route: Route
    output: Output
    contribution: Contribution
    sequence: int


class Combiner:
    """Combines the messages of several topics to scans.

    Parameters
    ----------
    conversion
        The conversion of the messages.
    last
        The consumer's last step with each scan.

    Attributes
    ----------
    reports
        The report's entry of each topic, by the topic's number. All publishers of a topic share one.
    """

    def __init__(self, conversion: MessagesToScan, last: Callable[[ConvertedMessage], ConvertedMessage]) -> None:
        if conversion.grouper is None:
            raise ValueError("each message is a scan by itself")
        self.reports: dict[int, TopicReport] = {}
        self._conversion = conversion
        self._last = last
        self._grouper = conversion.grouper()

    def add(self, arrival: Arrival, log_time_ns: int) -> list[Group]:
        """Take a message, and return the groups that are complete now."""
        contribution = arrival.contribution
        return self._grouper.add(contribution.source, contribution.stamp_ns, log_time_ns, contribution.size, arrival)

    def finish(self) -> list[Group]:
        """Return the groups that are still open, and add the counts to the report."""
        groups = self._grouper.finish()
        for number, entry in self.reports.items():
            entry.joined = self._grouper.counts[number]
            if number:
                entry.messages_out = entry.joined.used
        return groups

    def make(self, group: Group, log_time_ns: int) -> Item:
        """Make the scan of a group; runs on any thread."""
        lead: SourceMessage = group.lead
        route, output, contribution, sequence = lead.item
        result: ConvertedMessage | MessageError
        try:
            members = [member.item.contribution for member in group.members]
            result = self._last(self._conversion.scan(contribution, members))
        except MessageError as err:
            result = err
            err.stamp_ns = err.stamp_ns or contribution.stamp_ns
        return Item(route, log_time_ns, log_time_ns, sequence, [(output, result)], is_group=True)

    def is_quick(self, group: Group) -> bool:
        """Whether making a scan takes less time than handing it to another thread: all points are projected already."""
        return all(member.item.contribution.nearest is not None for member in group.members)

    def alone(self, contribution: Contribution) -> ConvertedMessage:
        """Make the scan of one message alone, for dry runs."""
        return self._last(self._conversion.alone(contribution))


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


def _work(
    items: Iterable[Item | StoredChunk], combiners: Iterable[Combiner]
) -> Generator[tuple[Callable[[], Item | StoredChunk], int, bool]]:
    """Yield the work in order, its size in bytes, and whether another thread should do it."""
    last_ns = dict.fromkeys(combiners, 0)
    for item in items:
        arrivals: list[tuple[Combiner, Arrival]] = []
        if isinstance(item, StoredChunk):
            log_time_ns, size = 0, len(item.stored)
        else:
            log_time_ns, size, arrivals = item.log_time_ns, item.size, _arrivals(item)
        yield partial(_same, item), size, False
        del item
        for combiner, arrival in arrivals:
            last_ns[combiner] = log_time_ns
            for group in combiner.add(arrival, log_time_ns):
                yield partial(combiner.make, group, log_time_ns), _size(group), not combiner.is_quick(group)
                # This frame must not hold the points in memory while the next message is read.
                del group
    for combiner, log_time_ns in last_ns.items():
        for group in combiner.finish():
            yield partial(combiner.make, group, log_time_ns), _size(group), not combiner.is_quick(group)


def _arrivals(item: Item) -> list[tuple[Combiner, Arrival]]:
    """Return the parts of a message in scans of several."""
    return [
        (output.combiner, Arrival(item.route, output, result, item.sequence))
        for output, result in item.results
        if output.combiner is not None and isinstance(result, Contribution)
    ]


def _same(item: Item | StoredChunk) -> Item | StoredChunk:
    return item


def _size(group: Group) -> int:
    return sum(member.size for member in group.members)
