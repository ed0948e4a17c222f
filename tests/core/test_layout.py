"""What centered scans advertise: angles that consumers compute with."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.layout import (
    TURN,
    centered_layout,
    float32,
    half_open_layout,
    symmetric_layout,
    upstream_layout,
)
from support.tables import rows

TABLES = Path(__file__).with_name("layouts.txt")

PI = math.pi
DEGREE = math.pi / 180


@pytest.mark.parametrize(
    ("angle_min", "angle_max", "angle_increment", "count", "full_circle"), rows(TABLES, "beams of a sector")
)
def test_beams_of_a_sector(
    angle_min: float, angle_max: float, angle_increment: float, count: int, full_circle: bool
) -> None:
    layout = centered_layout(angle_min, angle_max, angle_increment)
    assert (layout.count, layout.full_circle) == (count, full_circle)
    assert layout.angle_min == np.float32(angle_min)
    if not full_circle:
        assert layout.angle_increment == np.float32(angle_increment)


SECTORS = st.tuples(st.floats(-4, 4), st.floats(0.05, 7))
INCREMENTS = st.one_of(st.floats(1e-4, 0.04), st.sampled_from([DEGREE, DEGREE / 2, 0.0175, 0.0087, 0.01, 0.005]))


@given(SECTORS, INCREMENTS)
def test_angle_max_is_the_last_beams_and_no_beam_is_there_twice(sector: tuple[float, float], inc: float) -> None:
    low, span = sector
    layout = centered_layout(low, low + span, inc)
    last = layout.angle_min + (layout.count - 1) * layout.angle_increment
    assert layout.angle_max == float(np.float32(last))
    closing = TURN - layout.count * layout.angle_increment
    if layout.full_circle:
        # What rounding the increment down leaves, which no beam is that narrow to notice.
        assert 0 <= closing < 8e-7
        assert abs(layout.angle_increment - inc) <= inc * inc / 6
    else:
        assert closing > 0
        assert layout.angle_increment == np.float32(inc)
        # The last beam that there is room for; a thousandth of a beam is no lack of room.
        assert last <= low + span + 2e-3 * inc + 1e-6
        assert last + inc > low + span - 2e-3 * inc - 1e-6


@given(SECTORS, st.integers(2, 10_000))
def test_a_number_of_beams_fills_the_sector(sector: tuple[float, float], beams: int) -> None:
    low, span = sector
    layout = centered_layout(low, low + span, 1.0, beams)
    assert layout.count == beams
    if layout.full_circle:
        assert 0 <= TURN - beams * layout.angle_increment < 8e-7
    else:
        assert layout.angle_max == pytest.approx(low + span, abs=2e-6)


@given(SECTORS, st.integers(1, 10_000))
def test_upstream_advertises_the_parameters(sector: tuple[float, float], beams: int) -> None:
    low, high = sector[0], sector[0] + sector[1]
    layout = upstream_layout(low, high, 1.0, beams)
    assert layout.count == beams
    assert (layout.angle_min, layout.angle_max, layout.full_circle) == (float32(low), float32(high), False)
    assert layout.angle_increment == pytest.approx(sector[1] / beams, rel=1e-4, abs=1e-9)


@given(st.floats(-4, 4), st.floats(0.05, 7), st.integers(2, 3000))
def test_half_open_beams_are_the_centered_ones(angle_min: float, span: float, beams: int) -> None:
    centered = centered_layout(angle_min, angle_min + span, 0.0, beams)
    layout = half_open_layout(angle_min, angle_min + span, 0.0, beams)
    assert (layout.count, layout.angle_min, layout.angle_increment) == (
        centered.count,
        centered.angle_min,
        centered.angle_increment,
    )
    assert layout.angle_max == float32(layout.angle_min + layout.count * layout.angle_increment)
    assert half_open_layout(0.0, 1.0, 0.25).count == centered_layout(0.0, 1.0, 0.25).count == 5


@given(st.floats(0.05, 4), st.integers(3, 3000))
def test_symmetric_beams_have_0_in_their_middle(half: float, beams: int) -> None:
    layout = symmetric_layout(-half, half, 0.0, beams)
    assert layout.count == beams
    # They begin 20 float32 steps earlier than they end, so that the roundings of MRPT's indexes do not count.
    assert 0 < -(layout.angle_min + layout.angle_max) <= 20 * np.spacing(np.float32(-layout.angle_min))
    assert layout.angle_max == pytest.approx((beams - 1) * layout.angle_increment / 2, abs=5e-6)
    if layout.full_circle:
        assert layout.angle_max == pytest.approx(PI - layout.angle_increment / 2, abs=6e-6)
