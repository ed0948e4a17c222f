"""Takes a few messages of each topic, spread over a recording, without reading it once for each topic."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection, RawMessage

#: How often, for each sample, a stream may be opened only for the topics that lack it.
_NARROWED = 4


def sampled(
    reader: Reader, topics: Mapping[str, Sequence[Connection]], samples: int, start_ns: int, end_ns: int
) -> Iterator[RawMessage]:
    """Yield samples of every topic: the first message at or after each of some times.

    Parameters
    ----------
    reader
        An open recording.
    topics
        The connections of each topic.
    samples
        Number of these times, evenly spread from ``start_ns`` on. No message is yielded twice.
    start_ns, end_ns
        Log times of the first and the last message.

    Yields
    ------
    RawMessage
        By log time. Those of one topic do not depend on the other topics.

    Notes
    -----
    The messages of all topics are read in one stream. When every topic has its sample of a time, a new stream is opened
    at the next time; if some topics still lack theirs, a new stream is opened for these only, so that chunks without
    them are not read. A new stream reads some data again, so the number of streams is bounded.
    """
    plan = _SamplingPlan(topics, samples, start_ns, end_ns)
    budget = reader.summary.size_bytes
    narrowed = 0
    position = start_ns
    while plan.unfinished:
        plan.wake(position)
        if not plan.awake:
            position = plan.next_due()
            plan.wake(position)
        group, stop = plan.due_from(position) if narrowed < _NARROWED * samples else (set(plan.unfinished), None)
        stream = reader.messages([c for name in group for c in topics[name]], position, stop)
        read, before, opened = 0, reader.bytes_read, -1
        for message in stream:
            # Some readers count from the beginning of each stream.
            before = min(before, reader.bytes_read)
            read = reader.bytes_read - before
            opened = read if opened < 0 else opened
            position = message.log_time_ns
            plan.wake(position)
            if plan.take(message):
                yield message
            if plan.waiting and plan.next_due() <= position + 1:
                # A new stream would begin with the next message, for the same topics: this one goes on.
                continue
            if not plan.awake and plan.waiting and (read != opened or read <= budget):
                position = plan.next_due()
                break
            if read != opened and len(plan.awake) < len(group) and narrowed < _NARROWED * samples:
                narrowed += 1
                break
        else:
            if stop is None:
                # These topics have no further messages.
                plan.end(group)
            else:
                position = stop
                narrowed += 1
        budget -= read


class _SamplingPlan:
    """The time from which on each topic takes its next sample.

    Attributes
    ----------
    unfinished
        The next time of each topic that has one.
    awake
        Topics that take their next message.
    waiting
        Topics that do so from a later time on, by that time.
    """

    def __init__(self, names: Iterable[str], samples: int, start_ns: int, end_ns: int) -> None:
        # Their times are computed as they are needed: there may be far more of them than messages.
        self._samples = samples
        self._start_ns, self._span_ns = start_ns, end_ns - start_ns
        self._step = dict.fromkeys(names, 0)
        self.unfinished = dict.fromkeys(self._step, start_ns)
        self.awake = set(self._step)
        self.waiting: list[tuple[int, str]] = []

    def next_due(self) -> int:
        """Return the first time at which a waiting topic is due."""
        return self.waiting[0][0]

    def wake(self, time_ns: int) -> None:
        """Wake the topics that waited for this time."""
        while self.waiting and self.waiting[0][0] <= time_ns:
            self.awake.add(heapq.heappop(self.waiting)[1])

    def due_from(self, time_ns: int) -> tuple[set[str], int | None]:
        """Return the topics that are due at a time, and when further ones are (None: never)."""
        # Topics with a message of exactly this time are due a nanosecond later.
        group = self.awake | {name for due, name in self.waiting if due <= time_ns + 1}
        return group, min((due for due, _ in self.waiting if due > time_ns + 1), default=None)

    def take(self, message: RawMessage) -> bool:
        """Whether a message is its topic's next sample."""
        name = message.connection.topic
        if name not in self.awake or message.log_time_ns < self.unfinished[name]:
            return False
        self.awake.discard(name)
        self._step[name] += 1
        if self._step[name] == self._samples:
            del self.unfinished[name]
            return True
        # A message is taken once, even if several times are before it.
        due = max(self._start_ns + self._span_ns * self._step[name] // self._samples, message.log_time_ns + 1)
        self.unfinished[name] = due
        heapq.heappush(self.waiting, (due, name))
        return True

    def end(self, names: set[str]) -> None:
        """Drop topics that have no further messages."""
        for name in names:
            self.unfinished.pop(name, None)
        self.awake -= names
        self.waiting = [entry for entry in self.waiting if entry[1] not in names]
        heapq.heapify(self.waiting)
