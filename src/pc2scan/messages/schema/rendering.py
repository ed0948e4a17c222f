"""Writes definitions as text, for either ROS version."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.model import ros1_type

from .types import BUILTIN, PRIMITIVES, builtin, fields_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .types import Field, Schema, Struct


def render(schema: Schema, ros_version: int) -> str:
    """Write a schema as ``ros1msg`` or ``ros2msg`` text: its first type, then the others in sections."""
    names = list(schema)
    parts = [_render_struct(names[0], schema[names[0]], ros_version)]
    for name in names[1:]:
        if ros_version == 1 and builtin(name):
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
            value = bare if ros_version == 1 else _quoted(bare)
        yield f"{constant.type} {constant.name}={value}"


def _quoted(value: str) -> str:
    return f"'{value}'" if '"' in value and "'" not in value else '"' + value.replace('"', '\\"') + '"'


def type_word(field: Field, ros_version: int) -> str:
    """Write a field's type; ROS 1 has no bounds."""
    if field.type in PRIMITIVES:
        word = f"{field.type}<={field.bound}" if field.bound and ros_version == 2 else field.type
    elif ros_version == 1 and builtin(field.type):
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
