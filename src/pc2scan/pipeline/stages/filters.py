"""The protocol of filters: classes that reject points for one reason."""

from __future__ import annotations

from dataclasses import fields
from enum import Enum
from typing import TYPE_CHECKING, Any, Protocol

from pc2scan.core.rule import Rejection

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pc2scan.core.points import Points


class Frame(Enum):
    """The frames that every conversion has; a filter may use any other frame by its name."""

    SOURCE = "source"
    TARGET = "target"


class Filter(Protocol):
    """Selects points of a cloud: a frozen dataclass with its parameters, and these attributes.

    The result of a filter depends only on the cloud; threads share the filter. Two more attributes are optional:
    ``absent``, a warning for the case that nothing is rejected, and ``text``, the value of the option that makes the
    same filter, which pages show in their command.
    """

    @property
    def name(self) -> str:
        """The name of the count of rejected points: a Python identifier."""
        ...

    @property
    def explanation(self) -> str:
        """Why points are rejected, for a user whose scans are empty: completes "40% of all points were"."""
        ...

    @property
    def fields(self) -> tuple[str, ...]:
        """The fields that it needs besides ``x``, ``y`` and ``z``; if one is missing, the conversion does not begin."""
        ...

    @property
    def frame(self) -> Frame | str:
        """The frame of the coordinates that it needs."""
        ...

    def __call__(self, points: Points) -> NDArray[np.bool_]:
        """Return a mask of the points that are kept, in the shape of the points' fields.

        Points that it cannot judge are kept, such as those with NaN coordinates: the projection rejects and counts
        them. NumPy's floating-point warnings are off.
        """
        ...


def rejection_of(chosen: Filter) -> Rejection:
    """Return the reason of a filter's rejections."""
    # The warning for the case that nothing is rejected is optional.
    return Rejection(chosen.name, chosen.explanation, absent=getattr(chosen, "absent", ""))


def as_dict(chosen: Filter) -> dict[str, Any]:
    """Return the name and the parameters of a filter, for reports."""
    parameters = {each.name: getattr(chosen, each.name) for each in fields(chosen) if each.repr}  # type: ignore[arg-type]
    return {"name": chosen.name, **parameters}
