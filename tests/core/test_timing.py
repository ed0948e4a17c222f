"""When scans and beams were measured: lidars that are made to turn, and what does not turn."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.layout import TURN, centered_layout
from pc2scan.core.timing import Sweep, azimuth_times, beam_times, fit_sweep, median_interval_ns
from support.tables import rows

TABLES = Path(__file__).with_name("timing.txt")


@pytest.mark.parametrize(("stamps", "expected"), rows(TABLES, "median intervals"))
def test_the_median_interval(stamps: list[int], expected: int | None) -> None:
    assert median_interval_ns(stamps) == expected


def sweep_of(rate: float, start: float, turned: float = TURN, begin: float = 0.0, columns: int = 900) -> Any:
    """Angles and times of a lidar with 16 lasers that look up to 3 degrees to the side."""
    times = np.repeat(begin + np.linspace(0, turned / abs(rate), columns, endpoint=False), 16)
    aside = np.tile(np.deg2rad(np.linspace(-3, 3, 16)), columns)
    return np.remainder(start + rate * (times - begin) + aside + math.pi, TURN) - math.pi, times


@given(
    st.sampled_from([-1.0, 1.0]),
    st.floats(5, 20),
    st.floats(-math.pi, math.pi),
    st.floats(1.0, TURN),
    st.floats(-0.1, 0.1),
)
def test_a_turning_lidar_is_recognised(way: float, hertz: float, start: float, turned: float, begin: float) -> None:
    rate = way * TURN * hertz
    angles, times = sweep_of(rate, start, turned, begin)
    # Shuffled, and a third of the points missing.
    kept = np.random.default_rng(1).permutation(times.size)[: times.size * 2 // 3]
    sweep = fit_sweep(angles[kept], times[kept])
    assert sweep is not None
    assert sweep.rate == pytest.approx(rate, rel=2e-3)
    assert abs(math.remainder(sweep.angle - start, TURN)) < 0.02
    assert sweep.begin == pytest.approx(begin, abs=1e-3)


TURN_OF_60 = sweep_of(60.0, 0.0)
ONES = np.ones_like(TURN_OF_60[1])


@pytest.mark.parametrize(
    ("angles", "times"),
    [
        (np.random.default_rng(2).permutation(TURN_OF_60[0]), TURN_OF_60[1]),
        (TURN_OF_60[0], 0 * ONES),
        (TURN_OF_60[0], math.nan * ONES),
        (TURN_OF_60[0][:20], TURN_OF_60[1][:20]),
        # There and back, as a MEMS mirror does; two turns in one cloud; times that are all but equal.
        (np.abs(np.linspace(-1, 1, 5000)), np.linspace(0, 0.1, 5000)),
        sweep_of(60.0, 0.0, 2 * TURN),
        (np.linspace(-3, 3, 200), np.repeat([0.0, 5e-324], 100)),
    ],
)
def test_what_does_not_turn_is_not_taken_for_it(angles: Any, times: Any) -> None:
    assert fit_sweep(angles, times) is None


TEN = TURN * 10
CIRCLE = (-math.pi, math.pi, 360)


@pytest.mark.parametrize(
    ("sweep", "layout", "expected"),
    [
        # One that begins with the scan; clockwise, the first beam is the last in time.
        (Sweep(-0.1, 0.0, 0.0, TEN), (0.0, TURN, 1000), (-0.1, 1e-4)),
        (Sweep(-0.1, 0.0, 0.0, -TEN), (0.0, TURN, 1000), (0.0, -1e-4)),
        # Beginning inside the scan it cannot be told, but of a sector that the seam is outside of.
        *((Sweep(0.0, 0.1, 1.0, rate), layout, None) for rate in (TEN, -TEN) for layout in (CIRCLE, (0.0, 2.0, 100))),
        (Sweep(0.0, 0.1, 1.0, TEN), (-2.0, 0.0, 101), ((TURN - 3.0) / TEN, 0.02 / TEN)),
        (Sweep(0.0, 0.1, 1.0, -TEN), (-2.0, 0.0, 101), (3.0 / TEN, -0.02 / TEN)),
        (Sweep(0.0, 0.1, 1.0, TEN), (1.0, 1.0 + TURN, 360), (0.0, 0.1 / 360)),
        (Sweep(0.0, 0.1, 1.0, -TEN), (1.0, 1.0 + TURN, 360), (0.1, -0.1 / 360)),
        # Ahead only, clockwise from pi/2 to -pi/2: the beams behind are never seen, and tell nothing.
        (Sweep(-0.05, 0.0, math.pi / 2, -math.pi / 0.05), CIRCLE, (0.025, -0.05 / 180)),
        (Sweep(-0.05, 0.0, math.pi / 2, -math.pi / 0.05), (2.0, 4.0, 100), None),
    ],
)
def test_when_the_beams_of_a_sweep_were_measured(
    sweep: Sweep, layout: tuple[float, float, int], expected: tuple[float, float] | None
) -> None:
    low, high, beams = layout
    found = beam_times(sweep, centered_layout(low, high, 1.0, beams))
    assert found == (None if expected is None else pytest.approx(expected, rel=1e-5, abs=1e-6))
    if sweep.angle == 1.0:
        assert sweep.lowest == pytest.approx(1.0)


def turning(layout: str, *, clockwise: bool, offsets: float = 0.03, share: float = 1.0) -> tuple[Any, Any, Any]:
    """x, y and the times of points of 8 lasers, of 600 columns: one turn in 0.1 s."""
    columns = np.arange(600) / 600 * share
    aside = np.linspace(-offsets, offsets, 8)
    azimuth = (0.7 + (-1 if clockwise else 1) * columns * 2 * math.pi)[np.newaxis] + aside[:, np.newaxis]
    times = np.broadcast_to(columns * 0.1, azimuth.shape)
    reach = 5 + np.sin(3 * azimuth)
    x, y = reach * np.cos(azimuth), reach * np.sin(azimuth)
    if layout == "columns":
        return x.T.ravel(), y.T.ravel(), times.T.ravel()
    if layout == "rows of columns":
        return x.T.copy(), y.T.copy(), times.T
    return x, y, times


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize("layout", ["rings", "columns", "rows of columns"])
@pytest.mark.parametrize("share", [1.0, 0.4, 1.02])
def test_azimuth_tells_times(layout: str, clockwise: bool, share: float) -> None:
    x, y, times = turning(layout, clockwise=clockwise, share=share)
    x = x.astype(np.float32)
    x[np.unravel_index(np.arange(50, x.size, 37), x.shape)] = np.nan
    found = azimuth_times(x, y.astype(np.float32), 0.1)
    assert found is not None
    np.testing.assert_array_equal(np.isnan(found), np.isnan(x))
    # The lasers look 0.03 rad to either side, and the first one decides where the turn begins.
    np.testing.assert_allclose(found[~np.isnan(x)], times[~np.isnan(x)], rtol=0, atol=0.1 * 0.07 / (2 * math.pi))
    same = azimuth_times(x, y.astype(np.float32), 0.1, -1 if clockwise else 1)
    np.testing.assert_array_equal(found, same)
