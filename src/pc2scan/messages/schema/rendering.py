"""Writes definitions as text, for either ROS version, and computes ROS's hashes of them: md5sum and RIHS01."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from pc2scan.model import ros1_type

from .message_sets import fielddefs
from .types import BUILTIN, PRIMITIVES, fields_of, is_builtin

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .types import Field, Schema, Struct


def render(schema: Schema, ros_version: int) -> str:
    """Write a schema as ``ros1msg`` or ``ros2msg`` text: its first type, then the others in sections."""
    names = list(schema)
    parts = [_render_struct(names[0], schema[names[0]], ros_version)]
    for name in names[1:]:
        if ros_version == 1 and is_builtin(name):
            continue
        parts.append(f"{'=' * 80}\nMSG: {ros1_type(name)}\n{_render_struct(name, schema[name], ros_version)}")
    return "".join(parts)


def _render_struct(name: str, struct: Struct, ros_version: int) -> str:
    lines = [*constant_lines(struct, ros_version)]
    lines += [f"{type_word(field, ros_version)} {field.name}" for field in fields_of(name, struct, ros_version)]
    return "".join(f"{line}\n" for line in lines)


def constant_lines(struct: Struct, ros_version: int) -> Iterator[str]:
    """Write the constants, a line each."""
    for constant in struct.constants:
        value = constant.value
        if constant.type == "string":
            bare = value[1:-1] if len(value) > 1 and value[0] == value[-1] and value[0] in "'\"" else value
            # In ROS 1 quotes would be part of the value; in ROS 2 a # outside quotes begins a comment.
            value = bare if ros_version == 1 else _quote(bare)
        yield f"{constant.type} {constant.name}={value}"


def _quote(value: str) -> str:
    return f"'{value}'" if '"' in value and "'" not in value else '"' + value.replace('"', '\\"') + '"'


def type_word(field: Field, ros_version: int) -> str:
    """Write a field's type; ROS 1 has no bounds."""
    if field.type in PRIMITIVES:
        word = f"{field.type}<={field.bound}" if field.bound and ros_version == 2 else field.type
    elif ros_version == 1 and is_builtin(field.type):
        word = BUILTIN[field.type][0]
    else:
        word = ros1_type(field.type)
    return word + _suffix(field, ros_version)


def _suffix(field: Field, ros_version: int) -> str:
    if field.shape == "scalar":
        return ""
    if field.shape == "array":
        return f"[{field.size}]"
    return f"[<={field.size}]" if field.size and ros_version == 2 else "[]"


def md5sum(schema: Schema) -> str:
    """Compute ROS 1's hash of a schema's first type: the MD5 of its text, nested types as their sums."""
    sums: dict[str, str] = {}

    def identify(name: str) -> str:
        if name not in sums:
            lines = [*constant_lines(schema[name], 1)]
            for field in fields_of(name, schema[name], 1):
                plain = field.type in PRIMITIVES or is_builtin(field.type)
                lines.append(f"{type_word(field, 1) if plain else identify(field.type)} {field.name}")
            sums[name] = hashlib.md5("\n".join(lines).encode(), usedforsecurity=False).hexdigest()
        return sums[name]

    return identify(next(iter(schema)))


def rihs01(schema: Schema) -> str:
    """Compute ROS 2's hash of a schema's first type."""
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    store = get_typestore(Stores.EMPTY)
    # Only the parse trees are needed: nothing is registered, so no code is generated from the names.
    store.fielddefs = fielddefs(schema, str, lambda _, field: field.name)
    return store.hash_rihs01(next(iter(schema)))
