"""Re-encodes messages that pc2scan does not convert, from ROS 1 to ROS 2 and back.

The ROS versions differ in padding and string terminators, the Header's sequence number, the spelling of types, the
definitions and their hashes, and latching or durability. rosbags converts the bytes without making objects; this module
gives it the types.

rosbags generates Python source from definitions and executes it. It gets names made here (``f0``,
``pc2scan/msg/T1``), so that no name from a recording reaches the interpreter; names are checked nevertheless
(`schema`).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from functools import lru_cache
from threading import Lock
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from pc2scan.errors import DecodeError
from pc2scan.model import LATCHED_QOS, Definition, ros1_type

from . import definitions as own_definitions
from . import schema as schemas

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pc2scan.model import Buffer, Connection

    from .schema import Schema, Struct

#: rosbags' message sets by ROS version: of ROS 1's last distribution, and of a long-term release of ROS 2; few message
#: types have changed since foxy.
_STORES = {1: "ros1_noetic", 2: "ros2_jazzy"}

#: Channel metadata and connection header fields that only one ROS version uses.
_METADATA_OF = {
    1: frozenset({"callerid", "latching", "md5sum", "type", "topic", "message_definition"}),
    2: frozenset({"offered_qos_profiles", "topic_type_hash"}),
}


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


def transcoder(
    connection: Connection,
    ros_version: int,
) -> Transcoding:
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
        raise DecodeError(
            f"{connection.msgtype} is serialised as {connection.serialization!r}, expected 'ros1' or 'cdr'",
            topic=connection.topic,
        )
    plan = _type_plan(connection.msgtype, connection.definition, source)
    if isinstance(plan, DecodeError):
        raise DecodeError(plan.message, topic=connection.topic, hint=plan.hint)
    encoder = _Encoder(plan, source, connection.topic)
    return Transcoding(_transcoded_connection(connection, plan), encoder, plan.notes, plan.fields)


def with_definition(connection: Connection) -> Connection:
    """Add the definition to a connection without one; older rosbag2 recordings have none.

    Parameters
    ----------
    connection
        A connection of either ROS version.

    Returns
    -------
    Connection
        The same connection if it has a definition, or if the message set does not have its type.
    """
    ros_version = connection.ros_version
    if connection.definition.encoding or connection.definition.data or ros_version is None:
        return connection
    root = schemas.canonical_type(connection.msgtype)
    known = schemas.known_types(_STORES[ros_version])
    if root not in known:
        return connection
    schema = schemas.closure(root, known.get)
    text, digest = (
        own_definitions.definition(root, ros_version)
        if root in own_definitions.TYPES
        else (
            Definition(f"ros{ros_version}msg", schemas.render(schema, ros_version).encode()),
            schemas.md5sum(schema) if ros_version == 1 else schemas.rihs01(schema),
        )
    )
    return replace(connection, definition=text, digest=connection.digest or digest)


# --- planning ---


@dataclass(frozen=True, slots=True)
class _TypePlan:
    """The part of a plan that depends on type and definition only; connections share it."""

    msgtype: str
    definition: Definition
    digest: str
    store: Any
    root: str
    types: BoundedTypes
    lock: Lock
    notes: tuple[str, ...]
    fields: int


@lru_cache(maxsize=256)
def _type_plan(msgtype: str, definition: Definition, source: int) -> _TypePlan | DecodeError:
    """Return the plan for all connections of a type, or the error; both are cached."""
    try:
        return _new_type_plan(msgtype, definition, source)
    except DecodeError as err:
        return err.with_traceback(None)


def _new_type_plan(msgtype: str, definition: Definition, source: int) -> _TypePlan:
    """Choose the destination's type and compile the conversion."""
    target = 3 - source
    root = schemas.canonical_type(msgtype)
    here, there = _STORES[source], _STORES[target]
    recorded, notes = _recorded_types(msgtype, definition, here)
    ours = schemas.closure(root, lambda name: recorded.get(name) or schemas.known_types(here).get(name))
    theirs = schemas.known_types(there)
    shared = {name for name in ours if schemas.same_layout(ours, theirs, name)}
    schema = schemas.closure(root, lambda name: theirs[name] if name in shared else ours.get(name))
    if differing := [name for name in ours if name in theirs and name not in shared]:
        names = ", ".join(ros1_type(name) if target == 1 else name for name in differing)
        notes = (
            *notes,
            f"layout differs from {_distro_name(there)}'s {names}: written with the recording's own definition",
        )
    if root in shared and root in own_definitions.TYPES:
        text, digest = own_definitions.definition(root, target)
    else:
        text = Definition(f"ros{target}msg", schemas.render(schema, target).encode())
        digest = schemas.md5sum(schema) if target == 1 else schemas.rihs01(schema)
    store, made_names = _compile(schema)
    fields = sum(len(struct.fields) for struct in schema.values())
    return _TypePlan(
        ros1_type(root) if target == 1 else root,
        text,
        digest,
        store,
        made_names[root],
        _bound_types(store, schema, made_names, source),
        Lock(),
        notes,
        fields,
    )


def _distro_name(store: str) -> str:
    word, _, distro = store.partition("_")
    return f"ROS {word[-1]} {distro}"


def _recorded_types(msgtype: str, definition: Definition, here: str) -> tuple[Mapping[str, Struct], tuple[str, ...]]:
    """Read the recording's definition; if it is empty, the ROS version's message set has the type."""
    if definition.data.strip():
        return schemas.parse(definition, msgtype), ()
    if schemas.canonical_type(msgtype) in schemas.known_types(here):
        # A message without fields has an empty definition, as if it had none.
        empty = not schemas.known_types(here)[schemas.canonical_type(msgtype)].fields
        return {}, () if empty else (f"no definition in the recording: {_distro_name(here)}'s {msgtype} is assumed",)
    return schemas.parse(definition, msgtype) if definition.encoding else {}, ()


def _compile(schema: Schema) -> tuple[Any, dict[str, str]]:
    """Register a schema with rosbags under names made here; returns the store and the made names.

    The Header keeps its name, by which rosbags finds ROS 1's sequence number, and so do the two types
    that rosbags' empty store already has.
    """
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    names = {
        name: name if name == schemas.HEADER or schemas.is_builtin(name) else f"pc2scan/msg/T{index}"
        for index, name in enumerate(schema)
    }
    store = get_typestore(Stores.EMPTY)
    store.register(
        schemas.fielddefs(
            {name: content for name, content in schema.items() if not schemas.is_builtin(name)},
            names.__getitem__,
            lambda index, _: f"f{index}",
        )
    )
    # Compiles now, so that an error concerns the topic and not each message.
    store.get_msgdef(names[next(iter(schema))])
    return store, names


def _bound_types(store: Any, schema: Schema, names: Mapping[str, str], source: int) -> BoundedTypes:
    """Make the conversion, with the minimum size of each type."""
    root = next(iter(schema))
    repeated = {
        field.type
        for struct in schema.values()
        for field in struct.fields
        if field.shape == "sequence" and field.type not in schemas.PRIMITIVES
    }
    words = any(
        field.shape == "sequence" and field.type == "string" for struct in schema.values() for field in struct.fields
    )
    return BoundedTypes(
        {made: store.get_msgdef(made) for made in names.values()},
        names[root],
        schemas.min_size(schema, root, source),
        {names[name]: schemas.min_size(schema, name, source) for name in repeated},
        makes_objects=words or bool(repeated),
    )


# --- declaring ---


def _transcoded_connection(connection: Connection, plan: _TypePlan) -> Connection:
    """Return the connection as the other ROS version declares it."""
    source = connection.ros_version or 0
    target = 3 - source
    return replace(
        connection,
        msgtype=plan.msgtype,
        serialization="cdr" if target == 2 else "ros1",
        definition=plan.definition,
        digest=plan.digest,
        callerid=None,
        qos=LATCHED_QOS if target == 2 and connection.latching else "",
        metadata={key: value for key, value in connection.metadata.items() if key not in _METADATA_OF[source]},
    )


# --- encoding ---


#: A larger big-endian message is refused if it has sequences of messages or strings: it is re-encoded by way of
#: Python objects, which take a hundred times as much memory. No known recorder writes big-endian.
_MAX_BIG_ENDIAN = 1_000_000


class _Encoder:
    """Re-encodes one connection's messages."""

    __slots__ = ("_convert", "_errors", "_plan", "_topic")

    def __init__(self, plan: _TypePlan, source: int, topic: str) -> None:
        from rosbags.serde import SerdeError  # noqa: PLC0415

        self._plan = plan
        self._topic = topic
        self._convert = self._to_cdr if source == 1 else self._to_ros1
        # Besides its own, rosbags raises the errors of slices, structs and asserts.
        self._errors = (
            SerdeError,
            struct.error,
            AssertionError,
            LookupError,
            OverflowError,
            RecursionError,
            TypeError,
            ValueError,
        )

    def __call__(self, data: Buffer) -> Buffer:
        """Re-encode one message."""
        try:
            return self._convert(memoryview(data))
        except self._errors as err:
            reason = str(err).replace(repr(self._plan.root), "it") or type(err).__name__
            raise DecodeError(
                f"{self._plan.msgtype} of {len(data)} bytes cannot be re-encoded: {reason}", topic=self._topic
            ) from err

    def _to_cdr(self, data: memoryview) -> memoryview:
        return self._plan.types.ros1_to_cdr(data)

    def _to_ros1(self, data: memoryview) -> memoryview:
        if len(data) < 4 or data[0] != 0 or data[1] > 1:
            raise DecodeError(
                f"{self._plan.msgtype} of {len(data)} bytes begins with {data[:4].hex() or 'nothing'}, "
                "expected a CDR header (0001 or 0000, then two bytes)",
                topic=self._topic,
            )
        plan = self._plan
        if data[1] == 0:
            # rosbags' direct conversion does not accept big-endian.
            if len(data) > _MAX_BIG_ENDIAN and plan.types.makes_objects:
                raise ValueError(f"it is big-endian, and longer than the {_MAX_BIG_ENDIAN} bytes allowed for that")
            store, root = plan.store, plan.root
            with plan.lock:
                store.max_sequence_length = max(len(data), 1)
                data = store.serialize_cdr(store.deserialize_cdr(data, root), root, little_endian=True)
        return plan.types.cdr_to_ros1(data)


# --- bounding ---
#
# The functions that rosbags generates check a message's length only at the beginning of a sequence or a string. They
# assume that arrays of a fixed size, and messages made of nothing else, are complete: a message of a hundred bytes can
# then take gigabytes, or hours. So each type has a minimum size, which is checked first.

#: At the end of a message, the generated functions may skip to the alignment of a member that does not exist.
_MAX_PADDING = 7


class BoundedTypes:
    """The types of one conversion.

    Parameters
    ----------
    msgdefs
        rosbags' compiled definitions, by name: of the type itself and all nested types.
    root
        The type's name.
    least
        Minimum size of a message, bytes.
    repeated
        Minimum sizes of the types that are elements of sequences.
    makes_objects
        Whether a message can become as many Python objects as it has bytes.
    """

    __slots__ = ("_least", "_msgdefs", "_root", "makes_objects")

    def __init__(
        self, msgdefs: Mapping[str, Any], root: str, least: int, repeated: Mapping[str, int], *, makes_objects: bool
    ) -> None:
        self._msgdefs = {
            name: _guard_sizes(msgdef, repeated[name]) if repeated.get(name) else msgdef
            for name, msgdef in msgdefs.items()
        }
        self._root = root
        self._least = least
        self.makes_objects = makes_objects

    def ros1_to_cdr(self, data: memoryview) -> memoryview:
        """Convert a message of ROS 1 to little-endian CDR.

        Raises
        ------
        SerdeError, struct.error, ValueError
            If the bytes contradict the type.
        """
        msgdef = self._msgdefs[self._root]
        types = _TypeStore(self._msgdefs, len(data))
        size = self._result_size(data, 0, msgdef.getsize_ros1_to_cdr, types, 0)
        made = memoryview(bytearray(4 + size))
        made[1] = 1
        msgdef.ros1_to_cdr(data, 0, made[4:], 0, types)
        return made.toreadonly()

    def cdr_to_ros1(self, data: memoryview) -> memoryview:
        """Convert a message in little-endian CDR, its header included, to ROS 1's format.

        Raises
        ------
        SerdeError, struct.error, ValueError
            If the bytes contradict the type.
        """
        msgdef = self._msgdefs[self._root]
        body = data[4:]
        types = _TypeStore(self._msgdefs, len(data))
        # Some writers add padding at the end.
        size = self._result_size(body, 4, msgdef.getsize_cdr_to_ros1, types, 3)
        made = memoryview(bytearray(size))
        msgdef.cdr_to_ros1(body, 0, made, 0, types)
        return made.toreadonly()

    def _result_size(
        self, body: memoryview, head: int, measure: Callable[..., tuple[int, int]], types: _TypeStore, padding: int
    ) -> int:
        """Check that the fields take as many bytes as the message has; return the size of the result."""
        if len(body) < self._least:
            raise ValueError(f"its fields take {head + self._least} or more")
        taken, size = measure(body, 0, None, 0, types)
        if not taken - _MAX_PADDING * (head > 0) <= len(body) <= taken + padding:
            raise ValueError(f"its fields take {head + taken}")
        return size


class _TypeStore:
    """The part of rosbags' store that the generated functions use, for one message."""

    __slots__ = ("_msgdefs", "max_sequence_length")

    def __init__(self, msgdefs: Mapping[str, Any], length: int) -> None:
        self._msgdefs = msgdefs
        # Every element takes at least one byte.
        self.max_sequence_length = max(length, 1)

    def get_msgdef(self, name: str) -> Any:
        return self._msgdefs[name]


def _guard_sizes(msgdef: Any, least: int) -> SimpleNamespace:
    """Wrap a type's functions: its size is computed only if the message has the type's minimum of bytes left."""

    def checked(measure: Callable[..., tuple[int, int]]) -> Callable[..., tuple[int, int]]:
        def measured(body: memoryview, place: int, made: None, size: int, types: _TypeStore) -> tuple[int, int]:
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
