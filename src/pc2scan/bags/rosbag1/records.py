"""Reads and parses the records of ROS 1 bags, format 2.0, in the file and in its chunks, and its index.

A bag is a first line and records; a record is a header of named fields and a body, each after its uint32 length.
Messages are in chunks, in which records are compressed together. After the chunks follows the index: every connection,
and for every chunk its place, times and counts.

::

    #ROSBAG V2.0
    BAG HEADER                         padded to 4096 bytes; has the offset of the index
    CHUNK { CONNECTION | MESSAGE }*    followed by an INDEX DATA record for each connection in it
    ...
    CONNECTION ...                     the index
    CHUNK INFO ...

Source: http://wiki.ros.org/Bags/Format/2.0, and for details missing there, ROS 1's own reader.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.chunks import NearbyFile, Segment, Segments, unpacked
from pc2scan.bags.damage import RECOVER
from pc2scan.bags.formats import FORMATS
from pc2scan.bags.reader import ConnectionLimit
from pc2scan.errors import DamageError, RecordingError
from pc2scan.files.compression import CompressionError
from pc2scan.model import Connection, Definition

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pc2scan.bags.damage import DamageLog
    from pc2scan.model import Buffer

FIRST_LINE = FORMATS["rosbag1"].magic
COMPRESSIONS = FORMATS["rosbag1"].compressions

MESSAGE, BAG_HEADER, INDEX_DATA, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
_KINDS = {
    MESSAGE: "message",
    BAG_HEADER: "bag header",
    INDEX_DATA: "index data",
    CHUNK: "chunk",
    CHUNK_INFO: "chunk info",
    CONNECTION: "connection",
}

#: Fields of a connection's header with an attribute in `Connection`.
OWN_FIELDS = frozenset({"callerid", "latching", "md5sum", "message_definition", "topic", "type"})

UINT32_MAX = 0xFFFF_FFFF
SECOND_NS = 1_000_000_000

#: Fields of a header; publishers write about ten. In memory a field takes many times its bytes.
_MAX_FIELDS = 4096

UINT32 = struct.Struct("<I")
UINT64 = struct.Struct("<Q")
PAIR = struct.Struct("<II")


class FormatError(Exception):  # it never leaves the reader
    """Bytes contradict the format; the reader adds the place and raises a DamageError."""


def parse_fields(raw: Buffer) -> dict[bytes, bytes]:
    """Split a header into fields; each is a uint32 length and ``name=value``."""
    raw = bytes(raw)
    fields: dict[bytes, bytes] = {}
    position = 0
    while position < len(raw):
        start = position + 4
        if start > len(raw):
            raise FormatError(f"a header of {len(raw)} bytes ends inside a field's length")
        (size,) = UINT32.unpack_from(raw, position)
        position = start + size
        if position > len(raw):
            raise FormatError(f"a header field of {size} bytes does not fit into its header of {len(raw)} bytes")
        name, equals, value = raw[start:position].partition(b"=")
        if not equals:
            raise FormatError(f"the header field {name[:40]!r} has no '='")
        if len(fields) == _MAX_FIELDS:
            raise FormatError(f"a header has more than {_MAX_FIELDS} fields")
        fields[name] = value
    return fields


def field_of(fields: Mapping[bytes, bytes], name: str, size: int | None = None) -> bytes:
    """Return a required field, of ``size`` bytes if given."""
    value = fields.get(name.encode())
    if value is None:
        raise FormatError(f"a record's header has no field '{name}'")
    if size is not None and len(value) != size:
        raise FormatError(f"the header field '{name}' has {len(value)} bytes, {size} are needed")
    return value


def number_field(fields: Mapping[bytes, bytes], name: str, size: int = 4) -> int:
    """Return a field with an unsigned number of so many bytes."""
    return int.from_bytes(field_of(fields, name, size), "little")


def time_field(fields: Mapping[bytes, bytes], name: str) -> int:
    """Return a field with a time, as nanoseconds."""
    seconds, nanoseconds = PAIR.unpack(field_of(fields, name, 8))
    return int(seconds) * SECOND_NS + int(nanoseconds)


def text_of(value: bytes) -> str:
    """Decode UTF-8; other bytes become surrogates, which are written as the same bytes."""
    return value.decode("utf-8", "surrogateescape")


def parse_connection(fields: Mapping[bytes, bytes], body: Buffer) -> Connection:
    """Make a connection from its record. The body is a header itself: the publisher's."""
    topic = text_of(field_of(fields, "topic"))
    header = parse_fields(body)
    texts = {text_of(name): text_of(value) for name, value in header.items() if name != b"message_definition"}
    metadata = {name: value for name, value in texts.items() if name not in OWN_FIELDS}
    # What the publisher called the topic, and a latching that is not plainly "1", would otherwise be lost.
    if texts.get("topic", topic) != topic:
        metadata["topic"] = texts["topic"]
    if texts.get("latching", "1") != "1":
        metadata["latching"] = texts["latching"]
    definition = header.get(b"message_definition")
    return Connection(
        id=number_field(fields, "conn"),
        topic=topic,
        msgtype=text_of(field_of(header, "type")),
        serialization="ros1",
        definition=Definition() if definition is None else Definition("ros1msg", definition),
        digest=texts.get("md5sum", ""),
        callerid=texts.get("callerid"),
        latching=texts.get("latching") == "1",
        metadata=metadata,
    )


class BagFile(NearbyFile):
    """Reads records of a bag."""

    def damage(self, message: str) -> FormatError:
        """Return the error for a damaged bag; the reader adds the place."""
        return FormatError(message)

    def damage_error(self, message: str) -> DamageError:
        """Return the error that the reader raises."""
        return DamageError(message, path=self.path, hint=RECOVER)

    def record(self, offset: int, kind: int) -> BagRecord:
        """Return a record of a required kind."""
        record = read_record(self.nearby, offset, self.size)
        if record.kind != kind:
            raise FormatError(
                f"the record at byte {offset} is a {_KINDS.get(record.kind, record.kind)}, "
                f"a {_KINDS[kind]} should be there"
            )
        if record.stop > self.size:
            raise FormatError(
                f"the {_KINDS[kind]} at byte {offset} reaches to byte {record.stop}, the file has {self.size} bytes"
            )
        return record


class BagRecord(NamedTuple):
    """A record: its kind, its fields, and start and stop of its body, which may be behind the data."""

    kind: int
    fields: dict[bytes, bytes]
    start: int
    stop: int


def read_record(read: Callable[[int, int], Buffer], position: int, size: int) -> BagRecord:
    """Return the record at a place of a file or a chunk of ``size`` bytes; ``read`` returns bytes of it."""
    header = body = position
    for _ in range(2):
        if body + 4 > size:
            raise FormatError(f"a record's length does not fit into {size} bytes")
        header, (length,) = body, UINT32.unpack(read(body, 4))
        body += 4 + length
        if body > size and header == position:
            raise FormatError(f"a record's header reaches to byte {body} of {size}")
    fields = parse_fields(read(position + 4, header - position - 4))
    return BagRecord(field_of(fields, "op", 1)[0], fields, header + 4, body)


# --- Inside chunks ---


def part_of(data: memoryview, offset: int, length: int) -> memoryview:
    """Return bytes of a chunk, for `read_record`."""
    return data[offset : offset + length]


def read_chunk(file: BagFile, segment: Segment) -> tuple[memoryview, memoryview]:
    """Read a chunk; return its payload and its decompressed records."""
    stored = file.borrow(segment.offset, segment.length)
    try:
        return stored, unpacked(segment, stored, file.size)
    except CompressionError as err:
        raise FormatError(str(err)) from err


def records_of(file: BagFile, segment: Segment) -> Iterator[tuple[BagRecord, memoryview]]:
    """Read a chunk, and yield all of its records and their bodies."""
    _, data = read_chunk(file, segment)
    position = 0
    while position < len(data):
        record = read_record(partial(part_of, data), position, len(data))
        yield record, data[record.start : record.stop]
        position = record.stop


_CONN, _OP, _TIME = b"\x09\0\0\0conn=", b"\x04\0\0\0op=\x02", b"\x0d\0\0\0time="
_LENGTH = b"\x26\0\0\0"

#: A message record up to its body, by the order of its fields: that of ROS 1's recorder, of its Python library and
#: rosbags, and of that library in Python 2. Other orders are read field by field. Of the record's seven values, the
#: first and the sixth are literals, and the last is the length of the body. Behind the three literals are the places of
#: the second one, of the connection, and of the seconds, which nanoseconds follow.
LAYOUTS: Mapping[tuple[bytes, ...], tuple[struct.Struct, bytes, bytes, bytes, int, int, int]] = {
    (b"conn", b"op", b"time"): (struct.Struct("<13sI17sII0sI"), _LENGTH + _CONN, _OP + _TIME, b"", 2, 1, 3),
    (b"op", b"conn", b"time"): (struct.Struct("<21sI9sII0sI"), _LENGTH + _OP + _CONN, _TIME, b"", 2, 1, 3),
    (b"time", b"conn", b"op"): (struct.Struct("<13sII9sI8sI"), _LENGTH + _TIME, _CONN, _OP, 3, 4, 1),
}
USUAL_LAYOUT = LAYOUTS[b"conn", b"op", b"time"]


# --- The index: connections and chunks, and after each chunk the log times of its messages ---

#: Seconds, nanoseconds and the place in the chunk of one message.
_ENTRY = struct.Struct("<III")


@dataclass(slots=True, eq=False)
class Connections:
    """The connections of a bag by id, of which the first description counts; they are limited (`ConnectionLimit`)."""

    limit: ConnectionLimit
    by_id: dict[int, Connection] = field(default_factory=dict)

    def add(self, fields: Mapping[bytes, bytes], body: Buffer) -> None:
        """Add the connection of a record with these fields and this body."""
        connection = parse_connection(fields, body)
        if self.by_id.setdefault(connection.id, connection) is connection:
            self.limit.add(len(body))


def read_index(file: BagFile, log: DamageLog) -> tuple[dict[int, Connection], Segments]:
    """Read the index of a bag: connections by id, and chunks with messages, in the order of the file."""
    position, connection_count, chunk_count = _read_bag_header(file)
    connections = Connections(ConnectionLimit(file.path, file.size))
    for _ in range(connection_count):
        record = file.record(position, CONNECTION)
        connections.add(record.fields, file.nearby(record.start, record.stop - record.start))
        position = record.stop

    counts = dict.fromkeys(connections.by_id, 0)
    located = Segments()
    for _ in range(chunk_count):
        _, fields, start, stop = file.record(position, CHUNK_INFO)
        if (version := number_field(fields, "ver")) != 1:
            raise FormatError(f"a chunk info has version {version}, only 1 can be read")
        entries = number_field(fields, "count")
        if 8 * entries != stop - start:
            raise FormatError(f"a chunk info of {stop - start} bytes declares {entries} counts of 8 bytes")
        numbers = struct.unpack(f"<{2 * entries}I", file.nearby(start, 8 * entries))
        for identity, count in zip(numbers[::2], numbers[1::2], strict=True):
            counts[identity] = counts.get(identity, 0) + count
        if ids := frozenset(numbers[::2]):
            place = number_field(fields, "chunk_pos", 8)
            start_ns, end_ns = time_field(fields, "start_time"), time_field(fields, "end_time")
            count = sum(numbers[1::2])
            located.append(Segment(place, 0, 0, start_ns, end_ns, connection_ids=ids, message_count=count))
        position = stop
    # Zeros are no records: a file that was preallocated, or copied in blocks, may end with them.
    if file.read(position, min(file.size - position, 1 << 20)).strip(b"\0"):
        raise FormatError(f"the file continues at byte {position}, after the records that the bag header counts")

    segments = Segments()
    for entry in located:
        chunk = chunk_segment(entry.offset, file.record(entry.offset, CHUNK))
        entry.offset, entry.length, entry.uncompressed_size = chunk.offset, chunk.length, chunk.uncompressed_size
        entry.compression = chunk.compression
        segments.append(entry)
    del located
    segments.sort()
    # Otherwise the index of a short file could repeat its chunks without limit.
    if (segments.rows["offset"][1:] == segments.rows["offset"][:-1]).any():
        raise FormatError("the index names a chunk twice")
    # One damaged length may reach into the next chunk, but not all lengths.
    if (stored := int(segments.rows["length"].sum())) > 2 * file.size:
        raise FormatError(f"the chunks have {stored} bytes together, in a bag of {file.size}")
    unlisted = set(counts.keys() - connections.by_id.keys())
    doubtful = {key for key, connection in connections.by_id.items() if "topic" in connection.metadata}
    if unlisted or doubtful:
        _compare_connections(file, segments, unlisted | doubtful, doubtful, connections)
    for identity in sorted(unlisted):
        error = f"connection {identity} has messages, and only chunks describe it"
        log.note(file.damage_error(error), key=("unlisted", identity), messages_lost=0)
    return {key: replace(own, message_count=counts[key]) for key, own in connections.by_id.items()}, segments


def _read_bag_header(file: BagFile) -> tuple[int, int, int]:
    """Read the offset of the index, and its numbers of connections and chunks."""
    fields = file.record(len(FIRST_LINE), BAG_HEADER).fields
    if encryptor := text_of(fields.get(b"encryptor", b"")):
        raise RecordingError(
            f"is encrypted ({encryptor}); only unencrypted bags can be read",
            path=file.path,
            hint="decrypt it with ROS 1: rosbag decrypt FILE",
        )
    index_pos = number_field(fields, "index_pos", 8)
    if index_pos == 0:
        raise FormatError("there is none, the bag was never closed (index_pos is 0)")
    if index_pos > file.size:
        raise FormatError(f"the index should be at byte {index_pos}, the file has {file.size} bytes")
    return index_pos, number_field(fields, "conn_count"), number_field(fields, "chunk_count")


def chunk_segment(chunk_pos: int, record: BagRecord) -> Segment:
    """Make a segment from a chunk's record, without times and connections."""
    compression = text_of(field_of(record.fields, "compression"))
    if compression not in COMPRESSIONS:
        raise FormatError(
            f"the chunk at byte {chunk_pos} is compressed with {compression!r}, allowed are {', '.join(COMPRESSIONS)}"
        )
    length, size = record.stop - record.start, number_field(record.fields, "size")
    return Segment(record.start, length, size, start_ns=0, end_ns=0, compression=compression)


def indexed_entries(file: BagFile, segment: Segment) -> Iterator[tuple[int, list[tuple[int, int]]]]:
    """Yield the connections, and the log times and places of their messages, of the index records after a chunk."""
    position = segment.offset + segment.length
    with suppress(FormatError):
        while True:
            _, fields, start, position = file.record(position, INDEX_DATA)
            if number_field(fields, "ver") != 1 or _ENTRY.size * number_field(fields, "count") != position - start:
                return
            entries = _ENTRY.iter_unpack(file.nearby(start, position - start))
            yield number_field(fields, "conn"), [(time * SECOND_NS + more, place) for time, more, place in entries]


def _compare_connections(
    file: BagFile, segments: Segments, missing: set[int], doubtful: set[int], connections: Connections
) -> None:
    """Add connections that only chunks describe, and compare those to which the index gives two topics.

    Chunks are right: where they differ, the index is not used.
    """
    for segment in segments:
        if not missing.isdisjoint(segment.connection_ids or ()):
            for record, body in records_of(file, segment):
                if record.kind == CONNECTION and (identity := number_field(record.fields, "conn")) in missing:
                    missing.discard(identity)
                    connections.add(record.fields, body)
                    if connections.by_id[identity] != (content := parse_connection(record.fields, body)):
                        raise FormatError(f"connection {identity} is {content.topic} in a chunk, and not in it")
    if missing := missing - doubtful:
        raise FormatError(f"connection {min(missing)} has messages but is not described")
