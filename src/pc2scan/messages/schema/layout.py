"""Compares the wire layout of two definitions of a type."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .types import PRIMITIVES, builtin

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .types import Field, Struct


def same_layout(ours: Mapping[str, Struct], theirs: Mapping[str, Struct], name: str) -> bool:
    """Whether both have a type with the same bytes on the wire and the same names.

    Names are compared without case and underscores (ROS 1's ``CameraInfo.D`` is ROS 2's ``d``). Bounds and
    constants are ignored, and ``byte``, ``char`` and ``uint8`` are the same.
    """
    if builtin(name):
        return True
    if name not in ours or name not in theirs:
        return False
    left, right = ours[name].fields, theirs[name].fields
    return len(left) == len(right) and all(
        _wire(a) == _wire(b) and (a.type in PRIMITIVES or same_layout(ours, theirs, a.type))
        for a, b in zip(left, right, strict=True)
    )


def _wire(field: Field) -> tuple[str, str, str, int]:
    kind = "uint8" if field.type in {"byte", "char"} else field.type
    size = field.size if field.shape == "array" else 0
    return field.name.lower().replace("_", ""), kind, field.shape, size
