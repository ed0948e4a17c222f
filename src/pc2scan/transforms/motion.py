"""How a robot moves in the frames above it: a sensor within a cloud and its tilt; and what moves in a target frame."""

from __future__ import annotations

import math
import shlex
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.gravity import up_in

from .frames import BODIES, WORLDS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .buffer import TransformBuffer

#: At how many times the motion is looked at, and the longest gap between transforms that is interpolated, nanoseconds.
_LOOKS = 200
_LONGEST_GAP_NS = 500_000_000

#: The share of all times with less motion, which leaves out jumps.
_MOST = 90

#: How far something has to move in a frame with such a name, or with any other name, metres. A lift or an arm that
#: carries a lidar moves in a robot's frame, by less than this.
_MOVES = 0.05
_MOVES_FAR = 2.0

#: Maximum number of frames between the sensor and the frame that it moves in.
_MOST_LINKS = 100


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
    # Localisation makes the robot jump in map, so odom comes first. Sensors that move on the robot are no odometry.
    for fixed in (*(name for name in WORLDS if name in above), *(name for name in above[-1:] if name not in BODIES)):
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
        first, last = (buffer.known(fixed, frame, at_ns) for at_ns in (begin_ns, begin_ns + step_ns))
        if first is None or last is None:
            continue
        between = first.inverse().compose(last)
        metres.append(float(np.linalg.norm(between.translation)))
        radians.append(2 * math.atan2(float(np.linalg.norm(between.quaternion[:3])), abs(float(between.quaternion[3]))))
        ups.append(up_in(first.quaternion.tolist()))
    if len(metres) < 3:
        return None
    return SensorMotion(fixed, _most(metres), _most(radians), spread_of_up(np.array(ups)))


def spread_of_up(ups: NDArray[np.float64]) -> float:
    """Return how far directions of up, (N, 3) of unit length, are from their mean, radians, in nine of ten at most.

    0 without any.
    """
    if not len(ups):
        return 0.0
    middle = ups.mean(axis=0)
    length = float(np.linalg.norm(middle))
    if not length:
        return math.pi
    return _most(np.arccos(np.clip(ups @ middle / length, -1.0, 1.0)).tolist())


def _most(values: list[float]) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, len(ordered) * _MOST // 100)]


class BodyMotion(NamedTuple):
    """What moves in a frame: the robot's frame, and how far it moves (the diagonal of the box around its positions)."""

    body: str
    metres: float

    def of_target(self, target: str) -> str:
        """Return the warning about scans in this frame."""
        return (
            f"`target_frame` is {target}, in which {self.body} moves (by {self.metres:.2f} m): the scans are "
            f"measured from the origin of {target} instead of from the robot, as SLAM and navigation expect; "
            f"`target_frame={shlex.quote(self.body)}`"
        )

    def of_source(self, source: str, own: str) -> str:
        """Return the warning that ``source_frame`` is this frame, given the clouds' own frame."""
        with_body = f" with {self.body}" if self.body != own else ""
        return (
            f"`source_frame` is {source}, in which {own}, the frame of the clouds, moves{with_body}: "
            f"their points are placed as if the sensor stayed at the origin of {source}; leave out `source_frame`"
        )


def body_in(buffer: TransformBuffer, world: str) -> str:
    """Return the frame of a robot in a world: one with a usual name, or the only one that moves; empty if unknown."""
    named = next((name for name in BODIES if name in buffer.frames), "")
    links = ((name, buffer.history(name)) for name in buffer.frames if name not in WORLDS)
    moving = [name for name, link in links if link is not None and not link.static]
    moving = [name for name in moving if world.removeprefix("/") in buffer.above(name)]
    return named or (moving[0] if len(moving) == 1 else "")


def find_body_motion(buffer: TransformBuffer, world: str, source: str) -> BodyMotion | None:
    """Return what carries ``source`` through ``world``; None if nothing does.

    >>> from pc2scan.transforms.builder import TransformBuilder
    >>> builder = TransformBuilder()
    >>> builder.add([("base_link", "lidar", 0, 0, 0, 1, 0, 0, 0, 1)], static=True)
    >>> for stamp_ns, x in (1, 0.0), (2, 3.5):
    ...     builder.add([("odom", "base_link", stamp_ns, x, 0, 0, 0, 0, 0, 1)], static=False)
    >>> find_body_motion(builder.build(), "odom", "lidar"), find_body_motion(builder.build(), "base_link", "lidar")
    (BodyMotion(body='base_link', metres=3.5), None)
    """
    world, name = world.removeprefix("/"), source.removeprefix("/")
    if world in BODIES:
        return None
    below: list[str] = []
    moves: list[tuple[float, str]] = []
    while name != world:
        history = buffer.history(name)
        if history is None or history.sole_parent < 0 or len(below) == _MOST_LINKS:
            return None
        below.append(name)
        if not history.static:
            moves.append((float(np.linalg.norm(history.extent[:3])), name))
        name = buffer.frames[history.sole_parent]
    farthest, child = max(moves, default=(0.0, ""))
    if not farthest > (_MOVES if world in WORLDS else _MOVES_FAR):
        return None
    return BodyMotion(next((body for body in BODIES if body in below), child), farthest)
