"""What the benchmarks time, and the straightforward NumPy that it is compared with."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

import pc2scan
from benchmarks.clouds import cloud
from pc2scan import ProjectionParams
from pc2scan.conversion.stages.deskew import Deskew
from pc2scan.core.points import Points
from pc2scan.core.project import Projector
from pc2scan.core.rigid import Rigid
from pc2scan.request.point_time import PointTime
from pc2scan.transforms.builder import TransformBuilder
from pc2scan.transforms.placing import Placer

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

LAYOUTS = ["organised", "ring-major", "column-major", "random"]
HEIGHTS = {"all": (-100.0, 100.0), "band": (-0.5, 0.5)}


SECOND = 1_000_000_000
T0 = 1_700_000_000 * SECOND


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


def params_of(beams: int, heights: str) -> ProjectionParams:
    low, high = HEIGHTS[heights]
    return ProjectionParams(min_height=low, max_height=high, angle_increment=2 * math.pi / beams)


def driven() -> Placer:
    """A robot at 1.5 m/s and 1 rad/s, with odometry at 50 Hz and a tilted lidar."""
    builder = TransformBuilder()
    for number in range(-50, 51):
        seconds = number / 50
        pose = Rigid.from_rpy(0.0, 0.0, seconds, (1.5 * math.sin(seconds), 1.5 - 1.5 * math.cos(seconds), 0.0)).pose
        builder.add([("odom", "base_link", T0 + number * SECOND // 50, *pose)], static=False)
    builder.add([("base_link", "lidar", T0, *Rigid.from_rpy(0.1, -0.2, 0.7, (0.3, -0.1, 0.5)).pose)], static=True)
    return Placer("base_link", "", builder.build(), 0)


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


def deskewing_tasks(layout: str, heights: str) -> tuple[Callable[[], Any], Callable[[], Any]]:
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


def convert_two(source: Path, destination: Path, how: str, heights: str, jobs: int) -> pc2scan.Report:
    """Convert them: a scan of each, one scan, or one scan through a fixed frame."""
    params = pc2scan.ProjectionParams(target_frame="base_link", min_height=-1e6)
    if heights == "a band":
        params = pc2scan.ProjectionParams(target_frame="base_link", min_height=-0.5, max_height=1.0)
    return pc2scan.convert(
        source,
        destination,
        topics=("/front:=/scan", "/rear:=/scan") if how != "a scan of each" else ("/front:=/one", "/rear:=/other"),
        params=params,
        fixed_frame="odom" if "fixed" in how else "",
        only_scans=True,
        overwrite=True,
        jobs=jobs,
    )
