"""Which beam an angle falls into, as slots of an array: one for each beam, then one for each fate that is no beam.

All angles are float32 atan2(y, x), radians; they are compared with what the message's float32 values describe.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .layout import TURN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .layout import BeamLayout

__all__ = ["centered_slots", "upstream_slots"]


def upstream_slots(angles: NDArray[np.float32], layout: BeamLayout) -> NDArray[np.intp]:
    """Slots by upstream's rule: beam i begins at ``angle_min + i * angle_increment``.

    Source of the rule: pointcloud_to_laserscan_node.cpp, as told in `pc2scan.core.plain`, which applies it together
    with the rest of upstream's projection.

    Parameters
    ----------
    angles
        (M,), within -pi to pi, not NaN.
    layout
        Of `upstream_layout`; N beams.

    Returns
    -------
    (M,) intp: 0 to N - 1; N behind the last beam, where upstream writes past its array; N + 1 outside the sector.
    """
    slots = np.full(angles.shape, layout.count + 1, np.intp)
    inside = (angles >= np.float32(layout.angle_min)) & (angles <= np.float32(layout.angle_max))
    quotients = (angles[inside].astype(np.float64) - layout.angle_min) / layout.angle_increment
    slots[inside] = np.minimum(quotients.astype(np.intp), layout.count)
    return slots


def centered_slots(angles: NDArray[np.float32], layout: BeamLayout) -> NDArray[np.intp]:
    """Slots of the centered geometry: beam i takes what is within half an increment on either side of its middle.

    Beams are half open, the last one of a sector closed. On a full circle every angle belongs to the nearest beam;
    what rounding the increment left of the circle is shared by the last beam and the first.

    Parameters
    ----------
    angles
        (M,), within -pi to pi, not NaN.
    layout
        Of `centered_layout`; N beams, from any angle on.

    Returns
    -------
    (M,) intp: 0 to N - 1; N + 1 where no beam looks.
    """
    increment, last = layout.angle_increment, layout.count - 1
    # The first edge lies half a beam before the first middle; on a circle half way to the last middle.
    skew = (layout.count * increment - TURN) / 2 if layout.full_circle else 0.0
    first_edge = layout.angle_min - increment / 2 + skew
    # No angle is below -pi by more than a rounding: with whole turns added, none comes before the first edge.
    behind = angles.astype(np.float64)
    behind += TURN * math.ceil((first_edge + math.pi + 1e-6) / TURN) - first_edge
    behind -= TURN * (behind >= TURN)
    # A skew below zero takes angles to less than a beam before 0, which is cut off to 0.
    slots = ((behind + skew) / increment).astype(np.intp)
    np.minimum(slots, last, out=slots)
    if not layout.full_circle:
        slots[behind > layout.count * increment] = layout.count + 1
    return slots
