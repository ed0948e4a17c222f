"""Beams that share a bin, and bins that lie between two beams: counted one by one."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.conversion.combine.rebinning import Rebinning, count_rebinning


def one_by_one(sources: list[list[tuple[int, int]]], length: int, *, full_circle: bool) -> Rebinning:
    """The same in loops."""
    filled = {place for source in sources for place, _ in source}
    between: set[int] = set()
    for source in sources:
        for (here, number), (there, following) in itertools.pairwise(source):
            if following - number != 1:
                continue
            low, high = min(here, there), max(here, there)
            inside = set(range(low + 1, high))
            if full_circle and high - low > length // 2:
                inside = set(range(high + 1, length)) | set(range(low))
            between |= inside
    total = sum(map(len, sources))
    return Rebinning(total, total - len(filled), len(between - filled))


@given(
    st.lists(st.lists(st.tuples(st.integers(0, 19), st.integers(1, 3)), max_size=12), max_size=3),
    st.booleans(),
)
def test_counts_are_those_of_a_loop(drawn: list[list[tuple[int, int]]], full_circle: bool) -> None:
    sources = []
    for source in drawn:
        numbers = np.cumsum([step for _, step in source]).tolist()
        sources.append([(place, number) for (place, _), number in zip(source, numbers, strict=True)])
    arrays = [
        (np.array([p for p, _ in source], np.int32), np.array([n for _, n in source], np.int32)) for source in sources
    ]
    assert count_rebinning(arrays, 20, full_circle=full_circle) == one_by_one(sources, 20, full_circle=full_circle)


@pytest.mark.parametrize(("full_circle", "between"), [(True, 2), (False, 6)])
def test_the_shorter_way_around_a_circle(full_circle: bool, between: int) -> None:
    bins, numbers = np.array([1, 8], np.int32), np.array([0, 1], np.int32)
    assert count_rebinning([(bins, numbers)], 10, full_circle=full_circle) == Rebinning(2, 0, between)
