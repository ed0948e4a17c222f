"""Reads and decompresses the chunks of MCAP files, and indexes the messages of those that are copied as a whole."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from pc2scan.bags.chunks import Segment, unpacked
from pc2scan.bags.formats import and_list
from pc2scan.bags.loading import check_number
from pc2scan.files.compression import ZSTD_MAGIC, CompressionError, crc32
from pc2scan.model import StoredChunk

from .records import CHUNK, COMPRESSIONS, MESSAGE, OP_CHUNK, OP_MESSAGE, RECORD, UINT64

if TYPE_CHECKING:
    from collections.abc import Collection

    from pc2scan.model import Buffer, ChunkRule

    from .records import RecordFile

    #: By channel: log times and places of its messages.
    Index = dict[int, list[tuple[int, int]]]

#: A chunk's record up to its payload; the name of its compression is no longer than 64 bytes.
CHUNK_HEAD_SIZE = RECORD.size + CHUNK.size + 64 + UINT64.size


def form_of(chunk: Segment) -> tuple[int, int, int, str, int]:
    """Return how a chunk is stored, wherever it is."""
    head = chunk.offset - chunk.record_offset
    return head, chunk.length, chunk.padding, chunk.compression, chunk.uncompressed_size


def chunk_at(head: Buffer, record_offset: int, file: RecordFile, *, fits: bool = True) -> Segment:
    """Read the header of a chunk from the beginning of its record.

    With ``fits``, its payload must not be longer than its record.
    """
    malformed = f"the chunk at byte {record_offset} has a malformed header"
    try:
        _, record_length = RECORD.unpack_from(head)
        start_ns, end_ns, size, crc, name_size = CHUNK.unpack_from(head, RECORD.size)
        payload_at = RECORD.size + CHUNK.size + name_size + UINT64.size
        (length,) = UINT64.unpack(head[payload_at - UINT64.size : payload_at])
        name = str(head[payload_at - UINT64.size - name_size : payload_at - UINT64.size], "utf-8")
    except (struct.error, UnicodeDecodeError) as err:
        raise file.damage(malformed) from err
    padding = RECORD.size + record_length - payload_at - length
    if not length and padding > 0:
        raise file.damage(f"{malformed}: it declares no records in {record_length} bytes")
    if padding < 0 and fits:
        raise file.damage(f"{malformed}: it declares {length} bytes of records in {record_length} bytes")
    return Segment(
        offset=record_offset + payload_at,
        length=length,
        compression=name or "none",
        uncompressed_size=size,
        crc=crc,
        start_ns=start_ns,
        end_ns=end_ns,
        record_offset=record_offset,
        padding=max(0, padding),
    )


def read_chunk(file: RecordFile, segment: Segment, *, keep: bool = False) -> tuple[Segment, memoryview, memoryview]:
    """Read a chunk; return it by its own header, its payload, and its decompressed records.

    The payload is in a buffer that is used again, unless it is to ``keep``.

    Raises
    ------
    DamageError
        If bytes are missing, do not decompress to the declared size, or fail their CRC, or if the index contradicts it.
    """
    where = f"the chunk at byte {segment.record_offset}"
    head = segment.offset - segment.record_offset
    read = file.read if keep else file.borrow
    record = memoryview(read(segment.record_offset, head + segment.length))
    chunk = chunk_at(record, segment.record_offset, file)
    if record[0] != OP_CHUNK or form_of(chunk) != form_of(segment):
        raise file.damage(f"the index and {where} contradict each other")
    if chunk.compression not in COMPRESSIONS:
        raise file.damage(f"{where} has compression {chunk.compression!r}, known are {and_list(COMPRESSIONS)}")
    stored = record[head:]
    try:
        records = unpacked(chunk, stored, file.size)
    except CompressionError as err:
        raise file.damage(f"{where}: {err}") from err
    if chunk.crc and (actual := crc32(records)) != chunk.crc:
        raise file.damage(f"{where} has CRC {actual:08x}, recorded is {chunk.crc:08x}")
    return chunk, stored, records


def whole_chunk(file: RecordFile, segment: Segment, rule: ChunkRule) -> StoredChunk | memoryview:
    """Read a chunk to copy it as a whole; return its decompressed records if ``rule`` does not allow that."""
    chunk, stored, records = read_chunk(file, segment, keep=True)
    index = _index_of(records, segment, rule.declarations)
    if index is None or not index.keys() <= rule.connection_ids:
        return records
    crc = chunk.crc or crc32(records)
    if chunk.compression not in rule.compressions:
        return StoredChunk("", records, len(records), crc, index)
    return StoredChunk(chunk.compression, stored, len(records), crc, index)


def _index_of(records: memoryview, segment: Segment, declarations: Collection[bytes]) -> Index | None:
    """Index a chunk's messages; None if one is outside of its times, or it has a record of another kind."""
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
            check_number(times)
        position = following
    if position == size and times and segment.start_ns <= min(times) and max(times) <= segment.end_ns:
        return index
    return None
