from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pc2scan.core.tolerance import EXACT, Tolerance, compare_arrays
from pc2scan.errors import UsageError

ALL = (-math.inf, math.inf)


def f32(*values: float) -> np.ndarray[Any, np.dtype[np.float32]]:
    return np.array(values, np.float32)


@given(st.data())
def test_exact_means_every_bit(data: st.DataObject) -> None:
    a = data.draw(arrays(np.uint32, st.integers(0, 8)))
    b = data.draw(arrays(np.uint32, len(a)) | st.just(a))
    found = compare_arrays(a.view(np.float32), b.view(np.float32), limits=ALL)
    assert found.elements == len(a)
    assert found.differing == int(np.count_nonzero(a != b))
    assert (found.worst is None) == (found.differing == 0)


INF, NAN = math.inf, math.nan
PAYLOAD, SIGNALLING = np.array([0x7FC0_0001, 0x7FA0_0000], np.uint32).view(np.float32)
LIMITS = (0.1, 30.0)


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
