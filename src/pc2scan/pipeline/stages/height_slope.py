"""A filter with a lower height limit that grows with range: for ramps, rough ground, and lidars that are not level."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.errors import UsageError

from .filters import Frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.core.points import Points


@dataclass(frozen=True, slots=True)
class MinHeightSlope:
    """Rejects points below ``min_height + slope * hypot(x, y)`` in the scan's frame.

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
    explanation = "below min_height and `min_height_slope`"
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

    @property
    def text(self) -> str:
        """The slope as the option takes it."""
        return repr(self.slope)

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return which points are not below the limit; see `pc2scan.pipeline.stages.filters.Filter`."""
        x, y, z = (axis.astype(np.float64) for axis in points.xyz())
        # NumPy's hypot takes ten times as long; squares of float32 cannot overflow in float64.
        below: NDArray[np.bool_] = z < self.min_height + self.slope * np.sqrt(x * x + y * y)
        return ~below
