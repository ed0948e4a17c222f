"""The beams of the centered geometry: each takes what is within half an increment on either side of its middle.

The angle of a point is that of upstream, float32 atan2(y, x), and compared in float64 with the edges between the beams
that the message's float32 values describe. Beams are half open, the last one of a sector closed. On a full circle every
angle belongs to the nearest beam; what rounding the increment leaves of the circle, or takes twice, is shared
by the last beam and the first.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .layout import TURN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .layout import BeamLayout

__all__ = ["CenteredGrid"]

#: How far NumPy's float32 arctan2 may be from the angle's float32, radians: 4 ulp close to pi, and some.
_ANGLE_ERROR = 1.1e-6

#: From this share of a beam on, the neighbourhoods of the edges are too large a part of it to gain anything.
_MUCH_DOUBT = 0.1


class CenteredGrid:
    """The beams as slots of an array: one for each beam, then `past_end`, which nothing falls into, and `outside`.

    Parameters
    ----------
    layout
        Of `centered_layout`.

    Attributes
    ----------
    beams
        N, the length of the scan's ``ranges``.
    outside
        N + 1, the slot of angles that no beam takes. The slots are those of `Grid`.
    """

    __slots__ = ("_doubt", "_end", "_increment", "_offset", "_skew", "beams", "outside")

    def __init__(self, layout: BeamLayout) -> None:
        self.beams = layout.count
        self.outside = self.beams + 1
        self._increment = layout.angle_increment
        self._end = TURN if layout.full_circle else min(TURN, self.beams * self._increment)
        # The first edge lies half a beam before the first middle; on a circle half way to the last middle.
        self._skew = (self.beams * self._increment - TURN) / 2 if layout.full_circle else 0.0
        first_edge = layout.angle_min - self._increment / 2 + self._skew
        # No angle is below -pi by more than a rounding: with whole turns added, none comes before the first edge.
        self._offset = TURN * math.ceil((first_edge + math.pi + 1e-6) / TURN) - first_edge
        self._doubt = _ANGLE_ERROR / self._increment

    def slots_of_angles(self, angles: NDArray[np.float32]) -> NDArray[np.intp]:
        """Slots of angles.

        Parameters
        ----------
        angles
            (M,) float32, radians, within -pi to pi, not NaN.

        Returns
        -------
        (M,) intp: 0 to N - 1, or N + 1.
        """
        turned = self._turned(angles)
        return self._slots(turned, self._quotients(turned))

    def slots_of_points(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.intp]:
        """Slots of points, (M,) intp: those of the angles ``float32(atan2(y, x))``.

        NumPy's arctan2 is a lot faster in float32, but some ulp off: the angles that seem to be close to an edge
        are computed again.

        Parameters
        ----------
        x, y
            (M,) float32, metres, not NaN.
        """
        if self._doubt >= _MUCH_DOUBT:
            return self.slots_of_angles(_angles(x, y))
        turned = self._turned(np.arctan2(y, x))
        quotients = self._quotients(turned)
        slots = self._slots(turned, quotients)
        quotients -= np.rint(quotients)
        doubtful = np.abs(quotients, out=quotients) < self._doubt
        # Next to where the circle was cut open, an angle may seem to be a turn further.
        doubtful |= turned > TURN - _ANGLE_ERROR
        again = np.flatnonzero(doubtful)
        if again.size:
            slots[again] = self.slots_of_angles(_angles(x[again], y[again]))
        return slots

    def _turned(self, angles: NDArray[np.float32]) -> NDArray[np.float64]:
        """How far behind the first edge, radians, 0 to 2 pi."""
        turned = angles.astype(np.float64)
        turned += self._offset
        np.subtract(turned, TURN, out=turned, where=turned >= TURN)
        return turned

    def _quotients(self, turned: NDArray[np.float64]) -> NDArray[np.float64]:
        quotients = turned + self._skew
        quotients /= self._increment
        return quotients

    def _slots(self, turned: NDArray[np.float64], quotients: NDArray[np.float64]) -> NDArray[np.intp]:
        slots = np.floor(quotients).astype(np.intp)
        np.clip(slots, 0, self.beams - 1, out=slots)
        if self._end < TURN:
            slots[turned > self._end] = self.outside
        return slots


def _angles(x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
    # What float64 is off by is lost in the rounding, but for about one in a hundred million.
    angles: NDArray[np.float32] = np.arctan2(y, x, dtype=np.float64).astype(np.float32)
    return angles
