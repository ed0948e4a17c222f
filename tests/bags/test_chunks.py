from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.bags.chunks import MIN_WHOLE_BYTES, Segment, isolated_chunks, segment_units
from pc2scan.model import ChunkRule

if TYPE_CHECKING:
    from collections.abc import Iterable

RULE = ChunkRule("mcap", frozenset({"zstd"}), frozenset({1, 2}))


def segment(offset: int, start_ns: int, end_ns: int, ids: Iterable[int] = (1,), **changes: int) -> Segment:
    made = Segment(offset, 10, "zstd", MIN_WHOLE_BYTES, 0, start_ns, end_ns, frozenset(ids))
    return replace(made, **changes)  # type: ignore[arg-type]


def alone(*segments: Segment, start_ns: int | None = None, stop_ns: int | None = None) -> list[int]:
    return sorted(found.offset for found in isolated_chunks(segments, RULE, start_ns, stop_ns))


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


def test_units_are_in_the_order_in_which_they_are_due() -> None:
    file: Any = object()

    def load(*_: Any, **__: Any) -> list[Any]:
        return []

    late, early = segment(10, 5, 9), replace(segment(30, 1, 9), compression="none")
    units = segment_units([late, early], load, [late], file)
    assert [(unit.start_ns, unit.place, unit.is_quick, unit.may_be_whole) for unit in units] == [
        (1, (30,), True, False),
        (5, (10,), False, True),
    ]
    assert [unit.extent for unit in units] == [(file, 30, 10), (file, 10, 10)]
    large = replace(early, uncompressed_size=1 << 20)
    assert not segment_units([large], load, [], file)[0].is_quick
