"""Counts the messages of a ROS 1 bag, and finds their times, in the index records after the chunks."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from .records import INDEX_DATA, SECOND_NS, Damaged, uint32_field

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from pc2scan.bags.chunked.segments import Segment

    from .records import BagFile

#: Seconds, nanoseconds and the place in the chunk of one message.
_ENTRY = struct.Struct("<III")


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
    except Damaged:
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
    except Damaged:
        return None
    return (min(found), max(found)) if found else None


def _times(file: BagFile, fields: Mapping[bytes, bytes], start: int, stop: int) -> Iterator[int]:
    """Yield the log times of an index record's messages."""
    if uint32_field(fields, "ver") != 1 or _ENTRY.size * uint32_field(fields, "count") != stop - start:
        raise Damaged(f"an index record of {stop - start} bytes contradicts its count")
    for seconds, nanoseconds, _ in _ENTRY.iter_unpack(file.body(start, stop)):
        yield seconds * SECOND_NS + nanoseconds
