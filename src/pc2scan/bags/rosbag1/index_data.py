"""Reads the INDEX DATA records after a chunk of a ROS 1 bag: compares them with the chunk, counts messages by them."""

from __future__ import annotations

import struct
from itertools import permutations
from typing import TYPE_CHECKING

from pc2scan.bags.chunked.index_checks import EntryForm, IndexCheck, count_wrong_entries

from .records import INDEX_DATA, MESSAGE, SECOND_NS, UINT32, FormatError, kind_of, parse_fields, uint32_field

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.model import Buffer

    from .records import BagFile

#: The stored seconds and nanoseconds of one message, and its place in the chunk.
_ENTRY = struct.Struct("<8sI")

_OP = bytes([INDEX_DATA])
_LONGEST_HEADER = 256

#: Bytes that are read at a time.
_AHEAD = 4096

#: Sizes of the fields of a message's header, with their lengths, bytes.
_FIELDS = {b"conn": 13, b"op": 8, b"time": 17}


def _entry_form(order: Sequence[bytes]) -> EntryForm:
    """Return the form for messages whose header has its fields in this order."""
    at = {name: 4 + 9 + sum(_FIELDS[other] for other in order[: order.index(name)]) for name in order}
    return EntryForm(_ENTRY, UINT32, at[b"conn"], at[b"time"])


_FORMS = {order: _entry_form(order) for order in permutations(_FIELDS)}
_USUAL_FORM = _FORMS[b"conn", b"op", b"time"]


def index_entries(file: BagFile, segment: Segment) -> Iterator[tuple[int, bytes]]:
    """Yield each index record after a chunk: the connection, and its stored entries.

    May be called on any thread.

    Raises
    ------
    FormatError
        If a record contradicts its own lengths.
    """
    position = segment.offset + segment.length
    origin, ahead = position, b""

    def taken(start: int, length: int) -> bytes:
        nonlocal origin, ahead
        if start + length > origin + len(ahead):
            if start + length > file.size:
                raise FormatError(f"an index record reaches to byte {start + length}, the file has {file.size} bytes")
            origin, ahead = start, file.read(start, min(max(length, _AHEAD), file.size - start))
        return ahead[start - origin : start - origin + length]

    while position + 4 <= file.size:
        (length,) = UINT32.unpack(taken(position, 4))
        # Index records have no longer header: this is another record.
        if not 0 < length <= _LONGEST_HEADER:
            return
        fields = parse_fields(taken(position + 4, length))
        if fields.get(b"op") != _OP:
            return
        start = position + 8 + length
        (size,) = UINT32.unpack(taken(start - 4, 4))
        position = start + size
        if uint32_field(fields, "ver") != 1 or _ENTRY.size * uint32_field(fields, "count") != size:
            raise FormatError(f"an index record of {size} bytes contradicts its count")
        yield uint32_field(fields, "conn"), taken(start, size)


def index_check(file: BagFile, segment: Segment, chunk: Buffer, ids: Collection[int]) -> IndexCheck:
    """Compare the index records after a chunk with it.

    Records that contradict their own lengths are ignored: a known recorder writes them after sound chunks.

    Parameters
    ----------
    file, segment
        The chunk.
    chunk
        Its records.
    ids
        The connections to compare.
    """
    groups: list[tuple[int, bytes]] = []
    # To save time, no further records are read after those of all connections.
    awaited = set(segment.connection_ids or ())
    try:
        for identity, entries in index_entries(file, segment):
            groups.append((identity, entries))
            awaited.discard(identity)
            if not awaited and segment.connection_ids:
                break
        mine = [(identity, entries) for identity, entries in groups if identity in ids]
        total = sum(len(entries) for _, entries in mine) // _ENTRY.size
        # If the fields are not all in one order, entries are compared one by one.
        form = _form_of(chunk, mine)
        astray = count_wrong_entries(chunk, mine, form) if form else total
        astray = astray and _count_wrong_entries(memoryview(chunk), mine)
    except FormatError:
        return IndexCheck()
    problem = f"{astray} of {total} entries match no message by their connection and time" if astray else None
    return IndexCheck(problem, total if groups else None, astray)


def _form_of(chunk: Buffer, groups: Sequence[tuple[int, bytes]]) -> EntryForm | None:
    """Return the form of the first message with an entry."""
    for _, entries in groups:
        for _, place in _ENTRY.iter_unpack(entries[: _ENTRY.size]):
            if chunk[place + 8 : place + 13] == b"conn=" and chunk[place + 21 : place + 25] == b"op=\x02":
                return _USUAL_FORM
            return _FORMS.get(tuple(_header(memoryview(chunk), place)))
    return None


def _header(chunk: memoryview, place: int) -> dict[bytes, bytes]:
    """Return the fields of a record in a chunk; none if there is no record."""
    if place + 4 > len(chunk):
        return {}
    (length,) = UINT32.unpack_from(chunk, place)
    try:
        return parse_fields(chunk[place + 4 : place + 4 + length]) if place + 4 + length <= len(chunk) else {}
    except FormatError:
        return {}


def _count_wrong_entries(chunk: memoryview, groups: Sequence[tuple[int, bytes]]) -> int:
    """Count the wrong entries as `count_wrong_entries` does, for any order of fields."""
    astray = 0
    seen = set()
    for identity, entries in groups:
        own = UINT32.pack(identity)
        for time, place in _ENTRY.iter_unpack(entries):
            fields = _header(chunk, place)
            there = fields.get(b"conn") == own and fields.get(b"time") == time and kind_of(fields) == MESSAGE
            astray += not there or place in seen
            seen.add(place)
    return astray


#: Seconds, nanoseconds and the place in the chunk of one message.
_TIMED_ENTRY = struct.Struct("<III")


def counts_between(
    file: BagFile, segments: Iterable[Segment], ids: frozenset[int], start_ns: int | None, stop_ns: int | None
) -> dict[int, int]:
    """Count the messages of these connections with ``start_ns <= log_time_ns < stop_ns``.

    Returns
    -------
    dict[int, int]
        By connection id; empty if the index does not have all of them.
    """
    counts = dict.fromkeys(ids, 0)
    low, high = start_ns or 0, stop_ns
    read = 0
    try:
        for segment in segments:
            if not segment.may_hold(ids, start_ns, stop_ns):
                continue
            if segment.connection_ids is None:
                return {}
            missing = set(segment.connection_ids & ids)
            position = segment.offset + segment.length
            while missing:
                origin = position
                fields, start, position = file.record(origin, INDEX_DATA)
                read += position - origin
                # Chunks of a hostile bag may share their index records, which would take quadratic time.
                if read > file.size:
                    return {}
                identity = uint32_field(fields, "conn")
                if identity in missing:
                    missing.discard(identity)
                    times = _times(file, fields, start, position)
                    counts[identity] += sum(low <= time and (high is None or time < high) for time in times)
    except FormatError:
        return {}
    return counts


def indexed_span(file: BagFile, segment: Segment) -> tuple[int, int] | None:
    """Return the first and the last log time of a chunk's messages; None if the records do not have all of them."""
    missing = set(segment.connection_ids or ())
    position = segment.offset + segment.length
    found: list[int] = []
    try:
        while missing:
            fields, start, position = file.record(position, INDEX_DATA)
            missing.discard(uint32_field(fields, "conn"))
            found += _times(file, fields, start, position)
    except FormatError:
        return None
    return (min(found), max(found)) if found else None


def _times(file: BagFile, fields: Mapping[bytes, bytes], start: int, stop: int) -> Iterator[int]:
    """Yield the log times of an index record's messages."""
    if uint32_field(fields, "ver") != 1 or _TIMED_ENTRY.size * uint32_field(fields, "count") != stop - start:
        raise FormatError(f"an index record of {stop - start} bytes contradicts its count")
    for seconds, nanoseconds, _ in _TIMED_ENTRY.iter_unpack(file.body(start, stop)):
        yield seconds * SECOND_NS + nanoseconds
