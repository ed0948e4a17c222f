"""Times of points: in the units that fields have, and by a lidar's turns, as measured in its first clouds."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.points import Points
from pc2scan.errors import ParameterError
from pc2scan.request.point_time import PointTime, Turn, TurnSample, measure_turn, turn_sample
from support.tables import rows

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


TABLES = Path(__file__).with_name("turns.txt")
MS = 1_000_000
T0 = 1_700_000_000_000 * MS


def clouds(
    stamps_ms: list[float] | None = None, *, late_ms: float = 4, turns: float = -1.0, parts: int = 1, hidden: int = 0
) -> list[TurnSample]:
    """Return looks at consecutive clouds, each ``1 / parts`` of a turn, without ``hidden`` of 90 directions."""
    stamps = [T0 + round(MS * each) for each in (stamps_ms or range(0, 1100, 100))]
    width = 90 // parts
    seen = (1 << width) - 1 >> hidden
    directions = [seen << number % parts * width for number in range(len(stamps))]
    return [
        TurnSample(stamp, stamp + round(late_ms * MS), turns, own)
        for stamp, own in zip(stamps, directions, strict=True)
    ]


@pytest.mark.parametrize(("text", "expected"), rows(TABLES, "options"))
def test_options_are_parsed(text: str, expected: tuple[Any, ...]) -> None:
    assert Turn.parse(text) == Turn(*expected)


def test_period_direction_and_stamp_are_measured() -> None:
    turn, note = measure_turn("/points", Turn(), clouds())
    assert turn == Turn(0.1, -1, True)
    assert note.endswith("one turn takes 0.1 s, clockwise, and the stamp is that of the last point")
    assert measure_turn("/points", Turn(), clouds(turns=64.0))[0] == Turn(0.1, 1, True)
    # One that is logged at its stamp is not logged before it.
    assert measure_turn("/points", Turn(), clouds(late_ms=0)[:1] + clouds()[1:])[0] == Turn(0.1, -1, True)


def test_a_missing_cloud_and_jitter_change_nothing() -> None:
    turn, _ = measure_turn("/points", Turn(), clouds([0, 100, 200, 401, 500, 600, 696, 800, 900, 1002, 1101]))
    assert turn.period == 0.1


@pytest.mark.parametrize(("seen", "why", "typed"), rows(TABLES, "insufficient evidence"))
def test_insufficient_evidence_is_refused_with_what_to_type(seen: dict[str, Any], why: str, typed: str) -> None:
    other = seen.pop("other_way_from", None)
    found = clouds(**seen) if other is None else clouds()[:other] + clouds(turns=1.0)[other:]
    with pytest.raises(ParameterError) as caught:
        measure_turn("/points", Turn(), found)
    assert why in caught.value.message
    assert f"`point_time={typed}`" in str(caught.value.hint)


@pytest.mark.parametrize(("is_columns", "sign"), [(True, 1), (False, -1)])
def test_turns_and_directions_of_a_cloud(is_columns: bool, sign: int) -> None:
    azimuth = np.linspace(0.3, 0.3 + 2 * math.pi, 600, endpoint=False) * sign
    x, y = (np.tile(each, (16, 1)).astype(np.float32) for each in (5 * np.cos(azimuth), 5 * np.sin(azimuth)))
    if is_columns:
        x, y = x.T.ravel(), y.T.ravel()
    x[..., 7] = np.nan
    found = turn_sample(Points(0, T0, "lidar", {"x": x, "y": y, "z": 0 * x}), T0 + 5)
    assert found.directions.bit_count() >= 89
    assert found.turns * sign == pytest.approx(1 if is_columns else 16, rel=0.01)
