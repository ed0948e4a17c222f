"""Reads the message indexes after a chunk of an MCAP file: compares them with the chunk, counts messages by them."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from pc2scan.bags.chunked.index_checks import EntryForm, IndexCheck, count_wrong_entries
from pc2scan.errors import DamageError

from .chunks import ChunkSegment
from .records import OP_MESSAGE_INDEX, RECORD, Opcode

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator

    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.model import Buffer

    from .records import RecordFile

#: A message index up to its entries: opcode and length, the channel, and how many bytes of entries follow.
_HEAD = struct.Struct("<BQHI")

#: An entry is a message's stored log time and its place in the chunk. A message has its channel after opcode and
#: length, then a sequence number, then the log time.
_FORM = EntryForm(struct.Struct("<8sQ"), struct.Struct("<H"), RECORD.size, RECORD.size + 2 + 4)

#: Bytes that are read at a time if their number is unknown.
_AHEAD = 4096


def index_entries(file: RecordFile, segment: ChunkSegment) -> Iterator[tuple[int, memoryview]]:
    """Yield each message index after a chunk: the channel, and its stored entries.

    Raises
    ------
    DamageError
        If an index contradicts its own lengths.
    """
    position = segment.stop
    # Usually, one call reads all of them.
    origin, ahead = position, memoryview(b"")
    while position + _HEAD.size <= file.size:
        if position + _HEAD.size > origin + len(ahead):
            length = max(0 if ahead else segment.index_length, _AHEAD)
            origin, ahead = position, memoryview(file.read(position, min(length, file.size - position)))
        opcode, length, channel_id, size = _HEAD.unpack_from(ahead, position - origin)
        start = position + _HEAD.size
        position += RECORD.size + length
        if opcode != OP_MESSAGE_INDEX:
            if opcode <= Opcode.DATA_END:
                return
            continue
        if size % _FORM.entry.size or start + size > position:
            raise file.damage(f"the message index at byte {start - _HEAD.size} contradicts its own lengths")
        if start + size <= origin + len(ahead):
            yield channel_id, ahead[start - origin : start - origin + size]
        else:
            yield channel_id, memoryview(file.read(start, size))


def indexed_places(file: RecordFile, segment: ChunkSegment) -> frozenset[int]:
    """Return the places of messages in a chunk by the message indexes after it; none if these are malformed."""
    try:
        groups = list(index_entries(file, segment))
    except DamageError:
        return frozenset()
    return frozenset(place for _, entries in groups for _, place in _FORM.entry.iter_unpack(entries))


def index_check(file: RecordFile, segment: ChunkSegment, records: Buffer, ids: Container[int]) -> IndexCheck:
    """Compare the message indexes after a chunk with the chunk.

    Parameters
    ----------
    file, segment
        The chunk.
    records
        Its records.
    ids
        The channels to compare.
    """
    try:
        groups = list(index_entries(file, segment))
    except DamageError as err:
        return IndexCheck(err.message)
    mine = [(channel_id, entries) for channel_id, entries in groups if channel_id in ids]
    total = sum(len(entries) for _, entries in mine) // _FORM.entry.size
    problem = None
    if astray := count_wrong_entries(records, mine, _FORM):
        problem = f"{astray} of {total} entries match no message by their channel and log time"
    return IndexCheck(problem, total if groups else None, astray)


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
            for channel_id, times in _message_indexes(file, segment):
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
        for channel_id, times in _message_indexes(file, segment):
            missing.discard(channel_id)
            found += times
    except DamageError:
        return None
    return (min(found), max(found)) if found and not missing else None


def _message_indexes(file: RecordFile, segment: ChunkSegment) -> Iterator[tuple[int, Iterator[int]]]:
    """Yield each message index after a chunk: the channel, and the log times of its messages."""
    for channel_id, entries in index_entries(file, segment):
        yield channel_id, (time_ns for time_ns, _ in _ENTRY.iter_unpack(entries))
