"""Every angle belongs to the beam that looks closest by."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core import kernel
from pc2scan.core.layout import TURN, BeamLayout, centered_layout
from pc2scan.core.plain import bins_of
from pc2scan.core.rule import centered_beams

if TYPE_CHECKING:
    from numpy.typing import NDArray

PI = math.pi
#: What float64 may be off by in an angle of some turns.
EXACT = 4e-15


def bins_of_angles(layout: BeamLayout, angles: NDArray[np.float32]) -> NDArray[np.intp]:
    return bins_of(angles, np.array([0.0] * 4 + [*centered_beams(layout)]), layout.count)


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
    bins = bins_of_angles(layout, angles)
    for angle, index in zip(angles.tolist(), bins.tolist(), strict=True):
        beams, offset = nearest(layout, angle)
        half = layout.angle_increment / 2
        if index == layout.count + 1:
            assert not layout.full_circle
            assert offset >= half - EXACT
        else:
            assert index in beams
            # Half an increment on either side; on a circle also half of what rounding has left of it.
            assert offset <= half + (4e-7 if layout.full_circle else EXACT)


@given(LAYOUTS, st.integers(0, 2**32 - 1))
@pytest.mark.usefixtures("loops")
def test_points_fall_where_their_angles_do(layout: BeamLayout, seed: int) -> None:
    random = np.random.default_rng(seed)
    beams = random.integers(-1, layout.count + 1, 400)
    # Half of them on edges, to the last bits of their coordinates.
    angles = layout.angle_min + (beams + random.choice([0.5, 0.5, 0.0, 0.3], 400)) * layout.angle_increment
    radii = random.uniform(0.1, 50, 400)
    x, y = (radii * np.cos(angles)).astype(np.float32), (radii * np.sin(angles)).astype(np.float32)
    expected = bins_of_angles(layout, np.arctan2(y, x, dtype=np.float64).astype(np.float32))
    rule = np.array([-math.inf, math.inf, 0.0, math.inf, *centered_beams(layout), 0.0])
    bins, ranges, numbers = np.empty(400, np.int32), np.empty(400, np.float32), np.empty(400, np.int64)
    rejected = kernel.gather(x, y, np.zeros_like(x), rule, None, layout.count, bins, ranges, numbers)
    used = 400 - sum(rejected)
    np.testing.assert_array_equal(numbers[:used], np.flatnonzero(expected < layout.count))
    np.testing.assert_array_equal(bins[:used], expected[expected < layout.count])


@pytest.mark.parametrize(("low", "high"), [(-PI, PI), (0.0, 2 * PI), (0.3, 0.3 + 2 * PI), (-7.0, -7.0 + 2 * PI)])
@pytest.mark.parametrize("beams", [2, 3, 4, 7, 360, 1440, 40_000])
def test_a_circle_wraps_around(low: float, high: float, beams: int) -> None:
    layout = centered_layout(low, high, 1.0, beams)
    middles = layout.angle_min + np.arange(beams) * layout.angle_increment
    for offset in (0.0, 0.49, -0.49):
        angles = np.remainder(middles + offset * layout.angle_increment + PI, TURN) - PI
        np.testing.assert_array_equal(bins_of_angles(layout, angles.astype(np.float32)), np.arange(beams))


def test_the_directions_that_atan2_doubles_are_one_beam() -> None:
    layout = centered_layout(-PI, PI, PI / 180)
    x, y = np.array([-1, -1, -1, -1], np.float32), np.array([0.0, -0.0, 1e-30, -1e-30], np.float32)
    assert bins_of_angles(layout, np.arctan2(y, x)).tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize("start", [-PI / 2, np.nextafter(np.float32(-PI / 2), np.float32(0)), PI + PI / 2])
def test_pi_as_float32_is_beyond_an_edge_at_pi(start: float) -> None:
    layout = centered_layout(float(start), float(start) + 2 * PI, PI)
    angle = np.float32(PI)
    beams, _ = nearest(layout, float(angle))
    assert set(bins_of_angles(layout, np.array([angle])).tolist()) == beams


def test_beams_of_a_sector_end_half_an_increment_outside() -> None:
    layout = centered_layout(-0.5, 0.5, 0.25)
    angles = np.array([-0.63, -0.625, -0.62, -0.376, -0.374, 0.0, 0.374, 0.62, 0.625, 0.63, 3.1, -3.1], np.float32)
    assert bins_of_angles(layout, angles).tolist() == [6, 0, 0, 0, 1, 2, 3, 4, 4, 6, 6, 6]
