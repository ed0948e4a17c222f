"""The points of one message, and of callers: arrays, structured or masked arrays, dicts of columns."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeGuard, cast

import numpy as np

from pc2scan.errors import DecodeError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, DTypeLike, NDArray


class Columns(Protocol):
    """Fields of points by name, as in a dict of arrays, a DataFrame, or a `pc2scan.Cloud`."""

    def keys(self) -> Iterable[str]:
        """Return the names."""
        ...

    def __getitem__(self, name: str, /) -> Any: ...


_AXES = ("x", "y", "z")

#: A field that steps add and no message has: the time of each point, float64 seconds after the stamp, NaN if unknown.
TIME = "<time>"

#: A field that is added on request: the index of each point in its cloud.
NUMBER = "<number>"


# Instances are never changed. They are not frozen, because creating a frozen one takes three times as long.
@dataclass(slots=True, eq=False)
class Points:
    """The points of one message: the result of decoding, and the input and output of steps.

    Attributes
    ----------
    sequence
        ROS 1's ``header.seq``; 0 for ROS 2.
    stamp_ns
        ``header.stamp``, nanoseconds.
    frame_id
        The frame of ``x``, ``y`` and ``z``.
    fields
        Every field of the points by name, ``x``, ``y`` and ``z`` (metres) among them: arrays of one shape, (M,) or
        (H, W), of any of PointField's datatypes. May be decoded on request.
    lossy
        What was lost before the points were recorded, for a warning; empty: nothing.
    """

    sequence: int
    stamp_ns: int
    frame_id: str
    fields: Mapping[str, NDArray[Any]]
    lossy: str = ""

    def field(self, name: str) -> NDArray[Any]:
        """Return one field of every point.

        Raises
        ------
        DecodeError
            If it is missing, or cannot be decoded.
        """
        try:
            return self.fields[name]
        except KeyError:
            raise self._missing(name) from None

    def xyz(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return the coordinates, metres in ``frame_id``.

        Raises
        ------
        DecodeError
            As `field` does.
        """
        fields = self.fields
        try:
            return fields["x"], fields["y"], fields["z"]
        except KeyError as err:
            raise self._missing(err.args[0]) from None

    def _missing(self, name: str) -> DecodeError:
        names = ", ".join(self.fields) or "none"
        return DecodeError(f"no field {name!r}; the cloud's fields are: {names}", stamp_ns=self.stamp_ns)

    def select(self, kept: NDArray[np.bool_]) -> Points:
        """Return the points where ``kept`` is true, in their order.

        Parameters
        ----------
        kept
            Boolean array of the shape of the fields.
        """
        return Points(self.sequence, self.stamp_ns, self.frame_id, _SelectedFields(self.fields, np.flatnonzero(kept)))

    def transform(self, transform: NDArray[np.float32], frame_id: str) -> Points:
        """Return the points with ``x``, ``y`` and ``z`` in another frame, equal to the projection's to the bit.

        Parameters
        ----------
        transform
            (4, 3): the rows of the rotation, then the translation; see `pc2scan.core.rigid.Rigid.as_float32`.
        frame_id
            The name of the other frame.
        """
        from .plain import transform_points  # noqa: PLC0415  # most conversions transform in the compiled loops

        with np.errstate(all="ignore"):
            x, y, z = (axis.astype(np.float32, copy=False) for axis in self.xyz())
            coordinates = transform_points(x, y, z, transform)
        return self.replace(dict(zip(_AXES, coordinates, strict=True)), frame_id)

    def replace(self, values: Mapping[str, NDArray[Any]], frame_id: str) -> Points:
        """Return the points with other values of some fields, or with new fields; all of the same shape."""
        fields = ChainMap(cast("dict[str, NDArray[Any]]", values), cast("dict[str, NDArray[Any]]", self.fields))
        return Points(self.sequence, self.stamp_ns, frame_id, fields)


class _SelectedFields(Mapping[str, "NDArray[Any]"]):
    """Fields of some of the points, which are selected on request."""

    def __init__(self, fields: Mapping[str, NDArray[Any]], places: NDArray[np.intp]) -> None:
        self._fields = fields
        # Indexing by places takes a sixth of the time of a mask that changes often.
        self._places = places
        self._selected: dict[str, NDArray[Any]] = {}

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._selected:
            self._selected[name] = self._fields[name].reshape(-1)[self._places]
        return self._selected[name]

    def __contains__(self, name: object) -> bool:
        return name in self._fields

    def __iter__(self) -> Iterator[str]:
        return iter(self._fields)

    def __len__(self) -> int:
        return len(self._fields)


def _has_columns(points: object) -> TypeGuard[Columns]:
    return hasattr(points, "keys")


def coordinates_of(points: ArrayLike | Columns) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return x, y and z of points.

    Parameters
    ----------
    points
        (M, 3) or (H, W, 3) numbers, or a structured array or a mapping with the fields x, y and z.

    Returns
    -------
    x, y, z
        In their own types; views where possible. NaN where they are masked.

    Raises
    ------
    ValueError
        If the shape is another one, or a field is missing.
    TypeError
        If they are not real numbers.
    """
    if _has_columns(points):
        return _columns(points, points.keys())
    array = np.asanyarray(points)
    if array.dtype.names is not None:
        return _columns(array, array.dtype.names)
    if array.ndim not in {2, 3} or array.shape[-1] != len(_AXES):
        raise ValueError(
            f"points have the shape {array.shape}, expected (M, 3) or (H, W, 3), or a structured array or a dict "
            "with x, y and z"
        )
    x, y, z = (_real_array(array[..., axis], "points", np.float32) for axis in range(len(_AXES)))
    return x, y, z


def values_of(intensities: ArrayLike) -> NDArray[Any]:
    """Return one value for each point; NaN where it is masked.

    Raises
    ------
    TypeError
        If the values are not real numbers.
    """
    return _real_array(intensities, "intensities", np.float64)


def _columns(points: Any, names: Any) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    if missing := [axis for axis in _AXES if axis not in names]:
        raise ValueError(
            f"points have no {' and no '.join(missing)}, their fields are {', '.join(map(str, names)) or 'none'}"
        )
    x, y, z = (_real_array(points[axis], axis, np.float32) for axis in _AXES)
    return x, y, z


def _real_array(values: ArrayLike, name: str, wide: DTypeLike) -> NDArray[Any]:
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
