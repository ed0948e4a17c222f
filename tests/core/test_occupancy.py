"""The grid against one that is filled cell by cell, by the compiled loop and by NumPy's."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.occupancy import FREE, OCCUPIED, UNSEEN, OccupancyGrid, observing_beams, place_beams
from pc2scan.core.rigid import Rigid
from pc2scan.core.unproject import UnprojectParams, deskew, unproject
from support.loops import BOTH_LOOPS

if TYPE_CHECKING:
    from collections.abc import Sequence


Ray = tuple[int, int, int, int, bool]


def line(x0: int, y0: int, x1: int, y1: int) -> list[tuple[int, int]]:
    """The cells nearest to a straight line, one for each step along its longer side; halves go away from the start."""
    longer = max(abs(x1 - x0), abs(y1 - y0))
    cells = []
    for step in range(longer + 1):
        offsets = [math.floor(abs(end) * step / longer + 0.5) if longer else 0 for end in (x1 - x0, y1 - y0)]
        cells.append((x0 + int(math.copysign(offsets[0], x1 - x0)), y0 + int(math.copysign(offsets[1], y1 - y0))))
    return cells


def reference(scans: Sequence[Sequence[Ray]]) -> dict[tuple[int, int], float]:
    """Log-odds of each cell by the rules, in a dict of floats."""
    odds: dict[tuple[int, int], float] = {}
    for rays in scans:
        hits = {(x1, y1) for _, _, x1, y1, hit in rays if hit}
        passed = {cell for x0, y0, x1, y1, hit in rays for cell in line(x0, y0, x1, y1)[: -1 if hit else None]}
        for cell in hits:
            odds[cell] = min(odds.get(cell, 0) + 0.85, 3.5)
        for cell in passed - hits:
            odds[cell] = max(odds.get(cell, 0) - 0.4, -2)
    return odds


rays = st.lists(st.tuples(*[st.integers(-15, 15)] * 4, st.booleans()), max_size=30)


@pytest.mark.parametrize("loops", BOTH_LOOPS, ids=lambda loops: loops.__name__)
@given(st.lists(rays, min_size=1, max_size=6))
def test_cells_are_those_of_the_rules(loops: Any, scans: list[list[Ray]]) -> None:
    grid = OccupancyGrid(0.5, 10_000)
    for scan in scans:
        ends = np.array([ray[:4] for ray in scan], np.float64).reshape(-1, 4) * 0.5 + 0.25
        with loops():
            grid.add(ends[:, :2], ends[:, 2:], np.array([ray[4] for ray in scan], bool))
    expected = reference(scans)
    found = grid.occupancy()
    if not expected:
        assert found is None
        return
    assert found is not None
    columns, rows = zip(*expected, strict=True)
    assert (found.x, found.y) == (min(columns) * 0.5, min(rows) * 0.5)
    assert found.cells.shape == (max(rows) - min(rows) + 1, max(columns) - min(columns) + 1)
    states = np.full(found.cells.shape, UNSEEN, np.int8)
    for (column, row), odds in expected.items():
        states[row - min(rows), column - min(columns)] = OCCUPIED if odds > 1e-9 else FREE
    np.testing.assert_array_equal(found.cells, states)


@pytest.mark.parametrize("moving", [False, True])
def test_beams_are_where_laser_geometry_has_them(moving: bool) -> None:
    rng = np.random.default_rng(3)
    ranges = rng.uniform(0, 12, 300).astype(np.float32)
    angle_min, increment = np.float32(-1.5), np.float32(0.01)
    start = Rigid.from_rpy(0.02, -0.03, 0.4, (1.0, 2.0, 0.5))
    end = Rigid.from_rpy(0.01, -0.02, 0.6, (1.3, 2.1, 0.5))
    angles = float(angle_min) + np.arange(300) * float(increment)
    beams = observing_beams(ranges, 0.5, 10.0)
    directions = np.stack((np.cos(angles), np.sin(angles)))
    origins, ends = place_beams(beams, directions, 300, start, end if moving else None)
    points = unproject(
        ranges,
        np.empty(0, np.float32),
        angle_min=float(angle_min),
        angle_increment=float(increment),
        range_min=0.5,
        range_max=10.0,
        params=UnprojectParams(viewpoint=True),
    )
    expected = deskew(points, start, end if moving else start)
    np.testing.assert_array_equal(beams.numbers, points.beams)
    assert expected.viewpoint is not None
    np.testing.assert_allclose(ends, expected.xyz[:, :2], atol=3e-6)
    np.testing.assert_allclose(origins, expected.viewpoint[:, :2], atol=3e-6)
