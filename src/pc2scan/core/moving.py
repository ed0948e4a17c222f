"""The transform of a cloud that was measured while its sensor moved."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["MovingTransform"]


class MovingTransform(NamedTuple):
    """Transforms over time, and when each point of a cloud was measured.

    Between two nodes a transform is a polynomial of second degree: the one through the rows of both nodes and that of
    the middle between them. It is off by 0.008 times the third power of the angle that the sensor turns meanwhile.
    A point is ``start p + s * (rate p + s * bend p)``: the first product in float64, the rest, which is small, in
    float32.

    Attributes
    ----------
    times
        A value for each point, of the shape of the coordinates and of any of PointField's datatypes.
    offset, unit
        A point was measured at ``(value - offset) * unit``, in seconds; NaN: not known.
    node_times
        (N,) seconds, increasing, at least two.
    rows
        (2 N - 1, 12): at the nodes, and in the middle between each and the next one: the rows of the rotation, then the
        translation, in metres; NaN where there is no transform.
    timed
        Whether every point with coordinates has a time between the first and the last node. The compiled loops then
        need no times of points that are too high or too low wherever the sensor was.
    """

    times: NDArray[Any]
    offset: float
    unit: float
    node_times: NDArray[np.float64]
    rows: NDArray[np.float64]
    timed: bool = False
