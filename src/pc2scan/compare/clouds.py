"""One PointCloud2 against another: values of fields, told apart from where the bytes are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.compare import compare_arrays
from pc2scan.errors import DecodeError
from pc2scan.messages.pointcloud2 import DATATYPES

from .difference import Change, ValueChange

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from pc2scan.messages.pointcloud2 import PointCloud2, PointField

    from .rules import Rules

__all__ = ["cloud_changes", "cloud_values", "field_elements"]


def cloud_changes(a: PointCloud2, b: PointCloud2) -> Iterator[Change]:
    """What differs beside the values: fields, shape, layout, and bytes that belong to no field."""
    if a.is_dense != b.is_dense:
        yield Change("is_dense", str(a.is_dense).lower(), str(b.is_dense).lower())
    if (a.height, a.width) != (b.height, b.width):
        yield Change("shape", f"{a.height} x {a.width}", f"{b.height} x {b.width}")
    fields = [", ".join(sorted(map(_described, cloud.fields))) for cloud in (a, b)]
    if fields[0] != fields[1]:
        yield Change("fields", *fields)
    layouts = [_layout(cloud) for cloud in (a, b)]
    if layouts[0] != layouts[1]:
        yield Change("layout", *layouts)
    elif fields[0] == fields[1] and (differing := _differing_padding(a, b)):
        yield Change("padding", "", f"{differing:,} bytes differ")


def cloud_values(a: PointCloud2, b: PointCloud2, rules: Rules) -> Iterator[ValueChange]:
    """Fields whose values differ, where both clouds have them and as many points; wherever their bytes are."""
    if a.points != b.points or (_layout(a) == _layout(b) and np.array_equal(_bytes(a), _bytes(b))):
        return
    others = {field.name: field for field in _readable(b)}
    for field in _readable(a):
        other = others.get(field.name)
        if other is not None and _described(field) == _described(other):
            found = compare_arrays(field_elements(a, field), field_elements(b, other), rules.tolerance(field.name))
            if found.differing:
                yield ValueChange(field.name, found)


def _described(field: PointField) -> str:
    kind = np.dtype(DATATYPES[field.datatype]).name if field.datatype in DATATYPES else f"datatype {field.datatype}"
    # Drivers write 0 for a single element, too.
    return f"{field.name} {kind}" + (f"[{field.count}]" if field.count > 1 else "")


def _layout(cloud: PointCloud2) -> str:
    places = ", ".join(f"{f.name} @{f.offset}" + ("" if f.count == 1 else f" x {f.count}") for f in cloud.fields)
    order = "big" if cloud.is_bigendian else "little"
    steps = f"point_step {cloud.point_step}, row_step {cloud.row_step}, {len(cloud.data)} bytes"
    return f"{places}; {steps}, {order}-endian"


def _readable(cloud: PointCloud2) -> list[PointField]:
    """The fields whose values can be told, of several with one name the first."""
    first: dict[str, PointField] = {}
    for field in cloud.fields:
        first.setdefault(field.name, field)
    return [field for field in first.values() if field.datatype in DATATYPES]


def field_elements(cloud: PointCloud2, field: PointField) -> NDArray[Any]:
    """All elements of a field: shape (points, count), a view where rows follow each other without a gap."""
    first = cloud.field(field.name)
    count = max(field.count, 1)
    if field.offset + count * first.itemsize > cloud.point_step:
        raise DecodeError(
            f"field {field.name!r} has {count} elements, more than fit into point_step {cloud.point_step}",
            stamp_ns=cloud.stamp_ns,
        )
    if not cloud.points:
        return np.empty((0, count), first.dtype)
    strides = (*first.strides, first.itemsize)
    view: NDArray[Any] = np.ndarray((*first.shape, count), first.dtype, cloud.data, field.offset, strides)
    return view.reshape(cloud.points, count)


def _bytes(cloud: PointCloud2) -> NDArray[np.uint8]:
    return np.frombuffer(cloud.data, np.uint8)


def _differing_padding(a: PointCloud2, b: PointCloud2) -> int:
    """Bytes outside of every readable field that differ between clouds of one layout."""
    differs = _bytes(a) != _bytes(b)
    if not differs.any():
        return 0
    # A field's own view, laid over the mask instead of the data, clears what belongs to it.
    for field in _readable(a) if a.points else ():
        width = field_elements(a, field).shape[1] * np.dtype(DATATYPES[field.datatype]).itemsize
        first = a.field(field.name)
        np.ndarray((*first.shape, width), bool, differs, field.offset, (*first.strides, 1))[...] = False
    return int(np.count_nonzero(differs))
