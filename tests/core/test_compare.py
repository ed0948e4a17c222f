from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pc2scan.core.compare import EXACT, Tolerance, compare_arrays
from pc2scan.errors import UsageError

FLOATS = st.floats(width=32) | st.sampled_from([0.0, -0.0, math.inf, -math.inf, math.nan, 1.0, 1.0000001])
ALL = (-math.inf, math.inf)


def f32(*values: float) -> np.ndarray[Any, np.dtype[np.float32]]:
    return np.array(values, np.float32)


def same_value(a: float, b: float, tolerance: Tolerance) -> bool:
    """The rule, one value at a time."""
    if math.isnan(a) or math.isnan(b):
        return math.isnan(a) and math.isnan(b)
    if math.isinf(a) or math.isinf(b):
        return a == b
    return abs(b - a) <= tolerance.atol + tolerance.rtol * abs(a)


@given(st.data())
def test_exact_means_every_bit(data: st.DataObject) -> None:
    a = data.draw(arrays(np.uint32, st.integers(0, 8)))
    b = data.draw(arrays(np.uint32, len(a)) | st.just(a))
    found = compare_arrays(a.view(np.float32), b.view(np.float32), limits=ALL)
    assert found.elements == len(a)
    assert found.differing == int(np.count_nonzero(a != b))
    assert (found.worst is None) == (found.differing == 0)


@given(
    st.lists(st.tuples(FLOATS, FLOATS), max_size=8),
    st.sampled_from([Tolerance(atol=0.5), Tolerance(rtol=1e-5), Tolerance(1e-3, 1e-6)]),
)
def test_tolerances_agree_with_the_rule(pairs: list[tuple[float, float]], tolerance: Tolerance) -> None:
    a, b = (np.array([pair[side] for pair in pairs], np.float32) for side in (0, 1))
    expected = sum(not same_value(float(x), float(y), tolerance) for x, y in zip(a, b, strict=True))
    assert compare_arrays(a, b, tolerance).differing == expected


@pytest.mark.parametrize("bit", range(32))
def test_a_single_bit_is_found(bit: int) -> None:
    a = f32(1.0, 2.5, 3.0)
    bits = a.view(np.uint32).copy()
    bits[1] ^= np.uint32(1 << bit)
    found = compare_arrays(a, bits.view(np.float32), EXACT, limits=ALL)
    assert (found.changed, found.shifted, found.worst and found.worst.index) == (1, 0, 1)


INF, NAN = math.inf, math.nan
PAYLOAD, SIGNALLING = np.array([0x7FC0_0001, 0x7FA0_0000], np.uint32).view(np.float32)
LIMITS = (0.1, 30.0)
SCAN = np.linspace(1, 9, 50, dtype=np.float32)


@pytest.mark.parametrize(
    ("a", "b", "tolerance", "limits", "expected"),
    [
        # Other bits of one value are no distance, but a difference, unless there is a tolerance.
        ([0.0], [-0.0], EXACT, None, (1, 0)),
        ([NAN], [PAYLOAD], EXACT, None, (1, 0)),
        ([NAN, 0.0], [PAYLOAD, -0.0], Tolerance(atol=1e-9), None, (0, 0)),
        # A NaN that signals is one like any other.
        ([SIGNALLING, 1.0], [NAN, 2.0], Tolerance(rtol=1e-3), ALL, (1, 0)),
        ([1.0, 1.0], [SIGNALLING, 1.0], EXACT, ALL, (1, 0)),
        # The reference is the first.
        ([10.0], [9.05], Tolerance(rtol=0.1), None, (0, 0)),
        ([9.05], [10.0], Tolerance(rtol=0.1), None, (1, 0)),
        # A return one beam over, and a changed range, which is not one.
        ([INF, 4.0, INF, 7.0], [INF, INF, 4.0, 7.0], EXACT, LIMITS, (0, 2)),
        ([1.0, 4.0, 6.0], [1.0, 5.0, 6.0], EXACT, LIMITS, (1, 0)),
        ([9.0, 4.0], [4.001, 9.0], Tolerance(atol=0.01), LIMITS, (0, 2)),
        # 31 says that nothing came back: one return vanished and another appeared, which is no shift.
        ([31.0, 5.5], [5.0, 31.0], EXACT, LIMITS, (2, 0)),
        # Without limits nothing is called shifted.
        ([1.0, 2.0], [2.0, 1.0], EXACT, None, (2, 0)),
    ],
)
def test_what_has_changed_and_what_is_shifted(
    a: list[float], b: list[float], tolerance: Tolerance, limits: tuple[float, float] | None, expected: tuple[int, int]
) -> None:
    found = compare_arrays(f32(*a), f32(*b), tolerance, **({"limits": limits} if limits else {}))
    assert (found.changed, found.shifted) == expected


@pytest.mark.parametrize("direction", [1, -1])
def test_a_whole_scan_that_is_shifted(direction: int) -> None:
    assert compare_arrays(f32(INF, 4, INF, 7), f32(INF, INF, 4, 7), limits=LIMITS).shift == 0
    found = compare_arrays(SCAN, np.roll(SCAN, direction), limits=LIMITS)
    assert (found.shift, found.differing) == (direction, 50)
    assert found.shifted >= 49


@pytest.mark.parametrize(
    ("a", "b", "tolerance", "index", "difference"),
    [
        (f32(0.0), f32(-0.0), EXACT, 0, 0),
        (f32(1.0, 2.0, NAN), f32(500.0, INF, NAN), EXACT, 1, INF),
        # Elements of several values count once.
        (np.zeros((3, 2), np.int16), np.array([[0, 0], [0, 0], [5, -700]], np.int16), Tolerance(atol=100), 2, 700),
    ],
)
def test_the_worst_difference(a: Any, b: Any, tolerance: Tolerance, index: int, difference: float) -> None:
    found = compare_arrays(a, b, tolerance)
    assert found.elements == len(a)
    assert found.worst is not None
    assert (found.worst.index, found.worst.difference) == (index, difference)


def test_several_values_of_an_element_count_once() -> None:
    found = compare_arrays(
        np.zeros((3, 2), np.int16), np.array([[0, 0], [0, 0], [5, -7]], np.int16), Tolerance(atol=100)
    )
    assert (found.elements, found.changed, found.worst and found.worst.value) == (3, 1, -7)


def test_arrays_of_any_byte_order_stay_as_they_are() -> None:
    a = f32(1.0, NAN, -0.0)
    before = a.tobytes()
    assert compare_arrays(a, a.astype(">f4")).differing == 0
    assert a.tobytes() == before


def test_what_cannot_be_compared() -> None:
    with pytest.raises(ValueError, match=r"\(1,\)"):
        compare_arrays(f32(1.0), f32(1.0, 2.0))
    with pytest.raises(ValueError, match="float64"):
        compare_arrays(f32(1.0), np.ones(1))
    for value in (-1e-9, NAN, INF):
        with pytest.raises(UsageError, match="at least 0"):
            Tolerance(atol=value)
        with pytest.raises(UsageError, match="rtol"):
            Tolerance(rtol=value)
