"""Takes a few messages of each topic, spread over a recording."""

from __future__ import annotations

import heapq
from collections import deque
from operator import attrgetter
from typing import TYPE_CHECKING

from pc2scan.bags.observers import Observer, Spread, observing
from pc2scan.model import RawMessage, copied_message

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection


def sampled(
    reader: Reader, topics: Mapping[str, Sequence[Connection]], samples: int, start_ns: int, stop_ns: int
) -> Iterator[RawMessage]:
    """Yield samples of every topic, as they are read: the first message of each of some equal parts of a time.

    Parameters
    ----------
    reader
        An open recording.
    topics
        The connections of each topic.
    samples
        The number of parts. If a topic has no more messages, all of them are samples.
    start_ns, stop_ns
        The time: ``start_ns <= log_time_ns < stop_ns``.

    Yields
    ------
    RawMessage
        By log time. Those of one topic do not depend on the other topics.
    """
    # A recording with chunks is read once; of one with rows, each topic is read by itself.
    together = [list(topics.values())] if reader.has_chunks else [[own] for own in topics.values()]
    found = [_sampled_together(reader, each, samples, start_ns, stop_ns) for each in together]
    # Merging keeps two messages of each.
    return found[0] if len(found) == 1 else heapq.merge(*found, key=attrgetter("log_time_ns"))


def _sampled_together(
    reader: Reader, topics: Sequence[Sequence[Connection]], samples: int, start_ns: int, stop_ns: int
) -> Iterator[RawMessage]:
    found: deque[RawMessage] = deque()
    observers = [
        Observer(
            own,
            copied_message,
            start_ns=start_ns,
            stop_ns=stop_ns,
            keep=found.append,
            spread=spread_over(own, samples, start_ns, stop_ns),
        )
        for own in topics
    ]
    for _ in observing(reader, observers):
        while found:
            yield found.popleft()


def spread_over(connections: Sequence[Connection], samples: int, start_ns: int, stop_ns: int) -> Spread | None:
    """Return the parts of a time for so many samples of connections; None if they have no more messages."""
    counts = [each.message_count for each in connections]
    messages = None if None in counts else sum(each or 0 for each in counts)
    return Spread.of(start_ns, stop_ns, samples, messages)
