"""Detects target frames that a robot moves in: scans in these are measured from a place that the robot leaves."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .summary import BODIES, WORLDS

if TYPE_CHECKING:
    from .buffer import TransformBuffer

#: How far something has to move in a frame with such a name, or with any other name, metres. A lift or an arm that
#: carries a lidar moves in a robot's frame, by less than this.
_MOVES = 0.05
_MOVES_FAR = 2.0

#: Maximum number of frames between the sensor and the frame that it moves in.
_MOST_LINKS = 100


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
        """Return the warning about clouds that are said to be in this frame, given their own frame."""
        with_body = f" with {self.body}" if self.body != own else ""
        return (
            f"`source_frame` is {source}, in which {own}, the frame of the clouds, moves{with_body}: "
            f"their points are placed as if the sensor stayed at the origin of {source}; leave out `source_frame`"
        )


def find_body_motion(buffer: TransformBuffer, world: str, source: str) -> BodyMotion | None:
    """Return what carries ``source`` through ``world``; None if nothing does.

    >>> from pc2scan.transforms.builder import TransformBuilder
    >>> builder = TransformBuilder()
    >>> builder.add([("base_link", "lidar", 0, 0, 0, 1, 0, 0, 0, 1)], static=True)
    >>> for stamp_ns, x in (1, 0.0), (2, 3.5):
    ...     builder.add([("odom", "base_link", stamp_ns, x, 0, 0, 0, 0, 0, 1)], static=False)
    >>> find_body_motion(builder.build(), "odom", "lidar"), find_body_motion(builder.build(), "base_link", "lidar")
    (Moving(body='base_link', metres=3.5), None)
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
