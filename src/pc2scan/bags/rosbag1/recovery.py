"""Recovers the records of a damaged ROS 1 bag without its index, and the messages of a damaged chunk.

Records are read in the order of the file. If no record begins where one should, the file is searched for the next
certain beginning of one. A bag that was never closed (``.bag.active``) has no index either, and is read in the same
way.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from pc2scan.bags.chunked.salvage import SalvagedMessages, clamp_times
from pc2scan.bags.chunked.segments import Segment, times_around
from pc2scan.files.salvage import decompressed_prefix

from .chunks import MessagePlaces, payload
from .index import BagIndex, Connections, chunk_segment
from .records import (
    BAG_HEADER,
    CHUNK,
    CONNECTION,
    FIRST_LINE,
    INDEX_DATA,
    MESSAGE,
    SECOND_NS,
    FormatError,
    kind_of,
    time_field,
    uint32_field,
)
from .search import ANYWHERE, OUTSIDE_CHUNKS, BagRecord, next_record, record_at, refuse_another

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pc2scan.bags.damage import DamageLog
    from pc2scan.errors import DamageError
    from pc2scan.model import Connection

    from .records import BagFile
    from .search import Fields

#: Messages outside chunks, which only damaged bags have, are read in segments of about this size, bytes.
_RUN_SIZE = 4 << 20

# --- The file ---


@dataclass(slots=True)
class _RecoveredRecords:
    """The results of the pass over the file."""

    connections: Connections
    segments: list[Segment] = field(default_factory=list)
    gaps: list[tuple[int, int, str]] = field(default_factory=list)


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
    NextRecordingError
        If another bag begins where something is damaged.
    """
    if log.strict:
        raise problem
    found = _RecoveredRecords(Connections(file))
    position = _next_after_header(file)
    loose = _MessageRun()
    loose_start = position
    # The index records after the last chunk; None if they cannot be used.
    index: _MessageRun | None = None
    previous: tuple[int, BagRecord] | None = None

    def end_run(at: int) -> None:
        nonlocal loose
        if loose.counts:
            size = at - loose_start
            found.segments.append(
                Segment(loose_start, size, "none", size, 0, loose.first_ns, loose.last_ns, frozenset(loose.counts))
            )
        loose = _MessageRun()

    while position < file.size:
        record = record_at(file.nearby, position, file.size)
        whole = record is not None and record.stop <= file.size
        if record is None or not whole:
            end_run(position)
            index = None
            since = position if previous is None else previous[0]
            # The record before it may have a wrong length: it may include others, or be too short.
            if previous is not None and record is None:
                if previous[1].kind != CHUNK:
                    again = next_record(file.nearby, previous[0] + 1, file.size, ANYWHERE, position)
                    if again < position:
                        previous, position = None, again
                        continue
                elif not _is_sound(file, found, previous[1]):
                    position = next_record(file.nearby, previous[1].start, file.size, OUTSIDE_CHUNKS)
                    refuse_another(file, since, position)
                    _set_end(found, previous[1], position)
                    previous = None
                    continue
            if record is not None and record.kind == CHUNK:
                again = next_record(file.nearby, record.start, file.size, OUTSIDE_CHUNKS)
                refuse_another(file, since, again)
                _add_chunk(file, found, position, again)
                previous, position = None, again
                continue
            again = next_record(file.nearby, position + 1, file.size, ANYWHERE)
            refuse_another(file, since, again)
            found.gaps.append((position, again, "no record begins here"))
            previous, position = None, again
            continue
        if record.kind == MESSAGE:
            if not loose.counts or record.stop - loose_start > _RUN_SIZE:
                end_run(position)
                loose_start = position
            loose.add(uint32_field(record.fields, "conn"), time_field(record.fields, "time"))
        else:
            end_run(position)
            if record.kind == INDEX_DATA:
                index = _with_entries(index, file, record)
            else:
                # The index records are complete if another record follows; then the chunk's times are known.
                _set_times(found, index)
                _note_record(file, found, position, record)
                noted = record.kind == CHUNK and found.segments and found.segments[-1].offset == record.start
                index = _MessageRun() if noted else None
        previous, position = (position, record), record.stop
    end_run(file.size)
    _find_times(file, found, log)
    _note(file, found, problem, log)
    connections = {key: replace(item, message_count=None) for key, item in sorted(found.connections.by_id.items())}
    return BagIndex(connections, [segment for segment in found.segments if segment.end_ns])


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
    count = uint32_field(record.fields, "count")
    if index is None or 12 * count != record.stop - record.start or uint32_field(record.fields, "ver") != 1:
        return None
    connection = uint32_field(record.fields, "conn")
    entries = file.nearby(record.start, record.stop - record.start)
    for seconds, nanoseconds, _ in struct.iter_unpack("<III", entries):
        index.add(connection, seconds * SECOND_NS + nanoseconds)
    return index


def _set_times(found: _RecoveredRecords, index: _MessageRun | None) -> None:
    """Set the last chunk's times to those in its index records."""
    if index is not None and index.counts and found.segments and not found.segments[-1].end_ns:
        found.segments[-1] = replace(
            found.segments[-1],
            start_ns=index.first_ns,
            end_ns=max(index.last_ns, 1),
            connection_ids=frozenset(index.counts),
        )


def _add_chunk(file: BagFile, found: _RecoveredRecords, position: int, stop: int) -> None:
    record = record_at(file.nearby, position, file.size)
    assert record is not None
    try:
        found.segments.append(chunk_segment(record.fields, position, record.start, stop))
    except FormatError as err:
        found.gaps.append((position, stop, str(err)))


def _is_sound(file: BagFile, found: _RecoveredRecords, record: BagRecord) -> bool:
    """Whether the last chunk decompresses to its declared size."""
    segment = found.segments[-1] if found.segments else None
    if segment is None or segment.offset != record.start:
        return True
    try:
        return bool(payload(file, segment))
    except FormatError:
        return False


def _set_end(found: _RecoveredRecords, record: BagRecord, stop: int) -> None:
    """Set the end of the last chunk to the next record."""
    if found.segments and found.segments[-1].offset == record.start:
        found.segments[-1] = replace(found.segments[-1], length=stop - record.start)


def _find_times(file: BagFile, found: _RecoveredRecords, log: DamageLog) -> None:
    """Read the chunks whose times are not in index records, or that may describe unknown connections."""
    segments = []
    known = found.connections.by_id
    for segment in found.segments:
        if segment.end_ns and segment.connection_ids is not None and segment.connection_ids <= known.keys():
            segments.append(segment)
            continue
        try:
            data = payload(file, segment)
        except FormatError:
            data = payload_prefix(file, segment)
        stamps = _MessageRun()
        for fields, start, stop, sound in find_records(data):
            if not sound:
                continue
            if kind_of(fields) == MESSAGE:
                stamps.add(uint32_field(fields, "conn"), time_field(fields, "time"))
            elif kind_of(fields) == CONNECTION:
                with suppress(FormatError):
                    found.connections.add(fields, data[start:stop])
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
    data = memoryview(chunk)
    found = MessagePlaces()
    lost = unknown_channel = 0
    for fields, start, stop, sound in find_records(chunk):
        if not sound:
            lost += stop - start
        elif kind_of(fields) == MESSAGE:
            identity = uint32_field(fields, "conn")
            if identity not in known:
                unknown_channel += 1
                continue
            seconds, nanoseconds = divmod(time_field(fields, "time"), SECOND_NS)
            stamp = seconds * SECOND_NS + nanoseconds
            found.add(identity, stamp, start, stop)
    return SalvagedMessages(clamp_times(found.lazy_messages(data, known).as_list(), span), lost, unknown_channel)


def find_records(chunk: bytes) -> Iterator[tuple[Fields, int, int, bool]]:
    """Yield the records of a chunk (fields, and start and stop of the body) and the gaps between them.

    The last value is true for a record.
    """
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
                yield *held[1], True
            held = (position, record)
            position = record.stop
            continue
        begin, following = position, size
        if held is not None:
            following = next_record(read, held[0] + 1, size, inside, position)
            if following < position:
                begin = held[0]
            else:
                yield *held[1], True
                following = size
        held = None
        position = following if begin < position else next_record(read, position + 1, size, inside)
        yield {}, begin, position, False
    if held is not None:
        yield *held[1], True
