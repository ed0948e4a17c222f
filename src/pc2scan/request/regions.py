"""Filters that reject the points of a region: a box or a polygon in any frame, such as the robot's own body."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.rule import within
from pc2scan.errors import UsageError
from pc2scan.transforms.static import number_in

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.core.points import Points

_BOX = "write 'frame x0 x1 y0 y1 z0 z1' (metres), such as 'base_link -0.4 0.4 -0.3 0.3 0 1.2'"
_POLYGON = "write 'frame x0 y0 x1 y1 x2 y2 ...' (metres), at least three corners"


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
        frame, numbers = _frame_and_numbers("exclude_box", text, _BOX)
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


@dataclass(frozen=True, slots=True)
class ExcludePolygon:
    """Rejects the points above, below and inside of a polygon in the x-y plane of a frame.

    A point is inside if a ray from it crosses the outline an odd number of times. Points on the outline may be
    inside or outside.

    Parameters
    ----------
    frame
        The frame of the polygon.
    corners
        x and y of each corner in order, metres; the last one is connected to the first.

    Raises
    ------
    UsageError
        If the frame is empty, there are fewer than three corners, one is not finite, or the polygon has no area.
    """

    frame: str
    corners: tuple[tuple[float, float], ...]

    name = "exclude_polygon"
    explanation = "inside a polygon of `exclude_polygon`"
    fields = ()

    def __post_init__(self) -> None:
        is_finite = all(math.isfinite(value) for corner in self.corners for value in corner)
        has_area = all(len(set(values)) > 1 for values in zip(*self.corners, strict=True))
        if not self.frame or len(self.corners) < 3 or not is_finite or not has_area:
            corners = " ".join(f"{value:g}" for corner in self.corners for value in corner)
            raise UsageError(
                f"`exclude_polygon`: the corners {corners} in {self.frame!r} are no polygon: a polygon has at least "
                "three finite corners, which are not on one line",
                hint=_POLYGON,
            )

    @classmethod
    def parse(cls, text: str, _: float = 0.0) -> ExcludePolygon:
        """Read ``frame x0 y0 x1 y1 x2 y2 ...``; brackets, as in a footprint of Nav2, make no difference.

        Raises
        ------
        UsageError
            If the text cannot be read, or is not a polygon.
        """
        frame, numbers = _frame_and_numbers("exclude_polygon", text.translate(str.maketrans("[]()", "    ")), _POLYGON)
        if len(numbers) % 2:
            raise UsageError(f"`exclude_polygon`: {text!r} has {len(numbers)} numbers, which is odd", hint=_POLYGON)
        return cls(frame, tuple(zip(numbers[::2], numbers[1::2], strict=True)))

    @property
    def text(self) -> str:
        """The polygon as `parse` reads it."""
        return " ".join((self.frame, *(repr(value) for corner in self.corners for value in corner)))

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return which points are outside; see `pc2scan.request.filters.Filter`."""
        xs, ys = zip(*self.corners, strict=True)
        all_x, all_y, _ = points.xyz()
        near = within(all_x, min(xs), max(xs)) & within(all_y, min(ys), max(ys))
        x, y = (axis[near].astype(np.float64) for axis in (all_x, all_y))
        inside = np.zeros(x.size, np.bool_)
        for (x0, y0), (x1, y1) in zip(self.corners, (*self.corners[1:], self.corners[0]), strict=True):
            if y0 != y1:
                inside ^= ((y0 > y) != (y1 > y)) & (x < (x1 - x0) * ((y - y0) / (y1 - y0)) + x0)
        kept = np.ones(all_x.shape, np.bool_)
        kept[near] = ~inside
        return kept


def _frame_and_numbers(option: str, text: str, usage: str) -> tuple[str, list[float]]:
    """Read a frame and the numbers after it."""
    words = text.replace(",", " ").split()
    numbers = [number for word in words[1:] if (number := number_in(word, "m")) is not None and not math.isnan(number)]
    if not words or number_in(words[0], "m") is not None or len(numbers) < len(words) - 1:
        raise UsageError(f"`{option}`: {text!r} is not a frame and numbers", hint=usage)
    return words[0], numbers
