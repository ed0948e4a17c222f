"""The index of a ROS 1 bag: its connections and chunks."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.chunked.segments import Segment
from pc2scan.errors import RecordingError
from pc2scan.files.limits import ConnectionLimit

from .chunks import payload, scan_records
from .records import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    COMPRESSIONS,
    CONNECTION,
    FIRST_LINE,
    MESSAGE,
    FormatError,
    field_of,
    kind_of,
    parse_connection,
    text_of,
    time_field,
    uint32_field,
    uint64_field,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pc2scan.model import Buffer, Connection

    from .records import BagFile


class BagIndex(NamedTuple):
    """The connections and chunks of a bag.

    ``unlisted`` are the connections with messages that are not in the bag's index.
    """

    connections: dict[int, Connection]
    segments: list[Segment]
    unlisted: frozenset[int] = frozenset()


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


class ConnectionCheck:
    """Compares the connections in chunks with those in the index.

    Parameters
    ----------
    connections
        The connections of the index.
    """

    def __init__(self, connections: Mapping[int, Connection]) -> None:
        self._connections = connections
        # Equal records, to compare bytes only: some recorders repeat connections in every chunk.
        self._equal: dict[int, tuple[bytes | None, bytes]] = {}

    def difference(self, fields: Mapping[bytes, bytes], body: Buffer) -> str | None:
        """Describe the difference of a chunk's copy of a connection; None if there is none."""
        try:
            identity = uint32_field(fields, "conn")
            record = (fields.get(b"topic"), bytes(body))
            if self._equal.get(identity) == record:
                return None
            copy, known = parse_connection(fields, body), self._connections.get(identity)
        except FormatError as err:
            return f"it describes a connection that cannot be read: {err}"
        if known is None:
            return f"it describes connection {identity}, which is not in the index"
        if known == replace(copy, message_count=known.message_count):
            self._equal[identity] = record
            return None
        for name in ("topic", "msgtype", "digest", "callerid"):
            ours, theirs = getattr(known, name), getattr(copy, name)
            if ours != theirs:
                word = {"msgtype": "type", "digest": "md5sum"}.get(name, name)
                return f"connection {identity} has {word} {theirs!r:.80} in it, {ours!r:.80} elsewhere"
        part = "definition" if known.definition != copy.definition else "header"
        return f"connection {identity} has another {part} in it than elsewhere"


def read_index(file: BagFile) -> BagIndex:
    """Read the index of a bag."""
    position, connection_count, chunk_count = _read_bag_header(file)
    found = Connections(file)
    for _ in range(connection_count):
        fields, start, position = file.record(position, CONNECTION)
        found.add(fields, file.body(start, position))
    connections = found.by_id

    counts = dict.fromkeys(connections, 0)
    located = []
    # Most chunks have the same connections, and share one set.
    sets: dict[frozenset[int], frozenset[int]] = {}
    for _ in range(chunk_count):
        fields, start, position = file.record(position, CHUNK_INFO)
        if (version := uint32_field(fields, "ver")) != 1:
            raise FormatError(f"a chunk info has version {version}, only 1 can be read")
        entries = uint32_field(fields, "count")
        if 8 * entries != position - start:
            raise FormatError(f"a chunk info of {position - start} bytes declares {entries} counts of 8 bytes")
        numbers = struct.unpack(f"<{2 * entries}I", file.body(start, start + 8 * entries))
        for identity, count in zip(numbers[::2], numbers[1::2], strict=True):
            counts[identity] = counts.get(identity, 0) + count
        ids = frozenset(numbers[::2])
        if ids:
            place = uint64_field(fields, "chunk_pos")
            times = (time_field(fields, "start_time"), time_field(fields, "end_time"))
            located.append((place, *times, sets.setdefault(ids, ids)))

    if position < file.size:
        _end_behind_index(file, position)

    segments = []
    placed = [
        replace(_segment(file, place), start_ns=start_ns, end_ns=end_ns, connection_ids=ids)
        for place, start_ns, end_ns, ids in located
    ]
    _refuse_overlaps(placed, file.size)
    for segment in placed:
        # Some recorders write zeros for unknown times: the chunk is read then.
        known = segment if segment.end_ns else _with_times(file, segment)
        if known:
            segments.append(known)
    unlisted = frozenset(counts) - connections.keys()
    _find_connections(file, segments, set(unlisted), found)
    return BagIndex(
        {key: replace(connection, message_count=counts[key]) for key, connection in connections.items()},
        segments,
        unlisted,
    )


def _end_behind_index(file: BagFile, position: int) -> None:
    """Check the bytes after the index; a sound bag has none."""
    from .search import another_bag, record_behind  # noqa: PLC0415  # only damaged bags pay for it

    if (start := another_bag(file, position, file.size)) is not None:
        file.end_at(start)
    if (found := record_behind(file, position)) is not None:
        raise FormatError(f"it continues at byte {found}, after the records that the bag header counts")


def _read_bag_header(file: BagFile) -> tuple[int, int, int]:
    """Read the offset of the index, and its numbers of connections and chunks."""
    first = file.head(len(FIRST_LINE))
    if first != FIRST_LINE:
        if first.startswith((b"#ROSBAG V1", b"#ROSRECORD")):
            raise RecordingError(
                f"begins with {first!r}, only bags of format 2.0 can be read",
                path=file.path,
                hint="rewrite it with ROS 1: rosbag fix OLD.bag NEW.bag",
            )
        raise RecordingError(f"begins with {first!r}, a ROS 1 bag begins with {FIRST_LINE!r}", path=file.path)
    fields, _, _ = file.record(len(FIRST_LINE), BAG_HEADER)
    if encryptor := text_of(fields.get(b"encryptor", b"")):
        raise RecordingError(
            f"is encrypted ({encryptor}), only bags that are not can be read",
            path=file.path,
            hint="decrypt it with ROS 1: rosbag decrypt FILE",
        )
    index_pos = uint64_field(fields, "index_pos")
    if index_pos == 0:
        raise FormatError("there is none, the bag was never closed (index_pos is 0)")
    if index_pos > file.size:
        raise FormatError(f"the index should be at byte {index_pos}, the file has {file.size} bytes")
    return index_pos, uint32_field(fields, "conn_count"), uint32_field(fields, "chunk_count")


def _segment(file: BagFile, chunk_pos: int) -> Segment:
    fields, start, stop = file.record(chunk_pos, CHUNK)
    return chunk_segment(fields, chunk_pos, start, stop)


def chunk_segment(fields: Mapping[bytes, bytes], chunk_pos: int, start: int, stop: int) -> Segment:
    """Make a segment from a chunk's record, without times and connections."""
    compression = text_of(field_of(fields, "compression"))
    if compression not in COMPRESSIONS:
        raise FormatError(
            f"the chunk at byte {chunk_pos} is compressed with {compression!r}, allowed are {', '.join(COMPRESSIONS)}"
        )
    size = uint32_field(fields, "size")
    return Segment(start, stop - start, compression, size, crc=0, start_ns=0, end_ns=0)


def _refuse_overlaps(segments: Sequence[Segment], size: int) -> None:
    """Raise if chunks overlap: otherwise the index of a short file could repeat its chunks without limit."""
    if len({segment.offset for segment in segments}) < len(segments):
        raise FormatError("the index names a chunk twice")
    # One damaged length may reach into the next chunk, but not all lengths.
    if (stored := sum(segment.length for segment in segments)) > 2 * size:
        raise FormatError(f"the chunks have {stored} bytes together, in a bag of {size}")


def contained_span(file: BagFile, segment: Segment) -> tuple[int, int] | None:
    """Read a chunk for the first and the last log time of its messages; None if it has none."""
    records = scan_records(memoryview(payload(file, segment)))
    stamps = [time_field(fields, "time") for fields, _ in records if kind_of(fields) == MESSAGE]
    return (min(stamps), max(stamps)) if stamps else None


def _with_times(file: BagFile, segment: Segment) -> Segment | None:
    """Set a chunk's times by reading it; None if it has no messages."""
    span = contained_span(file, segment)
    return replace(segment, start_ns=span[0], end_ns=span[1]) if span else None


def _find_connections(file: BagFile, segments: Sequence[Segment], missing: set[int], found: Connections) -> None:
    """Find connections in the chunks that have messages and are not in the index."""
    for segment in segments:
        if not missing:
            return
        for fields, body in scan_records(memoryview(payload(file, segment))):
            if kind_of(fields) == CONNECTION and (identity := uint32_field(fields, "conn")) in missing:
                found.add(fields, body)
                missing.discard(identity)
    if missing:
        raise FormatError(f"connection {min(missing)} has messages but is not described")
