"""The projection one point at a time: what the fast one has to equal. Upstream's is in the words of its callback."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.core.rule import PointCounts

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

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


class Expected(NamedTuple):
    """What a scan of points is, and which beams have how many returns."""

    ranges: NDArray[np.float32]
    counts: PointCounts
    intensities: NDArray[np.float32]
    returns: NDArray[np.intp]


def reference_scan(
    points: Iterable[Iterable[float]],
    params: ProjectionParams,
    angles: NDArray[np.float32] | None = None,
    values: Sequence[float] | None = None,
) -> Expected:
    """Project points, given as Python floats; with other angles of theirs than the correct ones, and with values."""
    empty = params.empty_range
    if not params.no_return:
        empty = math.inf if params.use_inf else float32(float32(params.range_max) + params.inf_epsilon)
    # Upstream's beams begin with the range of no return, and closer points replace it.
    limit = empty if params.no_return in {"", "inf", "range-max-plus"} else math.inf
    rejected = dict.fromkeys(("nan", "height", "range", "angle", "past_end"), 0)
    beams: list[list[tuple[float, int]]] = [[] for _ in range(params.length)]
    total = 0
    for number, point in enumerate(points):
        total += 1
        x, y, z = (float32(value) for value in point)
        reach = float32(math.sqrt(x * x + y * y))
        beam: int | str
        if math.isnan(x) or math.isnan(y) or math.isnan(z):
            beam = "nan"
        elif z > params.max_height or z < params.min_height:
            beam = "height"
        elif reach < params.range_min or reach > params.range_max:
            beam = "range"
        else:
            beam = _beam_of(float32(math.atan2(y, x)) if angles is None else float(angles[number]), params)
        if isinstance(beam, str):
            rejected[beam] += 1
        elif reach < limit:
            beams[beam].append((reach, number))
    ranges, lit = np.full(len(beams), empty, np.float32), np.zeros(len(beams), np.float32)
    with np.errstate(all="ignore"):
        for beam, returns in enumerate(beams):
            if len(returns) >= max(params.min_points, params.kth, 1):
                ranges[beam], lit[beam] = _reading(returns, values or [0.0] * total, params)
    counts = PointCounts(total, total - sum(rejected.values()), **rejected)
    return Expected(ranges, counts, lit if values is not None else lit[:0], np.array([*map(len, beams)], np.intp))


def _beam_of(angle: float, params: ProjectionParams) -> int | str:
    """The beam of an angle, or why it has none."""
    layout = params.layout
    if params.geometry == "upstream":
        low, high = float32(params.angle_min), float32(params.angle_max)
        increment = float32(params.angle_increment)
        if angle < low or angle > high:
            return "angle"
        beam = int((angle - low) / increment)
        return beam if beam < math.ceil(float32(float32(high - low) / increment)) else "past_end"
    offset, beam = min(
        (abs(math.remainder(angle - layout.angle_min - beam * layout.angle_increment, math.tau)), beam)
        for beam in range(layout.count)
    )
    return beam if layout.full_circle or offset <= layout.angle_increment / 2 else "angle"


def _reading(
    returns: list[tuple[float, int]], values: Sequence[float], params: ProjectionParams
) -> tuple[float, float]:
    """The range and the value of a beam, of the range and the number of each return; the first of equals counts."""
    ordered = sorted(returns)
    match params.reduce:
        case "mean":
            length = value = 0.0
            for reach, number in returns:
                length, value = length + reach, value + values[number]
            return length / len(returns), value / len(returns)
        case "surface":
            closest = ordered[0][0]
            depth = 0.05 + 3.0 * params.layout.angle_increment * closest
            near = [entry for entry in ordered if entry[0] <= closest + depth]
            chosen = near[(len(near) - 1) // 2]
        case "max":
            chosen = max(returns, key=lambda entry: (entry[0], -entry[1]))
        case "median":
            chosen = ordered[(len(ordered) - 1) // 2]
        case "kth=1" | "kth=2" | "kth=3":
            chosen = ordered[params.kth - 1]
        case _:
            chosen = ordered[0]
    return chosen[0], values[chosen[1]]
