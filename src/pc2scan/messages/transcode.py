"""Re-encodes messages that pc2scan does not convert, from ROS 1 to ROS 2 and back.

The ROS versions differ in padding and string terminators, the Header's sequence number, the spelling of types, the
definitions and their hashes, and latching or durability. rosbags converts the bytes without making objects; this module
gives it the types.

rosbags generates Python source from definitions and executes it. It gets names made here (``f0``,
``pc2scan/msg/T1``), so that no name from a recording reaches the interpreter.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from functools import lru_cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from pc2scan.errors import DecodeError
from pc2scan.model import LATCHED_QOS, NEW_ID, Connection, Definition, ros1_type

from . import definitions, schema

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.model import Buffer

#: Channel metadata and connection header fields that only one ROS version uses.
_METADATA_OF = {
    1: frozenset({"callerid", "latching", "md5sum", "type", "topic", "message_definition"}),
    2: frozenset({"offered_qos_profiles", "topic_type_hash"}),
}

#: Definitions that are not read.
_IDL = ("omgidl", "ros2idl")

_SETS = {1: "ROS 1 noetic", 2: "ROS 2 jazzy"}

#: What rosbags raises besides its own error: those of slices, structs and asserts.
_FAILURES = (SerdeError, struct.error, AssertionError, LookupError, OverflowError, RecursionError, ValueError)

#: At the end of a message, the generated functions may skip to the alignment of a member that does not exist.
_MAX_PADDING = 7


@dataclass(frozen=True, slots=True)
class Transcoding:
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
    ValueError
        If the connection already is of that ROS version.

    Notes
    -----
    ROS 2's Header has no sequence number: it is dropped, and 0 on the way back. ROS 1's unsigned seconds
    and ROS 2's signed ones have the same bytes until 2038.
    """
    source = connection.ros_version
    if source == ros_version:
        raise ValueError(f"{connection.topic} already is of ROS version {ros_version}")
    if source is None:
        form = connection.serialization
        raise DecodeError(f"{connection.msgtype} is serialised as {form!r}, expected 'ros1' or 'cdr'")
    plan = _type_plan(connection.msgtype, connection.definition, source)
    if isinstance(plan, DecodeError):
        raise DecodeError(plan.message, hint=plan.hint)
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
    return replace(plan, connection=declared)


def with_definition(connection: Connection) -> Connection:
    """Return a connection with the definition of ROS's message set, if it has none: older rosbag2 recordings have none.

    The connection stays as it is if the message set does not have its type.
    """
    ros_version = connection.ros_version
    root = schema.canonical_type(connection.msgtype)
    has_one = connection.definition.encoding or connection.definition.data
    if has_one or ros_version is None or root not in schema.known_types(ros_version):
        return connection
    text, digest = _declared(schema.closure(root, schema.known_types(ros_version).get), ros_version)
    return replace(connection, definition=text, digest=connection.digest or digest)


def ros2_hash(msgtype: str, definition: Definition) -> str:
    """Return the hash of a recorded type, as ROS 2 computes it.

    Raises
    ------
    DecodeError
        If its definition is unusable.
    """
    types = schema.closure(schema.canonical_type(msgtype), schema.parse(definition, msgtype).get)
    return _declared(types, 2, known=False)[1]


# --- planning ---


@lru_cache(maxsize=256)
def _type_plan(msgtype: str, definition: Definition, source: int) -> Transcoding | DecodeError:
    """Return how all connections of a type are re-encoded, declared as one without a topic; or the error."""
    try:
        return _new_type_plan(msgtype, definition, source)
    except DecodeError as err:
        return err.with_traceback(None)


def _new_type_plan(msgtype: str, definition: Definition, source: int) -> Transcoding:
    """Choose the destination's type and compile the conversion."""
    target = 3 - source
    root = schema.canonical_type(msgtype)
    source_types, target_types = schema.known_types(source), schema.known_types(target)
    recorded, notes = _recorded_types(msgtype, definition, source)
    ours = schema.closure(root, lambda name: recorded.get(name) or source_types.get(name))
    shared = {name for name in ours if schema.same_layout(ours, target_types, name)}
    types = schema.closure(root, lambda name: target_types[name] if name in shared else ours.get(name))
    if differing := [name for name in ours if name in target_types and name not in shared]:
        names = ", ".join(ros1_type(name) if target == 1 else name for name in differing)
        notes = (*notes, f"layout differs from {_SETS[target]}'s {names}: written with the recording's own definition")
    text, digest = _declared(types, target, known=root in shared)
    named = ros1_type(root) if target == 1 else root
    fields = sum(len(fields) for _, fields in types.values())
    declared = Connection(NEW_ID, "", named, "ros1" if target == 1 else "cdr", text, digest)
    return Transcoding(declared, _encoder(named, types, source), notes, fields)


def _recorded_types(msgtype: str, definition: Definition, source: int) -> tuple[schema.Types, tuple[str, ...]]:
    """Read the recording's definition; ROS's message set is used where there is none, or one in IDL."""
    known = schema.known_types(source).get(schema.canonical_type(msgtype))
    if known is not None and (not definition.data.strip() or definition.encoding in _IDL):
        # A message without fields has an empty definition, as if it had none.
        _, fields = known
        what = f"only a definition in {definition.encoding}" if definition.data.strip() else "no definition"
        return {}, (f"{what} in the recording: {_SETS[source]}'s {msgtype} is assumed",) if fields else ()
    return schema.parse(definition, msgtype) if definition.encoding or definition.data else {}, ()


def _declared(types: schema.Types, ros_version: int, *, known: bool = True) -> tuple[Definition, str]:
    """Return the definition text of the first type, and ROS's hash of it."""
    root = next(iter(types))
    if known and root in definitions.TYPES:
        return definitions.definition(root, ros_version)
    store = get_typestore(Stores.EMPTY)
    # Only the parse trees are needed: nothing is registered, so no code is generated from the names.
    store.fielddefs = {
        name: (
            [_declared_constant(constant, ros_version) for constant in constants],
            _declared_fields(name, types, ros_version),
        )
        for name, (constants, _) in types.items()
    }
    try:
        text, md5sum = store.generate_msgdef(root, ros_version=ros_version)
    except AssertionError:
        raise DecodeError(f"{root} is not the type of a message") from None
    if ros_version == 2:
        # ROS 2's hashes are made of its IDL, which has uint8 for char.
        for _, fields in store.fielddefs.values():
            fields[:] = [(field, schema.mapped(desc, base=_without_char)) for field, desc in fields]
    return Definition(f"ros{ros_version}msg", text.encode()), md5sum if ros_version == 1 else store.hash_rihs01(root)


def _without_char(base: Any) -> Any:
    return ("uint8" if base[0] == "char" else base[0], base[1])


def _declared_constant(constant: tuple[str, Any, Any], ros_version: int) -> tuple[str, Any, Any]:
    """Return a constant as a ROS version writes it: in ROS 1 quotes are part of a string, in ROS 2 they enclose it."""
    name, word, value = constant
    if word != "string":
        return constant
    bare = value[1:-1] if len(value) > 1 and value[0] == value[-1] and value[0] in "'\"" else value
    quoted = f"'{bare}'" if '"' in bare and "'" not in bare else '"' + bare.replace('"', '\\"') + '"'
    return name, word, bare if ros_version == 1 else quoted


def _declared_fields(name: str, types: schema.Types, ros_version: int) -> list[tuple[str, Any]]:
    """Return fields as a ROS version declares them: ROS 1 has sequence numbers and no bounds."""
    fields = types[name][1]
    if ros_version == 2:
        return list(fields)
    number = [("seq", (Nodetype.BASE, ("uint32", 0)))] if name == schema.HEADER else []
    return number + [
        (field, schema.mapped(desc, base=lambda base: (base[0], 0), bounded=False)) for field, desc in fields
    ]


# --- encoding ---


def _encoder(msgtype: str, types: schema.Types, source: int) -> Callable[[Buffer], Buffer]:
    """Compile what re-encodes messages of the first type in the other serialisation.

    Types and fields get names made here. The Header keeps its name, by which rosbags finds ROS 1's sequence number, and
    so do the two types that rosbags' empty store already has.
    """
    names = {
        name: name if name == schema.HEADER or name in schema.BUILTIN else f"pc2scan/msg/T{index}"
        for index, name in enumerate(types)
    }
    store = get_typestore(Stores.EMPTY)
    store.register(
        {
            names[name]: (
                [],
                [(f"f{index}", schema.mapped(desc, name=names.__getitem__)) for index, (_, desc) in enumerate(fields)],
            )
            for name, (_, fields) in types.items()
            if name not in schema.BUILTIN
        }
    )
    repeated = {field.type for name in types for field in schema.fields_of(types, name) if field.size < 0}
    msgdefs = {
        names[name]: _guard_sizes(store.get_msgdef(names[name]), schema.min_size(types, name, source))
        if name in repeated
        else store.get_msgdef(names[name])
        for name in types
    }
    first = next(iter(types))
    root, least = msgdefs[names[first]], schema.min_size(types, first, source)
    measure, copy, head = (
        (root.getsize_ros1_to_cdr, root.ros1_to_cdr, b"\0\1\0\0")
        if source == 1
        else (root.getsize_cdr_to_ros1, root.cdr_to_ros1, b"")
    )

    def encode(data: Buffer) -> Buffer:
        body = memoryview(data)
        try:
            if source == 2:
                if bytes(body[:2]) != b"\0\1":
                    begin = body[:4].hex() or "nothing"
                    raise ValueError(f"it begins with {begin}, expected a CDR header (0001, then two bytes)")
                body = body[4:]
            if len(body) < least:
                raise ValueError(f"its fields take {len(data) - len(body) + least} or more")
            # What the generated functions use of a store. Every element takes at least one byte.
            own = SimpleNamespace(get_msgdef=msgdefs.__getitem__, max_sequence_length=max(len(body), 1))
            taken, size = measure(body, 0, None, 0, own)
            # Some writers of CDR add padding at the end.
            low, high = (taken, taken) if source == 1 else (taken - _MAX_PADDING, taken + 3)
            if not low <= len(body) <= high:
                raise ValueError(f"its fields take {len(data) - len(body) + taken}")
            output = memoryview(bytearray(len(head) + size))
            output[: len(head)] = head
            copy(body, 0, output[len(head) :], 0, own)
        except _FAILURES as err:
            reason = str(err) or type(err).__name__
            raise DecodeError(f"{msgtype} of {len(data)} bytes cannot be re-encoded: {reason}") from err
        return output.toreadonly()

    return encode


def _guard_sizes(msgdef: Any, least: int) -> SimpleNamespace:
    """Wrap an element's functions: its size is computed only if the message has the type's minimum of bytes left.

    The generated functions check a message's length only at the beginning of a sequence or a string: a message of a
    hundred bytes could take gigabytes, or hours.
    """

    def checked(measure: Callable[..., tuple[int, int]]) -> Callable[..., tuple[int, int]]:
        def measured(body: memoryview, place: int, made: None, size: int, types: Any) -> tuple[int, int]:
            if place + least > len(body):
                raise ValueError(f"it ends inside a sequence, {place + least} bytes are needed and {len(body)} there")
            return measure(body, place, made, size, types)

        return measured

    return SimpleNamespace(
        getsize_ros1_to_cdr=checked(msgdef.getsize_ros1_to_cdr),
        getsize_cdr_to_ros1=checked(msgdef.getsize_cdr_to_ros1),
        ros1_to_cdr=msgdef.ros1_to_cdr,
        cdr_to_ros1=msgdef.cdr_to_ros1,
    )
