"""Beam filters by the rules of laser_filters: shadows and speckles."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from pc2scan.core.beam_filters import shadows, speckles_by_distance, speckles_by_neighbors
from pc2scan.errors import UsageError
from pc2scan.names import did_you_mean

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["BeamFilter", "Shadows", "Speckles", "beam_filter"]

_TRUE = {"true": True, "false": False}


@dataclass(frozen=True, slots=True)
class Shadows:
    """``ScanShadowsFilter``: finds returns between an edge and the object behind it, which are on neither.

    Parameters
    ----------
    min_angle, max_angle, window, neighbors, remove_shadow_start_point
        As in laser_filters, with the values of its example; see `pc2scan.core.beam_filters.shadows`.
    """

    min_angle: float = 10.0
    max_angle: float = 170.0
    window: int = 1
    neighbors: int = 20
    remove_shadow_start_point: bool = False

    name: ClassVar[str] = "shadows"

    def __post_init__(self) -> None:
        _refuse_unless(0 <= self.min_angle <= 90, "min_angle", self.min_angle, "0 to 90 degrees")
        _refuse_unless(90 <= self.max_angle <= 180, "max_angle", self.max_angle, "90 to 180 degrees")
        _refuse_unless(1 <= self.window <= 1000, "window", self.window, "1 to 1000 beams")
        _refuse_unless(0 <= self.neighbors <= 1000, "neighbors", self.neighbors, "0 to 1000 beams")

    def __call__(self, ranges: NDArray[np.float32], increment: float, *, closed: bool) -> NDArray[np.bool_]:
        """Return which beams to remove."""
        return shadows(ranges, increment, closed=closed, **dataclasses.asdict(self))


@dataclass(frozen=True, slots=True)
class Speckles:
    """``LaserScanSpeckleFilter``: finds returns with too few other returns near them.

    Parameters
    ----------
    filter_type
        ``Distance`` compares ranges of consecutive beams, ``RadiusOutlier`` counts returns that are near.
    max_range, max_range_difference, filter_window
        As in laser_filters, with the values of its example; see `pc2scan.core.beam_filters`.
    """

    filter_type: str = "Distance"
    max_range: float = 2.0
    max_range_difference: float = 0.1
    filter_window: int = 2

    name: ClassVar[str] = "speckles"

    def __post_init__(self) -> None:
        types = {"0": "Distance", "1": "RadiusOutlier"}
        object.__setattr__(self, "filter_type", types.get(self.filter_type, self.filter_type))
        known = self.filter_type in types.values()
        _refuse_unless(known, "filter_type", self.filter_type, "Distance (0) or RadiusOutlier (1)")
        _refuse_unless(self.max_range >= 0, "max_range", self.max_range, "0 m or more")
        _refuse_unless(self.max_range_difference >= 0, "max_range_difference", self.max_range_difference, "0 m or more")
        _refuse_unless(1 <= self.filter_window <= 1000, "filter_window", self.filter_window, "1 to 1000 beams")

    def __call__(self, ranges: NDArray[np.float32], increment: float, *, closed: bool) -> NDArray[np.bool_]:
        """Return which beams to remove."""
        limits = self.max_range, self.max_range_difference, self.filter_window
        most, difference, window = limits
        if self.filter_type == "Distance":
            return speckles_by_distance(
                ranges, max_range=most, max_range_difference=difference, filter_window=window, closed=closed
            )
        return speckles_by_neighbors(
            ranges, increment, max_range=most, max_range_difference=difference, filter_window=window, closed=closed
        )


BeamFilter = Shadows | Speckles

_FILTERS: dict[str, type[Shadows | Speckles]] = {kind.name: kind for kind in (Shadows, Speckles)}


def _refuse_unless(holds: bool, name: str, value: object, allowed: str) -> None:  # the result of the check
    if not holds:
        raise UsageError(f"`remove`: {name} is {value}, it must be {allowed}")


def beam_filter(text: str) -> BeamFilter:
    """Read ``shadows`` or ``speckles``, and its parameters: ``shadows min_angle=5 window=2``.

    Raises
    ------
    UsageError
        If it is neither, or a parameter is wrong.
    """
    name, *settings = text.split() or [""]
    if name not in _FILTERS:
        raise UsageError(
            f"`remove` is {text!r}, it must begin with one of {', '.join(_FILTERS)}",
            hint=did_you_mean(name, _FILTERS) or None,
        )
    kind = _FILTERS[name]
    defaults = {each.name: each.default for each in fields(kind)}
    given: dict[str, object] = {}
    for setting in settings:
        key, _, value = setting.partition("=")
        if key not in defaults:
            raise UsageError(
                f"`remove`: {name} has no parameter {key!r}, only {', '.join(defaults)}",
                hint=did_you_mean(key, defaults) or None,
            )
        given[key] = _read_value(name, key, value, defaults[key])
    return kind(**given)  # type: ignore[arg-type]  # of the types of the defaults


def _read_value(name: str, key: str, value: str, default: object) -> object:
    """Return a value of the same type as the default."""
    try:
        if isinstance(default, bool):
            return _TRUE[value.lower()]
        if isinstance(default, int):
            return int(value)
        if isinstance(default, float):
            number = float(value)
            if math.isnan(number):
                raise ValueError(value)
            return number
    except (KeyError, ValueError):
        kind = "true or false" if isinstance(default, bool) else "a number"
        raise UsageError(f"`remove`: {key} of {name} is {value!r}, it must be {kind}") from None
    return value
