"""What a filter is: a class that rejects points for a reason of its own."""

from __future__ import annotations

from dataclasses import fields
from enum import Enum
from typing import TYPE_CHECKING, Any, Protocol

from pc2scan.core.rule import Rejection

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pc2scan.core.points import Points

__all__ = ["Filter", "Frame", "as_dict", "rejection_of"]


class Frame(Enum):
    """The frames that every conversion has; a filter may also work in any other one, by its name."""

    SOURCE = "source"
    TARGET = "target"


class Filter(Protocol):
    """Which points of a cloud are kept: a frozen dataclass whose attributes are its parameters, and these.

    A filter depends on the cloud that it is called with and on nothing else; threads share it.
    """

    @property
    def name(self) -> str:
        """The name of the count of what it rejects: a Python identifier."""
        ...

    @property
    def explanation(self) -> str:
        """What the rejected points are, for a user whose scans are empty: completes "40% of all points were"."""
        ...

    @property
    def fields(self) -> tuple[str, ...]:
        """The fields that it needs besides ``x``, ``y`` and ``z``; the conversion does not begin without them."""
        ...

    @property
    def frame(self) -> Frame | str:
        """The frame that it needs the coordinates in."""
        ...

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return which points are kept, in the shape of the points' fields.

        Points that it cannot judge, such as those with NaN coordinates, are kept: the projection rejects and counts
        them. NumPy's floating-point warnings are off.
        """
        ...


def rejection_of(chosen: Filter) -> Rejection:
    """Return the reason of a filter's rejections."""
    # Of most filters it is no surprise that they reject nothing; so few have this.
    return Rejection(chosen.name, chosen.explanation, absent=getattr(chosen, "absent", ""))


def as_dict(chosen: Filter) -> dict[str, Any]:
    """Return the name and the parameters of a filter, for reports."""
    parameters = {each.name: getattr(chosen, each.name) for each in fields(chosen) if each.repr}  # type: ignore[arg-type]
    return {"name": chosen.name, **parameters}
