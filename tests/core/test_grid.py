"""Which beam an angle falls into: by upstream's rule, and to the one that looks closest by."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.grid import centered_slots, upstream_slots
from pc2scan.core.layout import TURN, BeamLayout, centered_layout, upstream_layout

if TYPE_CHECKING:
    from numpy.typing import NDArray

PI = math.pi
#: What float64 may be off by in an angle of some turns.
EXACT = 4e-15


def nearest(layout: BeamLayout, angle: float) -> tuple[set[int], float]:
    """The beams that look closest to an angle, one by one, and how far off they look."""
    offsets = [
        abs(math.remainder(angle - (layout.angle_min + beam * layout.angle_increment), TURN))
        for beam in range(layout.count)
    ]
    least = min(offsets)
    return {beam for beam, offset in enumerate(offsets) if offset <= least + EXACT}, least


LAYOUTS = st.builds(
    centered_layout,
    st.one_of(st.sampled_from([-PI, 0.0, -PI / 2, 1.0, -7.0]), st.floats(-8, 8)),
    st.just(0.0),
    st.just(1.0),
).flatmap(
    lambda start: st.builds(
        centered_layout,
        st.just(start.angle_min),
        st.one_of(st.just(2 * PI), st.floats(0.1, 6.3)).map(lambda span: start.angle_min + span),
        st.one_of(st.sampled_from([PI / 180, PI / 4, 0.0175, 0.5, 2.5]), st.floats(0.02, 3)),
    )
)


@st.composite
def layouts_and_angles(draw: st.DrawFn) -> tuple[BeamLayout, NDArray[np.float32]]:
    layout = draw(LAYOUTS)
    beams = st.integers(0, layout.count)
    edges = beams.map(lambda beam: layout.angle_min + (beam - 0.5) * layout.angle_increment)
    special = st.sampled_from([PI, -PI, 0.0, -0.0, PI / 2, float(np.float32(PI)), -float(np.float32(PI))])
    around = st.one_of(edges, special, st.floats(-PI, PI)).map(lambda angle: math.remainder(angle, TURN))
    drawn = draw(st.lists(st.tuples(around, st.integers(-2, 2)), min_size=1, max_size=30))
    angles = np.array([angle for angle, _ in drawn], np.float32)
    for number, (_, steps) in enumerate(drawn):
        for _ in range(abs(steps)):
            angles[number] = np.nextafter(angles[number], np.float32(math.copysign(9, steps)))
    return layout, np.clip(angles, -np.float32(PI), np.float32(PI))


@given(layouts_and_angles())
def test_an_accepted_angle_belongs_to_the_nearest_beam(case: tuple[BeamLayout, NDArray[np.float32]]) -> None:
    layout, angles = case
    slots = centered_slots(angles, layout)
    for angle, slot in zip(angles.tolist(), slots.tolist(), strict=True):
        beams, offset = nearest(layout, angle)
        half = layout.angle_increment / 2
        if slot == layout.count + 1:
            assert not layout.full_circle
            assert offset >= half - EXACT
        else:
            assert slot in beams
            # Half an increment on either side; on a circle also half of what rounding has left of it.
            assert offset <= half + (4e-7 if layout.full_circle else EXACT)


@pytest.mark.parametrize(("low", "high"), [(-PI, PI), (0.0, 2 * PI), (0.3, 0.3 + 2 * PI), (-7.0, -7.0 + 2 * PI)])
@pytest.mark.parametrize("beams", [2, 3, 4, 7, 360, 1440, 40_000])
def test_a_circle_wraps_around(low: float, high: float, beams: int) -> None:
    layout = centered_layout(low, high, 1.0, beams)
    middles = layout.angle_min + np.arange(beams) * layout.angle_increment
    for offset in (0.0, 0.49, -0.49):
        angles = np.remainder(middles + offset * layout.angle_increment + PI, TURN) - PI
        np.testing.assert_array_equal(centered_slots(angles.astype(np.float32), layout), np.arange(beams))


def test_the_directions_that_atan2_doubles_are_one_beam() -> None:
    layout = centered_layout(-PI, PI, PI / 180)
    x, y = np.array([-1, -1, -1, -1], np.float32), np.array([0.0, -0.0, 1e-30, -1e-30], np.float32)
    assert centered_slots(np.arctan2(y, x, dtype=np.float64).astype(np.float32), layout).tolist() == [0, 0, 0, 0]


def test_beams_of_a_sector_end_half_an_increment_outside() -> None:
    layout = centered_layout(-0.5, 0.5, 0.25)
    angles = np.array([-0.63, -0.625, -0.62, -0.376, -0.374, 0.0, 0.374, 0.62, 0.625, 0.63, 3.1, -3.1], np.float32)
    assert centered_slots(angles, layout).tolist() == [6, 0, 0, 0, 1, 2, 3, 4, 4, 6, 6, 6]


@given(
    st.floats(-4, 2),
    st.floats(0.1, 7),
    st.floats(0.002, 2),
    st.lists(st.one_of(st.floats(-PI, PI), st.integers(0, 400)), min_size=1, max_size=40),
)
def test_upstreams_beams(low: float, span: float, increment: float, wanted: list[float | int]) -> None:
    layout = upstream_layout(low, low + span, increment)
    # Whole numbers mean the edges of beams.
    edges = [layout.angle_min + value * layout.angle_increment if isinstance(value, int) else value for value in wanted]
    angles = np.array([edge for edge in edges if abs(edge) <= PI] or [0.0], np.float32)
    for angle, slot in zip(angles.tolist(), upstream_slots(angles, layout).tolist(), strict=True):
        if not layout.angle_min <= angle <= layout.angle_max:
            assert slot == layout.count + 1
        else:
            index = int((angle - layout.angle_min) / layout.angle_increment)
            assert slot == (min(layout.count, index))
