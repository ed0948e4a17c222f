"""The protocol of filters: classes that reject points for one reason."""

from __future__ import annotations

from dataclasses import fields
from enum import Enum
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from pc2scan.core.rule import Rejection
from pc2scan.options.table import options_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

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
    same filter, which pages show in their command. The filter of an option has a class method ``parse``; see
    `filters_of`.
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


def filters_of(values: Mapping[str, Any], min_height: float) -> Iterator[Filter]:
    """Yield the filters that options ask for, in the order of the table of options.

    Its class makes a filter by ``parse(value, min_height)`` of each value of the option, or returns None: no filter is
    needed. The module is imported when it is asked for, because few conversions need it.

    Parameters
    ----------
    values
        Values of options by name; others than those with a filter are ignored.
    min_height
        The parameter of the projection.

    Raises
    ------
    UsageError
        If a value cannot be read.
    """
    for name, option in options_of("convert").items():
        if option.makes and name in values:
            module, _, kind = option.makes.partition(":")
            parse = getattr(import_module(f".{module}", __package__), kind).parse
            for value in values[name] if option.value.repeats else (values[name],):
                if (point_filter := parse(value, min_height)) is not None:
                    yield point_filter
