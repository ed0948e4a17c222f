"""Combines messages to scans in the stream of a conversion.

Messages are grouped in order, scans are made on any thread, and they are written in order. A scan has the log time of
the message that completed its group, which is when a node would have published it. So log times in the destination are
sorted as they are without such scans.
"""

from __future__ import annotations

from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from pc2scan.errors import MessageError
from pc2scan.threads import InOrder

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable

    from pc2scan.pipeline.conversion import EncodedMessage
    from pc2scan.pipeline.topic_report import TopicReport
    from pc2scan.threads import Threads

    from .conversion import Contribution, MessagesToScan
    from .grouping import Group
    from .rules import SourceMessage

Outcome = TypeVar("Outcome")

#: Bytes that may wait for each thread to be written.
_AHEAD_BYTES = 6 << 20


class Arrival(NamedTuple):
    """A message for a scan, the output of the scan if this message leads it, and the sequence number."""

    combiner: Combiner
    output: Any
    contribution: Contribution
    sequence: int


class CombinedScan(NamedTuple):
    """A scan to be written, or the error in its place; ``output`` is that of the leading message."""

    output: Any
    log_time_ns: int
    stamp_ns: int
    sequence: int
    made: EncodedMessage | MessageError


class Combiner:
    """Combines the messages of several topics to scans.

    Parameters
    ----------
    conversion
        The conversion of the messages.
    serialization
        The serialisation of the scans: ``ros1`` or ``cdr``.

    Attributes
    ----------
    reports
        The report's entry of each topic, by the topic's number. All publishers of a topic share one.
    """

    def __init__(self, conversion: MessagesToScan, serialization: str) -> None:
        if conversion.grouper is None:
            raise ValueError("each message is a scan by itself")
        self.reports: dict[int, TopicReport] = {}
        self._conversion = conversion
        self._serialization = serialization
        self._grouper = conversion.grouper()

    def add(self, arrival: Arrival, log_time_ns: int) -> list[Group[Any]]:
        """Take a message, and return the groups that are complete now."""
        contribution = arrival.contribution
        return self._grouper.add(contribution.source, contribution.stamp_ns, log_time_ns, contribution.size, arrival)  # type: ignore[arg-type]

    def finish(self) -> list[Group[Any]]:
        """Return the groups that are still open, and add the counts to the report."""
        groups: list[Group[Any]] = self._grouper.finish()
        for number, entry in self.reports.items():
            entry.joined = self._grouper.counts[number]
            if number:
                entry.messages_out = entry.joined.used
        return groups

    def make(self, group: Group[Arrival], log_time_ns: int) -> CombinedScan:
        """Make the scan of a group; runs on any thread."""
        lead: SourceMessage[Arrival] = group.lead
        output, contribution, sequence = lead.item.output, lead.item.contribution, lead.item.sequence
        made: EncodedMessage | MessageError
        try:
            members = [member.item.contribution for member in group.members]
            made = self._conversion.encode_scan(contribution, members, self._serialization)
        except MessageError as err:
            made = err
        return CombinedScan(output, log_time_ns, contribution.stamp_ns, sequence, made)

    def is_quick(self, group: Group[Arrival]) -> bool:
        """Whether making a scan takes less time than handing it to another thread."""
        return self._conversion.is_projected(
            group.lead.item.contribution, [each.item.contribution for each in group.members]
        )

    def alone(self, contribution: Contribution) -> EncodedMessage:
        """Make the scan of one message alone, for forecasts."""
        return self._conversion.encode_scan(contribution, (contribution,), self._serialization)


def add_scans(
    outcomes: Generator[Outcome],
    arrivals: Callable[[Outcome], tuple[int, int, Iterable[Arrival]]],
    combiners: Iterable[Combiner],
    threads: Threads | None,
) -> Generator[Outcome | CombinedScan]:
    """Add the scans of several messages to the results of single messages.

    Parameters
    ----------
    outcomes
        The results of single messages, in the order of writing.
    arrivals
        Returns the log time of an outcome, its size in bytes, and the messages that it has for scans.
    combiners
        All combiners of the conversion.
    threads
        The threads that make the scans, or None for the caller's alone. The scans do not depend on it.

    Yields
    ------
    Outcome | CombinedScan
        Each scan follows the outcome that completes it.
    """
    if threads is None:
        with closing(outcomes):
            for work, _, _ in _work(outcomes, arrivals, combiners):
                done = work()
                # The next message is read into the buffer that this scan's points were in.
                del work
                yield done
        return
    # Of scans with very many points, only one may wait.
    queue: InOrder[Any] = InOrder(threads, _AHEAD_BYTES, 1)
    try:
        for work, size, takes_long in _work(outcomes, arrivals, combiners):
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
        outcomes.close()


def _work(
    outcomes: Iterable[Outcome],
    arrivals: Callable[[Outcome], tuple[int, int, Iterable[Arrival]]],
    combiners: Iterable[Combiner],
) -> Generator[tuple[Callable[[], Outcome | CombinedScan], int, bool]]:
    """Yield the work in order, its size in bytes, and whether another thread should do it."""
    latest_ns = 0
    for outcome in outcomes:
        log_time_ns, size, found = arrivals(outcome)
        latest_ns = max(latest_ns, log_time_ns)
        arrival = list(found)
        yield partial(_same, outcome), size, False
        del outcome
        for each in arrival:
            for group in each.combiner.add(each, log_time_ns):
                yield partial(each.combiner.make, group, log_time_ns), _size(group), not each.combiner.is_quick(group)
                # This frame must not hold the points in memory while the next message is read.
                del group
    for combiner in combiners:
        for group in combiner.finish():
            yield partial(combiner.make, group, latest_ns), _size(group), not combiner.is_quick(group)


def _same(outcome: Outcome) -> Outcome:
    return outcome


def _size(group: Group[Arrival]) -> int:
    return sum(member.size for member in group.members)
