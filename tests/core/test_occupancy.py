"""The grid against one that is filled cell by cell, and the compiled loop against NumPy's."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core import kernel, plain
from pc2scan.core.occupancy import FREE, OCCUPIED, UNSEEN, OccupancyGrid, observing_beams, place_beams
from pc2scan.core.rigid import Rigid
from pc2scan.core.unproject import UnprojectParams, deskew, unproject
from pc2scan.errors import DecodeError, UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

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


rays = st.lists(st.tuples(*[st.integers(-40, 40)] * 4, st.booleans()), max_size=30)


@given(st.lists(rays, min_size=1, max_size=6))
def test_cells_are_those_of_the_rules(scans: list[list[Ray]]) -> None:
    grid = OccupancyGrid(0.5, 10_000)
    for scan in scans:
        ends = np.array([ray[:4] for ray in scan], np.float64).reshape(-1, 4) * 0.5 + 0.25
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


def traced(
    trace: object, shape: tuple[int, int], scans: Sequence[tuple[NDArray[np.int32], NDArray[np.bool_]]]
) -> object:
    assert callable(trace)
    cells = np.full(shape, -128 * 256, np.int16)
    for number, (lines, hits) in enumerate(scans, 1):
        trace(cells, shape[1], number, lines, hits)
    return cells


@pytest.mark.skipif(not kernel.COMPILED, reason="there was no C compiler")
@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 1), (37, 53)])
def test_both_loops_draw_the_same(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(5)
    scans = []
    for count in (0, 1, 300, 700, 700):
        lines = rng.integers(0, shape[::-1] * 2, (count, 4)).astype(np.int32)
        lines[count // 2 :, :2] = lines[:1, :2]
        lines[count // 3 : count // 2] = lines[count // 3 : count // 3 + 1]
        scans.append((lines, rng.random(count) < 0.7))
    np.testing.assert_array_equal(traced(kernel.trace, shape, scans), traced(plain.trace, shape, scans))


def test_arrays_that_do_not_fit_together_are_refused() -> None:
    cells, ray, hit = np.zeros((3, 4), np.int16), np.zeros((1, 4), np.int32), np.ones(1, bool)
    kernel.trace(cells, 4, 1, ray, hit)
    fixed = cells.copy()
    fixed.setflags(write=False)
    wrong: list[tuple[object, ...]] = [
        (cells.astype(np.int32), 4, 1, ray, hit),
        (cells, 5, 1, ray, hit),
        (cells, 0, 1, ray, hit),
        (cells, 4, 256, ray, hit),
        (cells, 4, -1, ray, hit),
        (cells, 4, 1, ray.astype(np.int64), hit),
        (cells, 4, 1, ray, np.ones(2, bool)),
        (cells[:, ::2], 2, 1, ray, hit),
        (fixed, 4, 1, ray, hit),
    ]
    for corner in ([4, 0, 0, 0], [0, 3, 0, 0], [0, 0, -1, 0], [0, 0, 0, 2**31 - 1], [0, -(2**31), 0, 0]):
        outside = np.array([corner], np.int32)
        with pytest.raises(ValueError, match="leaves the grid"):
            plain.trace(cells, 4, 1, outside, hit)
        wrong.append((cells, 4, 1, outside, hit))
    if kernel.COMPILED:
        for arguments in wrong:
            with pytest.raises((ValueError, BufferError)):
                kernel.trace(*arguments)  # type: ignore[arg-type]


def test_marks_are_used_again() -> None:
    grid = OccupancyGrid(1.0, 1000)
    here, there = np.array([[0.5, 0.5]]), np.array([[3.5, 0.5]])
    # Less than one hit in three: the cell is free, unless some scans do not count.
    for number in range(1000):
        grid.add(here, there, np.array([number % 4 == 0]))
    found = grid.occupancy()
    assert found is not None
    assert found.cells.tolist() == [[FREE, FREE, FREE, FREE]]
    for _ in range(10):
        grid.add(here, there, np.array([True]))
    found = grid.occupancy()
    assert found is not None
    assert found.cells.tolist() == [[FREE, FREE, FREE, OCCUPIED]]


def test_what_the_beams_of_a_scan_say() -> None:
    ranges = np.array([np.nan, np.inf, -np.inf, 0.05, 0.1, 5.0, 9.9, 10.0, 11.0, -1.0], np.float32)
    beams = observing_beams(ranges, 0.1, 10.0)
    # 0.1 as float32 is more than 0.1.
    assert beams.numbers.tolist() == [4, 5, 6]
    assert beams.hits.all()
    shorter = observing_beams(ranges, 0.1, 10.0, longest=6.0)
    assert shorter.lengths.tolist() == [pytest.approx(0.1), 5.0, 6.0]
    assert shorter.hits.tolist() == [True, True, False]
    endless = observing_beams(ranges, 0.1, np.inf)
    assert endless.numbers.tolist() == [4, 5, 6, 7, 8]
    assert observing_beams(ranges, 0.1, np.nan).numbers.size == 0


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


def test_a_grid_that_would_be_too_large_is_refused() -> None:
    grid = OccupancyGrid(0.05, 1_000_000)
    here, hit = np.zeros((1, 2)), np.array([True])
    grid.add(here, np.array([[40.0, 40.0]]), hit)
    with pytest.raises(UsageError, match=r"2,001 x 801 cells of 0.05 m \(100 x 40 m\); at most 1,000,000"):
        grid.add(here, np.array([[100.0, 0.0]]), hit)
    with pytest.raises(UsageError, match="m from the origin"):
        grid.add(here, np.array([[1e300, 0.0]]), hit)
    # What is there stays as it was.
    found = grid.occupancy()
    assert found is not None
    assert found.cells.shape == (801, 801)


def test_a_scan_that_would_take_too_long_is_refused() -> None:
    grid = OccupancyGrid(0.001, 64 << 20)
    ends = np.stack((np.full(1000, 40.0), np.linspace(0, 0.5, 1000)), axis=1)
    with pytest.raises(DecodeError, match="cross more than 33,554,432 cells"):
        grid.add(np.zeros((1000, 2)), ends, np.ones(1000, bool))
    grid.add(np.zeros((100, 2)), ends[:100], np.ones(100, bool))
    assert grid.occupancy() is not None
