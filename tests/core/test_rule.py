"""Every angle belongs to the beam that looks closest by."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

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
