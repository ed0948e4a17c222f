"""The index records behind a chunk of a ROS 1 bag, compared with the chunk."""

from __future__ import annotations

import struct
from itertools import permutations
from typing import TYPE_CHECKING

from pc2scan.bags.chunked.entries import EntryForm, entries_astray

from .records import INDEX_DATA, MESSAGE, UINT32, Damaged, kind_of, parsed_fields, uint32_field

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.model import Buffer

    from .records import BagFile

__all__ = ["index_entries", "index_trouble"]

#: Seconds and nanoseconds as they are stored, and the place in the chunk, of one message.
_ENTRY = struct.Struct("<8sI")

_OP = bytes([INDEX_DATA])
_LONGEST_HEADER = 256

#: Bytes that are read at a time.
_AHEAD = 4096

#: Bytes that the fields of a message's header take, with their lengths.
_FIELDS = {b"conn": 13, b"op": 8, b"time": 17}


def _form(order: Sequence[bytes]) -> EntryForm:
    """Of messages whose header has its fields in this order, behind its length; before a value is ``conn=``."""
    at = {name: 4 + 9 + sum(_FIELDS[other] for other in order[: order.index(name)]) for name in order}
    return EntryForm(_ENTRY, UINT32, at[b"conn"], at[b"time"])


_FORMS = {order: _form(order) for order in permutations(_FIELDS)}
_USUAL_FORM = _FORMS[b"conn", b"op", b"time"]


def index_entries(file: BagFile, segment: Segment) -> Iterator[tuple[int, bytes]]:
    """Yield each index record behind a chunk: the connection, and its entries as they are stored.

    May be called on any thread.

    Raises
    ------
    Damaged
        If a record contradicts its own lengths.
    """
    position = segment.offset + segment.length
    origin, ahead = position, b""

    def taken(start: int, length: int) -> bytes:
        nonlocal origin, ahead
        if start + length > origin + len(ahead):
            if start + length > file.size:
                raise Damaged(f"an index record reaches to byte {start + length}, the file has {file.size} bytes")
            origin, ahead = start, file.read(start, min(max(length, _AHEAD), file.size - start))
        return ahead[start - origin : start - origin + length]

    while position + 4 <= file.size:
        (length,) = UINT32.unpack(taken(position, 4))
        # No header of an index record is longer; another record follows the last one.
        if not 0 < length <= _LONGEST_HEADER:
            return
        fields = parsed_fields(taken(position + 4, length))
        if fields.get(b"op") != _OP:
            return
        start = position + 8 + length
        (size,) = UINT32.unpack(taken(start - 4, 4))
        position = start + size
        if uint32_field(fields, "ver") != 1 or _ENTRY.size * uint32_field(fields, "count") != size:
            raise Damaged(f"an index record of {size} bytes contradicts its count")
        yield uint32_field(fields, "conn"), taken(start, size)


def index_trouble(
    file: BagFile, segment: Segment, chunk: Buffer, ids: Collection[int], found: int | None
) -> str | None:
    """How the index records behind a chunk differ from it; None if they do not, or if there are none.

    Records that contradict their own lengths are ignored: a recorder is known that writes such, behind sound chunks.

    Parameters
    ----------
    file, segment
        Where the chunk is.
    chunk
        Its records.
    ids
        The connections that are compared.
    found
        How many messages of these it has; None if they were not all looked for.
    """
    groups: list[tuple[int, bytes]] = []
    # Every record that is looked at takes time: behind those of all connections comes another chunk.
    awaited = set(segment.connection_ids or ())
    try:
        for identity, entries in index_entries(file, segment):
            groups.append((identity, entries))
            awaited.discard(identity)
            if not awaited and segment.connection_ids:
                break
        mine = [(identity, entries) for identity, entries in groups if identity in ids]
        total = sum(len(entries) for _, entries in mine) // _ENTRY.size
        # Most messages have their fields in one order; others are looked at one by one.
        form = _form_of(chunk, mine)
        astray = entries_astray(chunk, mine, form) if form else total
        astray = astray and _astray(memoryview(chunk), mine)
    except Damaged:
        return None
    if astray:
        return f"{astray} of {total} entries are of no message with their connection and time"
    if found is not None and groups and total != found:
        return f"it has entries for {total} messages, the chunk has {found}"
    return None


def _form_of(chunk: Buffer, groups: Sequence[tuple[int, bytes]]) -> EntryForm | None:
    """How the first message of the chunk that an entry is about is written."""
    for _, entries in groups:
        for _, place in _ENTRY.iter_unpack(entries[: _ENTRY.size]):
            if chunk[place + 8 : place + 13] == b"conn=" and chunk[place + 21 : place + 25] == b"op=\x02":
                return _USUAL_FORM
            return _FORMS.get(tuple(_header(memoryview(chunk), place)))
    return None


def _header(chunk: memoryview, place: int) -> dict[bytes, bytes]:
    """The fields of a record in a chunk; none where there is no record."""
    if place + 4 > len(chunk):
        return {}
    (length,) = UINT32.unpack_from(chunk, place)
    try:
        return parsed_fields(chunk[place + 4 : place + 4 + length]) if place + 4 + length <= len(chunk) else {}
    except Damaged:
        return {}


def _astray(chunk: memoryview, groups: Sequence[tuple[int, bytes]]) -> int:
    """Count the entries of no message, or of the message of another one, whatever the order of fields."""
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
