"""Recovers the records of a damaged ROS 1 bag without its index, and the messages of a damaged chunk.

Records are read in the order of the file. Behind damage the bag is searched for the next record, at most up to the next
chunk in its index. A bag that was never closed (``.bag.active``) has no index, and is read in the same way. The
beginning of another bag (``cat a.bag b.bag``) ends the first.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.chunks import Salvage, Segment, Segments, times_around
from pc2scan.bags.damage import AnotherRecordingError
from pc2scan.files.salvage import decompressed_prefix
from pc2scan.model import RawMessage

from .index import BagIndex, Connections, chunk_segment, indexed_entries
from .records import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    FIRST_LINE,
    INDEX_DATA,
    MESSAGE,
    UINT32,
    FormatError,
    number_field,
    parse_fields,
    time_field,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pc2scan.bags.damage import DamageLog
    from pc2scan.errors import DamageError
    from pc2scan.model import Connection

    from .records import BagFile

#: Bytes that are searched at a time.
_WINDOW = 1 << 20

#: Limit of a record's header, except for connections with longer topics.
_MAX_HEADER = 4096

#: The beginning of another bag, or the field with the kind of a record that is not inside chunks; the fields before it
#: are few and short.
_BEGINNING = re.compile(re.escape(FIRST_LINE) + rb"|\x04\0\0\0op=[\x03-\x06]")
_REACH = 72

#: The required fields of each kind of record, so that other text is not detected as a record.
_NEEDED = {
    MESSAGE: {b"conn", b"time"},
    INDEX_DATA: {b"ver", b"conn", b"count"},
    CHUNK: {b"compression", b"size"},
    CHUNK_INFO: {b"ver", b"chunk_pos", b"start_time", b"end_time", b"count"},
    CONNECTION: {b"conn", b"topic"},
    BAG_HEADER: {b"index_pos"},
}


class BagRecord(NamedTuple):
    """A record: its fields, and start and stop of its body."""

    fields: dict[bytes, bytes]
    start: int
    stop: int

    @property
    def kind(self) -> int:
        """The kind of the record."""
        return self.fields[b"op"][0]


def record_at(read: Callable[[int, int], bytes], position: int, size: int) -> BagRecord | None:
    """Return the record that begins here, if one does; its body may reach beyond ``size``."""
    if position + 8 > size:
        return None
    (length,) = UINT32.unpack(read(position, 4))
    if not 8 <= length <= _MAX_HEADER or position + 8 + length > size:
        return None
    try:
        fields = parse_fields(read(position + 4, length))
    except FormatError:
        return None
    kind = fields.get(b"op", b"")
    if len(kind) != 1 or not _NEEDED.get(kind[0], {b""}) <= fields.keys():
        return None
    if any(len(fields[name]) != size for name, size in ((b"conn", 4), (b"time", 8), (b"size", 4)) if name in fields):
        return None
    (body,) = UINT32.unpack(read(position + 4 + length, 4))
    start = position + 8 + length
    return BagRecord(fields, start, start + body)


def next_record(file: BagFile, failed: int, end: int, *, since: int | None = None) -> int:
    """Search behind damage for the beginning of a record; ``end`` if there is none.

    The record before it, from ``since`` on, may have taken the beginning of another bag.

    Raises
    ------
    AnotherRecordingError
        If another bag begins before it. One in front of the index is part of a message.
    """
    first = max(failed if since is None else since, _index_place(file), 1)
    start, size = max(0, min(first, failed) - _REACH), _REACH + _MAX_HEADER
    while start < end:
        window = file.read(start, min(size + _REACH, end - start))
        for match in _BEGINNING.finditer(window):
            if match[0] == FIRST_LINE:
                if start + match.start() >= first:
                    raise AnotherRecordingError(start + match.start())
            else:
                # ``op`` is the header's first field, or after ``conn``, ``compression``...
                for back in range(4, _REACH):
                    position = start + match.start() - back
                    record = record_at(file.nearby, position, end) if position > failed else None
                    # A chunk may be cut off by the end of the file; all other records must be whole.
                    if record is not None and (record.stop <= end or record.kind == CHUNK):
                        return position
        start, size = start + size, min(2 * size, _WINDOW)
    return end


def _index_place(file: BagFile) -> int:
    """Return where the bag's own index is; 0 if it is not where the bag header places it."""
    header = record_at(file.nearby, len(FIRST_LINE), file.size)
    with suppress(FormatError):
        place = 0 if header is None else number_field(header.fields, "index_pos", 8)
        index = record_at(file.nearby, place, file.size)
        return place if index is not None and index.kind == CONNECTION else 0
    return 0


def refuse_more(file: BagFile, start: int) -> None:
    """Raise if another bag, or more records, follow the index; a sound bag has none.

    Raises
    ------
    AnotherRecordingError
        If another bag begins there.
    FormatError
        If a record does.
    """
    following = next_record(file, start - 1, file.size)
    if following < file.size:
        raise FormatError(f"it continues at byte {following}, after the records that the bag header counts")


def _indexed_chunks(file: BagFile) -> list[int]:
    """Return where the bag's own index places chunks, as far as chunks are there, in the order of the file."""
    places = []
    position = _index_place(file)
    while position and (record := record_at(file.nearby, position, file.size)) is not None:
        if record.kind == CHUNK_INFO:
            place = int.from_bytes(record.fields[b"chunk_pos"], "little")
            chunk = record_at(file.nearby, place, file.size)
            if chunk is not None and chunk.kind == CHUNK:
                places.append(place)
        position = record.stop
    return sorted(places)


class _Walk(NamedTuple):
    """What a walk over the records of a file finds.

    Attributes
    ----------
    segments
        Chunks without times.
    described
        The records of connections outside chunks.
    gaps
        Where no record is, and why.
    """

    segments: Segments
    described: list[BagRecord]
    gaps: list[tuple[int, int, str]]


def _walk(file: BagFile) -> _Walk:
    """Walk over the records of a file.

    Raises
    ------
    AnotherRecordingError
        If another bag begins behind damage.
    """
    walk, places = _Walk(Segments(), [], []), _indexed_chunks(file)
    header = record_at(file.nearby, len(FIRST_LINE), file.size)
    position, since = len(FIRST_LINE), 0
    if header is not None and header.kind == BAG_HEADER:
        is_followed = record_at(file.nearby, header.stop, file.size) is not None
        position = header.stop if is_followed else next_record(file, header.start, file.size)
    while position < file.size:
        following = bisect_right(places, position)
        limit = places[following] if following < len(places) else file.size
        record = record_at(file.nearby, position, file.size)
        if record is None or record.kind == MESSAGE or (record.stop > limit and record.kind != CHUNK):
            stop = next_record(file, position, limit, since=since)
            walk.gaps.append((position, stop, "no record begins here"))
            position = since = stop
            continue
        stop = record.stop
        if record.kind == INDEX_DATA and record_at(file.nearby, stop, file.size) is None:
            # A real recorder declares 20 bytes for each entry, where there are 12.
            stop = record.start + 12 * number_field(record.fields, "count")
        elif record.kind == CHUNK:
            stop = stop if stop <= limit else next_record(file, record.start, limit)
            try:
                walk.segments.append(chunk_segment(position, record.fields, record.start, stop))
            except FormatError as err:
                walk.gaps.append((position, stop, str(err)))
        elif record.kind == CONNECTION:
            walk.described.append(record)
        since, position = position, stop
    return walk


def recover_index(file: BagFile, problem: DamageError, log: DamageLog) -> BagIndex:
    """Index a bag without its own index; ``problem`` is why that cannot be used.

    Its connections have no counts, because only the bag's own index has them. What chunks say of connections counts.

    Raises
    ------
    AnotherRecordingError
        If another bag begins where something is damaged.
    """
    if log.strict:
        raise problem
    walk = _walk(file)
    connections, segments = Connections(file), Segments()
    for segment in walk.segments:
        timed = _with_times(file, segment, connections)
        if timed is not None:
            segments.append(timed)
        elif segment.offset + segment.length == file.size:
            error = file.damage_error(f"the chunk with data at byte {segment.offset} has no complete message")
            lost = {"bytes_lost": segment.uncompressed_size, **times_around(segments)(segment.offset, segment.offset)}
            log.note(error, offset=segment.offset, **lost)
    for record in walk.described:
        try:
            connections.add(record.fields, file.nearby(record.start, record.stop - record.start))
        except FormatError as err:
            walk.gaps.append((record.start, record.stop, str(err)))
    around = times_around(segments)
    log.note(problem, **around(file.size, file.size))
    for start, stop, what in walk.gaps:
        error = file.damage_error(f"{what} (bytes {start} to {stop})")
        log.note(error, offset=start, bytes_lost=stop - start, **around(start, stop))
    by_id = {key: replace(item, message_count=None) for key, item in sorted(connections.by_id.items())}
    return BagIndex(by_id, segments)


def _with_times(file: BagFile, segment: Segment, connections: Connections) -> Segment | None:
    """Return a segment with times and connections; None if it has no message.

    They are in its index records, but a chunk of unknown connections is read, because it describes these.
    """
    times = {identity: [time for time, _ in entries] for identity, entries in indexed_entries(file, segment)}
    if not times or not times.keys() <= connections.by_id.keys():
        times = times_in(file, segment, connections)
    stamps = [stamp for found in times.values() for stamp in found]
    if not stamps:
        return None
    return replace(segment, start_ns=min(stamps), end_ns=max(*stamps, 1), connection_ids=frozenset(times))


def times_in(file: BagFile, segment: Segment, connections: Connections | None = None) -> dict[int, list[int]]:
    """Read a chunk, sound or damaged, for the log times of its messages by connection.

    ``connections`` gets those that it describes.
    """
    data = memoryview(payload_prefix(file, segment))
    salvage = salvage_of(data, {})
    times: dict[int, list[int]] = {}
    for start, stop in salvage.records(data, (), complete=False):
        if (head := salvage.head_of(start)) is not None:
            times.setdefault(head[0], []).append(head[1])
        elif connections is not None and (record := record_at(_reading(data), start, len(data))) is not None:
            with suppress(FormatError):
                connections.add(record.fields, data[record.start : stop])
    return times


# --- Inside chunks ---


def payload_prefix(file: BagFile, segment: Segment) -> bytes:
    """Read the records of a damaged chunk as far as they can be decompressed."""
    data = file.read(segment.offset, min(segment.length, file.size - segment.offset))
    return decompressed_prefix(data, segment.compression, segment.uncompressed_size)


def _reading(data: memoryview) -> Callable[[int, int], bytes]:
    return lambda offset, length: bytes(data[offset : offset + length])


def salvage_of(data: memoryview, known: Mapping[int, Connection]) -> Salvage:
    """Return how the records of a damaged chunk are read."""
    read, size = _reading(data), len(data)

    def end_of(place: int) -> int | None:
        record = record_at(read, place, size)
        is_inside = record is not None and record.kind in (MESSAGE, CONNECTION) and record.stop <= size
        return record.stop if record is not None and is_inside else None

    def head_of(place: int) -> tuple[int, int] | None:
        record = record_at(read, place, size)
        if record is None or record.kind != MESSAGE:
            return None
        return number_field(record.fields, "conn"), time_field(record.fields, "time")

    def message_at(place: int, stop: int) -> RawMessage:
        record = record_at(read, place, size)
        assert record is not None
        stamp_ns = time_field(record.fields, "time")
        return RawMessage(known[number_field(record.fields, "conn")], stamp_ns, data[record.start : stop], stamp_ns)

    return Salvage(end_of, head_of, message_at)
