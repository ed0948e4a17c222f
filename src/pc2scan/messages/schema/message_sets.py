"""Reads rosbags' message sets, and converts schemas to and from its form of definitions."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from .types import PLACEHOLDER, PRIMITIVES, Constant, Field, Shape, Struct, canonical_type, without_sequence_number

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from .types import Schema


@lru_cache(maxsize=16)
def known_types(store: str) -> Mapping[str, Struct]:
    """Read one of rosbags' message sets, by the value of its ``Stores`` name: ``ros2_jazzy``.

    ``tf2_msgs/msg/TFMessage``, which rosbags' set for ROS 1 lacks, is added.
    """
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    structs = structs_of(get_typestore(Stores(store)).fielddefs)
    structs = {name: without_sequence_number(name, struct) for name, struct in structs.items()}
    transforms = Field("transforms", "geometry_msgs/msg/TransformStamped", "sequence")
    structs.setdefault("tf2_msgs/msg/TFMessage", Struct((transforms,)))
    return structs


def structs_of(typesdict: Mapping[str, Any]) -> dict[str, Struct]:
    """Turn rosbags' parse trees into structs."""
    return {
        canonical_type(name): Struct(
            tuple(_from_rosbags(field, desc) for field, desc in fields if field != PLACEHOLDER),
            tuple(Constant(constant, word, str(value)) for constant, word, value in constants),
        )
        for name, (constants, fields) in typesdict.items()
    }


def _from_rosbags(name: str, desc: Any) -> Field:
    """Turn rosbags' field description into a field."""
    from rosbags.interfaces import Nodetype  # noqa: PLC0415

    shapes: dict[int, Shape] = {Nodetype.ARRAY: "array", Nodetype.SEQUENCE: "sequence"}
    kind, content = desc
    if kind in shapes:
        inner, size = content
        return replace(_from_rosbags(name, inner), shape=shapes[kind], size=size)
    if kind == Nodetype.NAME:
        return Field(name, canonical_type(content))
    word, bound = content
    return Field(name, word, bound=bound)


def fielddefs(
    schema: Schema, type_name: Callable[[str], str], field_name: Callable[[int, Field], str]
) -> dict[str, Any]:
    """Turn a schema into rosbags' parse trees, without constants, with new names for types and fields."""
    from rosbags.interfaces import Nodetype  # noqa: PLC0415

    shapes = {"array": Nodetype.ARRAY, "sequence": Nodetype.SEQUENCE}

    def describe(field: Field) -> Any:
        if field.type in PRIMITIVES:
            # ROS 2's hashes are made from its IDL, which has uint8 for char.
            inner: Any = (Nodetype.BASE, ("uint8" if field.type == "char" else field.type, field.bound))
        else:
            inner = (Nodetype.NAME, type_name(field.type))
        return inner if field.shape == "scalar" else (shapes[field.shape], (inner, field.size))

    return {
        type_name(name): (
            [],
            [(field_name(index, field), describe(field)) for index, field in enumerate(struct.fields)],
        )
        for name, struct in schema.items()
    }
