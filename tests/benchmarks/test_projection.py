"""What the projection costs beside a straightforward one. Run it with ``pytest -m benchmark tests/benchmarks``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan import ProjectionParams
from pc2scan.core.project import Projector

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pytest_benchmark.fixture import BenchmarkFixture

    Columns = tuple[NDArray[Any], NDArray[Any], NDArray[Any]]

LAYOUTS = ["organised", "ring-major", "column-major", "random"]
HEIGHTS = {"all": (-100.0, 100.0), "band": (-0.5, 0.5)}


def straightforward(x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], params: ProjectionParams) -> NDArray[Any]:
    """The same scan as whole-array NumPy: float64 arctan2 and minimum.at over the cloud."""
    low, high = np.float32(params.angle_min), np.float32(params.angle_max)
    increment = np.float64(np.float32(params.angle_increment))
    with np.errstate(all="ignore"):
        ranges = np.hypot(x, y)
        angles = np.arctan2(y.astype(np.float64), x.astype(np.float64)).astype(np.float32)
        indices = (angles.astype(np.float64) - np.float64(low)) / increment
        heights, lengths = z.astype(np.float64), ranges.astype(np.float64)
        keep = ~(np.isnan(x) | np.isnan(y) | np.isnan(z))
        keep &= (heights >= params.min_height) & (heights <= params.max_height)
        keep &= (lengths >= params.range_min) & (lengths <= params.range_max)
        keep &= (angles >= low) & (angles <= high)
        keep &= indices < params.length
        scan = np.full(params.length, params.empty_range, np.float32)
        np.minimum.at(scan, indices[keep].astype(np.intp), ranges[keep])
    return scan


def cloud(points: int, layout: str, step: int = 32) -> Columns:
    """A rotating lidar's view of a yard: x, y and z as views of points of ``step`` bytes."""
    rng = np.random.default_rng(0)
    rings = max(1, min(64, points // 256))
    azimuth = np.linspace(-math.pi, math.pi, points // rings, endpoint=False) + 1e-4
    elevation = np.deg2rad(np.linspace(-25, 15, rings))[:, None]
    azimuth = azimuth + rng.normal(0, 2e-4, (rings, azimuth.size))
    walls = np.minimum(20 / np.abs(np.cos(azimuth)), 12 / np.abs(np.sin(azimuth)))
    walls = np.minimum(walls, 8 + 3 * np.sin(7 * azimuth) + 20 * (np.sin(3 * azimuth) > 0))
    ground = np.where(elevation < 0, 1.8 / np.tan(np.maximum(-elevation, 1e-9)), np.inf)
    length = np.minimum(walls, ground) * rng.normal(1, 0.002, azimuth.shape)
    missing = rng.random(azimuth.shape) < 0.05
    length[missing] = np.nan
    scene = np.stack([length * np.cos(azimuth), length * np.sin(azimuth), length * np.tan(elevation)], axis=-1).astype(
        np.float32
    )
    if layout == "column-major":
        scene, missing = scene.swapaxes(0, 1), missing.T
    if layout != "organised":
        # Drivers keep the grid and mark what is missing, or leave both out.
        scene = scene[~missing]
    if layout == "random":
        scene = rng.permutation(scene)
    memory = np.zeros((*scene.shape[:-1], step // 4), np.float32)
    memory[..., :3] = scene
    return memory[..., 0], memory[..., 1], memory[..., 2]


def params_of(beams: int, heights: str) -> ProjectionParams:
    low, high = HEIGHTS[heights]
    return ProjectionParams(min_height=low, max_height=high, angle_increment=2 * math.pi / beams)


@pytest.mark.benchmark
@pytest.mark.parametrize("implementation", ["projector", "straightforward"])
@pytest.mark.parametrize("heights", HEIGHTS)
@pytest.mark.parametrize("beams", [360, 36_000])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_131072_points(benchmark: BenchmarkFixture, layout: str, beams: int, heights: str, implementation: str) -> None:
    benchmark.group = f"{layout}, {beams} beams, {heights}"
    x, y, z = cloud(131_072, layout)
    params = params_of(beams, heights)
    benchmark.extra_info["points"] = x.size
    expected = straightforward(x, y, z, params)
    if implementation == "projector":
        np.testing.assert_array_equal(benchmark(Projector(params), x, y, z).ranges, expected)
    else:
        np.testing.assert_array_equal(benchmark(straightforward, x, y, z, params), expected)


@pytest.mark.benchmark
@pytest.mark.parametrize("implementation", ["projector", "straightforward"])
@pytest.mark.parametrize("points", [1_000, 16_384, 2_000_000])
def test_sizes(benchmark: BenchmarkFixture, points: int, implementation: str) -> None:
    benchmark.group = f"ring-major, 360 beams, {points} points"
    x, y, z = cloud(points, "ring-major")
    params = params_of(360, "all")
    benchmark.extra_info["points"] = x.size
    expected = straightforward(x, y, z, params)
    if implementation == "projector":
        np.testing.assert_array_equal(benchmark(Projector(params), x, y, z).ranges, expected)
    else:
        np.testing.assert_array_equal(benchmark(straightforward, x, y, z, params), expected)
