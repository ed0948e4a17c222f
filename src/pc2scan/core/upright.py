"""The direction of up in a frame, and the rotation to the same frame without roll and pitch."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

from .rigid import Rigid

if TYPE_CHECKING:
    from collections.abc import Sequence

#: A direction of unit length: x, y, z.
Up: TypeAlias = tuple[float, float, float]

#: The tangent of the angle to the vertical below which an axis has no heading.
_VERTICAL = 1e-12


def up_in(world_from_frame: Sequence[float]) -> Up:
    """Return the direction of the world's z axis in a frame, by a quaternion x, y, z, w."""
    x, y, z, w = world_from_frame
    return _unit((2 * (x * z - w * y), 2 * (y * z + w * x), w * w + z * z - x * x - y * y))


def tilt(up: Up) -> float:
    """Return the angle between a frame's z axis and up, radians: 0 of a level frame, pi of one that is upside down."""
    return math.atan2(math.hypot(up[0], up[1]), up[2])


def upright(up: Up) -> Rigid:
    """Return the rotation ``frame_from_level``, where the level frame has the yaw of the frame, and no roll and pitch.

    Parameters
    ----------
    up
        The direction of up in the frame.

    Notes
    -----
    With ``world_from_frame = Rz(yaw) Ry(pitch) Rx(roll)``, as `Rigid.rpy` has them, this is ``Rx(-roll) Ry(-pitch)``,
    whatever the yaw. So the level x axis is the frame's own, projected onto the horizontal plane. At a pitch of
    +-pi/2, where that has no direction, roll is 0, as for `Rigid.rpy`: the level y axis is the frame's own.
    """
    x, y, z = up
    across = math.hypot(y, z)
    roll = math.atan2(y, z) if across > _VERTICAL * abs(x) else 0.0
    pitch = math.atan2(-x, across)
    (sr, cr), (sp, cp) = ((math.sin(-angle / 2), math.cos(angle / 2)) for angle in (roll, pitch))
    return Rigid.from_pose((0.0, 0.0, 0.0, sr * cp, cr * sp, sr * sp, cr * cp))


def _unit(direction: Sequence[float]) -> Up:
    length = math.hypot(*direction)
    x, y, z = (part / length for part in direction)
    return (x, y, z)
