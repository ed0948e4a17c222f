"""Beam filters: shadows and speckles."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from pc2scan.core.beam_filters import speckles, veiled_beams
from pc2scan.errors import UsageError
from pc2scan.text import did_you_mean

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Shadows:
    """Finds returns between an edge and the surface behind it; see `pc2scan.core.beam_filters.veiled_beams`."""

    name: ClassVar[str] = "shadows"
    remedy: ClassVar[str] = (
        "so many are hardly mixed pixels, but thin or rough things (plants, meshes): leave out `remove=shadows`"
    )

    def __call__(self, ranges: NDArray[np.float32], increment: float, *, closed: bool) -> NDArray[np.bool_]:
        """Return which beams to remove."""
        return veiled_beams(ranges, increment, closed=closed)


@dataclass(frozen=True, slots=True)
class Speckles:
    """``LaserScanSpeckleFilter``: finds returns with too few other returns near them.

    Parameters
    ----------
    max_range, max_range_difference, filter_window
        As in laser_filters, with the values of its example; see `pc2scan.core.beam_filters.speckles`.
    """

    max_range: float = 2.0
    max_range_difference: float = 0.1
    filter_window: int = 2

    name: ClassVar[str] = "speckles"

    def __post_init__(self) -> None:
        for name, low, high, unit in (
            ("max_range", 0, math.inf, "m"),
            ("max_range_difference", 0, math.inf, "m"),
            ("filter_window", 1, 1000, "beams"),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                allowed = f"{low} {unit} or more" if math.isinf(high) else f"{low} to {high} {unit}"
                raise UsageError(f"`remove`: {name} is {value}, it must be {allowed}")

    def __call__(self, ranges: NDArray[np.float32], increment: float, *, closed: bool) -> NDArray[np.bool_]:  # noqa: ARG002
        """Return which beams to remove."""
        return speckles(
            ranges,
            max_range=self.max_range,
            max_range_difference=self.max_range_difference,
            filter_window=self.filter_window,
            closed=closed,
        )

    @property
    def remedy(self) -> str:
        """What to type if it removes too many returns."""
        return f"max_range_difference={2 * self.max_range_difference:g} of the speckles removes fewer"


BeamFilter = Shadows | Speckles

_FILTERS: dict[str, type[BeamFilter]] = {Shadows.name: Shadows, Speckles.name: Speckles}


def beam_filter(text: str) -> BeamFilter:
    """Read ``shadows`` or ``speckles``, and its parameters: ``speckles filter_window=3``.

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
    known = {each.name: each.default for each in fields(kind)}
    given: dict[str, object] = {}
    for setting in settings:
        key, _, value = setting.partition("=")
        if key not in known:
            names = f", only {', '.join(known)}" if known else ""
            raise UsageError(f"`remove`: {name} has no parameter {key!r}{names}", hint=did_you_mean(key, known) or None)
        try:
            given[key] = int(value) if isinstance(known[key], int) else float(value)
        except ValueError:
            raise UsageError(f"`remove`: {key} of {name} is {value!r}, it must be a number") from None
    return kind(**given)  # type: ignore[arg-type]  # of the types of the defaults
