"""The data types of message definitions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from pc2scan.errors import DecodeError
from pc2scan.model import normalized_type

HEADER = "std_msgs/msg/Header"

#: Primitives of both ROS versions. ``byte`` and ``char`` are 8 bits wide in both.
PRIMITIVES = frozenset({"bool", "byte", "char", "string", "float32", "float64"}) | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
#: Primitives of ROS 2 only.
ROS2_ONLY = frozenset({"wstring", "wchar", "float128"})

RENAMED = {"roslib/msg/Header": HEADER, "tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
#: The field that ROS 2's IDL generator adds to a message without fields, since IDL has no empty struct.
PLACEHOLDER = "structure_needs_at_least_one_member"

Shape = Literal["scalar", "array", "sequence"]


@dataclass(frozen=True, slots=True)
class Field:
    """A member of a message.

    Attributes
    ----------
    name
        As defined.
    type
        One of `PRIMITIVES` or a message type in ROS 2's spelling.
    shape
        ``array`` has a fixed number of elements, ``sequence`` begins with their number.
    size
        Elements of an array; the bound of a sequence, 0 for none.
    bound
        The bound of a string in bytes, 0 for none.
    """

    name: str
    type: str
    shape: Shape = "scalar"
    size: int = 0
    bound: int = 0


@dataclass(frozen=True, slots=True)
class Constant:
    """A named constant; it takes no place in a message. ``value`` is text, as defined."""

    name: str
    type: str
    value: str


@dataclass(frozen=True, slots=True)
class Struct:
    """A message type."""

    fields: tuple[Field, ...] = ()
    constants: tuple[Constant, ...] = ()


#: A message type and all nested types, by name, in the order of first use, itself first.
Schema = dict[str, Struct]


_STAMP = Struct((Field("sec", "int32"), Field("nanosec", "uint32")))
BUILTIN = {
    "builtin_interfaces/msg/Time": ("time", _STAMP),
    "builtin_interfaces/msg/Duration": ("duration", _STAMP),
}


def is_builtin(name: str) -> bool:
    """Whether a type is a time or a duration, which are primitives in ROS 1."""
    return name in BUILTIN


def canonical_type(msgtype: str) -> str:
    """Spell a type as ROS 2 does, with its current name.

    >>> canonical_type("tf/tfMessage"), canonical_type("sensor_msgs/PointCloud2")
    ('tf2_msgs/msg/TFMessage', 'sensor_msgs/msg/PointCloud2')
    """
    name = normalized_type(msgtype)
    return RENAMED.get(name, name)


def fields_of(name: str, struct: Struct, ros_version: int) -> tuple[Field, ...]:
    """Return the fields, with the sequence number of ROS 1's Header."""
    return (Field("seq", "uint32"), *struct.fields) if ros_version == 1 and name == HEADER else struct.fields


def without_sequence_number(name: str, struct: Struct) -> Struct:
    """Remove ``seq`` from ROS 1's Header, after checking that it is a Header."""
    if name != HEADER:
        return struct
    kinds = [(field.type, field.shape) for field in struct.fields]
    expected = [("builtin_interfaces/msg/Time", "scalar"), ("string", "scalar")]
    if kinds == [("uint32", "scalar"), *expected]:
        return replace(struct, fields=struct.fields[1:])
    if kinds == expected:
        return struct
    names = ", ".join(f"{field.type} {field.name}" for field in struct.fields)
    raise DecodeError(f"{name} is defined as ({names}), expected a stamp and a frame_id")


def excerpt(text: str) -> str:
    """Return text from a recording, shortened for an error."""
    return repr(text if len(text) <= 60 else text[:57] + "...")
