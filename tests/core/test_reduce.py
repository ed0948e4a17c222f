"""Which return a beam reads, against one beam at a time in plain Python."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.reduce import extremes, means, surfaces, winners

BEAMS = 5
RETURNS = st.lists(
    st.tuples(
        st.integers(0, BEAMS - 1),
        st.one_of(st.sampled_from([0.0, 1.0, 2.0, math.inf]), st.floats(0, 100, width=32)),
    ),
    max_size=40,
)


def winner(ranges: list[tuple[float, int]], how: str, kth: int) -> int:
    """The index of the return that wins, of pairs of range and index."""
    ordered = sorted(ranges)
    if len(ordered) < max(1, kth):
        return -1
    if how == "max":
        largest = ordered[-1][0]
        return next(index for length, index in ordered if length == largest)
    if how == "median":
        middle = statistics.median_low([length for length, _ in ordered])
        assert ordered[(len(ordered) - 1) // 2][0] == middle
        return ordered[(len(ordered) - 1) // 2][1]
    return ordered[kth - 1 if how == "kth" else 0][1]


@pytest.mark.parametrize(("how", "kth"), [("min", 0), ("max", 0), ("median", 0), ("kth", 1), ("kth", 2), ("kth", 3)])
@given(RETURNS)
def test_winners(how: str, kth: int, returns: list[tuple[int, float]]) -> None:
    beams = np.array([beam for beam, _ in returns], np.intp)
    ranges = np.array([length for _, length in returns], np.float32)
    found = winners(beams, ranges, np.bincount(beams, minlength=BEAMS), how, kth)
    expected = [
        winner([(length, index) for index, (b, length) in enumerate(returns) if b == beam], how, kth)
        for beam in range(BEAMS)
    ]
    assert found.tolist() == expected
    if how in {"min", "max"}:
        empty = math.inf if how == "min" else -math.inf
        lengths = [empty if index < 0 else returns[index][1] for index in expected]
        assert extremes(beams, ranges, BEAMS, largest=how == "max").tolist() == lengths


def on_the_surface(ranges: list[tuple[float, int]], depth: float, slope: float) -> int:
    """The index of the median of the returns near the closest, of pairs of range and index."""
    if not ranges:
        return -1
    ordered = sorted(ranges)
    closest = ordered[0][0]
    limit = closest + (depth + slope * closest) if closest < math.inf else math.inf
    near = [(length, index) for length, index in ordered if length <= limit]
    middle = statistics.median_low([length for length, _ in near])
    assert near[(len(near) - 1) // 2][0] == middle
    return near[(len(near) - 1) // 2][1]


@given(
    st.lists(
        st.tuples(
            st.integers(0, BEAMS - 1),
            st.one_of(st.sampled_from([0.0, 1.0, 1.05, 1.25, math.inf]), st.floats(0, 3, width=32)),
        ),
        max_size=40,
    ),
    st.sampled_from([0.0, 0.05, 0.25, 10.0]),
    st.sampled_from([0.0, 0.05, 0.5]),
)
def test_surfaces(returns: list[tuple[int, float]], depth: float, slope: float) -> None:
    beams = np.array([beam for beam, _ in returns], np.intp)
    ranges = np.array([length for _, length in returns], np.float32)
    found = surfaces(beams, ranges, BEAMS, depth, slope)
    lengths = ranges.tolist()
    assert found.tolist() == [
        on_the_surface([(lengths[i], i) for i, (b, _) in enumerate(returns) if b == beam], depth, slope)
        for beam in range(BEAMS)
    ]


@given(st.lists(st.tuples(st.integers(0, BEAMS - 1), st.floats(-1e6, 1e6, width=32)), max_size=40))
def test_means(returns: list[tuple[int, float]]) -> None:
    beams = np.array([beam for beam, _ in returns], np.intp)
    values = np.array([value for _, value in returns], np.float32)
    found = means(beams, values, np.bincount(beams, minlength=BEAMS))
    for beam in range(BEAMS):
        own = [value for b, value in returns if b == beam]
        # Summed one after the other, as plain Python does it before 3.12.
        total = 0.0
        for value in own:
            total += value
        assert found[beam] == (total / len(own) if own else 0.0)
