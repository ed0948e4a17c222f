"""What centered scans advertise: angles that consumers compute with."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.layout import TURN, centered_layout
from support.tables import rows

TABLES = Path(__file__).with_name("layouts.txt")

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
