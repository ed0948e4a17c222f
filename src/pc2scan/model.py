"""The data types that all containers share: connections, messages, chunks; and the protocol of writers."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Collection, Container, Iterable, Mapping, Sequence

    from .threads import Threads

Buffer = bytes | memoryview

#: The id of a connection that is not in a recording yet.
NEW_ID = -1

#: The latest log time that rosbag2 can store; it is also the start of a recording without messages.
MAX_ROSBAG2_NS = 2**63 - 1

#: The ROS version of each serialisation of messages, and the other way round.
ROS_VERSIONS = {"ros1": 1, "cdr": 2}
SERIALIZATIONS = {version: name for name, version in ROS_VERSIONS.items()}

#: QoS profiles as rosbag2 (metadata version 8) writes them: keep last, reliable, automatic liveliness, infinite
#: durations.
_QOS = """\
- history: 1
  depth: {depth}
  reliability: 1
  durability: {durability}
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""

#: The QoS profile of a latched topic: keep last 1, transient local. Most other topics get no profile: ``ros2 bag play``
#: uses its default.
LATCHED_QOS = _QOS.format(depth=1, durability=1)
#: The QoS profile of tf2's transform broadcaster: keep last 100, volatile.
TF_QOS = _QOS.format(depth=100, durability=2)


class Definition(NamedTuple):
    """A message definition, verbatim.

    Attributes
    ----------
    encoding
        MCAP's schema encoding: ``ros1msg``, ``ros2msg``, ``ros2idl``, another one, or empty for none.
    data
        The definition with those it depends on, byte for byte as recorded.
    """

    encoding: str = ""
    data: bytes = b""

    @property
    def text(self) -> str:
        """Return the definition as text. Bytes that are not UTF-8 become replacement characters."""
        return self.data.decode("utf-8", "replace")


def _in_utf8(text: str) -> str:
    """Return the text with replacement characters instead of surrogates."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


@dataclass(frozen=True, slots=True)
class Connection:
    """One publisher's stream of one topic: a ROS 1 connection, a rosbag2 topic or an MCAP channel.

    Attributes
    ----------
    id
        Unique within its reader; in a chunked container the id in its messages. `NEW_ID` for a connection that is not
        read from a recording.
    topic
        As recorded.
    msgtype
        As recorded: ``sensor_msgs/PointCloud2`` or ``sensor_msgs/msg/PointCloud2``.
    serialization
        MCAP's message encoding: ``ros1``, ``cdr``, or another one.
    definition
        The recorded definition of the type.
    digest
        The recorded hash of the type: md5sum (ROS 1), RIHS01 (ROS 2), or empty.
    callerid
        ROS 1's name of the publishing node; None if not recorded.
    latching
        ROS 1: latched. ROS 2: durability transient local in any of the offered profiles.
    qos
        rosbag2's ``offered_qos_profiles``, verbatim (YAML text); empty if not recorded.
    metadata
        MCAP channel metadata or further ROS 1 connection header fields, verbatim.
    message_count
        None if the container does not have it.
    schema_id
        In an MCAP file: the id of the definition; 0 for none.
    """

    id: int
    topic: str
    msgtype: str
    serialization: str
    definition: Definition = Definition()
    digest: str = ""
    callerid: str | None = None
    latching: bool = False
    qos: str = ""
    metadata: Mapping[str, str] = field(default_factory=dict)
    message_count: int | None = None
    schema_id: int = 0

    @property
    def ros_type(self) -> str:
        """The type in ROS 2 spelling, ``sensor_msgs/msg/PointCloud2``, whichever spelling is recorded."""
        return normalized_type(self.msgtype)

    @property
    def kind(self) -> str:
        """The type, and the encoding if it is not ROS's (MCAP files also hold JSON and Protobuf)."""
        if self.ros_version is None:
            return f"{self.msgtype or 'untyped'} in {self.serialization or 'no encoding'}"
        return self.ros_type

    @property
    def is_static(self) -> bool:
        """Whether transforms on this topic are valid at any time."""
        return self.topic.rsplit("/", 1)[-1] == "tf_static"

    @property
    def is_latched(self) -> bool:
        """Whether its messages stay valid until the next one, or for ever."""
        return self.latching or self.is_static

    @property
    def in_utf8(self) -> Connection:
        """Return the connection with texts in UTF-8. Those of ROS 1 may have any bytes, read as surrogates."""
        return replace(
            self,
            topic=_in_utf8(self.topic),
            msgtype=_in_utf8(self.msgtype),
            digest=_in_utf8(self.digest),
            callerid=None if self.callerid is None else _in_utf8(self.callerid),
            metadata={_in_utf8(key): _in_utf8(value) for key, value in self.metadata.items()},
        )

    @property
    def ros_version(self) -> int | None:
        """The ROS version of the messages' serialisation, 1 or 2; None for another encoding."""
        return ROS_VERSIONS.get(self.serialization)


class RawMessage(NamedTuple):
    """One recorded message, not decoded.

    ``log_time_ns`` is the time of recording, ``publish_time_ns`` the time of publishing (the same if the container has
    only one), both in integer nanoseconds. ``data`` may be a view into a larger buffer.
    """

    connection: Connection
    log_time_ns: int
    data: Buffer
    publish_time_ns: int
    sequence: int = 0

    @property
    def size(self) -> int:
        """Size of the data, bytes."""
        return len(self.data)


def own_data(data: Buffer) -> Buffer:
    """Return data to keep: copied, if a view of it would keep more than twice as much in memory."""
    return data if isinstance(data, bytes) or 2 * len(data) >= memoryview(data.obj).nbytes else bytes(data)


def of_types(connections: Iterable[Connection], types: Container[str]) -> list[Connection]:
    """Return the connections whose messages have one of some types."""
    return [connection for connection in connections if connection.ros_type in types]


def copied_message(message: RawMessage) -> RawMessage:
    """Return a message that keeps nothing else in memory: a view would keep a whole chunk."""
    return message._replace(data=bytes(message.data))


def declared_counts(connections: Iterable[Connection]) -> dict[int, int]:
    """Return the number of messages of each connection in the whole recording, by id, as the container declares it."""
    return {c.id: c.message_count for c in connections if c.message_count is not None}


@dataclass(slots=True, eq=False)
class StoredChunk:
    """A chunk that is copied as a whole, without reading its messages one by one.

    Attributes
    ----------
    compression
        ``none``, ``bz2``, ``lz4`` or ``zstd``: it is written as stored. Empty: its records are not compressed, and the
        writer compresses them like its own chunks.
    stored
        Its records with this compression.
    size
        Size of its uncompressed records, bytes.
    crc
        CRC-32 of its uncompressed records; 0 if there is none.
    index
        For every connection with messages in it, by id: their log times (ns) and places among the uncompressed
        records, in the order of the file.
    """

    compression: str
    stored: Buffer
    size: int
    crc: int
    index: Mapping[int, Sequence[tuple[int, int]]]

    def span_ns(self) -> tuple[int, int]:
        """Return the log times of the earliest and the latest message."""
        return min(map(min, self.index.values()))[0], max(map(max, self.index.values()))[0]


class ChunkRule(NamedTuple):
    """The conditions under which a chunk can be copied to a destination as a whole.

    Attributes
    ----------
    container
        The container of the chunks: ``rosbag1`` or ``mcap``.
    compressions
        Compressions that a chunk may keep; a chunk with another one is compressed again, as a whole.
    connection_ids
        The connections that are copied unchanged and have the same ids in the destination. A chunk with messages of
        other connections is not copied.
    declarations
        Schema and Channel records of the destination, byte for byte. A chunk may repeat these, but have no others.
    last_ns
        The latest log time that the destination can store; None if it can store all of the source's.
    """

    container: str
    compressions: frozenset[str]
    connection_ids: frozenset[int]
    declarations: frozenset[bytes] = frozenset()
    last_ns: int | None = None


class Attachment(NamedTuple):
    """An MCAP attachment: a file in the recording."""

    name: str
    media_type: str
    log_time_ns: int
    create_time_ns: int
    data: bytes


class Metadata(NamedTuple):
    """An MCAP metadata record: named key-value text."""

    name: str
    entries: Mapping[str, str]


class Summary(NamedTuple):
    """A summary of a recording that is made without reading its messages.

    Attributes
    ----------
    container
        ``rosbag1``, ``rosbag2`` (a directory), ``sqlite3`` (a bare ``.db3``) or ``mcap``.
    storage
        Storage of a rosbag2 directory: ``sqlite3`` or ``mcap``; else empty.
    compression
        The compressions in use, sorted: ``none``, ``bz2``, ``lz4``, ``zstd``.
    size_bytes
        Size of all files together.
    message_count, start_ns, end_ns
        None if they are not known without reading every message. ``end_ns`` is the last message's log time.
    """

    container: str
    storage: str
    compression: tuple[str, ...]
    size_bytes: int
    message_count: int | None
    start_ns: int | None
    end_ns: int | None
    profile: str = ""


class Writer(Protocol):
    """Writes a recording. It is valid only after `finish`."""

    def keep_ids(self, connections: Collection[Connection]) -> None:
        """Reserve the ids of these connections, so that they keep them when they are declared."""
        del connections

    def add_connection(self, connection: Connection) -> int:
        """Declare a connection, and return its handle for `write`. Its ``id`` is ignored unless it is reserved."""
        ...

    def declarations(self) -> frozenset[bytes]:
        """Return the declarations written so far, which chunks may repeat; see `ChunkRule`."""
        return frozenset()

    def compress_ahead(self, pool: Threads) -> None:
        """Compress on these threads, which must run until `finish` or `abort`. The written bytes stay the same."""
        ...

    def write(self, handle: int, log_time_ns: int, data: Buffer, publish_time_ns: int, sequence: int = 0) -> None:
        """Append a message; raises ``UnwritableError`` and writes nothing if the format cannot hold it."""
        ...

    def write_chunk(self, chunk: StoredChunk) -> None:
        """Append a whole chunk; its connections must be declared and have kept their ids."""
        del chunk

    def add_attachment(self, attachment: Attachment) -> None:
        """Append an attachment; containers without attachments ignore it."""
        del attachment

    def add_metadata(self, metadata: Metadata) -> None:
        """Append a metadata record; containers without them ignore it."""
        del metadata

    def finish(self) -> None:
        """Write indexes and summaries, and put everything on the disk."""
        ...

    def abort(self) -> None:
        """Release the files; the caller removes the unfinished recording."""
        ...


def normalized_type(msgtype: str) -> str:
    """Spell a ROS type as ROS 2 does; DDS's name of it, too.

    >>> normalized_type("tf/tfMessage"), normalized_type("std_msgs::msg::dds_::Header_")
    ('tf/msg/tfMessage', 'std_msgs/msg/Header')
    """
    if match := re.fullmatch(r"(\w+)::msg::dds_::(\w+)_", msgtype):
        return f"{match[1]}/msg/{match[2]}"
    package, _, name = msgtype.rpartition("/")
    if not package or "/" in package:
        return msgtype
    return f"{package}/msg/{name}"


def ros1_type(msgtype: str) -> str:
    """Spell a ROS type as ROS 1 does: ``sensor_msgs/PointCloud2``."""
    parts = msgtype.split("/")
    return f"{parts[0]}/{parts[-1]}" if len(parts) == 3 else msgtype
