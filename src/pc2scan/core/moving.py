"""The transform of a cloud that was measured while its sensor moved."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class MovingTransform(NamedTuple):
    """Transforms over time, and the time of each point of a cloud.

    Between two nodes, the transform is a polynomial of second degree through three rows: those of both nodes, and that
    of the middle between them. Its error is 0.008 times the third power of the angle by which the sensor turns between
    the nodes. A moved point is ``start p + s * (rate p + s * bend p)``: the first product in float64, the others, which
    are small, in float32.

    Attributes
    ----------
    times
        One value for each point, of the shape of the coordinates and of any of PointField's datatypes.
    offset, unit
        A point was measured at ``(value - offset) * unit`` seconds. NaN: its time is unknown.
    node_times
        (N,) seconds, increasing, at least two.
    rows
        (2 N - 1, 12): transforms at the nodes, and in the middle between each node and the next. A row holds the rows
        of the rotation, then the translation in metres; NaN where there is no transform.
    timed
        Whether every point with coordinates has a time between the first and the last node. The compiled loops then
        drop points that are too high or too low at any of these times without reading their own.
    """

    times: NDArray[Any]
    offset: float
    unit: float
    node_times: NDArray[np.float64]
    rows: NDArray[np.float64]
    timed: bool = False

    def as_float32(self) -> MovingTransform:
        """Return itself: it is as the loops apply it, like the result of `pc2scan.core.rigid.Rigid.as_float32`."""
        return self
