"""Compares two arrays of measurements: which differ, by how much, and which only moved to a neighbouring element.

Without a tolerance, values are equal if their bits are: a NaN with another payload differs, and -0.0 differs from
0.0. With a tolerance they are compared as numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.errors import UsageError

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far a value may be from its reference: ``abs(value - reference) <= atol + rtol * abs(reference)``.

    Attributes
    ----------
    atol
        Absolute tolerance, in the unit of the values.
    rtol
        Relative tolerance, as a share of the reference.

    Raises
    ------
    UsageError
        If one is negative or not finite.
    """

    atol: float = 0.0
    rtol: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("atol", self.atol), ("rtol", self.rtol)):
            if not (math.isfinite(value) and value >= 0):
                raise UsageError(f"{name} is {value}, it must be a finite number of at least 0")

    @property
    def exact(self) -> bool:
        """Whether bits are compared."""
        return not (self.atol or self.rtol)


EXACT = Tolerance()


@dataclass(frozen=True, slots=True)
class WorstElement:
    """The element with the largest difference.

    Attributes
    ----------
    index
        Index of the element (the beam, the point).
    reference, value
        Its values in the two arrays.
    difference
        ``abs(value - reference)``; infinity if only one of them is finite, 0.0 if only the bits differ.
    """

    index: int
    reference: float
    value: float
    difference: float


@dataclass(frozen=True, slots=True)
class ArrayDifference:
    """The differences between two arrays of the same length.

    Attributes
    ----------
    elements
        How many elements were compared.
    changed
        How many elements are beyond the tolerance, and are not explained by a shift.
    shifted
        How many elements are beyond the tolerance, but have their value, or their reference, at a neighbour that
        differs, too: returns that fell into the neighbouring beam.
    worst
        The largest difference; None if nothing differs.
    """

    elements: int
    changed: int = 0
    shifted: int = 0
    worst: WorstElement | None = None

    @property
    def differing(self) -> int:
        """How many elements are beyond the tolerance."""
        return self.changed + self.shifted


@np.errstate(invalid="ignore", over="ignore")  # a NaN may be a signalling one
def compare_arrays(
    reference: NDArray[Any],
    value: NDArray[Any],
    tolerance: Tolerance = EXACT,
    *,
    limits: tuple[float, float] | None = None,
) -> ArrayDifference:
    """Compare two arrays, element by element.

    Parameters
    ----------
    reference, value
        Arrays of the same shape, ``(n,)`` or ``(n, count)``, and the same numeric dtype, except for the byte order. An
        element with several values differs if one of them does.
    tolerance
        It does not apply to integers: they are equal or not. An infinity equals only itself, and with a tolerance NaN
        equals NaN.
    limits
        Smallest and largest value of a return. If given, for one-dimensional arrays, returns that moved to a neighbour
        are distinguished from changed ones; values outside of the limits are no returns, and do not move.

    Raises
    ------
    ValueError
        If the shapes or dtypes differ.
    """
    kind = reference.dtype.newbyteorder("=")
    if reference.shape != value.shape or kind != value.dtype.newbyteorder("="):
        raise ValueError(f"{reference.dtype}{reference.shape} cannot be compared with {value.dtype}{value.shape}")
    a, b = (np.ascontiguousarray(array, kind) for array in (reference, value))
    elements = len(a)
    differs = ~_equal_values(a, b, tolerance)
    rows: NDArray[np.bool_] = differs if differs.ndim == 1 else np.any(differs, axis=1)
    total = int(np.count_nonzero(rows))
    if not total:
        return ArrayDifference(elements)
    shifted = 0
    if limits is not None and elements > 1:
        shifted = int(np.count_nonzero(_neighbour_moves(a, b, rows, tolerance, limits)))
    return ArrayDifference(elements, total - shifted, shifted, _worst(a, b, differs))


def _equal_values(a: NDArray[Any], b: NDArray[Any], tolerance: Tolerance) -> NDArray[np.bool_]:
    """Return which values are equal; all of one shape and dtype."""
    result: NDArray[np.bool_]
    if a.dtype.kind != "f":
        result = a == b
        return result
    bits = np.dtype(f"u{a.dtype.itemsize}")
    result = a.view(bits) == b.view(bits)
    if tolerance.exact or result.all():
        return result
    wide_a, wide_b = a.astype(np.float64), b.astype(np.float64)
    finite = np.isfinite(wide_a) & np.isfinite(wide_b)
    near = np.abs(wide_b - wide_a) <= tolerance.atol + tolerance.rtol * np.abs(wide_a)
    equal = (wide_a == wide_b) | (np.isnan(wide_a) & np.isnan(wide_b))
    result = result | equal | (finite & near)
    return result


def _neighbour_moves(
    a: NDArray[Any], b: NDArray[Any], differs: NDArray[np.bool_], tolerance: Tolerance, limits: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return which differing elements have their return at a neighbour that differs, too."""
    low, high = limits
    both = differs[:-1] & differs[1:]
    explained = np.zeros(len(a), bool)
    # For each pair of neighbours: the left one of a equals the right one of b, or the other way round.
    for left, right in ((a, b), (b, a)):
        moved = both & _equal_values(left[:-1], right[1:], tolerance) & (left[:-1] >= low) & (left[:-1] <= high)
        moved &= np.isfinite(left[:-1])
        explained[:-1] |= moved
        explained[1:] |= moved
    return explained


def _worst(a: NDArray[Any], b: NDArray[Any], differs: NDArray[np.bool_]) -> WorstElement:
    places = np.flatnonzero(differs)
    flat_a, flat_b = a.ravel()[places], b.ravel()[places]
    distance = np.abs(flat_b.astype(np.float64) - flat_a.astype(np.float64))
    alike = (flat_a == flat_b) | (np.isnan(flat_a) & np.isnan(flat_b))
    # NaN against a number is an infinite difference; different bits of the same value are no difference.
    distance[np.isnan(distance)] = np.inf
    distance[alike] = 0.0
    place = int(np.argmax(distance))
    index = int(places[place]) // (a.size // len(a))
    return WorstElement(index, flat_a[place].item(), flat_b[place].item(), float(distance[place]))
