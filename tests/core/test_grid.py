from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan import ProjectionParams
from pc2scan.core import grid as grid_module
from pc2scan.core.grid import Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

PI32 = float(np.float32(np.pi))


def beams_of(low: float, high: float, increment: float) -> Grid:
    return Grid(ProjectionParams(angle_min=low, angle_max=high, angle_increment=increment))


def find_slots(grid: Grid, x: NDArray[np.float32], y: NDArray[np.float32]) -> tuple[NDArray[np.intp], int]:
    out = np.empty(x.size, np.intp)
    close = grid.find_slots(x, y, out, (np.empty(x.size, np.float32), np.empty(x.size, np.float32)))
    return out, close


GRIDS = {
    "defaults": (-math.pi, math.pi, math.pi / 180),
    "0.01 degrees": (-math.pi, math.pi, math.pi / 18000),
    "odd increment": (-math.pi, math.pi, 0.0061359),
    "too fine": (-math.pi, math.pi, 3e-6),
    "one beam": (-math.pi, math.pi, 7.0),
    "front": (-0.5, 0.5, 0.01),
    "cut last beam": (-0.3, 2.0, 0.0061),
    "0 to 2 pi": (0.0, 2 * math.pi, 0.004),
    "beyond pi": (-10.0, 10.0, 0.01),
    "behind": (3.0, 3.3, 0.001),
    "nowhere": (4.0, 5.0, 0.1),
    "far away": (-1000.0, 1000.0, 0.05),
    "sliver": (0.1, 0.1001, 1e-6),
    "one sliver": (0.1, 0.1001, 1.0),
}


def edge_points(grid: tuple[float, float, float], rng: np.random.Generator) -> NDArray[np.float32]:
    """Points on the edges of beams and on both limits, and some float32 beside them."""
    low, high, increment = (float(np.float32(value)) for value in grid)
    count = math.ceil((high - low) / increment)
    edges = low + increment * rng.integers(0, count + 2, 20_000)
    edges = np.concatenate([edges, np.repeat([low, high, 0.0, np.pi, -np.pi, np.pi / 2], 500)])
    edges = edges[np.abs(edges) < 3.2]
    radius = 10.0 ** rng.uniform(-2, 3, edges.size)
    points = np.stack([radius * np.cos(edges), radius * np.sin(edges)]).astype(np.float32)
    points.view(np.int32)[...] += rng.integers(-3, 4, points.shape, dtype=np.int32)
    # One below zero's bit pattern is a NaN.
    return points[:, ~np.isnan(points).any(axis=0)]


@pytest.mark.parametrize("name", GRIDS)
def test_points_get_the_slot_of_their_exact_angle(name: str) -> None:
    rng = np.random.default_rng(7)
    grid = beams_of(*GRIDS[name])
    wide = rng.normal(size=(2, 20_000)).astype(np.float32)
    integers = rng.integers(-9, 10, (2, 20_000)).astype(np.float32)
    signed_zeros = np.array([[-1, -1, 1, 1, 0.0, -0.0, 0.0, -0.0], [0.0, -0.0, 0.0, -0.0, 0.0, 0.0, -0.0, -0.0]])
    tiny = (wide * np.float32(1e-41)).astype(np.float32)
    huge = wide[:, :2000] * np.float32(3e37)
    x, y = np.concatenate(
        [wide, integers, signed_zeros.astype(np.float32), tiny, huge, edge_points(GRIDS[name], rng)], axis=1
    )
    with np.errstate(all="ignore"):
        angles = np.arctan2(y.astype(np.float64), x.astype(np.float64)).astype(np.float32)
        expected = grid.slots_of_angles(angles)
        np.testing.assert_array_equal(grid.slots_of_points(x, y), expected)
        if grid.coarse:
            np.testing.assert_array_equal(find_slots(grid, x, y)[0], expected)
    assert grid.coarse == (name not in {"too fine", "sliver"})
    assert expected.min() >= 0
    assert expected.max() < grid.slots


@pytest.mark.parametrize(("beams", "share"), [(360, 0.001), (36_000, 0.04)])
def test_few_points_are_close_to_an_edge(beams: int, share: float) -> None:
    x, y = np.random.default_rng(1).normal(size=(2, 100_000)).astype(np.float32)
    slots, close = find_slots(beams_of(-math.pi, math.pi, 2 * math.pi / beams), x, y)
    assert slots.size == x.size
    assert 0 < close < share * x.size


def test_the_error_of_float32_arctan2_is_below_what_the_grid_allows() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(2, 1_000_000)).astype(np.float32)
    y[::2] *= np.float32(10) ** rng.integers(-8, 8, 500_000).astype(np.float32)
    fast = np.arctan2(y, x).astype(np.float64)
    rounded = np.arctan2(y.astype(np.float64), x.astype(np.float64)).astype(np.float32)
    assert np.max(np.abs(fast - rounded)) < grid_module._ANGLE_ERROR


def test_a_beam_is_half_open_and_angle_max_falls_behind_the_last_one() -> None:
    grid = beams_of(-1.0, 1.0, 0.5)
    below = np.nextafter(np.float32(-0.5), np.float32(-1))
    above = np.nextafter(np.float32(1), np.float32(2))
    angles = np.array([-1, below, -0.5, 0, 0.5, 1, above, -above], np.float32)
    assert grid.slots_of_angles(angles).tolist() == [0, 0, 1, 2, 3, grid.past_end, grid.outside, grid.outside]


def test_angle_max_cuts_the_last_beam_off() -> None:
    grid = beams_of(0.0, 1.25, 0.5)
    assert grid.beams == 3
    beyond = np.nextafter(np.float32(1.25), np.float32(2))
    assert grid.slots_of_angles(np.array([1.0, 1.25, beyond], np.float32)).tolist() == [2, 2, grid.outside]


@pytest.mark.parametrize(
    ("low", "high", "whole"),
    [
        (-math.pi, math.pi, True),
        (-4.0, 4.0, True),
        (-PI32, float(np.nextafter(np.float32(PI32), np.float32(0))), False),
        (float(np.nextafter(np.float32(-PI32), np.float32(0))), PI32, False),
        (0.0, 2 * math.pi, False),
    ],
)
def test_whole_circle(low: float, high: float, whole: bool) -> None:
    assert beams_of(low, high, 0.1).whole_circle is whole


def test_slots_follow_the_beams() -> None:
    grid = beams_of(-math.pi, math.pi, math.pi / 180)
    assert (grid.beams, grid.past_end, grid.outside, grid.slots) == (360, 360, 361, 362)
