"""Message definitions, and re-encoding what pc2scan does not convert, from ROS 1 to ROS 2 and back: rosbags, bounded.

The ROS versions differ in padding and string terminators, the Header's sequence number, the spelling of types, the
definitions and their hashes, and latching or durability. rosbags parses definitions and converts bytes without making
objects; this module gives it the types.

Definitions come from untrusted recordings, and rosbags executes Python source that it makes of them, a line for each
element of an array of strings or messages. So texts, depth, and numbers of fields are bounded before (`closure`), and
the least size of each type is compared with the bytes of a message (`min_size`). The source has names made here
(``f0``, ``pc2scan/msg/T1``), so that no name from a recording reaches the interpreter.

Types are named as in ROS 2, whatever the source, and have only what both ROS versions share: Headers have no sequence
number, and ROS 1's ``time`` and ``duration`` are messages of ``builtin_interfaces``.

Sources: http://wiki.ros.org/msg, https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html,
https://mcap.dev/spec/registry (how ``ros1msg`` and ``ros2msg`` concatenate definitions).
"""

from __future__ import annotations

import json
import re
import struct
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_typestore
from rosbags.typesys.base import make_typesdict
from rosbags.typesys.msg import MSGParser
from rosbags.typesys.peg import Success

from pc2scan.errors import DecodeError
from pc2scan.model import LATCHED_QOS, NEW_ID, SERIALIZATIONS, Connection, Definition, normalized_type, ros1_type

from . import definitions

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pc2scan.model import Buffer

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

#: Channel metadata and connection header fields that only one ROS version uses.
_METADATA_OF = {
    1: frozenset({"callerid", "latching", "md5sum", "type", "topic", "message_definition"}),
    2: frozenset({"offered_qos_profiles", "topic_type_hash"}),
}

_SETS = {1: "ROS 1 noetic", 2: "ROS 2 jazzy"}

#: What rosbags raises besides its own error: those of slices, structs and asserts.
_FAILURES = (SerdeError, struct.error, AssertionError, LookupError, OverflowError, RecursionError, ValueError)


class Transcoding(NamedTuple):
    """How one connection's messages are re-encoded for the other ROS version.

    Attributes
    ----------
    connection
        The connection to declare in the destination.
    encode
        Turns one serialised message into the other serialisation. ``DecodeError`` if its bytes contradict the type.
        May be called from several threads.
    notes
        Notes for the report.
    fields
        Number of fields that the type and its nested types declare.
    """

    connection: Connection
    encode: Callable[[Buffer], Buffer]
    notes: tuple[str, ...] = ()
    fields: int = 0


def transcoder(connection: Connection, ros_version: int) -> Transcoding:
    """Plan how a connection's messages are re-encoded for the other ROS version.

    If the other ROS version has a type of the same name and layout, the destination gets its definition and
    hash, so that its nodes accept the messages; field names may then differ in case (``CameraInfo.D``,
    ``d``). Otherwise the destination gets the recording's own definition in the other ROS version's syntax.

    Parameters
    ----------
    connection
        A connection of the other ROS version; ``serialization`` is ``ros1`` or ``cdr``.
    ros_version
        The destination's ROS version: 1 or 2.

    Returns
    -------
    Transcoding
        Connections with the same type and definition share their encoder.

    Raises
    ------
    DecodeError
        If the type is unknown, its definition is unusable, or the other ROS version cannot carry it. The
        error is about the whole topic.

    Notes
    -----
    ROS 2's Header has no sequence number: it is dropped, and 0 on the way back. ROS 1's unsigned seconds
    and ROS 2's signed ones have the same bytes until 2038.
    """
    source = 3 - ros_version
    plan = _type_plan(connection.msgtype, connection.definition, source)
    if isinstance(plan, DecodeError):
        raise DecodeError(plan.message)
    declared = replace(
        plan.connection,
        id=connection.id,
        topic=connection.topic,
        latching=connection.is_latched,
        qos=LATCHED_QOS if ros_version == 2 and connection.is_latched else "",
        metadata={key: value for key, value in connection.metadata.items() if key not in _METADATA_OF[source]},
        message_count=connection.message_count,
        schema_id=connection.schema_id,
    )
    return plan._replace(connection=declared)


def with_definition(connection: Connection) -> Connection:
    """Return a connection with the definition of ROS's message set, if it has none: older rosbag2 recordings have none.

    The connection stays as it is if the message set does not have its type.
    """
    ros_version = connection.ros_version
    root = canonical_type(connection.msgtype)
    if connection.definition != Definition() or ros_version is None or root not in known_types(ros_version):
        return connection
    text, digest = _declared(closure(root, known_types(ros_version)), ros_version)
    return replace(connection, definition=text, digest=connection.digest or digest)


def ros2_hash(msgtype: str, definition: Definition) -> str:
    """Return the hash of a recorded type, as ROS 2 computes it.

    Raises
    ------
    DecodeError
        If its definition is unusable.
    """
    types = closure(canonical_type(msgtype), parse(definition, msgtype))
    return _declared(types, 2, known=False)[1]


# --- definitions ---


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
        fields = plain.setdefault(canonical_type(name), (constants, [_field(*field) for field in described]))[1]
        if canonical_type(name) == HEADER:
            shape = [field.type for field in fields]
            if shape[-2:] != ["builtin_interfaces/msg/Time", "string"] or shape[:-2] not in ([], ["uint32"]):
                raise DecodeError(f"{name} is defined as ({', '.join(shape)}), expected a stamp and a frame_id")
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
            raise DecodeError(f"type {name}{within} is defined neither in the recording nor in ROS's message sets")
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


# --- planning ---


@lru_cache(maxsize=256)
def _type_plan(msgtype: str, definition: Definition, source: int) -> Transcoding | DecodeError:
    """Return how all connections of a type are re-encoded, declared as one without a topic; or the error."""
    target, root, notes = 3 - source, canonical_type(msgtype), list[str]()
    recorded, target_types = known_types(source), known_types(target)
    try:
        if root not in recorded or (definition.data.strip() and definition.encoding not in {"omgidl", "ros2idl"}):
            recorded = recorded | (parse(definition, msgtype) if definition.encoding or definition.data else {})
        elif recorded[root][1]:
            # A message without fields has an empty definition, as if it had none.
            what = f"only a definition in {definition.encoding}" if definition.data.strip() else "no definition"
            notes.append(f"{what} in the recording: {_SETS[source]}'s {msgtype} is assumed")
        ours = closure(root, recorded)
        shared = {name for name in ours if same_layout(ours, target_types, name)}
        types = closure(root, ours | {name: target_types[name] for name in shared})
        text, digest = _declared(types, target, known=root in shared)
    except DecodeError as err:
        return err.with_traceback(None)
    if differing := [name for name in ours if name in target_types and name not in shared]:
        names = ", ".join(ros1_type(name) if target == 1 else name for name in differing)
        notes.append(f"layout differs from {_SETS[target]}'s {names}: written with the recording's own definition")
    named = ros1_type(root) if target == 1 else root
    fields = sum(len(fields) for _, fields in types.values())
    declared = Connection(NEW_ID, "", named, SERIALIZATIONS[target], text, digest)
    return Transcoding(declared, _encoder(named, types, source), tuple(notes), fields)


def _declared(types: Types, ros_version: int, *, known: bool = True) -> tuple[Definition, str]:
    """Return the definition text of the first type, and ROS's hash of it."""
    root = next(iter(types))
    if known and root in definitions.TYPES:
        return definitions.definition(root, ros_version)
    store = get_typestore(Stores.EMPTY)
    # Only the parse trees are needed: nothing is registered, so no code is generated from the names.
    for name, (constants, fields) in types.items():
        # In ROS 1 quotes are part of a string, in ROS 2 they enclose it.
        values = [
            (constant, word, json.dumps(value, ensure_ascii=False) if (word, ros_version) == ("string", 2) else value)
            for constant, word, value in constants
        ]
        store.fielddefs[name] = values, _declared_fields(name, fields, ros_version)
    try:
        text, md5sum = store.generate_msgdef(root, ros_version=ros_version)
    except AssertionError:
        raise DecodeError(f"{root} is not the type of a message") from None
    if ros_version == 1:
        return Definition("ros1msg", text.encode()), md5sum
    # ROS 2's hashes are made of its IDL, which has uint8 for char.
    for name, (_, fields) in types.items():
        of = [field._replace(type="uint8") if field.type == "char" else field for field in fields]
        store.fielddefs[name] = [], _declared_fields(name, of, 2)
    return Definition("ros2msg", text.encode()), store.hash_rihs01(root)


def _declared_fields(name: str, fields: list[Field], ros_version: int) -> list[tuple[str, Any]]:
    """Return fields as a ROS version declares them: ROS 1 has sequence numbers and no bounds."""
    if ros_version == 2:
        return [(field.name, field.desc) for field in fields]
    number = [("seq", (Nodetype.BASE, ("uint32", 0)))] if name == HEADER else []
    return number + [(field.name, field._replace(elements=max(field.size, 0), longest=0).desc) for field in fields]


# --- encoding ---


def _encoder(msgtype: str, types: Types, source: int) -> Callable[[Buffer], Buffer]:
    """Compile what re-encodes messages of the first type in the other serialisation.

    Types and fields get names made here. The Header keeps its name, by which rosbags finds ROS 1's sequence number, and
    so do the two types that rosbags' empty store already has.
    """
    names = {
        name: name if name == HEADER or name in BUILTIN else f"pc2scan/msg/T{index}" for index, name in enumerate(types)
    }
    store = get_typestore(Stores.EMPTY)
    store.register(
        {
            names[name]: (
                [],
                [(f"f{n}", field._replace(type=names.get(field.type, field.type)).desc) for n, field in enumerate(own)],
            )
            for name, (_, own) in types.items()
            if name not in BUILTIN
        }
    )
    way = "ros1_to_cdr" if source == 1 else "cdr_to_ros1"
    for name in types:
        msgdef = store.get_msgdef(names[name])
        measure: Any = _bounded(getattr(msgdef, f"getsize_{way}"), min_size(types, name, source))
        store.cache[names[name]] = replace(msgdef, **{f"getsize_{way}": measure})
    root, convert = next(iter(names.values())), getattr(store, way)

    def encode(data: Buffer) -> Buffer:
        try:
            return convert(memoryview(data), root)  # type: ignore[no-any-return]
        except _FAILURES as err:
            reason = str(err.__cause__ or err).replace(root, msgtype) or type(err).__name__
            raise DecodeError(f"{msgtype} of {len(data)} bytes cannot be re-encoded: {reason}") from err

    return encode


def _bounded(measure: Callable[..., tuple[int, int]], least: int) -> Callable[..., tuple[int, int]]:
    """Wrap the function for a type's size: it is called only if the message has the type's minimum of bytes left.

    The generated functions check a message's length only at the beginning of a sequence or a string: a message of a
    hundred bytes could take gigabytes, or hours.
    """

    def measured(body: memoryview, place: int, output: None, size: int, store: Any) -> tuple[int, int]:
        if place + least > len(body):
            raise ValueError(f"it needs {place + least} bytes or more, without its CDR header")
        return measure(body, place, output, size, store)

    return measured
