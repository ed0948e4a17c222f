"""Compares two PointCloud2 messages: the values of fields, and apart from them the layout."""

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


def cloud_changes(a: PointCloud2, b: PointCloud2) -> Iterator[Change]:
    """Yield differences other than values: fields, shape, layout, and bytes that belong to no field."""
    if a.is_dense != b.is_dense:
        yield Change("is_dense", str(a.is_dense).lower(), str(b.is_dense).lower())
    if (a.height, a.width) != (b.height, b.width):
        yield Change("shape", f"{a.height} x {a.width}", f"{b.height} x {b.width}")
    fields = [", ".join(sorted(map(_field_text, cloud.fields))) for cloud in (a, b)]
    if fields[0] != fields[1]:
        yield Change("fields", *fields)
    layouts = [_layout_text(cloud) for cloud in (a, b)]
    if layouts[0] != layouts[1]:
        yield Change("layout", *layouts)
    elif fields[0] == fields[1] and (differing := _differing_padding(a, b)):
        yield Change("padding", "", f"{differing:,} bytes differ")


def cloud_values(a: PointCloud2, b: PointCloud2, rules: Rules) -> Iterator[ValueChange]:
    """Yield fields whose values differ, of fields that both clouds have, if they have as many points."""
    if a.points != b.points or (_layout_text(a) == _layout_text(b) and np.array_equal(_bytes(a), _bytes(b))):
        return
    others = {field.name: field for field in _readable(b)}
    for field in _readable(a):
        other = others.get(field.name)
        if other is not None and _field_text(field) == _field_text(other):
            found = compare_arrays(field_elements(a, field), field_elements(b, other), rules.tolerance(field.name))
            if found.differing:
                yield ValueChange(field.name, found)


def _field_text(field: PointField) -> str:
    # Drivers write 0 for a single element, too.
    return f"{field.name} {field.datatype_name}" + (f"[{field.count}]" if field.count > 1 else "")


def _layout_text(cloud: PointCloud2) -> str:
    places = ", ".join(f"{f.name} @{f.offset}" + ("" if f.count == 1 else f" x {f.count}") for f in cloud.fields)
    order = "big" if cloud.is_bigendian else "little"
    steps = f"point_step {cloud.point_step}, row_step {cloud.row_step}, {len(cloud.data)} bytes"
    return f"{places}; {steps}, {order}-endian"


def _readable(cloud: PointCloud2) -> list[PointField]:
    """Return the fields with a known datatype; of several with one name the first."""
    first: dict[str, PointField] = {}
    for field in cloud.fields:
        first.setdefault(field.name, field)
    return [field for field in first.values() if field.datatype in DATATYPES]


def field_elements(cloud: PointCloud2, field: PointField) -> NDArray[Any]:
    """Return all elements of a field: shape (points, count), a view if rows follow each other without a gap."""
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
    """Count the differing bytes outside of all readable fields, of clouds with one layout."""
    differs = _bytes(a) != _bytes(b)
    if not differs.any():
        return 0
    # Clears the bytes of each field, with the field's view on the mask instead of the data.
    for field in _readable(a) if a.points else ():
        width = field_elements(a, field).shape[1] * np.dtype(DATATYPES[field.datatype]).itemsize
        first = a.field(field.name)
        np.ndarray((*first.shape, width), bool, differs, field.offset, (*first.strides, 1))[...] = False
    return int(np.count_nonzero(differs))
