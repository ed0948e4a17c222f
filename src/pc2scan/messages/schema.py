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
from rosbags.typesys import Stores, TypesysError, get_typestore
from rosbags.typesys.base import make_typesdict
from rosbags.typesys.msg import MSGParser
from rosbags.typesys.peg import Success

from pc2scan.errors import DecodeError
from pc2scan.model import normalized_type

if TYPE_CHECKING:
    from collections.abc import Mapping

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

_VALUE = re.compile(r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|[^#\n]*""")

#: Limits of a definition: bytes of its text, levels, declared fields, and fields with all nested types expanded.
#: rosbags needs up to a millisecond and 45 kB to compile a field. The largest known definitions have 60 kB.
MAX_BYTES, MAX_DEPTH, MAX_FIELDS, MAX_LEAVES = 1 << 18, 64, 2_000, 100_000


class Field(NamedTuple):
    """A member of a message.

    ``elements`` is the number of an array's, or the bound of a sequence; ``longest`` is the bound of a string; 0: none.
    """

    name: str
    type: str
    kind: Nodetype
    elements: int
    longest: int

    @property
    def size(self) -> int:
        """The number of elements: 1 unless it is an array, -1 for a sequence, which begins with their number."""
        return {Nodetype.ARRAY: max(self.elements, 0), Nodetype.SEQUENCE: -1}.get(self.kind, 1)

    @property
    def desc(self) -> Any:
        """Its description in rosbags' parse trees."""
        is_base = self.type in _WIDTHS or self.type == "string"
        inner = (Nodetype.BASE, (self.type, self.longest)) if is_base else (Nodetype.NAME, self.type)
        return (self.kind, (inner, self.elements)) if self.kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else inner


#: Constants, as rosbags has them, and fields, by the name of the type.
Types = dict[str, tuple[list[tuple[str, Any, Any]], list[Field]]]


class _Parser(MSGParser):
    """Takes constants of any name. Their values stay text: ROS 1's hash is made of it."""

    ConstantName = MSGParser.MixedSnake

    def value(self, pos: int) -> Any:
        match = _VALUE.match(self.text, pos)
        return match and Success(match.end(), match[0].strip().strip("'\""))


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
    # rosbags' set for ROS 1 lacks it.
    transforms = Field("transforms", "geometry_msgs/msg/TransformStamped", Nodetype.SEQUENCE, 0, 0)
    types.setdefault(TRANSFORMS, ([], [transforms]))
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
    text = definition.text.replace("\r\n", "\n")
    try:
        return _plain(make_typesdict(_Parser(f"MSG: {msgtype}\n{text}\n").specification()))
    except (TypesysError, AssertionError, RecursionError, ValueError) as err:
        # rosbags' errors have the whole text, the place, and the rest.
        rest = str(err).split("\n")[3:4] or str(err).split("\n")[:1]
        raise DecodeError(f"{msgtype}: its definition cannot be read: {rest[0][:60]!r}") from err


def _plain(types: Mapping[str, Any]) -> Types:
    """Give types their current names, Headers no sequence number."""
    plain: Types = {}
    for name, (constants, described) in types.items():
        fields = plain.setdefault(canonical_type(name), (constants, [_field(*each) for each in described]))[1]
        if canonical_type(name) == HEADER:
            shape = [(field.type, field.size) for field in fields]
            stamp = [("builtin_interfaces/msg/Time", 1), ("string", 1)]
            if shape not in (stamp, [("uint32", 1), *stamp]):
                names = ", ".join(f"{field.type} {field.name}" for field in fields)
                raise DecodeError(f"{name} is defined as ({names}), expected a stamp and a frame_id")
            del fields[:-2]
    return plain


def _field(name: str, desc: Any) -> Field:
    """Return a field from its description in rosbags' parse trees."""
    kind, content = desc
    (inner, of), count = content if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (desc, 0)
    word, longest = of if inner == Nodetype.BASE else (canonical_type(of), 0)
    return Field(name, word, kind, count, longest)


def closure(root: str, known: Mapping[str, Any]) -> Types:
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
        if name in leaves:
            return leaves[name]
        if len(path) >= MAX_DEPTH:
            raise DecodeError(f"{root}: {name} contains itself, or is nested more than {MAX_DEPTH} levels deep")
        if name not in known:
            within = f" (needed by {path[-1]})" if path else ""
            raise DecodeError(
                f"type {name}{within} is defined neither in the recording nor in ROS's message sets",
                hint="record with definitions (MCAP does)",
            )
        types[name] = known[name]
        total = 1
        for field in types[name][1]:
            if not field.size:
                raise DecodeError(f"{name}: {field.name} is an array without elements")
            width = 1 if field.type in _WIDTHS else max(field.size, 1)
            declared += width
            if declared > MAX_FIELDS:
                raise DecodeError(f"{root}: more than {MAX_FIELDS} fields")
            nested = 1 if field.type in _WIDTHS or field.type == "string" else visit(field.type, (*path, name))
            if field.size < 0 and nested > 64 * min_size(types, field.type, 1):
                raise DecodeError(f"{name}: {field.name} is a sequence of messages with {nested} fields and few bytes")
            total += width * nested
        if total > MAX_LEAVES:
            raise DecodeError(f"{root}: more than {MAX_LEAVES} fields when written out")
        leaves[name] = total
        return total

    visit(root, ())
    return types


def min_size(types: Types, name: str, ros_version: int) -> int:
    """Return the bytes that every message of a type takes: sequences and strings empty, no padding."""
    known: dict[str, int] = {**_WIDTHS, "string": 3 + ros_version}  # ROS 2's strings end with a NUL.

    def least(name: str) -> int:
        if name not in known:
            sizes = [4 if field.size < 0 else least(field.type) * field.size for field in types[name][1]]
            # ROS 1's Header has a sequence number; ROS 2 puts one byte into a message without fields.
            known[name] = sum(sizes) + 4 * (name == HEADER and ros_version == 1) if sizes else ros_version - 1
        return known[name]

    return least(name)


def same_layout(ours: Types, theirs: Types, name: str) -> bool:
    """Return whether both have a type with the same bytes on the wire and the same names.

    Names are compared without case and underscores (ROS 1's ``CameraInfo.D`` is ROS 2's ``d``); ``byte``, ``char`` and
    ``uint8`` are the same.
    """

    def wire(types: Types) -> list[tuple[str, str, int]]:
        return [
            (field.name.lower().replace("_", ""), "uint8" if field.type in {"byte", "char"} else field.type, field.size)
            for field in types[name][1]
        ]

    if name in BUILTIN:
        return True
    if name not in ours or name not in theirs or wire(ours) != wire(theirs):
        return False
    nested = {field.type for field in ours[name][1]} & ours.keys()
    return all(same_layout(ours, theirs, other) for other in nested)
