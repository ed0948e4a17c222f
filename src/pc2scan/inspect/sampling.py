"""Takes a few messages of each topic, spread over a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.bags.observers import Observer, Spread, observe
from pc2scan.model import RawMessage, copied_message

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection


def sampled(
    reader: Reader, topics: Mapping[str, Sequence[Connection]], samples: int, start_ns: int, stop_ns: int
) -> Iterator[RawMessage]:
    """Yield samples of every topic: the first message of each of some equal parts of a time.

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
    found: list[RawMessage] = []
    observe(
        reader,
        [
            Observer(
                own,
                copied_message,
                start_ns=start_ns,
                stop_ns=stop_ns,
                keep=found.append,
                spread=spread_over(own, samples, start_ns, stop_ns),
            )
            for own in topics.values()
        ],
    )
    # Not all of them stay in memory until the last one is used.
    found.sort(key=lambda message: message.log_time_ns, reverse=True)
    while found:
        yield found.pop()


def spread_over(connections: Sequence[Connection], samples: int, start_ns: int, stop_ns: int) -> Spread | None:
    """Return the parts of a time for so many samples of connections; None if they have no more messages."""
    counts = [each.message_count for each in connections]
    messages = None if None in counts else sum(each or 0 for each in counts)
    return Spread.of(start_ns, stop_ns, samples, messages)
