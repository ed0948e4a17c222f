"""Reads chunks of MCAP files that can be copied as a whole, and indexes their messages."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from pc2scan.bags.lazy_items import MAX_LISTED_ITEMS
from pc2scan.files.compression import ZSTD_MAGIC, crc32
from pc2scan.model import StoredChunk

from .chunks import decompress_chunk, stored_chunk
from .records import MESSAGE, OP_MESSAGE, OP_MESSAGE_INDEX, RECORD, encode_record

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from pc2scan.model import ChunkRule

    from .chunks import ChunkSegment
    from .index import McapIndex
    from .records import RecordFile

    #: By channel: log times and places of its messages.
    Index = dict[int, list[tuple[int, int]]]


def shared_channels(index: McapIndex, rule: ChunkRule) -> frozenset[int]:
    """Find the channels that the destination declares as this file does, so that a chunk may repeat the declaration."""
    found = []
    for channel_id in rule.connection_ids & index.channels.keys():
        channel = index.channels[channel_id]
        schema = index.schemas.get(channel.schema_id)
        records = {encode_record(channel)} if schema is None else {encode_record(channel), encode_record(schema)}
        if records <= rule.declarations:
            found.append(channel_id)
    return frozenset(found)


def copy_by_index(file: RecordFile, segment: ChunkSegment, rule: ChunkRule) -> StoredChunk | None:
    """Read a chunk and the message indexes after it, without decompressing it.

    Returns
    -------
    StoredChunk | None
        None if it cannot keep its compression, its messages are not sorted by log time, the indexes do not have all
        of them, or there may be other declarations before the first one.

    Raises
    ------
    RecordingError
        If bytes are missing, or the chunk's header differs from the index.
    """
    if not 0 < segment.index_length <= MAX_LISTED_ITEMS * 16 or segment.compression not in rule.compressions:
        return None
    chunk, stored, indexes = stored_chunk(file, segment, segment.index_length)
    index: Index = {}
    position = 0
    while position < len(indexes):
        if position + RECORD.size + 6 > len(indexes):
            return None
        opcode, length, channel_id, size = struct.unpack_from("<BQHI", indexes, position)
        start = position + RECORD.size + 6
        position += RECORD.size + length
        if opcode != OP_MESSAGE_INDEX or size % 16 or start + size > position or position > len(indexes):
            return None
        if size:
            index[channel_id] = sorted(struct.iter_unpack("<QQ", indexes[start : start + size]), key=_place)
    entries = sorted((entry for found in index.values() for entry in found), key=_place)
    if not entries or entries[0][1] != 0 or entries[-1][1] >= segment.uncompressed_size:
        return None
    if index.keys() != segment.connection_ids or not _is_sorted([time_ns for time_ns, _ in entries], segment):
        return None
    return StoredChunk(segment.compression, stored, segment.uncompressed_size, chunk.crc, index)


def copy_by_content(
    file: RecordFile,
    segment: ChunkSegment,
    rule: ChunkRule,
    *,
    verify: bool,
    compare: Callable[[memoryview, int], object] | None = None,
) -> StoredChunk | memoryview:
    """Read a chunk, and decompress it to compare its CRC and to index its messages.

    Parameters
    ----------
    compare
        Called with the records of a chunk that can be copied, and the number of its messages.

    Returns
    -------
    StoredChunk | memoryview
        Its decompressed records, if ``rule`` does not allow to copy it or its messages are not sorted by log time.

    Raises
    ------
    RecordingError
        As `pc2scan.bags.mcap.chunks.payload` does.
    """
    chunk, stored, _ = stored_chunk(file, segment)
    records = decompress_chunk(file, chunk, stored, verify=verify)
    index = _index_of(records, segment, rule.declarations)
    if index is None or not index.keys() <= rule.connection_ids:
        return records
    if compare is not None:
        compare(records, sum(map(len, index.values())))
    crc = chunk.crc or crc32(records)
    if chunk.compression not in rule.compressions:
        return StoredChunk("", records, len(records), crc, index)
    return StoredChunk(chunk.compression, stored, len(records), crc, index)


def _index_of(records: memoryview, segment: ChunkSegment, declarations: Collection[bytes]) -> Index | None:
    """Index a chunk's messages; None if they are not in order, or it has any other record than these declarations."""
    index: Index = {}
    times = []
    position, size = 0, len(records)
    while position + RECORD.size <= size:
        opcode, length = RECORD.unpack_from(records, position)
        following = position + RECORD.size + length
        if following > size:
            return None
        if opcode != OP_MESSAGE:
            if bytes(records[position:following]) not in declarations:
                return None
        elif following - position < MESSAGE.size or records[position + MESSAGE.size : following][:4] == ZSTD_MAGIC:
            # Messages that are compressed one by one are decompressed, not copied.
            return None
        else:
            _, _, channel_id, _, log_time_ns, _ = MESSAGE.unpack_from(records, position)
            index.setdefault(channel_id, []).append((log_time_ns, position))
            times.append(log_time_ns)
            if len(times) > MAX_LISTED_ITEMS:
                return None
        position = following
    return index if position == size and times and _is_sorted(times, segment) else None


def _is_sorted(times: list[int], segment: ChunkSegment) -> bool:
    """Whether log times are sorted, and within the declared ones."""
    return segment.start_ns <= times[0] and times[-1] <= segment.end_ns and times == sorted(times)


def _place(entry: tuple[int, int]) -> int:
    return entry[1]
