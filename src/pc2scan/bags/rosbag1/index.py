"""The index of a ROS 1 bag: its connections and chunks, and after each chunk the log times of its messages."""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from pc2scan.bags.chunks import Segment, Segments
from pc2scan.bags.reader import ConnectionLimit
from pc2scan.errors import RecordingError

from .records import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    COMPRESSIONS,
    CONNECTION,
    FIRST_LINE,
    INDEX_DATA,
    SECOND_NS,
    FormatError,
    field_of,
    number_field,
    parse_connection,
    records_of,
    text_of,
    time_field,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pc2scan.bags.damage import DamageLog
    from pc2scan.model import Buffer, Connection

    from .records import BagFile, BagRecord

#: Seconds, nanoseconds and the place in the chunk of one message.
_ENTRY = struct.Struct("<III")


class Connections:
    """The connections of a bag by id, of which the first description counts; they are limited (`ConnectionLimit`)."""

    def __init__(self, file: BagFile) -> None:
        self.by_id: dict[int, Connection] = {}
        self._limit = ConnectionLimit(file.path, file.size)

    def add(self, fields: Mapping[bytes, bytes], body: Buffer) -> None:
        """Add the connection of a record with these fields and this body."""
        connection = parse_connection(fields, body)
        if self.by_id.setdefault(connection.id, connection) is connection:
            self._limit.add(len(body))


def read_index(file: BagFile, log: DamageLog) -> tuple[dict[int, Connection], Segments]:
    """Read the index of a bag: connections by id, and chunks with messages, in the order of the file."""
    position, connection_count, chunk_count = _read_bag_header(file)
    connections = Connections(file)
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
    _compare_connections(file, segments, unlisted, connections)
    for identity in sorted(unlisted):
        error = f"connection {identity} has messages, and only chunks describe it"
        log.note(file.damage_error(error), key=("unlisted", identity), messages_lost=0)
    return {key: replace(own, message_count=counts[key]) for key, own in connections.by_id.items()}, segments


def _read_bag_header(file: BagFile) -> tuple[int, int, int]:
    """Read the offset of the index, and its numbers of connections and chunks."""
    fields = file.record(len(FIRST_LINE), BAG_HEADER).fields
    if encryptor := text_of(fields.get(b"encryptor", b"")):
        raise RecordingError(
            f"is encrypted ({encryptor}), only bags that are not can be read",
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


def _compare_connections(file: BagFile, segments: Segments, unlisted: set[int], connections: Connections) -> None:
    """Add connections that only chunks describe, and compare those of whose topic the index says two things.

    Chunks are right: where they differ, the index is not used.
    """
    doubtful = {key for key, connection in connections.by_id.items() if "topic" in connection.metadata}
    missing = unlisted | doubtful
    for segment in segments if missing else ():
        if not missing.isdisjoint(segment.connection_ids or ()):
            for record, body in records_of(file, segment):
                if record.kind == CONNECTION and (identity := number_field(record.fields, "conn")) in missing:
                    missing.discard(identity)
                    connections.add(record.fields, body)
                    if connections.by_id[identity] != (content := parse_connection(record.fields, body)):
                        raise FormatError(f"connection {identity} is {content.topic} in a chunk, and not in it")
    if missing := missing - doubtful:
        raise FormatError(f"connection {min(missing)} has messages but is not described")
