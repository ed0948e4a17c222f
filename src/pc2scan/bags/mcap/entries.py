"""Compares the message indexes after a chunk of an MCAP file with the chunk."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from pc2scan.bags.chunked.entries import EntryForm, IndexCheck, entries_astray
from pc2scan.errors import DamageError

from .record_types import Opcode
from .records import OP_MESSAGE_INDEX, RECORD

if TYPE_CHECKING:
    from collections.abc import Container, Iterator

    from pc2scan.model import Buffer

    from .chunks import ChunkSegment
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
    if astray := entries_astray(records, mine, _FORM):
        problem = f"{astray} of {total} entries match no message by their channel and log time"
    return IndexCheck(problem, total if groups else None, astray)
