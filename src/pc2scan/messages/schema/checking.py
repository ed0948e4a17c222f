"""Checks definitions: their names and sizes, the minimum size of a message, and whether two have the same layout."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from pc2scan.errors import DecodeError

from .types import BUILTIN, PLACEHOLDER, PRIMITIVES, ROS2_ONLY, excerpt, fields_of, is_builtin

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from .types import Constant, Field, Schema, Struct

#: Bytes of the primitives that have a fixed size.
_WIDTHS = {"bool": 1, "byte": 1, "char": 1, "float32": 4, "float64": 8} | {
    f"{sign}int{bits}": bits // 8 for sign in ("", "u") for bits in (8, 16, 32, 64)
}


def min_size(schema: Mapping[str, Struct], name: str, ros_version: int) -> int:
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


def same_layout(ours: Mapping[str, Struct], theirs: Mapping[str, Struct], name: str) -> bool:
    """Whether both have a type with the same bytes on the wire and the same names.

    Names are compared without case and underscores (ROS 1's ``CameraInfo.D`` is ROS 2's ``d``). Bounds and
    constants are ignored, and ``byte``, ``char`` and ``uint8`` are the same.
    """
    if is_builtin(name):
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


MAX_DEPTH = 64
#: Limit of declared fields. rosbags needs up to a millisecond and 45 kB to compile one; each element of a fixed
#: array of strings or messages counts, because rosbags unrolls them.
MAX_FIELDS = 2_000
#: Limit of one message's fields with all nested types expanded, the elements of sequences once.
MAX_LEAVES = 100_000
#: Limits of the fields of a message in a sequence: so many, and so many more for each byte that it takes. Fields
#: without bytes take time, and a short message may have any number of them.
MAX_LEAVES_BESIDE_BYTES, MAX_LEAVES_A_BYTE = 64, 4

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)


def closure(root: str, lookup: Callable[[str], Struct | None]) -> Schema:
    """Collect a type and all nested types.

    Parameters
    ----------
    root
        Canonical name.
    lookup
        Finds a type by its canonical name.

    Returns
    -------
    Schema
        In the order of first use, depth first.

    Raises
    ------
    DecodeError
        If a type is missing or contains itself; if a name is not an identifier; beyond 64 levels, 2,000
        fields or 100,000 fields with all nested types expanded; for types that only one ROS version can carry
        (wstring, an array of length 0).
    """
    schema: Schema = {}
    leaves: dict[str, int] = {}
    declared = 0

    def visit(name: str, path: tuple[str, ...]) -> int:
        nonlocal declared
        if name in path:
            raise DecodeError(f"{root}: {name} contains itself")
        if name in leaves:
            return leaves[name]
        if len(path) >= MAX_DEPTH:
            raise DecodeError(f"{root}: nested more than {MAX_DEPTH} levels deep")
        _check_name(name, name.split("/"))
        struct = BUILTIN[name][1] if is_builtin(name) else lookup(name)
        if struct is None:
            within = f" (needed by {path[-1]})" if path else ""
            raise DecodeError(
                f"type {name}{within} is defined neither in the recording nor in ROS's message sets",
                hint="record with definitions (MCAP does)",
            )
        schema[name] = struct
        declared += sum(_width(field) for field in struct.fields) + len(struct.constants)
        if declared > MAX_FIELDS:
            raise DecodeError(f"{root}: more than {MAX_FIELDS} fields")
        total = 1
        for field in struct.fields:
            _check_field(name, field)
            nested = 1 if field.type in PRIMITIVES else visit(field.type, (*path, name))
            if field.shape == "sequence" and field.type not in PRIMITIVES and _is_empty(schema, field.type):
                raise DecodeError(f"{name}: {field.name} is a sequence of messages without fields")
            if (
                field.shape == "sequence"
                and nested > MAX_LEAVES_BESIDE_BYTES
                and nested > MAX_LEAVES_BESIDE_BYTES + MAX_LEAVES_A_BYTE * min_size(schema, field.type, 1)
            ):
                raise DecodeError(f"{name}: {field.name} is a sequence of messages with {nested} fields and few bytes")
            total += _width(field) * nested
            if total > MAX_LEAVES:
                raise DecodeError(f"{root}: more than {MAX_LEAVES} fields when written out")
        for constant in struct.constants:
            _check_constant(name, constant)
        leaves[name] = total
        return total

    visit(root, ())
    return schema


def _width(field: Field) -> int:
    """Return how many elements rosbags' conversion handles one by one."""
    return (
        max(field.size, 1) if field.shape == "array" and (field.type not in PRIMITIVES or field.type == "string") else 1
    )


def _is_empty(schema: Schema, name: str) -> bool:
    """Whether a message takes no bytes in ROS 1, so that a sequence may have any number of them."""
    return all(
        field.shape != "sequence" and field.type not in PRIMITIVES and _is_empty(schema, field.type)
        for field in schema[name].fields
    )


def _check_name(owner: str, names: Iterable[str]) -> None:
    for name in names:
        if not _IDENTIFIER.fullmatch(name) or len(name) > 255:
            raise DecodeError(f"{excerpt(owner)}: {excerpt(name)} is not a name")


def _check_constant(owner: str, constant: Constant) -> None:
    _check_name(owner, [constant.name])
    if constant.type not in PRIMITIVES | ROS2_ONLY:
        raise DecodeError(f"{owner}: the constant {constant.name} has the type {excerpt(constant.type)}")
    if "\n" in constant.value or "\r" in constant.value:
        raise DecodeError(f"{owner}: the constant {constant.name} runs over several lines")


def _check_field(owner: str, field: Field) -> None:
    _check_name(owner, [field.name])
    if field.name == PLACEHOLDER:
        raise DecodeError(f"{owner}: the field name {PLACEHOLDER} is ROS 2's own")
    if field.type in ROS2_ONLY:
        raise DecodeError(f"{owner}: {field.name} is a {field.type}, which ROS 1 cannot carry")
    if field.type not in PRIMITIVES and field.type.count("/") != 2:
        raise DecodeError(f"{owner}: {field.name} has the unknown type {excerpt(field.type)}")
    if field.shape == "array" and not 0 < field.size < 1 << 32:
        raise DecodeError(f"{owner}: {field.name} is an array of {field.size} elements")
