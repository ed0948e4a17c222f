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

#: How far NumPy's float32 arctan2 may be from the angle's float32, radians. NumPy allows its vectorised
#: functions 4 ulp, which are 0.95e-6 close to pi; the largest error that was seen is 0.34e-6.
_ANGLE_ERROR = 1.1e-6

#: From this share of a beam on, the neighbourhoods of the edges are too large a part of it to gain anything.
_MUCH_DOUBT = 0.1


class Grid:
    """The beams of a scan as slots of an array: one for each beam, then one for each fate that is no beam.

    Beam ``i`` is half open, ``angle_min + i * angle_increment <= angle < angle_min + (i + 1) *
    angle_increment``, and ``angle_max``, inclusive, cuts the last one off. If the sector is a multiple of the
    increment, ``angle_max`` itself lies behind the last beam: there upstream writes past its array.

    Parameters
    ----------
    params
        The sector and the increment; they are rounded to float32, as the scan carries them.

    Attributes
    ----------
    beams
        N, the length of the scan's ``ranges``.
    past_end
        N, the slot of angles that are in the sector but behind the last beam.
    outside
        N + 1, the slot of angles that are not in the sector.
    slots
        N + 2, the number of slots.
    whole_circle
        Whether no angle is outside the sector.
    coarse
        Whether beams are wide enough for `find_slots`.
    """

    __slots__ = (
        "_doubt",
        "_increment",
        "_max",
        "_min",
        "_scale",
        "_shift",
        "beams",
        "coarse",
        "outside",
        "past_end",
        "slots",
        "whole_circle",
    )

    def __init__(self, params: ProjectionParams) -> None:
        self.beams = params.length
        self.past_end = self.beams
        self.outside = self.beams + 1
        self.slots = self.beams + 2
        self._min = np.float32(params.angle_min)
        self._max = np.float32(params.angle_max)
        self._increment = np.float64(np.float32(params.angle_increment))
        # atan2 returns nothing beyond float32's pi.
        self.whole_circle = bool(self._min <= -np.float32(np.pi) and self._max >= np.float32(np.pi))

        # The quotient is nearly angle * scale + shift. In float32 that is off, in beams, by the angle's error
        # and by roundings of 2**-24 each: scale and product, at most turn; shift; the sum, at most both.
        scale = 1 / float(self._increment)
        shift = -float(self._min) * scale
        turn = math.pi * scale
        self._doubt = _ANGLE_ERROR * scale + 1.1 * 2.0**-24 * (3 * turn + 2 * abs(shift) + 1)
        self.coarse = self._doubt < _MUCH_DOUBT
        if self.coarse:
            self._scale = np.float32(scale)
            # Moved up by the doubt, a quotient that may belong to the beam below has a small fraction.
            self._shift = np.float32(shift + self._doubt)

    def slots_of_angles(self, angles: NDArray[np.float32]) -> NDArray[np.intp]:
        """Slots of angles, by upstream's rule.

        Parameters
        ----------
        angles
            (M,), float32, radians, within -pi to pi, not NaN.

        Returns
        -------
        (M,) intp, 0 to N + 1.
        """
        quotients = angles.astype(np.float64)
        quotients -= self._min
        quotients /= self._increment
        slots = quotients.astype(np.intp)
        if not self.whole_circle:
            slots[(angles < self._min) | (angles > self._max)] = self.outside
        return slots

    def slots_of_points(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.intp]:
        """Slots of points, (M,) intp: those of the angles ``float32(atan2(y, x))``.

        Parameters
        ----------
        x, y
            (M,), float32, metres, not NaN.
        """
        # What float64 is off by is lost in the rounding, but for about one in a hundred million.
        return self.slots_of_angles(np.arctan2(y, x, dtype=np.float64).astype(np.float32))

    def find_slots(
        self,
        x: NDArray[np.float32],
        y: NDArray[np.float32],
        out: NDArray[np.intp],
        scratch: tuple[NDArray[np.float32], NDArray[np.float32]],
    ) -> int:
        """Do as `slots_of_points`, in less time if few points lie on the edges of beams.

        NumPy's arctan2 is a lot faster in float32, but some ulp off. That is good enough for all points but
        those that seem to be close to an edge.

        Parameters
        ----------
        x, y
            As for `slots_of_points`.
        out
            (M,) intp, to put the slots in.
        scratch
            Two of (M,), float32, to overwrite.

        Returns
        -------
        int
            How many points were close to an edge.
        """
        quotients, floors = scratch
        np.arctan2(y, x, out=quotients)
        quotients *= self._scale
        quotients += self._shift
        np.floor(quotients, out=floors)
        quotients -= floors
        doubtful = quotients < np.float32(2 * self._doubt)
        if not self.whole_circle:
            # Read as unsigned integers, floats are in order, and the negative ones above all others.
            bits = floors.view(np.uint32)
            np.minimum(bits, np.float32(self.outside).view(np.uint32), out=bits)
            # The sector ends somewhere in the last beam, or by some ulp behind it.
            doubtful |= (floors >= self.beams - 1) & (floors <= self.beams)
        np.copyto(out, floors, casting="unsafe")
        again = np.flatnonzero(doubtful)
        if again.size:
            out[again] = self.slots_of_points(x.take(again), y.take(again))
        return again.size
