from __future__ import annotations

from dataclasses import replace
from threading import Lock, get_ident
from time import sleep
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.bags.model import ChunkRule, Connection, RawMessage, StoredChunk
from pc2scan.bags.segments import AHEAD_BYTES, LARGEST_AHEAD, MIN_WHOLE_BYTES, Segment, in_time_order, standing_alone
from pc2scan.bags.threads import Threads

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from pc2scan.bags.model import Work

RULE = ChunkRule("mcap", frozenset({"zstd"}), frozenset({1, 2}))
TOPIC = Connection(1, "/a", "a/msg/A", "cdr")


def segment(offset: int, start_ns: int, end_ns: int, ids: Iterable[int] = (1,), **changes: int) -> Segment:
    made = Segment(offset, 10, "zstd", MIN_WHOLE_BYTES, 0, start_ns, end_ns, frozenset(ids))
    return replace(made, **changes)  # type: ignore[arg-type]


def alone(*segments: Segment, start_ns: int | None = None, stop_ns: int | None = None) -> list[int]:
    return sorted(found.offset for found in standing_alone(segments, RULE, start_ns, stop_ns))


def test_of_no_chunks_none_stands_alone() -> None:
    assert alone() == []


def test_chunks_one_after_the_other_stand_alone() -> None:
    assert alone(segment(30, 1, 4), segment(10, 5, 8), segment(20, 9, 9)) == [10, 20, 30]


def test_chunks_that_overlap_do_not() -> None:
    assert alone(segment(1, 0, 9), segment(2, 3, 4), segment(3, 10, 11)) == [3]
    assert alone(segment(1, 0, 20), segment(2, 3, 4), segment(3, 10, 11), segment(4, 21, 22)) == [4]


def test_at_one_time_the_place_in_the_file_decides() -> None:
    assert alone(segment(1, 0, 5), segment(2, 5, 9)) == [2]
    assert alone(segment(2, 0, 5), segment(1, 5, 9)) == []


@pytest.mark.parametrize(
    "other",
    [
        segment(1, 0, 9, (1, 3)),
        segment(1, 0, 9, uncompressed_size=MIN_WHOLE_BYTES - 1),
        replace(segment(1, 0, 9), connection_ids=None),
    ],
    ids=["another connection", "too small", "unknown"],
)
def test_what_the_rule_does_not_allow_is_not_whole(other: Segment) -> None:
    assert alone(other, segment(2, 10, 11)) == [2]


def test_chunks_across_the_cut_are_not_whole() -> None:
    chunks = [segment(n, 10 * n, 10 * n + 9) for n in range(5)]
    assert alone(*chunks, start_ns=10, stop_ns=40) == [1, 2, 3]
    assert alone(*chunks, start_ns=11, stop_ns=39) == [2]


def places_of(item: RawMessage | StoredChunk) -> Iterator[tuple[int, int]]:
    """Log times, and the segment that each is of."""
    if isinstance(item, StoredChunk):
        yield from ((time_ns, item.size) for time_ns, _ in item.index[1])
    else:
        yield item.log_time_ns, item.data[0]


@given(
    st.lists(st.lists(st.integers(0, 60), min_size=1, max_size=4), min_size=1, max_size=8),
    st.lists(st.integers(0, 9), min_size=8, max_size=8),
)
def test_the_order_is_that_without_whole_chunks(chunks: list[list[int]], lies: list[int]) -> None:
    """Also where chunks do not say how late their last message is."""
    content = {10 * n: chunk for n, chunk in enumerate(chunks)}
    segments = [segment(at, min(c), max(c) - lie) for (at, c), lie in zip(content.items(), lies, strict=False)]

    def load(loaded: Segment, whole: bool, _: Work | None) -> list[RawMessage] | StoredChunk:
        times = content[loaded.offset]
        if whole and times == sorted(times):
            return StoredChunk("zstd", b"", loaded.offset, 0, {1: [(time_ns, 0) for time_ns in times]})
        return [RawMessage(TOPIC, time_ns, bytes([loaded.offset]), time_ns) for time_ns in times]

    whole = list(in_time_order(segments, load, alone=standing_alone(segments, RULE, None, None)))
    plain = list(in_time_order(segments, load))
    assert not any(isinstance(item, StoredChunk) for item in plain)
    assert [p for item in whole for p in places_of(item)] == [p for item in plain for p in places_of(item)]


@pytest.mark.parametrize("jobs", [None, 1, 2])
def test_work_is_given_to_whoever_loads(jobs: int | None) -> None:
    segments = [segment(n, 10 * n, 10 * n, uncompressed_size=n << 20) for n in range(24)]

    def load(loaded: Segment, _: bool, work: Work | None) -> list[RawMessage]:
        message = RawMessage(TOPIC, loaded.start_ns, b"data", 0)
        return [message if work is None else work(message)]

    def work(message: RawMessage) -> RawMessage:
        return message._replace(result="done")

    with Threads(jobs or 1) as pool:
        found = list(in_time_order(segments, load, pool=None if jobs is None else pool, work=work))
    messages = [item for item in found if isinstance(item, RawMessage)]
    assert [m.log_time_ns for m in messages] == [10 * n for n in range(24)]
    # What is too large to be loaded ahead is left to be worked on message by message, by all threads.
    large = 24 if jobs is None else LARGEST_AHEAD >> 20
    assert [m.result for m in messages] == ["done" if n <= large else None for n in range(24)]


@pytest.mark.parametrize("jobs", [2, 4])
@pytest.mark.parametrize("size", [1 << 10, 5 << 20, LARGEST_AHEAD])
def test_what_is_loaded_ahead_is_bounded_and_enough(size: int, jobs: int) -> None:
    """However large segments are, there is one for every thread, and one more for the first that is done."""
    segments = [segment(n, 10 * n, 10 * n, uncompressed_size=size) for n in range(40)]
    lock = Lock()
    loaded = taken = most = 0

    def load(due: Segment, _: bool, __: Work | None) -> list[RawMessage]:
        nonlocal loaded, most
        with lock:
            loaded += 1
            most = max(most, loaded - taken)
        return [RawMessage(TOPIC, due.start_ns, b"", 0)]

    with Threads(jobs) as pool:
        for _ in in_time_order(segments, load, pool=pool):
            sleep(0.001)
            with lock:
                taken += 1
    bound = max(min(pool.ahead, jobs * AHEAD_BYTES // size), jobs + 1)
    assert taken == 40
    # What the caller has in its hands counts too.
    assert jobs < most <= bound + 1


def test_what_will_be_loaded_is_announced_some_way_ahead() -> None:
    size = 10 << 20
    # Some other records in the middle.
    places = [n * size + (n >= 7) * (1 << 20) for n in range(12)]
    segments = [segment(at, 10 * n, 10 * n, length=size - 100) for n, at in enumerate(places)]
    told: list[tuple[int, int]] = []

    def load(loaded: Segment, _: bool, __: Work | None) -> list[RawMessage]:
        ends = [offset + length for offset, length in told]
        assert loaded.offset + loaded.length <= max(ends) <= loaded.offset + (53 << 20)
        return [RawMessage(TOPIC, loaded.start_ns, b"", 0)]

    assert len(list(in_time_order(segments, load, expect=lambda *stretch: told.append(stretch)))) == 12
    ends = [at + size - 100 for at in places]
    # Four bring it beyond 32 MiB, and when no more than half of that is left, the next ones follow.
    assert told == [
        (0, ends[3]),
        (places[4], ends[6] - places[4]),
        (places[7], ends[9] - places[7]),
        (places[10], ends[11] - places[10]),
    ]


def test_a_chunk_alone_is_handed_on_whole() -> None:
    chunk = StoredChunk("zstd", b"stored", 6, 0, {1: [(3, 0)]})
    segments = [segment(1, 0, 1), segment(2, 3, 3), segment(3, 5, 6)]

    def load(loaded: Segment, whole: bool, _: Work | None) -> list[RawMessage] | StoredChunk:
        assert whole is (loaded.offset == 2)
        return chunk if whole else [RawMessage(TOPIC, loaded.start_ns, b"", 0)]

    items = list(in_time_order(segments, load, alone=[segments[1]]))
    assert [item is chunk for item in items] == [False, True, False]


def test_small_uncompressed_segments_are_loaded_when_they_are_due() -> None:
    """Between large ones, which are loaded ahead all the same."""
    large = [segment(n, 10 * n, 10 * n, uncompressed_size=2 << 20) for n in range(0, 12, 2)]
    small = [replace(segment(n, 10 * n, 10 * n), compression="none") for n in range(1, 12, 2)]
    loaders: dict[int, int] = {}

    def load(loaded: Segment, _: bool, __: Work | None) -> list[RawMessage]:
        loaders[loaded.offset] = get_ident()
        return [RawMessage(TOPIC, loaded.start_ns, b"", 0)]

    with Threads(2) as pool:
        messages = list(in_time_order([*large, *small], load, pool=pool))
    assert [m.log_time_ns for m in messages if isinstance(m, RawMessage)] == [10 * n for n in range(12)]
    assert {s.offset for s in small} <= {n for n, thread in loaders.items() if thread == get_ident()}
