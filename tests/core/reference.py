"""The projection one point at a time, in the words of upstream's callback: what the fast one has to equal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.project import PointCounts

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from pc2scan.core.params import ProjectionParams


def float32(value: float) -> float:
    """The nearest float32; inf beyond the largest one."""
    with np.errstate(over="ignore"):
        return float(np.float32(value))


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
    return np.array(ranges, np.float32), PointCounts(total, used, nan, height, too_far, outside, past_end)
