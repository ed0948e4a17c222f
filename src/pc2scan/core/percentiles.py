"""Percentiles and medians.

NumPy's functions import `numpy.ma`, which takes 10 % of a short conversion. Importing `statistics` takes longer than
projecting a cloud.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike, NDArray

_Number = TypeVar("_Number", int, float)


def percentiles(values: ArrayLike, *percents: float) -> tuple[float, ...]:
    """Return percentiles, interpolated linearly between the two nearest values.

    Parameters
    ----------
    values
        At least one value; none is NaN.
    percents
        From 0 to 100.

    Examples
    --------
    >>> percentiles([4.0, 1.0, 2.0, 3.0], 0, 50, 90)
    (1.0, 2.5, 3.7)
    """
    flat = np.ravel(values)
    places = [percent / 100 * (len(flat) - 1) for percent in percents]
    near = {min(index, len(flat) - 1) for place in places for index in (math.floor(place), math.floor(place) + 1)}
    ordered: NDArray[Any] = np.partition(flat, sorted(near))
    results = []
    for place in places:
        below = math.floor(place)
        low, high = float(ordered[below]), float(ordered[min(below + 1, len(ordered) - 1)])
        # Interpolated from the nearer value, as NumPy does, so that the results are equal.
        part = place - below
        results.append(high - (high - low) * (1 - part) if part >= 0.5 else low + (high - low) * part)
    return tuple(results)


def median(values: ArrayLike) -> float:
    """Return the median of at least one value, none of them NaN; NumPy's imports its masked arrays, 10 MB.

    >>> median([3.0, 1.0])
    2.0
    """
    ordered: NDArray[Any] = np.sort(values, axis=None)
    half = len(ordered) // 2
    return float(ordered[half] + ordered[-1 - half]) / 2


def median_low(values: Iterable[_Number]) -> _Number:
    """Return the median of at least one number: the lower one, if two are in the middle.

    >>> median_low([3, 1, 2, 4])
    2
    """
    ordered = sorted(values)
    return ordered[(len(ordered) - 1) // 2]
