"""Reads and decompresses the chunks of MCAP files, and indexes the messages of those that are copied as a whole."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from pc2scan.bags.chunks import Segment
from pc2scan.bags.formats import and_list
from pc2scan.bags.loading import check_number
from pc2scan.files.compression import ZSTD_MAGIC, CompressionError, allowed_bytes, crc32, decompress
from pc2scan.files.source import lend
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
        raise file.damage(
            f"the chunk at byte {record_offset} declares {length} bytes of records in {record_length} bytes",
        )
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


def borrow_payload(file: RecordFile, segment: Segment) -> memoryview:
    """Read and decompress a segment's records.

    Raises
    ------
    RecordingError
        If bytes are missing, do not decompress to the declared size, or fail their CRC.
    """
    if not segment.record_offset:
        return file.borrow(segment.offset, segment.length)
    head = segment.offset - segment.record_offset
    record = file.borrow(segment.record_offset, head + segment.length)
    chunk = _check_header(record, segment, file)
    return decompress_chunk(file, chunk, record[head:])


def _check_header(record: memoryview, segment: Segment, file: RecordFile) -> Segment:
    """Return the chunk by its own header, which has a CRC, after comparing it with the index."""
    chunk = chunk_at(record, segment.record_offset, file)
    if record[0] != OP_CHUNK or form_of(chunk) != form_of(segment):
        raise file.damage(f"the index and the chunk at byte {segment.record_offset} contradict each other")
    return chunk


def decompress_chunk(file: RecordFile, chunk: Segment, stored: memoryview) -> memoryview:
    """Decompress a chunk's records into exactly the declared size, and compare their CRC; see `borrow_payload`."""
    size = chunk.uncompressed_size
    where = f"the chunk at byte {chunk.record_offset}"
    if size == 0 == len(stored):
        return stored
    if size > (allowed := allowed_bytes(file.size, len(stored))):
        raise file.damage(
            f"{where} declares {size} bytes uncompressed, in a file of {file.size} at most {allowed} may be"
        )
    if chunk.compression not in COMPRESSIONS:
        raise file.damage(f"{where} has compression {chunk.compression!r}, known are {and_list(COMPRESSIONS)}")
    unpacked = stored
    if chunk.compression != "none":
        try:
            unpacked = lend(size)
            decompress(chunk.compression, stored, unpacked)
        except (MemoryError, OverflowError) as err:
            raise file.damage(f"{where} declares {size} bytes uncompressed, which do not fit into memory") from err
        except CompressionError as err:
            raise file.damage(f"{where} cannot be decompressed to the declared {size} bytes: {err}") from err
    elif len(stored) != size:
        raise file.damage(f"{where} has {len(stored)} bytes, declared are {size}")
    if chunk.crc and (actual := crc32(unpacked)) != chunk.crc:
        raise file.damage(f"{where} has CRC {actual:08x}, recorded is {chunk.crc:08x}")
    return unpacked.toreadonly()


# --- Chunks that are copied as a whole ---


def whole_chunk(file: RecordFile, segment: Segment, rule: ChunkRule) -> StoredChunk | memoryview:
    """Read a chunk, and decompress it to compare its CRC and to index its messages.

    Returns
    -------
    StoredChunk | memoryview
        Its decompressed records, if ``rule`` does not allow to copy it.

    Raises
    ------
    RecordingError
        As `borrow_payload` does.
    """
    head = segment.offset - segment.record_offset
    record = memoryview(file.read(segment.record_offset, head + segment.length + segment.padding))
    chunk = _check_header(record, segment, file)
    stored = record[head : head + segment.length]
    records = decompress_chunk(file, chunk, stored)
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
