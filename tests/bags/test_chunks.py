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
    units = list(segment_units([late, early], load, {late: 4}, file))
    assert [(unit.start_ns, unit.place, unit.is_quick, unit.may_be_whole) for unit in units] == [
        (1, (30,), True, False),
        (4, (10,), False, True),
    ]
    assert [unit.extent for unit in units] == [(file, 30, 10), (file, 10, 10)]
    large = replace(early, uncompressed_size=1 << 20)
    assert not next(segment_units([large], load, {}, file)).is_quick
