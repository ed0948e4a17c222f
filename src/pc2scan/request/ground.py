"""Filters of the ground: one finds it in each cloud, the other has a lower height limit that grows with range."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.terrain import on_ground
from pc2scan.errors import UsageError

from .filters import Frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.core.points import Points


@dataclass(frozen=True, slots=True)
class RemoveGround:
    """Rejects points on the ground, which `pc2scan.core.terrain` finds in each cloud.

    It needs a frame of the robot whose z axis points up. In a cloud without ground it rejects nothing.
    """

    name = "ground"
    explanation = "on the ground, as `ground` finds it"
    absent = (
        "`ground` found no ground in any cloud, so it removed nothing; it needs a frame of the robot whose z axis "
        "points up (`target_frame`), and ground that is seen from near to far"
    )
    fields = ()
    frame = Frame.TARGET
    text = "remove"

    @classmethod
    def parse(cls, text: str, _: float = 0.0) -> RemoveGround | None:
        """Return the filter of ``remove``; None for ``keep``."""
        return cls() if text == "remove" else None

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return which points are not on the ground; see `pc2scan.request.filters.Filter`."""
        return ~on_ground(*points.xyz())


@dataclass(frozen=True, slots=True)
class MinHeightSlope:
    """Rejects points from ``min_height`` to ``min_height + slope * hypot(x, y)`` in the scan's frame.

    Parameters
    ----------
    min_height
        The limit at the origin of the scan's frame, metres.
    slope
        How much it grows with range, metres per metre: the tangent of an angle, 0.05 for about 3 degrees.

    Raises
    ------
    UsageError
        If the slope is negative or not finite, or ``min_height`` is not finite.
    """

    min_height: float
    slope: float

    name = "min_height_slope"
    explanation = "below `min_height_slope`"
    fields = ()
    frame = Frame.TARGET

    def __post_init__(self) -> None:
        if not 0 <= self.slope < math.inf:
            raise UsageError(
                f"`min_height_slope` is {self.slope}, it must be 0 or more, and finite",
                hint="it is in metres per metre: `min_height_slope=0.05` for about 3 degrees",
            )
        if not math.isfinite(self.min_height):
            raise UsageError(f"`min_height_slope` needs a finite min_height, which is {self.min_height}")

    @classmethod
    def parse(cls, slope: float, min_height: float) -> MinHeightSlope:
        """Return the filter of a value of the option."""
        return cls(min_height, slope)

    @property
    def text(self) -> str:
        """The slope as the option takes it."""
        return repr(self.slope)

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return which points are outside of the wedge; see `pc2scan.request.filters.Filter`."""
        x, y, z = (axis.astype(np.float64) for axis in points.xyz())
        # NumPy's hypot takes ten times as long; squares of float32 cannot overflow in float64.
        below: NDArray[np.bool_] = z < self.min_height + self.slope * np.sqrt(x * x + y * y)
        return ~below | (z < self.min_height)
