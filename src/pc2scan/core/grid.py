"""The beams of a scan: how many there are, and which one a point or an angle belongs to.

Source of the rule: pointcloud_to_laserscan_node.cpp computes ``int index = (angle - angle_min) /
angle_increment``, where ``angle`` is a double that holds a float32, atan2f(y, x), and the other two are the
message's float32 fields: a float64 quotient, truncated. Its check of the sector comes first.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .params import ProjectionParams

__all__ = ["Grid"]

#: How far NumPy's float32 arctan2 may be from the exact angle's float32, radians. NumPy allows its vectorised
#: functions 4 ulp, 0.95e-6 close to pi; the largest error that was seen is 0.34e-6.
_ANGLE_ERROR = 1.1e-6

#: In smaller blocks, computing every angle in float64 is cheaper than finding out which ones need it.
_FEW_POINTS = 4096


class Grid:
    """The beams of a scan, as slots of an array: one for each beam, then one for each fate that is no beam.

    Beam ``i`` is half open: ``angle_min + i * angle_increment <= angle < angle_min + (i + 1) *
    angle_increment``; ``angle_max``, inclusive, cuts the last one off. If the sector is a multiple of the
    increment, ``angle_max`` itself is behind the last beam: there upstream writes past its array.

    Parameters
    ----------
    params
        The sector and the increment; they are rounded to float32, as the scan carries them.

    Attributes
    ----------
    beams
        Length of the scan's ``ranges``, N.
    past_end
        N, the slot of angles in the sector but behind the last beam.
    outside
        N + 1, the slot of angles that are not in the sector.
    slots
        N + 2, the number of slots.
    whole_circle
        Whether no angle is outside the sector.
    """

    __slots__ = (
        "_doubt",
        "_increment",
        "_max",
        "_min",
        "_scale",
        "_shift",
        "beams",
        "outside",
        "past_end",
        "slots",
        "whole_circle",
    )

    def __init__(self, params: ProjectionParams) -> None:
        self.beams = params.beams
        self.past_end = self.beams
        self.outside = self.beams + 1
        self.slots = self.beams + 2
        self._min = np.float32(params.angle_min)
        self._max = np.float32(params.angle_max)
        self._increment = np.float64(np.float32(params.angle_increment))
        # No angle is beyond float32's pi, the largest that atan2 returns.
        self.whole_circle = bool(self._min <= -np.float32(np.pi) and self._max >= np.float32(np.pi))

        # In float32 the quotient is about angle * scale + shift. It is off, in beams, by the angle's error and by
        # the rounding of scale, shift, product and sum: each 2**-24 of no more than reach, one spare.
        scale = 1 / float(self._increment)
        shift = -float(self._min) * scale
        reach = math.pi * scale + abs(shift)
        self._doubt = scale * _ANGLE_ERROR + 5 * 2.0**-24 * reach
        if self._doubt < 0.1:
            self._scale = np.float32(scale)
            # Shifted by the doubt, what may belong to the beam below has a small fraction, and nothing has to look up.
            self._shift = np.float32(shift + self._doubt)

    def slots_of_angles(self, angles: NDArray[np.float32]) -> NDArray[np.intp]:
        """Slots of angles, by upstream's rule.

        Parameters
        ----------
        angles
            (M,), float32, radians, not NaN.

        Returns
        -------
        (M,) intp, 0 to N + 1.
        """
        quotients = np.subtract(angles, self._min, dtype=np.float64)
        quotients /= self._increment
        slots = quotients.astype(np.intp)
        if not self.whole_circle:
            slots[(angles < self._min) | (angles > self._max)] = self.outside
        return slots

    def slots_of_points(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.intp]:
        """Slots of points: those of ``float32(atan2(y, x))``.

        NumPy's arctan2 of float32 is fast but off by some ulp, its arctan2 of float64 is exact enough to be
        rounded. The fast one decides wherever its error does not matter: away from the edges of beams.

        Parameters
        ----------
        x, y
            (M,), float32, metres, not NaN.

        Returns
        -------
        (M,) intp, 0 to N + 1.
        """
        if x.size < _FEW_POINTS or not self._doubt < 0.1:
            return self.slots_of_angles(_angles(x, y))
        quotients = np.arctan2(y, x)
        quotients *= self._scale
        quotients += self._shift
        floors = np.floor(quotients)
        if not self.whole_circle:
            # What is far outside must not wrap around; everything below the sector becomes -1 and is moved below.
            np.clip(floors, -1, self.outside, out=floors)
        slots = floors.astype(np.intp)
        quotients -= floors
        doubtful = quotients < 2 * self._doubt
        if not self.whole_circle:
            slots[slots < 0] = self.outside
            # angle_max may be anywhere in the last beam.
            doubtful |= slots == self.beams - 1
        redo = np.flatnonzero(doubtful)
        if redo.size:
            slots[redo] = self.slots_of_angles(_angles(x[redo], y[redo]))
        return slots


def _angles(x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
    """Angles as upstream's atan2f returns them: next to the true ones. float64 leaves no more doubt than libm."""
    return np.arctan2(y, x, dtype=np.float64).astype(np.float32)
