"""Computes the minimum size of a message."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .types import PRIMITIVES, fields_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .types import Field, Struct

#: Bytes of the primitives that have a fixed size.
_WIDTHS = {"bool": 1, "byte": 1, "char": 1, "float32": 4, "float64": 8} | {
    f"{sign}int{bits}": bits // 8 for sign in ("", "u") for bits in (8, 16, 32, 64)
}


def least_bytes(schema: Mapping[str, Struct], name: str, ros_version: int) -> int:
    """Count the bytes that every message of a type takes: sequences and strings empty, no padding.

    Parameters
    ----------
    schema
        Has the type and all nested types; no type contains itself.
    ros_version
        ROS version of the wire format: 1 or 2.
    """
    known: dict[str, int] = {}

    def least(name: str) -> int:
        if name not in known:
            fields = fields_of(name, schema[name], ros_version)
            # ROS 2 puts one byte into a message without fields.
            known[name] = sum(map(of_field, fields)) if fields else ros_version - 1
        return known[name]

    def of_field(field: Field) -> int:
        if field.shape == "sequence":
            return 4
        if field.type == "string":
            # ROS 2's strings end with a NUL.
            size = 3 + ros_version
        else:
            size = _WIDTHS[field.type] if field.type in PRIMITIVES else least(field.type)
        return size * field.size if field.shape == "array" else size

    return least(name)
