"""Beam filters: shadows and speckles."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

from pc2scan.core.beam_filters import shadows, speckles_by_distance, speckles_by_neighbors, veiled_beams
from pc2scan.errors import UsageError
from pc2scan.text import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

_TRUE = {"true": True, "false": False}

#: The parameters of ``ScanShadowsFilter``, with the values of laser_filters' example.
_SHADOWS: Mapping[str, float | int | bool] = {
    "min_angle": 10.0,
    "max_angle": 170.0,
    "window": 1,
    "neighbors": 20,
    "remove_shadow_start_point": False,
}


@dataclass(frozen=True, slots=True)
class Shadows:
    """Finds returns between an edge and the surface behind it, which are on neither.

    Without parameters by pc2scan's own rule, `pc2scan.core.beam_filters.veiled_beams`. With any of them it is
    laser_filters' ``ScanShadowsFilter``, `pc2scan.core.beam_filters.shadows`; the others then have the values of
    laser_filters' example.

    Parameters
    ----------
    min_angle, max_angle, window, neighbors, remove_shadow_start_point
        As in laser_filters; all are None, or none is.
    """

    min_angle: float | None = None
    max_angle: float | None = None
    window: int | None = None
    neighbors: int | None = None
    remove_shadow_start_point: bool | None = None

    name: ClassVar[str] = "shadows"

    def __post_init__(self) -> None:
        if not self._parameters:
            return
        for name, value in _SHADOWS.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        _refuse_outside(self, "min_angle", 0, 90, "degrees")
        _refuse_outside(self, "max_angle", 90, 180, "degrees")
        _refuse_outside(self, "window", 1, 1000, "beams")
        _refuse_outside(self, "neighbors", 0, 1000, "beams")

    def __call__(self, ranges: NDArray[np.float32], increment: float, *, closed: bool) -> NDArray[np.bool_]:
        """Return which beams to remove."""
        if not self._parameters:
            return veiled_beams(ranges, increment, closed=closed)
        return shadows(ranges, increment, closed=closed, **self._parameters)

    @property
    def remedy(self) -> str:
        """What to type if it removes too many returns."""
        if self._parameters:
            return "`remove=shadows` without parameters keeps returns that continue a surface"
        return "so many are hardly mixed pixels, but thin or rough things (plants, meshes): leave out `remove=shadows`"

    @property
    def _parameters(self) -> dict[str, Any]:
        """The parameters of laser_filters; empty if they are not used."""
        return {name: value for name in _SHADOWS if (value := getattr(self, name)) is not None}


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
        if self.filter_type not in types.values():
            allowed = "Distance (0) or RadiusOutlier (1)"
            raise UsageError(f"`remove`: filter_type is {self.filter_type}, it must be {allowed}")
        _refuse_outside(self, "max_range", 0, math.inf, "m")
        _refuse_outside(self, "max_range_difference", 0, math.inf, "m")
        _refuse_outside(self, "filter_window", 1, 1000, "beams")

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

    @property
    def remedy(self) -> str:
        """What to type if it removes too many returns."""
        return f"`max_range_difference={2 * self.max_range_difference:g}` of the speckles removes fewer"


BeamFilter = Shadows | Speckles

#: Each filter by its name, and a value of each of its parameters.
_FILTERS: dict[str, tuple[type[BeamFilter], Mapping[str, object]]] = {
    Shadows.name: (Shadows, _SHADOWS),
    Speckles.name: (Speckles, {each.name: each.default for each in fields(Speckles)}),
}


def _refuse_outside(chosen: BeamFilter, name: str, low: float, high: float, unit: str) -> None:
    value = getattr(chosen, name)
    if not low <= value <= high:
        allowed = f"{low} {unit} or more" if math.isinf(high) else f"{low} to {high} {unit}"
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
    kind, known = _FILTERS[name]
    given: dict[str, object] = {}
    for setting in settings:
        key, _, value = setting.partition("=")
        if key not in known:
            raise UsageError(
                f"`remove`: {name} has no parameter {key!r}, only {', '.join(known)}",
                hint=did_you_mean(key, known) or None,
            )
        given[key] = _read_value(name, key, value, known[key])
    return kind(**given)  # type: ignore[arg-type]  # of the types of the defaults


def _read_value(name: str, key: str, value: str, known: object) -> object:
    """Return a value of the same type as a known one."""
    kind = type(known)
    try:
        return _TRUE[value.lower()] if isinstance(known, bool) else kind(value)  # type: ignore[call-arg]
    except (KeyError, ValueError):
        expected = "true or false" if isinstance(known, bool) else "a number"
        raise UsageError(f"`remove`: {key} of {name} is {value!r}, it must be {expected}") from None
