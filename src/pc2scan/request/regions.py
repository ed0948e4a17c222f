"""The filter that rejects the points in a box in any frame, such as the robot's own body."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pc2scan.core.rule import within
from pc2scan.errors import UsageError
from pc2scan.transforms.static import number_in

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pc2scan.core.points import Points

_BOX = "write 'frame x0 x1 y0 y1 z0 z1' (metres), such as 'base_link -0.4 0.4 -0.3 0.3 0 1.2'"


@dataclass(frozen=True, slots=True)
class ExcludeBox:
    """Rejects the points in a box, its faces included.

    Parameters
    ----------
    frame
        The frame of the box.
    x, y, z
        The limits of the box, metres; they may be infinite.

    Raises
    ------
    UsageError
        If a lower limit is not below the upper one.
    """

    frame: str
    x: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]

    name = "exclude_box"
    explanation = "inside a box of `exclude_box`"
    fields = ()

    def __post_init__(self) -> None:
        for axis in ("x", "y", "z"):
            low, high = getattr(self, axis)
            if not low < high:
                raise UsageError(
                    f"`exclude_box`: {axis}0 {low:g} m is not below {axis}1 {high:g} m in the box in {self.frame}",
                    hint=_BOX,
                )

    @classmethod
    def parse(cls, text: str, _: float = 0.0) -> ExcludeBox:
        """Read ``frame x0 x1 y0 y1 z0 z1``: metres, or with a unit (``20cm``).

        Raises
        ------
        UsageError
            If the text cannot be read, or is not a box.
        """
        frame, *words = text.replace(",", " ").split() or [""]
        if number_in(frame, "m") is not None:
            raise UsageError(f"`exclude_box`: {text!r} begins with a number, not with a frame", hint=_BOX)
        numbers = []
        for word in words:
            number = number_in(word, "m")
            if number is None or math.isnan(number):
                raise UsageError(f"`exclude_box`: {word!r} in {text!r} is not a number", hint=_BOX)
            numbers.append(number)
        if len(numbers) != 6:
            raise UsageError(f"`exclude_box`: {text!r} has {len(numbers)} numbers, a box has 6", hint=_BOX)
        x0, x1, y0, y1, z0, z1 = numbers
        return cls(frame, (x0, x1), (y0, y1), (z0, z1))

    @property
    def text(self) -> str:
        """The box as `parse` reads it."""
        return " ".join((self.frame, *map(repr, (*self.x, *self.y, *self.z))))

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return which points are outside; see `pc2scan.request.filters.Filter`."""
        x, y, z = points.xyz()
        return ~(within(x, *self.x) & within(y, *self.y) & within(z, *self.z))
