"""What deskewing costs beside the projection at one time. Run it with ``pytest -m benchmark tests/benchmarks``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from benchmarks.test_projection import HEIGHTS, cloud, params_of
from pc2scan.core.points import Points
from pc2scan.core.project import Projector
from pc2scan.core.rigid import Rigid
from pc2scan.pipeline.stages.deskew import Deskew, PointTime
from pc2scan.tf.builder import TransformBuilder
from pc2scan.tf.placing import Frames

if TYPE_CHECKING:
    from collections.abc import Callable

    from pytest_benchmark.fixture import BenchmarkFixture

SECOND = 1_000_000_000
T0 = 1_700_000_000 * SECOND


def driven() -> Frames:
    """A robot at 1.5 m/s and 1 rad/s, with odometry at 50 Hz and a tilted lidar."""
    builder = TransformBuilder()
    for number in range(-50, 51):
        seconds = number / 50
        pose = Rigid.from_rpy(0.0, 0.0, seconds, (1.5 * math.sin(seconds), 1.5 - 1.5 * math.cos(seconds), 0.0)).pose
        builder.add([("odom", "base_link", T0 + number * SECOND // 50, *pose)], static=False)
    builder.add([("base_link", "lidar", T0, *Rigid.from_rpy(0.1, -0.2, 0.7, (0.3, -0.1, 0.5)).pose)], static=True)
    return Frames("base_link", "", builder.build(), 0)


def timed_cloud(layout: str) -> Points:
    """Points of 32 bytes with the field t, as Ouster's driver has them: nanoseconds since the cloud's beginning."""
    x, y, z = cloud(131_072, layout)
    record = np.dtype(
        {"names": list("xyzt"), "formats": ["<f4"] * 3 + ["<u4"], "offsets": [0, 4, 8, 20], "itemsize": 32}
    )
    data = np.zeros(x.shape, record)
    data["x"], data["y"], data["z"] = x, y, z
    if layout == "organised":
        data["t"] = np.arange(x.shape[1]) * (SECOND // 10 // x.shape[1])
    else:
        data["t"] = ((np.arctan2(y, x) + math.pi) / (2 * math.pi) * 0.999e8).astype(np.uint32)
    return Points(0, T0, "lidar", {name: data[name] for name in "xyzt"})


def tasks(layout: str, heights: str) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """The projection at the cloud's stamp, and that of every point at its own time."""
    frames, points, project = driven(), timed_cloud(layout), Projector(params_of(360, heights))
    deskew = Deskew(frames, "odom", PointTime())

    def plain() -> Any:
        transform = frames.place("lidar", T0).target_from_source
        assert transform is not None
        return project(*points.xyz(), transform.as_float32())

    def deskewed() -> Any:
        moving = deskew(points)
        assert moving is not None
        return project(*points.xyz(), moving.transform)

    return plain, deskewed


@pytest.mark.benchmark
@pytest.mark.parametrize("how", ["at one time", "deskewed"])
@pytest.mark.parametrize("heights", HEIGHTS)
@pytest.mark.parametrize("layout", ["organised", "ring-major", "column-major"])
def test_131072_points_of_a_moving_lidar(benchmark: BenchmarkFixture, layout: str, heights: str, how: str) -> None:
    benchmark.group = f"deskewing, {layout}, {heights}"
    plain, deskewed = tasks(layout, heights)
    scan = benchmark(deskewed if how == "deskewed" else plain)
    assert scan.counts.used > 1000
