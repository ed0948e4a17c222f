"""Recovers the records of a damaged ROS 1 bag without its index, and the records of a damaged chunk.

Records are read in the order of the file. Behind damage, and behind a length that leads to no record, the bag is
searched for the next record. A bag that was never closed (``.bag.active``) has no index, and is read in the same way.
Another bag behind the first (``cat a.bag b.bag``) is not read.
"""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from pc2scan.bags.chunks import Record, Segment, Segments, sound_records, times_around
from pc2scan.bags.reader import ConnectionLimit
from pc2scan.files.compression import decompressed_prefix

from .records import (
    CHUNK,
    CONNECTION,
    FIRST_LINE,
    MESSAGE,
    Connections,
    FormatError,
    chunk_segment,
    indexed_entries,
    number_field,
    part_of,
    read_record,
    time_field,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pc2scan.bags.damage import DamageLog
    from pc2scan.errors import DamageError
    from pc2scan.model import Buffer, Connection

    from .records import BagFile, BagRecord

#: Limit of a record's header, so that a search does not read much for nothing.
_MAX_HEADER = 4096

#: The field with the kind of a record that is not inside chunks; the fields before it are few and short.
_KIND = re.compile(rb"\x04\0\0\0op=[\x03-\x06]")
_REACH = 72


#: A field that a record needs, by its kind, so that neither other text nor a changed kind is detected as a record.
_NEEDED = dict(enumerate((b"time", b"index_pos", b"count", b"size", b"count", b"topic"), MESSAGE))


def _plausible_record(read: Callable[[int, int], Buffer], position: int, size: int) -> BagRecord | None:
    """Return the record that begins here, if one does; its body may reach beyond ``size``."""
    with suppress(FormatError):
        if position + 4 <= size and int.from_bytes(read(position, 4), "little") <= _MAX_HEADER:
            record = read_record(read, position, size)
            return record if _NEEDED.get(record.kind) in record.fields else None
    return None


def _next_record(file: BagFile, failed: int) -> int:
    """Search behind damage for the beginning of a record; the end of the file if there is none."""
    for match in file.search(_KIND, failed + 1, file.size, _REACH):
        # ``op`` is the header's first field, or after ``conn``, ``compression``...
        for position in range(match - 4, max(failed, match - _REACH), -1):
            record = _plausible_record(file.nearby, position, file.size)
            # A chunk may be cut off by the end of the file; all other records must be whole.
            if record is not None and (record.stop <= file.size or record.kind == CHUNK):
                return position
    return file.size


def _records(file: BagFile, gaps: list[tuple[int, int, str]]) -> Iterator[tuple[int, BagRecord]]:
    """Yield the records outside chunks, and where they begin; ``gaps`` gets where no record is, and why."""
    # Each is looked at as the one behind another, too.
    record_from = lru_cache(maxsize=1)(lambda place: _plausible_record(file.nearby, place, file.size))
    position = len(FIRST_LINE)
    while position < file.size:
        record = record_from(position)
        if record is None or record.kind == MESSAGE:
            stop, what = _next_record(file, position), "no record begins here"
            if file.read(position, min(len(FIRST_LINE), file.size - position)) == FIRST_LINE:
                stop, what = file.size, "the recording ends here: what follows is not read"
            gaps.append((position, stop, what))
        else:
            stop = record.stop
            if stop != file.size and record_from(stop) is None:
                # Its length is too large, as that of a real recorder's index records: 20 bytes an entry, of 12.
                stop = min(stop, _next_record(file, record.start))
            yield position, record._replace(stop=stop)
        position = stop


def recover_index(file: BagFile, problem: DamageError, log: DamageLog) -> tuple[dict[int, Connection], Segments]:
    """Index a bag without its own index; ``problem`` is why that cannot be used.

    Its connections have no counts, because only the bag's own index has them. What chunks say of connections counts.
    """
    if log.strict:
        raise problem
    connections, segments = Connections(ConnectionLimit(file.path, file.size)), Segments()
    described: list[BagRecord] = []
    gaps: list[tuple[int, int, str]] = []
    for position, record in _records(file, gaps):
        try:
            if record.kind == CONNECTION:
                described.append(record)
            elif record.kind == CHUNK:
                segment = chunk_segment(position, record)
                if timed := _with_times(file, segment, connections):
                    segments.append(timed)
                elif record.stop == file.size:
                    gaps.append((position, record.stop, "the chunk has no complete message"))
        except FormatError as err:
            gaps.append((position, record.stop, str(err)))
    for record in described:
        with suppress(FormatError):
            connections.add(record.fields, file.nearby(record.start, record.stop - record.start))
    around = times_around(segments)
    log.note(problem, **around(file.size, file.size))
    for start, stop, what in gaps:
        error = file.damage_error(f"{what} (bytes {start} to {stop})")
        log.note(error, offset=start, bytes_lost=stop - start, **around(start, stop))
    return {key: replace(item, message_count=None) for key, item in sorted(connections.by_id.items())}, segments


def _with_times(file: BagFile, segment: Segment, connections: Connections) -> Segment | None:
    """Return a segment with times and connections; None if it has no message.

    They are in its index records, but a chunk of unknown connections is read, because it describes these.
    """
    times = {identity: [time for time, _ in entries] for identity, entries in indexed_entries(file, segment)}
    if not times or not times.keys() <= connections.by_id.keys():
        times = times_in(file, segment, connections)
    stamps = [stamp for own in times.values() for stamp in own]
    if not stamps:
        return None
    return replace(segment, start_ns=min(stamps), end_ns=max(*stamps, 1), connection_ids=frozenset(times))


# --- Inside chunks ---


def times_in(file: BagFile, segment: Segment, connections: Connections | None = None) -> dict[int, list[int]]:
    """Read a chunk, sound or damaged, for the log times of its messages by connection.

    ``connections`` gets those that it describes.
    """
    data = payload_prefix(file, segment)
    times: dict[int, list[int]] = {}
    for place, stop, record in sound_records(data, record_at):
        if record.connection_id is not None:
            times.setdefault(record.connection_id, []).append(record.log_time_ns)
        elif connections is not None:
            with suppress(FormatError):
                connections.add(read_record(partial(part_of, data), place, len(data)).fields, data[record.start : stop])
    return times


def payload_prefix(file: BagFile, segment: Segment) -> memoryview:
    """Read the records of a damaged chunk as far as they can be decompressed."""
    data = file.read(segment.offset, min(segment.length, file.size - segment.offset))
    return memoryview(decompressed_prefix(data, segment.compression, segment.uncompressed_size))


def record_at(data: memoryview, place: int) -> Record | None:
    """Return the record that begins at a place of a damaged chunk; None if none does."""
    record = _plausible_record(partial(part_of, data), place, len(data))
    with suppress(FormatError):
        if record is not None and record.kind == CONNECTION:
            return Record(record.stop, record.start)
        if record is not None and record.kind == MESSAGE:
            time_ns = time_field(record.fields, "time")
            return Record(record.stop, record.start, number_field(record.fields, "conn"), time_ns, time_ns)
    return None
