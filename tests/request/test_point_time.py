"""The times of points: every field, unit and origin that drivers write."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.points import Points
from pc2scan.request.point_time import PointTime

if TYPE_CHECKING:
    from numpy.typing import NDArray

STAMP = 1_700_000_000_123_456_789


def cloud_of(values: NDArray[Any], stamp_ns: int) -> Points:
    return Points(0, stamp_ns, "", {"x": np.zeros(values.shape, np.float32), "t": values})


def point_times(values: NDArray[Any], stamp_ns: int) -> NDArray[np.float64]:
    """When the points of a cloud with these values in its field were measured, seconds after its stamp."""
    return PointTime().read(cloud_of(values, stamp_ns)).at()


#: 0 to 99 ms, as drivers write it.
MILLISECONDS = np.arange(100)


@pytest.mark.parametrize(
    ("values", "first"),
    [
        ((MILLISECONDS * 1_000_000).astype("<u4"), 0.0),
        ((MILLISECONDS * 1_000_000).astype(">i4"), 0.0),
        ((MILLISECONDS * 1e-3).astype("<f4"), 0.0),
        ((MILLISECONDS * 1e-3 - 0.099).astype("<f4"), -0.099),
        (MILLISECONDS * 1.0, 0.0),
        (MILLISECONDS * 1e3, 0.0),
        (MILLISECONDS * 1e6, 0.0),
        (STAMP / 1e9 + 0.5 + MILLISECONDS * 1e-3, 0.5),
        (STAMP + MILLISECONDS * 1e6 - 0.099e9, -0.099),
        (STAMP / 1e3 + MILLISECONDS * 1e3, 0.0),
    ],
)
def test_times_of_points_in_every_unit(values: NDArray[Any], first: float) -> None:
    times = point_times(values, STAMP)
    # A float64 of seconds since 1970 resolves 0.24 us.
    np.testing.assert_allclose(times, first + MILLISECONDS * 1e-3, atol=5e-7)


UNITS = [1, 1_000, 1_000_000, 1_000_000_000]


@given(
    st.sampled_from(UNITS),
    st.integers(0, 4_000_000_000_000_000_000),
    st.floats(0.0025, 1.9),
    st.floats(-1.0, 0.0),
    # Of two points the one at 0 may be without a time, and the other alone has no span.
    st.integers(3, 6),
)
def test_relative_times_are_known_by_their_span(
    unit: int, stamp_ns: int, span: float, begin: float, count: int
) -> None:
    # A span of 2 ms to 2 s, before the stamp, after it, or around it.
    expected = np.linspace(begin * span, (begin + 1) * span, count)
    np.testing.assert_allclose(point_times(expected * (1e9 / unit), stamp_ns), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("unit", UNITS)
def test_a_zero_among_absolute_times_is_no_time(unit: int) -> None:
    after = np.array([0, 20_000_000, 90_000_000])
    with_zero = np.append((STAMP + after) / unit, 0.0)
    np.testing.assert_allclose(point_times(with_zero, STAMP), [*(after / 1e9), np.nan], atol=5e-7)
    assert PointTime().read(cloud_of(with_zero, STAMP)).unknown == 1
