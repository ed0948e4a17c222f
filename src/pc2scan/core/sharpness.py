"""How well odometry fits what a lidar sees: where a robot moves most, and how sharp its walls are.

Surroundings that do not move are sharp in a frame that does not move if each point is placed by the pose of its own
time. With poses of another time, or in another order, a wall that is seen several times becomes several walls.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .percentiles import median

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Rotations are compared with translations at this distance from the robot, metres.
_LEVER = 10.0

#: The width of cells, metres, and the directions of the grids, radians: walls along one grid lie across the others.
_CELL = 0.2
_DIRECTIONS = (0.3, 1.0, 1.7)

#: Motion is measured between poses this far apart, nanoseconds, or farther in long recordings.
_STEP_NS = 50_000_000
_MOST_STEPS = 20_000

#: The number of consecutive values that are compared, and how often there must be so many.
_TOGETHER = 5
_FEWEST = 50


class Window(NamedTuple):
    """A time in which the robot moves: nanoseconds, ``begin_ns <= stamp_ns < end_ns``."""

    begin_ns: int
    end_ns: int


def spread(points: NDArray[np.float64]) -> float:
    """Return over how many cells points are spread, (N, 2) metres: the inverse of Simpson's index; 0 without points.

    Fewer are sharper.
    """
    total = 0.0
    for direction in _DIRECTIONS:
        cosine, sine = math.cos(direction), math.sin(direction)
        turned = points @ np.array([[cosine, -sine], [sine, cosine]])
        cells = np.floor(turned / _CELL).astype(np.int64)
        _, counts = np.unique(cells[:, 0] << 32 ^ (cells[:, 1] & 0xFFFFFFFF), return_counts=True)
        total += float((counts.astype(np.float64) ** 2).sum())
    return len(_DIRECTIONS) * len(points) ** 2 / total if total else 0.0


def busiest(
    stamps_ns: NDArray[np.int64], poses: NDArray[np.float64], span: Window, length_ns: int, most: int
) -> list[Window]:
    """Return the windows in which a velocity changes most, none of which overlaps another one, the busiest first.

    Parameters
    ----------
    stamps_ns, poses
        (N,) increasing, and (N, 7): x, y, z, and the quaternion i, j, k, r.
    span
        Where windows may be.
    length_ns, most
        The length of a window, and how many are wanted.
    """
    begin_ns, end_ns = max(int(stamps_ns[0]), span.begin_ns), min(int(stamps_ns[-1]), span.end_ns)
    step_ns = max(_STEP_NS, (end_ns - begin_ns) // _MOST_STEPS)
    steps = length_ns // step_ns
    if steps < 2 or end_ns - begin_ns < length_ns:
        return []
    times = np.arange(begin_ns, end_ns, step_ns)
    near = poses[np.minimum(stamps_ns.searchsorted(times), len(stamps_ns) - 1)]
    one, other = near[:-1, 3:], near[1:, 3:]
    # The rotations from each pose to the next one, as vectors; a quaternion and its negative are one rotation.
    turned = one[:, 3:] * other[:, :3] - other[:, 3:] * one[:, :3] - np.cross(other[:, :3], one[:, :3])
    turned *= np.where((one * other).sum(axis=1, keepdims=True) < 0, -2.0, 2.0)
    motion = np.concatenate([np.diff(near[:, :3], axis=0), _LEVER / 2 * turned], axis=1)
    sums, squares = (np.cumsum(np.pad(values, ((1, 0), (0, 0))), axis=0) for values in (motion, motion**2))
    mean, square = ((cumulated[steps:] - cumulated[:-steps]) / steps for cumulated in (sums, squares))
    change = (square - mean**2).sum(axis=1)
    windows: list[Window] = []
    while len(windows) < most and change.size and (at := int(np.argmax(change))) >= 0 and change[at] > 0:
        windows.append(Window(int(times[at]), int(times[at]) + length_ns))
        change[max(0, at - steps + 1) : at + steps] = 0
    return windows


def roughness(stamps_ns: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard deviations of values from a smooth course, (K,); 0 for few values.

    Parameters
    ----------
    stamps_ns, values
        (N,) increasing, and (N, K).

    Notes
    -----
    The divided differences of five consecutive values are 0 for every polynomial of third degree. Their median size is
    that of the noise, even if single values jump.
    """
    count = len(stamps_ns) - _TOGETHER + 1
    if count < _FEWEST:
        return np.zeros(values.shape[1])
    # For long recordings, a thousand times five values are enough.
    begins = np.linspace(0, count - 1, min(count, 1_000)).astype(np.intp)
    places = begins[:, None] + np.arange(_TOGETHER)
    times = (stamps_ns[places] - stamps_ns[places[:, :1]]) / 1e9
    apart = times[:, :, None] - times[:, None, :]
    apart[:, range(_TOGETHER), range(_TOGETHER)] = 1.0
    weights = 1 / apart.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    off = np.abs(np.einsum("np,npk->nk", weights, values[places]))
    return np.array([median(column) / 0.6745 for column in off.T])
