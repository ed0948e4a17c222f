"""Counts the messages of an MCAP file, and finds their times, in the message indexes after the chunks."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from pc2scan.errors import DamageError

from .chunks import ChunkSegment
from .entries import index_entries

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from pc2scan.bags.chunked.segments import Segment

    from .records import RecordFile

#: Log time and place in the chunk of one message.
_ENTRY = struct.Struct("<QQ")


def counts_between(
    file: RecordFile, segments: Iterable[Segment], ids: frozenset[int], start_ns: int | None, stop_ns: int | None
) -> dict[int, int]:
    """Count the messages of these channels with ``start_ns <= log_time_ns < stop_ns``.

    Returns
    -------
    dict[int, int]
        By channel id; empty if the message indexes do not have all of them.
    """
    counts = dict.fromkeys(ids, 0)
    low, high = start_ns or 0, stop_ns
    try:
        for segment in segments:
            if not segment.may_hold(ids, start_ns, stop_ns):
                continue
            if not isinstance(segment, ChunkSegment) or segment.connection_ids is None:
                return {}
            missing = set(segment.connection_ids & ids)
            for channel_id, times in _indexed(file, segment):
                if channel_id in ids:
                    missing.discard(channel_id)
                    counts[channel_id] += sum(low <= time and (high is None or time < high) for time in times)
            if missing:
                return {}
    except DamageError:
        return {}
    return counts


def indexed_span(file: RecordFile, segment: ChunkSegment) -> tuple[int, int] | None:
    """Return the first and the last log time of a chunk's messages; None if the indexes do not have all of them."""
    missing = set(segment.connection_ids or ())
    found: list[int] = []
    try:
        for channel_id, times in _indexed(file, segment):
            missing.discard(channel_id)
            found += times
    except DamageError:
        return None
    return (min(found), max(found)) if found and not missing else None


def _indexed(file: RecordFile, segment: ChunkSegment) -> Iterator[tuple[int, Iterator[int]]]:
    """Yield each message index after a chunk: the channel, and the log times of its messages."""
    for channel_id, entries in index_entries(file, segment):
        yield channel_id, (time_ns for time_ns, _ in _ENTRY.iter_unpack(entries))
