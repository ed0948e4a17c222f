from __future__ import annotations

from dataclasses import astuple, replace
from itertools import compress
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from pc2scan.bags.chunks import (
    MIN_WHOLE_BYTES,
    ChunkedReader,
    Segment,
    Segments,
    segment_chunks,
    times_around,
    whole_chunks,
)
from pc2scan.model import ChunkRule

if TYPE_CHECKING:
    from collections.abc import Iterable

RULE = ChunkRule("mcap", frozenset({"zstd"}), frozenset({1, 2}))


def segment(offset: int, start_ns: int, end_ns: int, ids: Iterable[int] = (1,), **changes: int) -> Segment:
    made = Segment(offset, 10, MIN_WHOLE_BYTES, start_ns, end_ns, compression="zstd", connection_ids=frozenset(ids))
    return replace(made, **changes)  # type: ignore[arg-type]


def whole(*segments: Segment, start_ns: int | None = None, stop_ns: int | None = None) -> dict[int, int]:
    """When each whole chunk is due, by its offset."""
    sorted_segments = Segments(segments)
    sorted_segments.sort()
    found = zip(sorted_segments, *whole_chunks(sorted_segments, RULE, start_ns, stop_ns), strict=True)
    return {each.offset: int(due_ns) for each, is_whole, due_ns in found if is_whole}


def test_of_no_chunks_none_is_whole() -> None:
    assert whole() == {}


def test_chunks_one_after_the_other_are_whole() -> None:
    assert whole(segment(1, 1, 4), segment(2, 5, 8), segment(3, 9, 9)) == {1: 1, 2: 5, 3: 9}


#: Chunks in the order of a file: log times, and whether their messages are read one by one; and when those are due that
#: are whole.
LAYOUTS = {
    "apart": ([(0, 4), (5, 8, "read"), (9, 12)], {0: 0, 2: 9}),
    "neighbours share a time": ([(0, 5), (5, 9, "read"), (9, 12), (12, 12), (12, 13)], {0: 0, 2: 9, 3: 12, 4: 12}),
    "overlapping": ([(0, 5), (3, 8), (7, 9), (20, 21, "read")], {0: 0, 1: 5, 2: 8}),
    "one overlaps what is read": ([(0, 5), (4, 8), (7, 10, "read"), (9, 13), (12, 15)], {0: 0, 1: 5, 3: 10, 4: 13}),
    "what is read begins too early": ([(0, 5), (4, 8), (4, 10, "read"), (12, 15)], {0: 0, 3: 12}),
    "topics have chunks of their own": ([(0, 9, "read"), (0, 9), (10, 19, "read"), (9, 20)], {1: 9, 3: 19}),
    "topics have chunks that overlap": ([(0, 9, "read"), (0, 12), (10, 19, "read"), (9, 20)], {1: 9, 3: 19}),
    "not in order": ([(40, 41), (10, 20), (50, 50, "read")], {0: 40, 1: 41}),
    "what is read is earlier": ([(40, 41), (10, 20, "read"), (50, 50)], {2: 50}),
}


@pytest.mark.parametrize(("chunks", "expected"), LAYOUTS.values(), ids=LAYOUTS)
def test_chunks_keep_their_place_in_the_file(
    chunks: list[tuple[int, int] | tuple[int, int, str]], expected: dict[int, int]
) -> None:
    segments = [segment(n, start, end, (3,) if how else (1,)) for n, (start, end, *how) in enumerate(chunks)]
    assert whole(*segments) == expected
    assert whole(*reversed(segments)) == expected


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
    assert whole(other, segment(2, 10, 11)) == {2: 10}


def test_chunks_across_the_cut_are_not_whole() -> None:
    chunks = [segment(n, 10 * n, 10 * n + 9) for n in range(5)]
    assert whole(*chunks, start_ns=10, stop_ns=40) == {1: 10, 2: 20, 3: 30}
    assert whole(*chunks, start_ns=11, stop_ns=39) == {2: 20}


def test_units_are_in_the_order_in_which_they_are_due() -> None:
    file: Any = object()

    def load(*_: Any, **__: Any) -> list[Any]:
        return []

    late, early = segment(10, 5, 9), replace(segment(30, 1, 9), compression="none")
    due = np.array([4, 1], np.uint64)
    units = list(segment_chunks(Segments([late, early]), load, file, np.array([True, False]), due))
    assert [(unit.start_ns, unit.place, unit.is_quick) for unit in units] == [
        (1, (30,), True),
        (4, (10,), False),
    ]
    assert [(unit.file, unit.offset, unit.length) for unit in units] == [(file, 30, 10), (file, 10, 10)]
    large = replace(early, uncompressed_size=1 << 20)
    assert not next(segment_chunks(Segments([large]), load, file, np.array([False]), due[:1])).is_quick


# --- Against lists of segments, one at a time ---

#: The last number that a container can store, and numbers that are equal more often.
LAST = (1 << 64) - 1
NUMBERS = st.integers(0, 12) | st.sampled_from([1 << 63, LAST - 1, LAST])
CUTS = st.none() | st.integers(-2, 14) | st.sampled_from([1 << 63, LAST, LAST + 1, LAST + 2])
SEGMENTS = st.builds(
    Segment,
    *(NUMBERS for _ in range(9)),
    compression=st.sampled_from(["none", "zstd"]),
    connection_ids=st.none() | st.frozensets(st.integers(0, 3)),
    message_count=st.none() | st.integers(0, 9) | st.just(LAST - 1),
)


def fields(segments: Iterable[Segment]) -> list[tuple[object, ...]]:
    return [(type(each), astuple(each)) for each in segments]


@given(st.lists(SEGMENTS), st.lists(st.booleans()), st.integers(0, 3))
def test_a_table_has_what_was_added(made: list[Segment], chosen: list[bool], removed: int) -> None:
    table = Segments(made)
    for _ in range(min(removed, len(made))):
        assert fields([table.pop()]) == fields([made.pop()])
    assert len(table) == len(made)
    assert fields(table) == fields(made) == fields(map(table.__getitem__, range(len(made))))
    mask = (chosen + [False] * len(made))[: len(made)]
    assert fields(table.select(np.array(mask, bool))) == fields(compress(made, mask))
    table.sort()
    assert fields(table) == fields(sorted(made, key=attrgetter("offset")))


def whole_one_by_one(
    ordered: list[Segment], rule: ChunkRule, start_ns: int | None, stop_ns: int | None
) -> dict[int, int]:
    """When each whole chunk is due, by its place in the file."""
    found = {}
    following: int | None = None
    for place, each in reversed(list(enumerate(ordered))):
        due_ns = max([each.start_ns, *(other.end_ns for other in ordered[:place])])
        if (
            (following is None or due_ns <= following)
            and each.connection_ids is not None
            and each.connection_ids <= rule.connection_ids
            and each.uncompressed_size >= MIN_WHOLE_BYTES
            and (start_ns is None or start_ns <= each.start_ns)
            and (stop_ns is None or each.end_ns < stop_ns)
            and (rule.last_ns is None or each.end_ns <= rule.last_ns)
        ):
            found[place] = due_ns
        else:
            following = each.start_ns if following is None else min(following, each.start_ns)
    return found


RULES = st.builds(
    RULE._replace,
    last_ns=st.none() | NUMBERS,
)


@given(st.lists(SEGMENTS, max_size=7), RULES, CUTS, CUTS)
def test_chunks_are_whole_as_they_are_one_by_one(
    made: list[Segment], rule: ChunkRule, start_ns: int | None, stop_ns: int | None
) -> None:
    for place, each in enumerate(made):
        each.offset, each.uncompressed_size = place, MIN_WHOLE_BYTES - (each.uncompressed_size == 0)
        each.start_ns, each.end_ns = sorted((each.start_ns, each.end_ns))
    found, due = whole_chunks(Segments(made), rule, start_ns, stop_ns)
    expected = whole_one_by_one(made, rule, start_ns, stop_ns)
    assert np.flatnonzero(found).tolist() == sorted(expected)
    assert due.tolist() == [expected.get(place, each.start_ns) for place, each in enumerate(made)]


def beside_one_by_one(ordered: list[Segment], start_ns: int | None, stop_ns: int | None) -> set[int]:
    """The places of the segments next to a cut."""
    found = set()
    for place, each in enumerate(ordered):
        before, behind = ordered[place - 1] if place else None, ordered[place + 1] if place + 1 < len(ordered) else None
        if stop_ns is not None and each.start_ns >= stop_ns and (before is None or before.start_ns < stop_ns):
            found.add(place)
        if start_ns is not None and each.end_ns < start_ns and (behind is None or behind.end_ns >= start_ns):
            found.add(place)
    return found


class Compared(ChunkedReader):
    """A reader that notes which segments it compares."""

    def __init__(self, segments: Segments) -> None:
        self._segments = segments
        self.compared: set[int] = set()

    def _confirm(self, place: int, *, unless_repeated: bool = False) -> bool:
        del unless_repeated
        self.compared.add(place)
        return True

    _contained_span = chunks = None  # type: ignore[assignment]


Compared.__abstractmethods__ = frozenset()


@given(st.lists(SEGMENTS, max_size=7), st.none() | st.frozensets(st.integers(0, 3), min_size=1), CUTS, CUTS)
def test_a_cut_has_the_segments_that_may_have_its_messages(
    made: list[Segment], ids: frozenset[int] | None, start_ns: int | None, stop_ns: int | None
) -> None:
    def may_have(each: Segment) -> bool:
        return ids is None or each.connection_ids is None or bool(ids & each.connection_ids)

    # No message is in another cut, and it does not matter which segments are read.
    assume((start_ns is None or start_ns <= LAST) and (stop_ns is None or stop_ns > max(start_ns or 0, 0)))
    reader = Compared(Segments(made))
    found = fields(reader._segments_with(ids, start_ns, stop_ns))
    expected = [
        each
        for each in made
        if may_have(each)
        and (start_ns is None or each.end_ns >= start_ns)
        and (stop_ns is None or each.start_ns < stop_ns)
    ]
    assert found == fields(expected)
    beside = beside_one_by_one(made, start_ns, stop_ns)
    assert reader.compared == {place for place in beside if may_have(made[place])}


@given(st.lists(SEGMENTS, max_size=7), st.integers(0, 14), st.integers(0, 14))
def test_the_times_around_a_place_are_those_of_the_segments_there(made: list[Segment], start: int, stop: int) -> None:
    made.sort(key=attrgetter("offset"))
    assert times_around(Segments(made))(start, stop) == {
        "first_ns": max((each.end_ns for each in made if each.end_ns and each.offset < start), default=None),
        "last_ns": min((each.start_ns for each in made if each.end_ns and each.offset >= stop), default=None),
    }
