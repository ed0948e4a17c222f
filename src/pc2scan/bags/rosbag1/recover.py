"""Recovers the records of a damaged ROS 1 bag without its index, and the messages of a damaged chunk.

Records are read in the order of the file. If no record begins where one should, the file is searched for the next
certain beginning of one. A bag that was never closed (``.bag.active``) has no index either, and is read in the same
way. The beginning of another bag (``cat a.bag b.bag``) ends the first.
"""

from __future__ import annotations

import re
import struct
from array import array
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.chunks import Segment, Segments, times_around
from pc2scan.bags.damage import AnotherRecordingError
from pc2scan.bags.loading import LazyItems
from pc2scan.bags.salvage import SalvagedMessages, clamp_times
from pc2scan.files.salvage import decompressed_prefix

from .index import BagIndex, Connections, chunk_segment
from .records import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    FIRST_LINE,
    INDEX_DATA,
    MESSAGE,
    SECOND_NS,
    UINT32,
    FormatError,
    borrow_payload,
    message_at,
    number_field,
    parse_fields,
    time_field,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pc2scan.bags.damage import DamageLog
    from pc2scan.errors import DamageError
    from pc2scan.model import Connection

    from .records import BagFile

# --- Search ---

#: Bytes that are searched at a time.
_WINDOW = 1 << 20

#: Limit of a record's header, except for connections with longer topics.
_MAX_HEADER = 4096

# The field with the kind of a record; the fields before it are few and short.
_OP = re.compile(rb"\x04\0\0\0op=[\x02-\x07]")
_REACH = 72

ANYWHERE = frozenset({MESSAGE, INDEX_DATA, CHUNK, CHUNK_INFO, CONNECTION})
#: Records that cannot be in a chunk.
OUTSIDE_CHUNKS = frozenset({INDEX_DATA, CHUNK, CHUNK_INFO})

#: The required fields of each kind of record, so that other text is not detected as a record.
_NEEDED = {
    MESSAGE: {b"conn", b"time"},
    INDEX_DATA: {b"ver", b"conn", b"count"},
    CHUNK: {b"compression", b"size"},
    CHUNK_INFO: {b"ver", b"chunk_pos", b"start_time", b"end_time", b"count"},
    CONNECTION: {b"conn", b"topic"},
    BAG_HEADER: {b"index_pos"},
}

Fields = dict[bytes, bytes]


class BagRecord(NamedTuple):
    """A record: its fields, and start and stop of its body."""

    fields: Fields
    start: int
    stop: int

    @property
    def kind(self) -> int:
        """The kind of the record."""
        return self.fields[b"op"][0]


def _are_complete(fields: Fields) -> bool:
    kind = fields.get(b"op", b"")
    if len(kind) != 1 or not _NEEDED.get(kind[0], {b""}) <= fields.keys():
        return False
    return all(len(fields[name]) == size for name, size in ((b"conn", 4), (b"time", 8), (b"size", 4)) if name in fields)


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
    if not _are_complete(fields):
        return None
    (body,) = UINT32.unpack(read(position + 4 + length, 4))
    start = position + 8 + length
    return BagRecord(fields, start, start + body)


def _record_in(window: bytes, op_at: int) -> int | None:
    """Return the beginning of the record whose ``op`` field is here."""
    # The usual places first: ``op`` is the header's first field, or after ``conn``, ``compression``...
    for start in range(op_at - 4, max(-1, op_at - _REACH), -1):
        (length,) = struct.unpack_from("<I", window, start)
        if op_at - start + 5 <= length + 4 <= _MAX_HEADER and start + 8 + length <= len(window):
            try:
                fields = parse_fields(window[start + 4 : start + 4 + length])
            except FormatError:
                continue
            if _are_complete(fields):
                return start
    return None


def next_record(
    read: Callable[[int, int], bytes], start: int, size: int, kinds: frozenset[int], limit: int | None = None
) -> int:
    """Search, before ``limit``, for the beginning of a record; ``size`` if there is none."""
    stop = size if limit is None else min(size, limit + _REACH)
    begin = start
    while begin < stop:
        window = read(begin, min(_WINDOW, size - begin))
        for match in _OP.finditer(window):
            if match[0][-1] not in kinds:
                continue
            found = _record_in(window, match.start())
            if found is not None and begin + found >= start:
                position = begin + found
                if limit is not None and position >= limit:
                    return size
                record = record_at(read, position, size)
                # A chunk may be cut off by the end of the file; all other records must be whole.
                if record is not None and (record.stop <= size or record.kind == CHUNK):
                    return position
        if begin + len(window) >= size:
            break
        begin += len(window) - _MAX_HEADER - _REACH
    return size


def _index_place(file: BagFile) -> int:
    """Return where the bag's own index is; 0 if it is not where the bag header places it."""
    header = record_at(file.nearby, len(FIRST_LINE), file.size)
    with suppress(FormatError):
        place = 0 if header is None else number_field(header.fields, "index_pos", 8)
        index = record_at(file.nearby, place, file.size)
        return place if index is not None and index.kind == CONNECTION else 0
    return 0


def refuse_another(file: BagFile, start: int, stop: int) -> None:
    """Raise if another bag begins in this part of the file: its first line, and its header.

    A bag in front of the index is part of a message.
    """
    overlap = len(FIRST_LINE) - 1
    for begin in range(max(start, _index_place(file)), stop, _WINDOW):
        window = file.read(begin, min(_WINDOW + overlap, file.size - begin))
        at = window.find(FIRST_LINE)
        while at >= 0:
            record = record_at(file.nearby, begin + at + len(FIRST_LINE), file.size)
            if begin + at > 0 and record is not None and record.kind == BAG_HEADER:
                raise AnotherRecordingError(begin + at)
            at = window.find(FIRST_LINE, at + 1)


def refuse_more(file: BagFile, start: int) -> None:
    """Raise if another bag, or more records, follow the index; a sound bag has none.

    Raises
    ------
    AnotherRecordingError
        If another bag begins there.
    FormatError
        If a record does.
    """
    refuse_another(file, start, file.size)
    found = next_record(file.nearby, start, file.size, ANYWHERE)
    if found < file.size:
        raise FormatError(f"it continues at byte {found}, after the records that the bag header counts")


# --- The file ---

#: Messages outside chunks, which only damaged bags have, are read in segments of about this size, bytes.
_RUN_SIZE = 4 << 20


class _MessageRun:
    """The log times and connections of consecutive messages."""

    def __init__(self) -> None:
        self.first_ns = self.last_ns = 0
        self.counts: dict[int, int] = {}

    def add(self, connection: int, stamp_ns: int) -> None:
        if not self.counts:
            self.first_ns = self.last_ns = stamp_ns
        self.first_ns, self.last_ns = min(self.first_ns, stamp_ns), max(self.last_ns, stamp_ns)
        self.counts[connection] = self.counts.get(connection, 0) + 1


@dataclass(slots=True)
class _RecoveredRecords:
    """The results of the pass over the file, and the messages outside chunks that it is among."""

    connections: Connections
    segments: Segments = field(default_factory=Segments)
    gaps: list[tuple[int, int, str]] = field(default_factory=list)
    loose: _MessageRun = field(default_factory=_MessageRun)
    loose_start: int = 0

    def add_message(self, position: int, record: BagRecord) -> None:
        """Add a message outside chunks."""
        if not self.loose.counts or record.stop - self.loose_start > _RUN_SIZE:
            self.end_run(position)
            self.loose_start = position
        self.loose.add(number_field(record.fields, "conn"), time_field(record.fields, "time"))

    def ends_with(self, record: BagRecord) -> bool:
        """Whether the last segment is the chunk of this record."""
        return bool(self.segments) and self.segments[-1].offset == record.start

    def end_run(self, position: int) -> None:
        """Make a segment of the messages outside chunks, if there are any, that end here."""
        run = self.loose
        if run.counts:
            size = position - self.loose_start
            ids = frozenset(run.counts)
            self.segments.append(Segment(self.loose_start, size, size, run.first_ns, run.last_ns, connection_ids=ids))
            self.loose = _MessageRun()


def recover_index(file: BagFile, problem: DamageError, log: DamageLog) -> BagIndex:
    """Index a bag without its own index.

    Parameters
    ----------
    file
        The open file.
    problem
        Why its own index cannot be used.
    log
        Gets this, and all bytes that belong to no record.

    Returns
    -------
    BagIndex
        Its connections have no counts, because only the bag's own index has them.

    Raises
    ------
    AnotherRecordingError
        If another bag begins where something is damaged.
    """
    if log.strict:
        raise problem
    found = _RecoveredRecords(Connections(file))
    position = _next_after_header(file)
    # The index records after the last chunk; None if they cannot be used.
    index: _MessageRun | None = None
    previous: tuple[int, BagRecord] | None = None
    while position < file.size:
        record = record_at(file.nearby, position, file.size)
        if record is None or record.stop > file.size:
            found.end_run(position)
            position = _next_after_damage(file, found, position, record, previous)
            index = previous = None
            continue
        if record.kind == MESSAGE:
            found.add_message(position, record)
        else:
            found.end_run(position)
            if record.kind == INDEX_DATA:
                index = _with_entries(index, file, record)
            else:
                # The index records are complete if another record follows; then the chunk's times are known.
                _set_times(found, index)
                _note_record(file, found, position, record)
                noted = record.kind == CHUNK and found.ends_with(record)
                index = _MessageRun() if noted else None
        previous, position = (position, record), record.stop
    found.end_run(file.size)
    _find_times(file, found, log)
    _note(file, found, problem, log)
    connections = {key: replace(item, message_count=None) for key, item in sorted(found.connections.by_id.items())}
    return BagIndex(connections, found.segments.select(found.segments.rows["end_ns"] > 0))


def _next_after_damage(
    file: BagFile,
    found: _RecoveredRecords,
    position: int,
    record: BagRecord | None,
    previous: tuple[int, BagRecord] | None,
) -> int:
    """Return where to continue if no whole record is at a position.

    Parameters
    ----------
    found
        Gets a chunk that is cut off, or the gap.
    position, record
        The place; the record that begins there and reaches beyond the file, or None if none begins there.
    previous
        The place of the record before it, and that record; None if it is unknown.
    """
    since = position if previous is None else previous[0]
    # The record before it may have a wrong length: it may include others, or be too short.
    if previous is not None and record is None:
        if previous[1].kind != CHUNK:
            again = next_record(file.nearby, previous[0] + 1, file.size, ANYWHERE, position)
            if again < position:
                return again
        elif not _is_sound(file, found, previous[1]):
            again = next_record(file.nearby, previous[1].start, file.size, OUTSIDE_CHUNKS)
            refuse_another(file, since, again)
            _set_end(found, previous[1], again)
            return again
    if record is not None and record.kind == CHUNK:
        again = next_record(file.nearby, record.start, file.size, OUTSIDE_CHUNKS)
        refuse_another(file, since, again)
        _add_chunk(file, found, position, again)
        return again
    again = next_record(file.nearby, position + 1, file.size, ANYWHERE)
    refuse_another(file, since, again)
    found.gaps.append((position, again, "no record begins here"))
    return again


def _next_after_header(file: BagFile) -> int:
    """Return the offset of the first record after the bag header."""
    header = record_at(file.nearby, len(FIRST_LINE), file.size)
    if header is not None and header.kind == BAG_HEADER and header.stop <= file.size:
        return header.stop
    return next_record(file.nearby, len(FIRST_LINE), file.size, ANYWHERE)


def _note_record(file: BagFile, found: _RecoveredRecords, position: int, record: BagRecord) -> None:
    if record.kind == CHUNK:
        _add_chunk(file, found, position, record.stop)
    elif record.kind == CONNECTION:
        try:
            found.connections.add(record.fields, file.nearby(record.start, record.stop - record.start))
        except FormatError as err:
            found.gaps.append((position, record.stop, str(err)))


def _with_entries(index: _MessageRun | None, file: BagFile, record: BagRecord) -> _MessageRun | None:
    """Add the entries of an index record: times and places of a connection's messages, 12 bytes each."""
    count = number_field(record.fields, "count")
    if index is None or 12 * count != record.stop - record.start or number_field(record.fields, "ver") != 1:
        return None
    connection = number_field(record.fields, "conn")
    entries = file.nearby(record.start, record.stop - record.start)
    for seconds, nanoseconds, _ in struct.iter_unpack("<III", entries):
        index.add(connection, seconds * SECOND_NS + nanoseconds)
    return index


def _set_times(found: _RecoveredRecords, index: _MessageRun | None) -> None:
    """Set the last chunk's times to those in its index records."""
    if index is not None and index.counts and found.segments:
        chunk = found.segments.pop()
        if not chunk.end_ns:
            chunk.start_ns, chunk.end_ns = index.first_ns, max(index.last_ns, 1)
            chunk.connection_ids = frozenset(index.counts)
        found.segments.append(chunk)


def _add_chunk(file: BagFile, found: _RecoveredRecords, position: int, stop: int) -> None:
    record = record_at(file.nearby, position, file.size)
    assert record is not None
    try:
        found.segments.append(chunk_segment(position, record.fields, record.start, stop))
    except FormatError as err:
        found.gaps.append((position, stop, str(err)))


def _is_sound(file: BagFile, found: _RecoveredRecords, record: BagRecord) -> bool:
    """Whether the last chunk decompresses to its declared size."""
    if not found.ends_with(record):
        return True
    try:
        return bool(len(borrow_payload(file, found.segments[-1])))
    except FormatError:
        return False


def _set_end(found: _RecoveredRecords, record: BagRecord, stop: int) -> None:
    """Set the end of the last chunk to the next record."""
    if found.ends_with(record):
        found.segments.append(replace(found.segments.pop(), length=stop - record.start))


def _find_times(file: BagFile, found: _RecoveredRecords, log: DamageLog) -> None:
    """Read the chunks whose times are not in index records, or that may describe unknown connections."""
    segments = Segments()
    known = found.connections.by_id
    for segment in found.segments:
        if segment.end_ns and segment.connection_ids is not None and segment.connection_ids <= known.keys():
            segments.append(segment)
            continue
        try:
            data = bytes(borrow_payload(file, segment))
        except FormatError:
            data = payload_prefix(file, segment)
        stamps = _MessageRun()
        for _, record in find_records(data):
            if not record.fields:
                continue
            if record.kind == MESSAGE:
                stamps.add(number_field(record.fields, "conn"), time_field(record.fields, "time"))
            elif record.kind == CONNECTION:
                with suppress(FormatError):
                    found.connections.add(record.fields, data[record.start : record.stop])
        if stamps.counts:
            segments.append(
                replace(
                    segment,
                    start_ns=stamps.first_ns,
                    end_ns=max(stamps.last_ns, 1),
                    connection_ids=frozenset(stamps.counts),
                )
            )
        elif len(data) != segment.uncompressed_size:
            log.note(
                file.damage_error(f"the chunk with data at byte {segment.offset} has no complete message"),
                offset=segment.offset,
                bytes_lost=segment.uncompressed_size,
                **times_around(segments)(segment.offset, segment.offset),
            )
    found.segments = segments


def _note(file: BagFile, found: _RecoveredRecords, problem: DamageError, log: DamageLog) -> None:
    around = times_around(found.segments)
    log.note(problem, **around(file.size, file.size))
    for start, stop, what in found.gaps:
        error = file.damage_error(f"{what} (bytes {start} to {stop})")
        log.note(error, offset=start, bytes_lost=stop - start, **around(start, stop))


# --- Inside chunks ---


def payload_prefix(file: BagFile, segment: Segment) -> bytes:
    """Read the records of a damaged chunk as far as they can be decompressed."""
    data = file.read(segment.offset, min(segment.length, file.size - segment.offset))
    return decompressed_prefix(data, segment.compression, segment.uncompressed_size)


def salvage_messages(chunk: bytes, known: Mapping[int, Connection], span: tuple[int, int]) -> SalvagedMessages:
    """Find the messages of a damaged chunk.

    Parameters
    ----------
    chunk
        Its records, as far as they could be decompressed.
    known
        Every connection.
    span
        The first and the last log time of the chunk in the index; see `clamp_times`.
    """
    times, places = array("Q"), array("Q")
    lost = unknown_channel = 0
    for place, record in find_records(chunk):
        if not record.fields:
            lost += record.stop - record.start
        elif record.kind == MESSAGE:
            if number_field(record.fields, "conn") not in known:
                unknown_channel += 1
                continue
            times.append(time_field(record.fields, "time"))
            places.append(place)
    messages = LazyItems(times, places, partial(message_at, memoryview(chunk), known), len(chunk)).as_list()
    return SalvagedMessages(clamp_times(messages, span), lost, unknown_channel)


def find_records(chunk: bytes) -> Iterator[tuple[int, BagRecord]]:
    """Yield the records of a chunk with their places, and the gaps between them as records without fields."""
    inside = frozenset({MESSAGE, CONNECTION})

    def read(offset: int, length: int) -> bytes:
        return chunk[offset : offset + length]

    size = len(chunk)
    position = 0
    # A record is kept back until the next one begins at its end: its length may be damaged.
    held: tuple[int, BagRecord] | None = None
    while position < size:
        record = record_at(read, position, size)
        if record is not None and record.stop <= size and record.kind in inside:
            if held is not None:
                yield held
            held = (position, record)
            position = record.stop
            continue
        begin, following = position, size
        if held is not None:
            following = next_record(read, held[0] + 1, size, inside, position)
            if following < position:
                begin = held[0]
            else:
                yield held
                following = size
        held = None
        position = following if begin < position else next_record(read, position + 1, size, inside)
        yield begin, BagRecord({}, begin, position)
    if held is not None:
        yield held
