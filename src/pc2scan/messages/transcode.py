"""Re-encodes messages that pc2scan does not convert, from ROS 1 to ROS 2 and back.

The ROS versions differ in padding and string terminators, the Header's sequence number, the spelling of types, the
definitions and their hashes, and latching or durability. rosbags converts the bytes without making objects; this module
gives it the types.

rosbags generates Python source from definitions and executes it. It gets names made here (``f0``,
``pc2scan/msg/T1``), so that no name from a recording reaches the interpreter.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, replace
from functools import lru_cache
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

    Notes
    -----
    ROS 2's Header has no sequence number: it is dropped, and 0 on the way back. ROS 1's unsigned seconds
    and ROS 2's signed ones have the same bytes until 2038.
    """
    source = 3 - ros_version
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
    text, digest = _declared(schema.closure(root, schema.known_types(ros_version)), ros_version)
    return replace(connection, definition=text, digest=connection.digest or digest)


def ros2_hash(msgtype: str, definition: Definition) -> str:
    """Return the hash of a recorded type, as ROS 2 computes it.

    Raises
    ------
    DecodeError
        If its definition is unusable.
    """
    types = schema.closure(schema.canonical_type(msgtype), schema.parse(definition, msgtype))
    return _declared(types, 2, known=False)[1]


# --- planning ---


@lru_cache(maxsize=256)
def _type_plan(msgtype: str, definition: Definition, source: int) -> Transcoding | DecodeError:
    """Return how all connections of a type are re-encoded, declared as one without a topic; or the error."""
    target, root, notes = 3 - source, schema.canonical_type(msgtype), list[str]()
    recorded, target_types = schema.known_types(source), schema.known_types(target)
    try:
        if root not in recorded or (definition.data.strip() and definition.encoding not in _IDL):
            recorded = recorded | (schema.parse(definition, msgtype) if definition.encoding or definition.data else {})
        elif recorded[root][1]:
            # A message without fields has an empty definition, as if it had none.
            what = f"only a definition in {definition.encoding}" if definition.data.strip() else "no definition"
            notes.append(f"{what} in the recording: {_SETS[source]}'s {msgtype} is assumed")
        ours = schema.closure(root, recorded)
        shared = {name for name in ours if schema.same_layout(ours, target_types, name)}
        types = schema.closure(root, ours | {name: target_types[name] for name in shared})
        text, digest = _declared(types, target, known=root in shared)
    except DecodeError as err:
        return err.with_traceback(None)
    if differing := [name for name in ours if name in target_types and name not in shared]:
        names = ", ".join(ros1_type(name) if target == 1 else name for name in differing)
        notes.append(f"layout differs from {_SETS[target]}'s {names}: written with the recording's own definition")
    named = ros1_type(root) if target == 1 else root
    fields = sum(len(fields) for _, fields in types.values())
    declared = Connection(NEW_ID, "", named, "ros1" if target == 1 else "cdr", text, digest)
    return Transcoding(declared, _encoder(named, types, source), tuple(notes), fields)


def _declared(types: schema.Types, ros_version: int, *, known: bool = True) -> tuple[Definition, str]:
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


def _declared_fields(name: str, fields: list[schema.Field], ros_version: int) -> list[tuple[str, Any]]:
    """Return fields as a ROS version declares them: ROS 1 has sequence numbers and no bounds."""
    if ros_version == 2:
        return [(field.name, field.desc) for field in fields]
    number = [("seq", (Nodetype.BASE, ("uint32", 0)))] if name == schema.HEADER else []
    return number + [(field.name, field._replace(elements=max(field.size, 0), longest=0).desc) for field in fields]


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
                [(f"f{n}", field._replace(type=names.get(field.type, field.type)).desc) for n, field in enumerate(own)],
            )
            for name, (_, own) in types.items()
            if name not in schema.BUILTIN
        }
    )
    measure, convert = (
        ("getsize_ros1_to_cdr", store.ros1_to_cdr) if source == 1 else ("getsize_cdr_to_ros1", store.cdr_to_ros1)
    )
    for name in types:
        msgdef = store.get_msgdef(names[name])
        bounded: Any = _bounded(getattr(msgdef, measure), schema.min_size(types, name, source))
        store.cache[names[name]] = replace(msgdef, **{measure: bounded})
    root = next(iter(names.values()))

    def encode(data: Buffer) -> Buffer:
        try:
            return convert(memoryview(data), root)
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
