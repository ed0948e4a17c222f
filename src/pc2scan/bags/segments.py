"""Messages in the order of time out of a file whose stretches overlap in time.

ROS 1 bags and MCAP files are runs of chunks. Each chunk is (nearly) sorted, but chunks overlap where the recorder
had several buffers. Sorting a whole index would need memory that grows with the recording; here a
segment is loaded when its first message is due and forgotten after its last.

A chunk that stands alone in time may be handed on as a whole: see `standing_alone`.
"""

from __future__ import annotations

import heapq
from bisect import bisect_left
from collections import deque
from dataclasses import dataclass
from functools import partial
from itertools import accumulate, zip_longest
from operator import attrgetter
from typing import TYPE_CHECKING

from pc2scan.errors import RecordingError

from .model import StoredChunk

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
    from concurrent.futures import Future
    from pathlib import Path

    from .model import ChunkRule, RawMessage, Work
    from .threads import Threads

    #: What a segment is loaded as: its messages, or the chunk as a whole.
    Loaded = list[RawMessage] | StoredChunk

    #: How it is loaded; the flag says whether it may be whole, the work is done with its messages otherwise.
    Load = Callable[["Segment", bool, Work | None], Loaded]

#: Loaded segments may take this much before the ones needed last are dropped and later read again.
MAX_OPEN_BYTES = 64 << 20

#: So many bytes are announced to the system before they are read: it reads them while others are decompressed.
_EXPECTED_BYTES = 32 << 20

#: Chunks follow each other at no larger distance: an index may lie between them.
_GAP_BYTES = 64 << 10

#: To wait for the interpreter's lock behind another thread takes longer than to read fewer uncompressed bytes.
_WORTH_A_THREAD = 1 << 20

#: So much is loaded before its turn for every thread, and one segment more than threads of those up to the second size.
AHEAD_BYTES = 12 << 20
LARGEST_AHEAD = 20 << 20

#: Segments may be read again until that comes to so many times the whole, and a gigabyte.
_MAX_AGAIN = 16

#: Chunks smaller than this, uncompressed, are not worth copying: their messages are gathered in larger ones.
MIN_WHOLE_BYTES = 256 << 10


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of a file that holds messages: a chunk, or a run of records outside any chunk.

    Attributes
    ----------
    offset, length
        The stored payload's place in the file, bytes.
    compression
        ``none``, ``bz2``, ``lz4`` or ``zstd``.
    uncompressed_size
        Bytes after decompression.
    crc
        CRC-32 of the uncompressed payload; 0 when there is none.
    start_ns, end_ns
        Log times of the earliest and the latest message, both inclusive.
    connection_ids
        The connections with messages in it; None when unknown (then it has to be read to find out).
    """

    offset: int
    length: int
    compression: str
    uncompressed_size: int
    crc: int
    start_ns: int
    end_ns: int
    connection_ids: frozenset[int] | None = None

    def may_hold(self, ids: frozenset[int] | None, start_ns: int | None, stop_ns: int | None) -> bool:
        """Whether a message of these connections and times can be in it (``ids`` None: any connection)."""
        return (
            (start_ns is None or self.end_ns >= start_ns)
            and (stop_ns is None or self.start_ns < stop_ns)
            and (ids is None or self.connection_ids is None or not self.connection_ids.isdisjoint(ids))
        )


def standing_alone(
    segments: Collection[Segment], rule: ChunkRule, start_ns: int | None, stop_ns: int | None
) -> frozenset[Segment]:
    """Find the chunks that can be handed on whole, by what is known of them without reading them.

    Parameters
    ----------
    segments
        All that are read.
    rule
        What the destination takes.
    start_ns, stop_ns
        The cut, ``start_ns <= log_time_ns < stop_ns``.

    Returns
    -------
    frozenset[Segment]
        Those of which everything is wanted, and between whose first and last message no other segment has any.
    """
    ordered = sorted(segments, key=attrgetter("start_ns", "offset"))
    alone = []
    latest = (-1, 0)
    for segment, following in zip_longest(ordered, ordered[1:]):
        if (
            latest < (segment.start_ns, segment.offset)
            and (following is None or segment.end_ns < following.start_ns)
            and segment.connection_ids is not None
            and segment.connection_ids <= rule.connection_ids
            and segment.uncompressed_size >= MIN_WHOLE_BYTES
            and (start_ns is None or start_ns <= segment.start_ns)
            and (stop_ns is None or segment.end_ns < stop_ns)
            and (rule.last_ns is None or segment.end_ns <= rule.last_ns)
        ):
            alone.append(segment)
        latest = max(latest, (segment.end_ns, segment.offset))
    return frozenset(alone)


def times_around(segments: Iterable[Segment]) -> Callable[[int, int], dict[str, int | None]]:
    """Tell the log times next to a place of the file.

    The function returned takes where a stretch of the file starts and stops, and returns ``first_ns``, the latest log
    time in front of it, and ``last_ns``, the earliest behind it; None where there are no messages. Segments
    without times (``end_ns`` 0) do not count.
    """
    timed = sorted((segment for segment in segments if segment.end_ns), key=attrgetter("offset"))
    offsets = [segment.offset for segment in timed]
    latest = list(accumulate((segment.end_ns for segment in timed), max))
    earliest = list(accumulate((segment.start_ns for segment in reversed(timed)), min))[::-1]

    def around(start: int, stop: int) -> dict[str, int | None]:
        before, behind = bisect_left(offsets, start), bisect_left(offsets, stop)
        return {
            "first_ns": latest[before - 1] if before else None,
            "last_ns": earliest[behind] if behind < len(earliest) else None,
        }

    return around


class _Open:
    """A segment on the heap, keyed by its next message's log time, then by its place in the file."""

    __slots__ = ("key", "messages", "position", "segment", "whole")

    def __init__(self, segment: Segment, loaded: Loaded) -> None:
        self.segment = segment
        self.position = 0
        self.messages: list[RawMessage] | None = None
        self.whole: StoredChunk | None = None
        if isinstance(loaded, StoredChunk):
            self.whole = loaded
            self.key = (loaded.span_ns()[0], segment.offset)
        else:
            self.messages = loaded
            self.key = (loaded[0].log_time_ns, segment.offset)

    def __lt__(self, other: _Open) -> bool:
        return self.key < other.key


def in_time_order(
    segments: Iterable[Segment],
    load: Load,
    *,
    alone: Collection[Segment] = frozenset(),
    max_open_bytes: int = MAX_OPEN_BYTES,
    pool: Threads | None = None,
    work: Work | None = None,
    expect: Callable[[int, int], None] | None = None,
    path: Path | None = None,
) -> Iterator[RawMessage | StoredChunk]:
    """Merge the messages of overlapping segments.

    Parameters
    ----------
    segments
        Any order; ``start_ns`` must not be later than a segment's first message.
    load
        Returns a segment's wanted messages in the order of the file, after the work on them if there is any, or, where
        the flag allows it, the whole chunk if that is sorted. Called once a segment, except that a segment is loaded
        again if more than ``max_open_bytes`` of segments overlap at one time, or if one of ``alone`` does not stand
        alone after all.
    alone
        Segments that may be whole; see `standing_alone`.
    max_open_bytes
        Bound on the payload of the segments held at one time (one is always held).
    pool
        Threads on which segments are loaded ahead of their turn; ``load`` must bear that. None loads each when it is
        due. The messages are the same.
    work
        Makes what takes the place of a message; it may do nothing. It is not done with segments too large to be loaded
        ahead, or that are loaded again.
    expect
        Is told what will be loaded soon, by offset and length.
    path
        The file, for the error.

    Yields
    ------
    RawMessage | StoredChunk
        By log time; equal log times in the order of the file. Whole chunks only if there are any ``alone``.

    Raises
    ------
    RecordingError
        If segments that overlap would have to be read again and again.
    """
    waiting = sorted(segments, key=attrgetter("start_ns", "offset"))

    def loaded(segment: Segment, work: Work | None = None, *, split: bool = False) -> Loaded:
        found = load(segment, not split and bool(alone) and segment in alone, work)
        if not isinstance(found, StoredChunk):
            # A stable sort, and next to free where the recorder kept the order.
            found.sort(key=attrgetter("log_time_ns"))
        return found

    worked = partial(loaded, work=work)
    due = waiting if expect is None else _expected(waiting, expect)
    arrivals = _Ahead(due, worked, loaded, pool) if pool is not None else map(worked, due)
    try:
        yield from _merged(waiting, iter(arrivals), partial(loaded, split=True), max_open_bytes, path)
    finally:
        if isinstance(arrivals, _Ahead):
            arrivals.cancel()


def _expected(segments: Sequence[Segment], expect: Callable[[int, int], None]) -> Iterator[Segment]:
    """The segments, each announced some way ahead of its turn: several at a time, where they follow each other."""
    coming = iter(segments)
    announced = 0
    for segment in segments:
        stretches: list[tuple[int, int]] = []
        # Seldom: every call gives others the interpreter's lock.
        wanted = _EXPECTED_BYTES if announced <= _EXPECTED_BYTES // 2 else 0
        while announced < wanted and (following := next(coming, None)) is not None:
            start, stop = following.offset, following.offset + following.length
            if stretches and 0 <= start - stretches[-1][1] <= _GAP_BYTES:
                start = stretches.pop()[0]
            stretches.append((start, stop))
            announced += following.length
        for start, stop in stretches:
            expect(start, stop - start)
        announced -= segment.length
        yield segment


class _Ahead:
    """Segments loaded on other threads before their turn, in the order given, within the bounds of the pool."""

    def __init__(
        self,
        segments: Iterable[Segment],
        ahead: Callable[[Segment], Loaded],
        load: Callable[[Segment], Loaded],
        pool: Threads,
    ) -> None:
        self._segments = segments
        self._ahead = ahead
        self._load = load
        self._pool = pool
        #: With what is loaded when it is due.
        self._pending: deque[tuple[Segment, Future[Loaded] | None]] = deque()

    def __iter__(self) -> Iterator[Loaded]:
        held = 0
        for segment in self._segments:
            size = segment.uncompressed_size
            too_large = size > LARGEST_AHEAD
            while self._pending and (too_large or not self._has_room(held + size)):
                held -= self._pending[0][0].uncompressed_size
                # Bound to no name: this frame must not keep it alive meanwhile.
                yield self._next()
            if too_large:
                yield self._load(segment)
                continue
            quick = segment.compression == "none" and size < _WORTH_A_THREAD
            self._pending.append((segment, None if quick else self._pool.submit(self._ahead, segment)))
            held += size
        while self._pending:
            yield self._next()

    def _has_room(self, size: int) -> bool:
        """Whether one more may be pending, with so many bytes in all; there has to be one when a thread is done."""
        bound = self._pool.ahead if size <= self._pool.jobs * AHEAD_BYTES else self._pool.jobs + 1
        return len(self._pending) < bound

    def _next(self) -> Loaded:
        segment, future = self._pending.popleft()
        return self._ahead(segment) if future is None else future.result()

    def cancel(self) -> None:
        """Give up what has not begun."""
        for _, future in self._pending:
            if future is not None:
                future.cancel()


def _merged(
    waiting: Sequence[Segment],
    arrivals: Iterator[Loaded],
    split: Callable[[Segment], Loaded],
    max_open_bytes: int,
    path: Path | None,
) -> Iterator[RawMessage | StoredChunk]:
    """Merge segments, loaded in the same order; ``split`` is for those whose messages are not (or no longer) there."""
    heap: list[_Open] = []
    due = 0
    again = _MAX_AGAIN * sum(segment.uncompressed_size for segment in waiting) + (1 << 30)
    while heap or due < len(waiting):
        while due < len(waiting) and (not heap or waiting[due].start_ns <= heap[0].key[0]):
            segment = waiting[due]
            due += 1
            # Room is made before it is needed.
            _evict(heap, max_open_bytes - segment.uncompressed_size)
            found = next(arrivals)
            if found:
                heapq.heappush(heap, _Open(segment, found))
                _evict(heap, max_open_bytes)
            del found
        if not heap:
            continue
        current = heapq.heappop(heap)
        offset = current.segment.offset
        # Everything up to the next segment's turn comes from this one: no heap operation a message.
        limit = heap[0].key if heap else None
        if due < len(waiting):
            arrival = (waiting[due].start_ns, -1)
            limit = arrival if limit is None or arrival < limit else limit
        if current.whole is not None and (limit is None or (current.whole.span_ns()[1], offset) < limit):
            yield current.whole
            del current
            continue
        if current.messages is None:
            again -= current.segment.uncompressed_size
            if again < 0:
                raise RecordingError(
                    f"its chunks overlap in time so much that each would have to be read {_MAX_AGAIN} times", path=path
                )
            _evict(heap, max_open_bytes - current.segment.uncompressed_size)
            found = split(current.segment)
            assert not isinstance(found, StoredChunk)
            current.messages, current.whole = found, None
            del found
        messages, position = current.messages, current.position
        while position < len(messages) and (limit is None or (messages[position].log_time_ns, offset) < limit):
            yield messages[position]
            position += 1
        if position < len(messages):
            current.position = position
            current.key = (messages[position].log_time_ns, offset)
            heapq.heappush(heap, current)
            _evict(heap, max_open_bytes)
        # The generator's frame must not keep a spent or dropped segment alive while the next one is loaded.
        del messages, current


def _evict(heap: list[_Open], max_open_bytes: int) -> None:
    """Drop the payload of the segments that are needed last, until the rest fits."""
    if len(heap) <= 1:
        return
    held = sorted((entry for entry in heap if entry.messages is not None), reverse=True)
    total = sum(entry.segment.uncompressed_size for entry in held)
    for entry in held[:-1]:
        if total <= max_open_bytes:
            return
        entry.messages = None
        total -= entry.segment.uncompressed_size
