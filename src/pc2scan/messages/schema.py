"""Message definitions: rosbags parses them, this module bounds them.

Definitions come from untrusted recordings, and rosbags makes Python code of them, a line for each element of an array
of strings or messages. So texts, depth, and numbers of fields are bounded before (`closure`), and the least size of
each type is compared with the bytes of a message (`min_size`).

Types are named as in ROS 2, whatever the source, and have only what both ROS versions share: Headers have no sequence
number, and ROS 1's ``time`` and ``duration`` are messages of ``builtin_interfaces``.

Sources: http://wiki.ros.org/msg, https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html,
https://mcap.dev/spec/registry (how ``ros1msg`` and ``ros2msg`` concatenate definitions).
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from pc2scan.errors import DecodeError
from pc2scan.model import normalized_type

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pc2scan.model import Definition

HEADER = "std_msgs/msg/Header"
TRANSFORMS = "tf2_msgs/msg/TFMessage"

#: Types that are primitives in ROS 1.
BUILTIN = frozenset({"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"})

_RENAMED = {"roslib/msg/Header": HEADER, "tf/msg/tfMessage": TRANSFORMS}

#: Bytes of the primitives that have a fixed size.
_WIDTHS = {"bool": 1, "byte": 1, "char": 1, "float32": 4, "float64": 8} | {
    f"{sign}int{bits}": bits // 8 for sign in ("", "u") for bits in (8, 16, 32, 64)
}

_CONSTANT = re.compile(rf"\s*({'|'.join(_WIDTHS)}|string)\s+([A-Za-z]\w*)\s*=(.*)", re.ASCII)

#: What rosbags' parsers raise.
_UNREADABLE = TypesysError, ArithmeticError, AttributeError, AssertionError, LookupError, RecursionError, ValueError

#: Limits of a definition: bytes of its text, levels, declared fields, and fields with all nested types expanded.
#: rosbags needs up to a millisecond and 45 kB to compile a field. The largest known definitions have 60 kB.
MAX_BYTES, MAX_DEPTH, MAX_FIELDS, MAX_LEAVES = 1 << 18, 64, 2_000, 100_000

#: rosbags' parse trees, by the name of the type: constants, and names and types of fields.
Types = dict[str, tuple[list[Any], list[tuple[str, Any]]]]


class Field(NamedTuple):
    """A member of a message.

    ``size`` is the number of elements: 1 unless it is an array, -1 for a sequence, which begins with their number.
    """

    name: str
    type: str
    size: int


def fields_of(types: Mapping[str, Any], name: str) -> list[Field]:
    """Return the fields of a type, without their bounds."""
    fields = []
    for field, desc in types[name][1]:
        kind, content = desc
        inner, count = content if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (desc, 1)
        size = -1 if kind == Nodetype.SEQUENCE else max(count, 0)
        fields.append(Field(field, inner[1] if inner[0] == Nodetype.NAME else inner[1][0], size))
    return fields


def mapped(
    desc: Any,
    *,
    base: Callable[[Any], Any] = lambda base: base,
    name: Callable[[str], str] = lambda name: name,
    bounded: bool = True,
) -> Any:
    """Return rosbags' description of a field with other primitives or names, and with or without bounds."""
    kind, content = desc
    if kind == Nodetype.BASE:
        return kind, base(content)
    if kind == Nodetype.NAME:
        return kind, name(content)
    size = content[1] if bounded or kind == Nodetype.ARRAY else 0
    return kind, (mapped(content[0], base=base, name=name), size)


def canonical_type(msgtype: str) -> str:
    """Spell a type as ROS 2 does, with its current name.

    >>> canonical_type("tf/tfMessage"), canonical_type("sensor_msgs/PointCloud2")
    ('tf2_msgs/msg/TFMessage', 'sensor_msgs/msg/PointCloud2')
    """
    name = normalized_type(msgtype)
    return _RENAMED.get(name, name)


@lru_cache(maxsize=4)
def known_types(ros_version: int) -> Types:
    """Return ROS's message set: of Noetic, or of Jazzy."""
    types = _plain(get_typestore(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_JAZZY).fielddefs)
    element = (Nodetype.NAME, "geometry_msgs/msg/TransformStamped")
    # rosbags' set for ROS 1 lacks it.
    types.setdefault(TRANSFORMS, ([], [("transforms", (Nodetype.SEQUENCE, (element, 0)))]))
    return types


def parse(definition: Definition, msgtype: str) -> Types:
    """Read the definition text of a recording: the type's own text, then those that it depends on.

    Raises
    ------
    DecodeError
        If it is of another encoding, longer than 256 KiB, or not a definition.
    """
    if definition.encoding not in {"ros1msg", "ros2msg"}:
        raise DecodeError(f"{msgtype} is defined in {definition.encoding!r}, expected ros1msg or ros2msg")
    if len(definition.data) > MAX_BYTES:
        raise DecodeError(f"{msgtype}: definition of {len(definition.data)} bytes, allowed are {MAX_BYTES}")
    try:
        text, constants = _without_constants(definition.text, msgtype, ros1=definition.encoding == "ros1msg")
        parsed = get_types_from_msg(text, msgtype)
    except _UNREADABLE as err:
        # rosbags' errors have the whole text, the place, and the rest.
        rest = str(err).split("\n")[3:4] or str(err).split("\n")[:1]
        raise DecodeError(f"{msgtype}: its definition cannot be read: {rest[0][:60]!r}") from err
    return _plain({name: (constants.get(name, []), fields) for name, (_, fields) in parsed.items()})


def _without_constants(text: str, msgtype: str, *, ros1: bool) -> tuple[str, dict[str, list[tuple[str, str, str]]]]:
    """Take the constants out of a definition, by type: ROS 1's hash is made of their text, and rosbags keeps values."""
    lines: list[str] = []
    constants: dict[str, list[tuple[str, str, str]]] = {}
    owner = normalized_type(msgtype)
    for line in text.splitlines():
        if re.fullmatch(r"=+\s*", line):
            owner = ""
        elif heading := re.fullmatch(r"\s*MSG:\s*(\S+)\s*", line):
            owner = normalized_type(heading[1])
            lines += ["=" * 80, f"MSG: {heading[1]}"]
        elif match := _CONSTANT.fullmatch(line):
            word, name, value = match.groups()
            # Only a ROS 1 string runs to the end of the line; elsewhere # begins a comment.
            if not (ros1 and word == "string"):
                value = re.match(r"'(?:\\.|[^'\\])*'|\"(?:\\.|[^\"\\])*\"|[^#]*", value)[0]  # type: ignore[index]
            constants.setdefault(owner, []).append((name, word, value.strip()))
        elif owner:
            lines.append(line)
        elif line.strip() and not line.lstrip().startswith("#"):
            raise DecodeError(f"{msgtype}: a section of its definition does not begin with MSG: {line[:60]!r}")
    return "\n".join([*lines, ""]), constants


def _plain(types: Mapping[str, Any]) -> Types:
    """Give types their current names, Headers no sequence number."""
    plain: Types = {}
    for name, (constants, fields) in types.items():
        renamed = canonical_type(name)
        kept = [(field, mapped(desc, name=canonical_type)) for field, desc in fields]
        plain[renamed] = (list(constants), kept)
        if renamed == HEADER:
            shape = [(field.type, field.size) for field in fields_of(plain, HEADER)]
            stamp = [("builtin_interfaces/msg/Time", 1), ("string", 1)]
            if shape not in (stamp, [("uint32", 1), *stamp]):
                names = ", ".join(f"{field.type} {field.name}" for field in fields_of(plain, HEADER))
                raise DecodeError(f"{name} is defined as ({names}), expected a stamp and a frame_id")
            del kept[:-2]
    return plain


def closure(root: str, lookup: Callable[[str], Any]) -> Types:
    """Collect a type and all nested types, in the order of first use.

    Raises
    ------
    DecodeError
        If a type is missing, contains itself, has what only one ROS version can carry, or is beyond the limits.
    """
    types: Types = {}
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
        content = lookup(name)
        if content is None:
            within = f" (needed by {path[-1]})" if path else ""
            raise DecodeError(
                f"type {name}{within} is defined neither in the recording nor in ROS's message sets",
                hint="record with definitions (MCAP does)",
            )
        types[name] = content
        total = 1
        for field in fields_of(types, name):
            if field.size == 0:
                raise DecodeError(f"{name}: {field.name} is an array without elements")
            width = 1 if field.type in _WIDTHS else max(field.size, 1)
            declared += width
            if declared > MAX_FIELDS:
                raise DecodeError(f"{root}: more than {MAX_FIELDS} fields")
            nested = 1 if field.type in _WIDTHS or field.type == "string" else visit(field.type, (*path, name))
            if field.size < 0 and nested > 64 + 4 * min_size(types, field.type, 1):
                raise DecodeError(f"{name}: {field.name} is a sequence of messages with {nested} fields and few bytes")
            total += width * nested
        if total > MAX_LEAVES:
            raise DecodeError(f"{root}: more than {MAX_LEAVES} fields when written out")
        leaves[name] = total
        return total

    visit(root, ())
    return types


def min_size(types: Mapping[str, Any], name: str, ros_version: int) -> int:
    """Return the bytes that every message of a type takes: sequences and strings empty, no padding."""
    known: dict[str, int] = {**_WIDTHS, "string": 3 + ros_version}  # ROS 2's strings end with a NUL.

    def least(name: str) -> int:
        if name not in known:
            sizes = [4 if field.size < 0 else least(field.type) * field.size for field in fields_of(types, name)]
            # ROS 1's Header has a sequence number; ROS 2 puts one byte into a message without fields.
            known[name] = sum(sizes) + 4 * (name == HEADER and ros_version == 1) if sizes else ros_version - 1
        return known[name]

    return least(name)


def same_layout(ours: Mapping[str, Any], theirs: Mapping[str, Any], name: str) -> bool:
    """Return whether both have a type with the same bytes on the wire and the same names.

    Names are compared without case and underscores (ROS 1's ``CameraInfo.D`` is ROS 2's ``d``); ``byte``, ``char`` and
    ``uint8`` are the same.
    """

    def wire(types: Mapping[str, Any]) -> list[tuple[str, str, int]]:
        return [
            (field.name.lower().replace("_", ""), "uint8" if field.type in {"byte", "char"} else field.type, field.size)
            for field in fields_of(types, name)
        ]

    if name in BUILTIN:
        return True
    if name not in ours or name not in theirs or wire(ours) != wire(theirs):
        return False
    nested = {field.type for field in fields_of(ours, name)} & ours.keys()
    return all(same_layout(ours, theirs, other) for other in nested)
