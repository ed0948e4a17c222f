"""The distribution of a quantity: its range, its percentiles, and a table of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.percentiles import percentiles
from pc2scan.tables import Table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

#: Numbers of float64 beyond this count as infinite.
_LARGEST = 1e300


@dataclass(frozen=True, slots=True)
class Spread:
    """The distribution of a quantity over the sampled points, metres; finite values only."""

    min: float
    p5: float
    median: float
    p95: float
    max: float


def count_range(least: int, most: int) -> str:
    """Return the smallest and the largest of some counts as text; one number if they are equal."""
    return f"{least:,}" if least == most else f"{least:,} to {most:,}"


def finite(values: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Return the finite values whose differences are finite, too; the array itself if all are."""
    if values.size and float(values.min()) > -_LARGEST and float(values.max()) < _LARGEST:
        return values
    # No float32 is as large, nor is their difference.
    known = np.isfinite(values) if values.dtype == np.float32 else (values > -_LARGEST) & (values < _LARGEST)
    found: NDArray[np.floating[Any]] = values[known]
    return found


def spread_of(values: NDArray[np.floating[Any]]) -> Spread | None:
    """Return the spread of the finite values, which are reordered; None if there are none."""
    known = finite(values)
    if not known.size:
        return None
    return Spread(*percentiles(known, 0, 5, 50, 95, 100, reorder=True))


def spread_table(spreads: Mapping[str, Spread]) -> Table:
    """Return the table of spreads by name."""
    return Table(
        ("[m]", "min", "5%", "median", "95%", "max"),
        [(name, *(f"{v:.3f}" for v in (s.min, s.p5, s.median, s.p95, s.max))) for name, s in spreads.items()],
        left=("[m]",),
    )
