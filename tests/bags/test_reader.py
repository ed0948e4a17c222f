"""Chunks: loaded ahead within bounds, merged in the order of time, dropped and loaded again where many overlap."""

from __future__ import annotations

import time
from contextlib import closing, nullcontext
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.bags.chunks import MIN_WHOLE_BYTES, Segment, Segments, segment_chunks, whole_chunks
from pc2scan.bags.reader import AHEAD_BYTES, LARGEST_AHEAD, Chunk, merge_by_time
from pc2scan.model import ChunkRule, Connection, RawMessage, StoredChunk
from pc2scan.threads import Threads

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from contextlib import AbstractContextManager

TOPIC = Connection(1, "/a", "a/msg/A", "cdr")


class Load:
    """A chunk in memory; counts how often it is loaded."""

    def __init__(self, number: int, times_ns: list[int], size: int = 1, *, whole: bool = False) -> None:
        self.number, self.times_ns, self.size, self.whole = number, times_ns, size, whole
        self.calls = 0

    def __call__(self, callback: Callable[[RawMessage], Any]) -> list[Any] | StoredChunk:
        self.calls += 1
        if self.whole:
            return StoredChunk("zstd", b"", self.number, 0, {1: [(time_ns, 0) for time_ns in self.times_ns]})
        data = bytes([self.number]) * self.size
        return [callback(RawMessage(TOPIC, time_ns, data, time_ns)) for time_ns in self.times_ns]


def chunk(number: int, times_ns: Iterable[int] = (), *, size: int = 1, quick: bool = False) -> Chunk:
    times = list(times_ns) or [10 * number]
    # Sizes of a chunk that are not those of its messages are declared.
    data = size // len(times) if size <= 1 << 26 else 1
    return Chunk(min(times), (number,), size, Load(number, times, data), is_quick=quick)


def found(items: Iterator[Any]) -> list[tuple[int, int]]:
    """Log times, and the chunk that each is of."""
    places: list[tuple[int, int]] = []
    for item in items:
        if isinstance(item, StoredChunk):
            places += ((time_ns, item.size) for time_ns, _ in item.index[1])
        else:
            places.append((item.log_time_ns, item.data[0]))
    return places


def threads_of(jobs: int | None) -> AbstractContextManager[Threads | None]:
    return nullcontext() if jobs is None else closing(Threads(jobs))


CHUNKS = st.lists(st.lists(st.integers(0, 60), min_size=1, max_size=4), min_size=1, max_size=8)


@given(CHUNKS, st.integers(1, 9), st.sampled_from([None, 1, 2]))
def test_the_order_is_that_of_a_stable_sort(times: list[list[int]], room: int, jobs: int | None) -> None:
    chunks = sorted((chunk(number, each, size=len(each)) for number, each in enumerate(times)), key=attrgetter("due"))
    expected = sorted((time_ns, number) for number, each in enumerate(times) for time_ns in each)
    with threads_of(jobs) as threads:
        assert found(merge_by_time(chunks, threads=threads, max_open_bytes=room)) == expected


@given(CHUNKS, st.lists(st.booleans(), min_size=8, max_size=8), st.integers(1, 9))
def test_an_index_finds_the_order_of_the_source_in_whole_chunks(
    chunks: list[list[int]], may: list[bool], room: int
) -> None:
    """A stable sort of what is written is one of what is read; outside of chunks it is written sorted."""
    segments = Segments()
    for number, (times, may_be_copied) in enumerate(zip(chunks, may, strict=False)):
        ids = frozenset({int(may_be_copied)})
        segments.append(Segment(number, 1, MIN_WHOLE_BYTES, min(times), max(times), connection_ids=ids))
    whole, due = whole_chunks(segments, ChunkRule("mcap", frozenset(), frozenset({1})), None, None)
    file: Any = None

    def load(segment: Segment, callback: Callable[[RawMessage], Any], *, whole: bool) -> list[Any] | StoredChunk:
        return Load(segment.offset, chunks[segment.offset], whole=whole)(callback)

    listed = [made._replace(size=1) for made in segment_chunks(segments, load, file, whole, due)]
    written = found(merge_by_time(listed, max_open_bytes=room))
    read = [(time_ns, number) for number, times in enumerate(chunks) for time_ns in times]
    assert sorted(written, key=itemgetter(0)) == sorted(read, key=itemgetter(0))
    copied = set(np.flatnonzero(whole).tolist())
    single = [time_ns for time_ns, number in written if number not in copied]
    assert single == sorted(single)


# --- Bounds ---


@pytest.mark.parametrize("jobs", [2, 4])
@pytest.mark.parametrize("size", [1 << 10, 5 << 20, LARGEST_AHEAD])
def test_what_is_loaded_ahead_is_bounded_and_enough(size: int, jobs: int) -> None:
    """However large chunks are, there is one for every thread, and one more for the first that is done."""
    chunks = [chunk(number)._replace(size=size) for number in range(40)]
    most = 0
    with closing(Threads(jobs)) as threads:
        for taken, _ in enumerate(merge_by_time(chunks, threads=threads), 1):
            time.sleep(0.001)
            most = max(most, sum(each.load.calls for each in chunks) - taken)  # type: ignore[attr-defined]
    # One more is loaded to know what is due first.
    assert jobs <= most <= max(min(threads.ahead, jobs * AHEAD_BYTES // size), jobs + 1) + 1


def test_compressed_messages_may_be_more_than_their_bytes() -> None:
    file: Any = object()
    many = chunk(0, range(5_000), size=5_000)._replace(file=file, length=1)
    assert len(found(merge_by_time([many]))) == 5_000


# --- Threads ---


@pytest.mark.parametrize("jobs", [None, 2])
def test_an_error_is_raised_in_its_turn(jobs: int | None) -> None:
    def work(message: RawMessage) -> RawMessage:
        if message.log_time_ns == 50:
            raise ValueError("five")
        return message

    with threads_of(jobs) as threads:
        items = merge_by_time(map(chunk, range(10)), work, threads)
        assert [next(items).log_time_ns for _ in range(5)] == [0, 10, 20, 30, 40]
        with pytest.raises(ValueError, match="five"):
            next(items)


def test_leaving_early_gives_up_what_has_not_begun() -> None:
    chunks = [chunk(number) for number in range(100)]
    with closing(Threads(1)) as threads:
        items = merge_by_time(chunks, threads=threads)
        next(items)
        items.close()
    assert sum(each.load.calls for each in chunks) < 6  # type: ignore[attr-defined]
