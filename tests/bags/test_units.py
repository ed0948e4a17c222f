from __future__ import annotations

from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.bags.chunks import MIN_WHOLE_BYTES, Segment, Segments, segment_units, whole_chunks
from pc2scan.bags.units import Extent, Unit, merge_by_time
from pc2scan.errors import RecordingError
from pc2scan.model import ChunkRule, Connection, RawMessage, StoredChunk

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

TOPIC = Connection(1, "/a", "a/msg/A", "cdr")


class Load:
    """A chunk in memory; counts how often it is loaded."""

    def __init__(self, number: int, times_ns: list[int]) -> None:
        self.number = number
        self.times_ns = times_ns
        self.calls: list[bool] = []

    def __call__(self, callback: Callable[[RawMessage], Any], *, whole: bool) -> list[Any] | StoredChunk:
        self.calls.append(whole)
        if whole:
            return StoredChunk("zstd", b"", self.number, 0, {1: [(time_ns, 0) for time_ns in self.times_ns]})
        return [callback(RawMessage(TOPIC, time_ns, bytes([self.number]), time_ns)) for time_ns in self.times_ns]


def unit(number: int, times_ns: list[int], *, size: int = 1, whole: bool = False) -> Unit:
    return Unit(min(times_ns), (number,), size, Load(number, times_ns), may_be_whole=whole)


def calls(unit: Unit) -> list[bool]:
    assert isinstance(unit.load, Load)
    return unit.load.calls


def found(items: Iterator[Any]) -> list[tuple[int, int]]:
    """Log times, and the unit that each is of."""
    places: list[tuple[int, int]] = []
    for item in items:
        if isinstance(item, StoredChunk):
            places += ((time_ns, item.size) for time_ns, _ in item.index[1])
        else:
            places.append((item.log_time_ns, item.data[0]))
    return places


CHUNKS = st.lists(st.lists(st.integers(0, 60), min_size=1, max_size=4), min_size=1, max_size=8)


@given(CHUNKS, st.integers(1, 9))
def test_the_order_is_that_of_a_stable_sort(chunks: list[list[int]], room: int) -> None:
    units = sorted((unit(number, times) for number, times in enumerate(chunks)), key=attrgetter("due"))
    expected = sorted(((time, number) for number, times in enumerate(chunks) for time in times))
    assert found(merge_by_time(units, max_open_bytes=room)) == expected


@given(CHUNKS, st.lists(st.booleans(), min_size=8, max_size=8), st.integers(1, 9))
def test_an_index_finds_the_order_of_the_source_in_whole_chunks(
    chunks: list[list[int]], may: list[bool], room: int
) -> None:
    """A stable sort of what is written is one of what is read; outside of chunks it is written sorted."""
    segments = Segments(
        Segment(number, 1, MIN_WHOLE_BYTES, min(times), max(times), connection_ids=frozenset({int(copied)}))
        for number, (times, copied) in enumerate(zip(chunks, may, strict=False))
    )
    whole, due = whole_chunks(segments, ChunkRule("mcap", frozenset(), frozenset({1})), None, None)
    file: Any = None

    def load(segment: Segment, callback: Callable[[RawMessage], Any], *, whole: bool) -> list[Any] | StoredChunk:
        return Load(segment.offset, chunks[segment.offset])(callback, whole=whole)

    units = [made._replace(extent=None, size=1) for made in segment_units(segments, load, file, whole, due)]
    written = found(merge_by_time(units, max_open_bytes=room))
    read = [(time, number) for number, times in enumerate(chunks) for time in times]
    assert sorted(written, key=itemgetter(0)) == sorted(read, key=itemgetter(0))
    copied = set(np.flatnonzero(whole).tolist())
    single = [time for time, number in written if number not in copied]
    assert single == sorted(single)


def test_a_chunk_alone_is_handed_on_whole() -> None:
    units = [unit(1, [0, 1]), unit(2, [3], whole=True), unit(3, [5, 6])]
    items = list(merge_by_time(units))
    assert [isinstance(item, StoredChunk) for item in items] == [False, False, True, False, False]
    assert [calls(made) for made in units] == [[False], [True], [False]]


def test_units_are_made_when_they_are_needed() -> None:
    made: list[int] = []

    def units() -> Iterator[Unit]:
        for number in range(9):
            made.append(number)
            yield unit(number, [10 * number])

    items = merge_by_time(units())
    next(items)
    # The next unit bounds the messages of the first one, and one more waits to be announced.
    assert len(made) <= 3
    assert len(list(items)) == 8


def test_a_unit_that_declares_too_much_drives_no_other_out() -> None:
    """One damaged chunk made every message load a chunk again."""
    liar = unit(0, [0, 50, 100], size=1 << 60)
    units = [liar, *(unit(number, [number, 100 + number]) for number in range(1, 9))]
    assert len(list(merge_by_time(units, max_open_bytes=20_000))) == 3 + 16
    assert [len(calls(made)) for made in units] == [1] * 9


def test_what_would_be_loaded_again_and_again_is_refused() -> None:
    def overlapping(count: int) -> list[Unit]:
        return [unit(number, list(range(number, 2 * count, 2)), size=1 << 26) for number in range(2)]

    # A gigabyte, and four times their size: one of them may be loaded 24 times more.
    assert len(list(merge_by_time(overlapping(25), max_open_bytes=1))) == 50
    with pytest.raises(RecordingError, match="overlap in time"):
        list(merge_by_time(overlapping(26), max_open_bytes=1))


class File:
    """Notes what is announced."""

    def __init__(self) -> None:
        self.announced: list[tuple[int, int]] = []

    def expect(self, offset: int, length: int) -> None:
        self.announced.append((offset, length))


def test_what_will_be_loaded_is_announced_some_way_ahead() -> None:
    size = 10 << 20
    file: Any = File()
    # Some other records in the middle.
    places = [n * size + (n >= 7) * (1 << 20) for n in range(12)]

    def load(at: int) -> Callable[..., list[Any]]:
        def loading(callback: Callable[[RawMessage], Any], *, whole: bool) -> list[Any]:
            assert not whole
            announced = max(offset + length for offset, length in file.announced)
            assert at + size - 100 <= announced <= at + (53 << 20)
            return [callback(RawMessage(TOPIC, at, b"", 0))]

        return loading

    units = [Unit(at, (at,), size, load(at), extent=Extent(file, at, size - 100)) for at in places]
    assert len(list(merge_by_time(units))) == 12
    ends = [at + size - 100 for at in places]
    # Four bring it beyond 32 MiB, and when no more than half of that is left, the next ones follow.
    assert file.announced == [
        (0, ends[3]),
        (places[4], ends[6] - places[4]),
        (places[7], ends[9] - places[7]),
        (places[10], ends[11] - places[10]),
    ]


def test_few_units_are_listed_ahead() -> None:
    # Chunks of a hundred bytes, of which there may be a million.
    file: Any = File()
    listed: list[int] = []

    def units() -> Iterator[Unit]:
        for number in range(5_000):
            listed.append(number)
            yield unit(number % 256, [number])._replace(place=(number,), extent=Extent(file, 100 * number, 100))

    messages = merge_by_time(units())
    next(messages)
    assert len(listed) == 1_000
    assert len(list(messages)) == 4_999
    # A thousand, then five hundred at a time.
    assert len(file.announced) == 9
