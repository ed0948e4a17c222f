"""How a sensor moves in a frame that does not move with it: within a cloud, and how its tilt varies."""

from __future__ import annotations

import math
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.gravity import up_in
from pc2scan.errors import TransformError

from .summary import WORLDS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .buffer import TransformBuffer

#: At how many times the motion is looked at, and the longest gap between transforms that is interpolated, nanoseconds.
_LOOKS = 200
_LONGEST_GAP_NS = 500_000_000

#: The share of all times with less motion, which leaves out jumps.
_MOST = 90


class SensorMotion(NamedTuple):
    """The motion of a sensor in a fixed frame.

    Attributes
    ----------
    fixed
        The frame.
    metres, radians
        How far it moves within the time of a cloud, in nine of ten looks at most.
    tilt
        How far its direction of up is from the mean one, radians, in nine of ten looks at most.
    """

    fixed: str
    metres: float
    radians: float
    tilt: float


def sensor_motion(buffer: TransformBuffer, frame: str, seconds: float) -> SensorMotion | None:
    """Return how a sensor moves in the frame that suits best; None if it moves in none.

    Parameters
    ----------
    buffer
        The transforms, at some times at least.
    frame
        The frame of the sensor.
    seconds
        The time of a cloud.
    """
    above = buffer.above(frame)
    # Localisation makes the robot jump in map, so odom comes first.
    for fixed in (*(name for name in WORLDS if name in above), *above[-1:]):
        motion = _motion_in(buffer, fixed, frame.removeprefix("/"), seconds)
        if motion is not None:
            return motion
    return None


def _motion_in(buffer: TransformBuffer, fixed: str, frame: str, seconds: float) -> SensorMotion | None:
    if buffer.is_rigid(fixed, frame):
        return None
    links = [buffer.history(name) for name in (frame, *buffer.above(frame))]
    moving = [link for link in links if link is not None and not link.static]
    stamps = max(moving, key=attrgetter("size")).stamps_ns if moving else np.empty(0, np.int64)
    if len(stamps) < 3:
        return None
    near = np.flatnonzero(np.diff(stamps) < _LONGEST_GAP_NS)
    step_ns = round(max(seconds, 1e-3) * 1e9)
    metres, radians, ups = [], [], []
    for place in sorted(set(np.linspace(0, len(near) - 1, _LOOKS).astype(int).tolist())) if len(near) else ():
        begin_ns = int(stamps[near[place]])
        end = int(np.searchsorted(stamps, begin_ns + step_ns))
        if end >= len(stamps) or np.diff(stamps[near[place] : end + 1]).max(initial=0) >= _LONGEST_GAP_NS:
            continue
        try:
            first, last = (buffer.lookup(fixed, frame, at_ns) for at_ns in (begin_ns, begin_ns + step_ns))
        except TransformError:
            continue
        between = first.inverse().compose(last)
        metres.append(float(np.linalg.norm(between.translation)))
        radians.append(2 * math.atan2(float(np.linalg.norm(between.quaternion[:3])), abs(float(between.quaternion[3]))))
        ups.append(up_in(first.quaternion.tolist()))
    if len(metres) < 3:
        return None
    return SensorMotion(fixed, _most(metres), _most(radians), spread_of_up(np.array(ups)))


def spread_of_up(ups: NDArray[np.float64]) -> float:
    """Return how far directions of up, (N, 3) of unit length, are from their mean, radians, in nine of ten at most."""
    middle = ups.mean(axis=0)
    length = float(np.linalg.norm(middle))
    if not length:
        return math.pi
    return _most(np.arccos(np.clip(ups @ middle / length, -1.0, 1.0)).tolist())


def _most(values: list[float]) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, len(ordered) * _MOST // 100)]
