from __future__ import annotations

from dataclasses import astuple
from itertools import compress
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from pc2scan.bags.chunks import (
    MIN_WHOLE_BYTES,
    ChunkedReader,
    Segment,
    Segments,
    times_around,
    whole_chunks,
)
from pc2scan.model import ChunkRule

if TYPE_CHECKING:
    from collections.abc import Iterable

RULE = ChunkRule("mcap", frozenset({"zstd"}), frozenset({1, 2}))


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
