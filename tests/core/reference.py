"""The projection one point at a time, in the words of upstream's callback: what the fast one has to equal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.counts import PointCounts

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from pc2scan.core.params import ProjectionParams


def float32(value: float) -> float:
    """The nearest float32; inf beyond the largest one."""
    with np.errstate(over="ignore"):
        return float(np.float32(value))


def reference_moved(
    points: Iterable[Iterable[float]], rotation: NDArray[Any], translation: NDArray[Any]
) -> NDArray[np.float32]:
    """Points, (N, 3), transformed as tf2_sensor_msgs does it: rounded to float32 after every operation."""
    rows = [tuple(np.float32(value) for value in row) for row in rotation]
    offsets = [np.float32(value) for value in translation]
    moved = []
    with np.errstate(all="ignore"):
        for point in points:
            x, y, z = (np.float32(value) for value in point)
            moved.append([((a * x + b * y) + c * z) + t for (a, b, c), t in zip(rows, offsets, strict=True)])
    return np.array(moved, np.float32).reshape(-1, 3)


def reference_rotation(quaternion: Iterable[float]) -> NDArray[np.float32]:
    """Eigen's ``Quaternion<float>::toRotationMatrix``, in its words."""
    x, y, z, w = (np.float32(value) for value in quaternion)
    one, two = np.float32(1), np.float32(2)
    tx, ty, tz = two * x, two * y, two * z
    twx, twy, twz = tx * w, ty * w, tz * w
    txx, txy, txz = tx * x, ty * x, tz * x
    tyy, tyz, tzz = ty * y, tz * y, tz * z
    rows = [
        [one - (tyy + tzz), txy - twz, txz + twy],
        [txy + twz, one - (txx + tzz), tyz - twx],
        [txz - twy, tyz + twx, one - (txx + tyy)],
    ]
    assert all(value.dtype == np.float32 for row in rows for value in row)
    return np.array(rows)


def reference_scan(
    points: Iterable[Iterable[float]], params: ProjectionParams, angles: NDArray[np.float32] | None = None
) -> tuple[NDArray[np.float32], PointCounts]:
    """Ranges and counts of points, given as Python floats; with other angles of theirs than the correct ones."""
    angle_min, angle_max = float32(params.angle_min), float32(params.angle_max)
    angle_increment = float32(params.angle_increment)
    count = math.ceil(float32(float32(angle_max - angle_min) / angle_increment))
    empty = math.inf if params.use_inf else float32(float32(params.range_max) + params.inf_epsilon)
    ranges = [empty] * count
    nan = height = too_far = outside = past_end = total = 0
    for point in points:
        total += 1
        x, y, z = (float32(value) for value in point)
        if math.isnan(x) or math.isnan(y) or math.isnan(z):
            nan += 1
            continue
        if z > params.max_height or z < params.min_height:
            height += 1
            continue
        reach = float32(math.sqrt(x * x + y * y))
        if reach < params.range_min or reach > params.range_max:
            too_far += 1
            continue
        angle = float32(math.atan2(y, x)) if angles is None else float(angles[total - 1])
        if angle < angle_min or angle > angle_max:
            outside += 1
            continue
        index = int((angle - angle_min) / angle_increment)
        if index >= count:
            past_end += 1
        elif reach < ranges[index]:
            ranges[index] = reach
    used = total - nan - height - too_far - outside - past_end
    return np.array(ranges, np.float32), PointCounts(
        total, used, nan=nan, height=height, range=too_far, angle=outside, past_end=past_end
    )
