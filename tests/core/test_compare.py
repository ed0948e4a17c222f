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
    assert (found.changed, found.shifted) == (1, 0)
    assert found.worst is not None
    assert found.worst.index == 1


def test_other_bits_of_one_value_are_no_distance_but_a_difference() -> None:
    found = compare_arrays(f32(0.0), f32(-0.0))
    assert found.changed == 1
    assert found.worst is not None
    assert found.worst.difference == 0
    payload = np.array([0x7FC00001], np.uint32).view(np.float32)
    assert compare_arrays(f32(math.nan), payload).changed == 1
    assert compare_arrays(f32(math.nan, 0.0), np.append(payload, f32(-0.0)), Tolerance(atol=1e-9)).differing == 0


def test_the_reference_is_the_first() -> None:
    tolerance = Tolerance(rtol=0.1)
    assert compare_arrays(f32(10.0), f32(9.05), tolerance).differing == 0
    assert compare_arrays(f32(9.05), f32(10.0), tolerance).differing == 1


def test_an_infinite_distance_is_the_worst() -> None:
    found = compare_arrays(f32(1.0, 2.0, math.nan), f32(500.0, math.inf, math.nan))
    assert found.worst is not None
    assert (found.worst.index, found.worst.difference) == (1, math.inf)


class TestShifts:
    def test_a_return_one_beam_over(self) -> None:
        inf = math.inf
        found = compare_arrays(f32(inf, 4.0, inf, 7.0), f32(inf, inf, 4.0, 7.0), limits=(0.1, 30.0))
        assert (found.changed, found.shifted, found.shift) == (0, 2, 0)

    def test_a_changed_range_is_not_a_shift(self) -> None:
        found = compare_arrays(f32(1.0, 4.0, 6.0), f32(1.0, 5.0, 6.0), limits=(0.1, 30.0))
        assert (found.changed, found.shifted) == (1, 0)

    def test_what_stands_for_no_return_does_not_move(self) -> None:
        # 31 says that nothing came back: one return vanished and another appeared, which is no shift.
        found = compare_arrays(f32(31.0, 5.5), f32(5.0, 31.0), limits=(0.1, 30.0))
        assert (found.changed, found.shifted) == (2, 0)

    @pytest.mark.parametrize("direction", [1, -1])
    def test_a_whole_scan(self, direction: int) -> None:
        a = np.linspace(1, 9, 50, dtype=np.float32)
        found = compare_arrays(a, np.roll(a, direction), limits=(0.1, 30.0))
        assert found.shift == direction
        assert found.differing == 50
        assert found.shifted >= 49

    def test_without_limits_nothing_is_called_shifted(self) -> None:
        found = compare_arrays(f32(1.0, 2.0), f32(2.0, 1.0))
        assert (found.changed, found.shifted) == (2, 0)

    def test_with_a_tolerance(self) -> None:
        found = compare_arrays(f32(9.0, 4.0), f32(4.001, 9.0), Tolerance(atol=0.01), limits=(0.1, 30.0))
        assert (found.changed, found.shifted) == (0, 2)


def test_elements_of_several_values_count_once() -> None:
    a = np.zeros((3, 2), np.int16)
    b = a.copy()
    b[2] = (5, -7)
    found = compare_arrays(a, b, Tolerance(atol=100))
    assert (found.elements, found.changed) == (3, 1)
    assert found.worst is not None
    assert (found.worst.index, found.worst.value) == (2, -7)


def test_the_byte_order_makes_no_difference_and_arrays_stay_as_they_are() -> None:
    a = f32(1.0, math.nan, -0.0)
    before = a.tobytes()
    assert compare_arrays(a, a.astype(">f4")).differing == 0
    assert a.tobytes() == before


def test_what_cannot_be_compared() -> None:
    with pytest.raises(ValueError, match=r"\(1,\)"):
        compare_arrays(f32(1.0), f32(1.0, 2.0))
    with pytest.raises(ValueError, match="float64"):
        compare_arrays(f32(1.0), np.ones(1))


@pytest.mark.parametrize("value", [-1e-9, math.nan, math.inf])
def test_tolerances_that_cannot_be(value: float) -> None:
    with pytest.raises(UsageError, match="at least 0"):
        Tolerance(atol=value)
    with pytest.raises(UsageError, match="rtol"):
        Tolerance(rtol=value)


def test_a_nan_that_signals_is_a_nan_like_any_other() -> None:
    signalling = np.array([0x7FA0_0000, 0x3F80_0000], np.uint32).view(np.float32)
    found = compare_arrays(signalling, f32(math.nan, 2.0), Tolerance(rtol=1e-3), limits=ALL)
    assert (found.changed, found.worst and found.worst.index) == (1, 1)
    assert compare_arrays(f32(1.0, 1.0), signalling, EXACT, limits=ALL).changed == 1
