from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.bags.chunks import MIN_WHOLE_BYTES, Segment, segment_units, whole_chunks
from pc2scan.model import ChunkRule

if TYPE_CHECKING:
    from collections.abc import Iterable

RULE = ChunkRule("mcap", frozenset({"zstd"}), frozenset({1, 2}))


def segment(offset: int, start_ns: int, end_ns: int, ids: Iterable[int] = (1,), **changes: int) -> Segment:
    made = Segment(offset, 10, "zstd", MIN_WHOLE_BYTES, 0, start_ns, end_ns, frozenset(ids))
    return replace(made, **changes)  # type: ignore[arg-type]


def whole(*segments: Segment, start_ns: int | None = None, stop_ns: int | None = None) -> dict[int, int]:
    """When each whole chunk is due, by its offset."""
    return {found.offset: due_ns for found, due_ns in whole_chunks(segments, RULE, start_ns, stop_ns).items()}


def test_of_no_chunks_none_is_whole() -> None:
    assert whole() == {}


def test_chunks_one_after_the_other_are_whole() -> None:
    assert whole(segment(30, 1, 4), segment(10, 5, 8), segment(20, 9, 9)) == {30: 1, 10: 5, 20: 9}


def test_chunks_that_overlap_are_whole_together() -> None:
    assert whole(segment(1, 3, 9), segment(2, 0, 4), segment(3, 10, 11)) == {1: 0, 2: 0, 3: 10}
    other = (3,)
    assert whole(segment(1, 0, 9), segment(2, 3, 4, other), segment(3, 10, 11)) == {3: 10}
    chunks = [segment(1, 0, 20), segment(2, 3, 4), segment(3, 10, 11, other), segment(4, 21, 22)]
    assert whole(*chunks) == {4: 21}


def test_at_one_time_the_place_in_the_file_decides() -> None:
    assert whole(segment(1, 0, 5), segment(2, 5, 9, (3,))) == {1: 0}
    assert whole(segment(2, 0, 5), segment(1, 5, 9, (3,))) == {}
    assert whole(segment(1, 5, 5), segment(2, 5, 5), segment(3, 5, 5, (3,)), segment(4, 5, 9)) == {1: 5, 2: 5, 4: 5}


def test_small_chunks_are_whole_among_large_ones() -> None:
    small, large = (replace(segment(n, 3, 9), uncompressed_size=size) for n, size in ((1, 1), (2, 2 * MIN_WHOLE_BYTES)))
    assert whole(small, large) == {1: 3, 2: 3}
    assert whole(small, replace(large, uncompressed_size=2 * MIN_WHOLE_BYTES - 2)) == {}


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
    units = segment_units([late, early], load, {late: 4}, file)
    assert [(unit.start_ns, unit.place, unit.is_quick, unit.may_be_whole) for unit in units] == [
        (1, (30,), True, False),
        (4, (10,), False, True),
    ]
    assert [unit.extent for unit in units] == [(file, 30, 10), (file, 10, 10)]
    large = replace(early, uncompressed_size=1 << 20)
    assert not segment_units([large], load, {}, file)[0].is_quick
