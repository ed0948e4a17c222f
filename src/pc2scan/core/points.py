"""Points as callers have them: arrays, structured or masked ones, dicts of columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, DTypeLike, NDArray

__all__ = ["coordinates_of", "values_of"]

_AXES = ("x", "y", "z")


def coordinates_of(points: ArrayLike | Mapping[str, ArrayLike]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return x, y and z of points.

    Parameters
    ----------
    points
        (M, 3) or (H, W, 3) numbers, or a structured array or a mapping with the fields x, y and z.

    Returns
    -------
    x, y, z
        Of the types that they have; views where possible. NaN where they are masked.

    Raises
    ------
    ValueError
        If the shape is another one, or a field is missing.
    TypeError
        If they are not real numbers.
    """
    if isinstance(points, Mapping):
        return _columns(points, points.keys())
    array = np.asanyarray(points)
    if array.dtype.names is not None:
        return _columns(array, array.dtype.names)
    if array.ndim not in {2, 3} or array.shape[-1] != len(_AXES):
        raise ValueError(
            f"points have the shape {array.shape}, expected (M, 3) or (H, W, 3), or a structured array or a dict "
            "with x, y and z"
        )
    x, y, z = (_real(array[..., axis], "points", np.float32) for axis in range(len(_AXES)))
    return x, y, z


def values_of(intensities: ArrayLike) -> NDArray[Any]:
    """Return a value a point; NaN where it is masked.

    Raises
    ------
    TypeError
        If the values are not real numbers.
    """
    return _real(intensities, "intensities", np.float64)


def _columns(points: Any, names: Any) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    if missing := [axis for axis in _AXES if axis not in names]:
        raise ValueError(
            f"points have no {' and no '.join(missing)}, their fields are {', '.join(map(str, names)) or 'none'}"
        )
    x, y, z = (_real(points[axis], axis, np.float32) for axis in _AXES)
    return x, y, z


def _real(values: ArrayLike, name: str, wide: DTypeLike) -> NDArray[Any]:
    """Return real numbers as an array; masked integers become ``wide`` to hold NaN."""
    array = np.asanyarray(values)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{name} are of type {array.dtype}, expected integers or floats")
    if isinstance(array, np.ma.MaskedArray):
        if np.ma.is_masked(array):
            unmasked: NDArray[Any] = np.ma.filled(array if array.dtype.kind == "f" else array.astype(wide), np.nan)
            return unmasked
        return array.data
    return np.asarray(array)
