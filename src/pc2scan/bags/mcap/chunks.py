"""Reads and decompresses the chunks of MCAP files, and indexes the messages of those that are copied as a whole."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from pc2scan.bags.chunks import Segment
from pc2scan.bags.formats import and_list
from pc2scan.bags.units import MAX_LISTED_ITEMS
from pc2scan.files.compression import ZSTD_MAGIC, CompressionError, allowed_bytes, crc32, decompress
from pc2scan.model import StoredChunk, own_data

from .records import CHUNK, COMPRESSIONS, MESSAGE, OP_CHUNK, OP_MESSAGE, OP_MESSAGE_INDEX, RECORD, UINT64

if TYPE_CHECKING:
    from collections.abc import Collection

    from pc2scan.files.source import BorrowedBytes
    from pc2scan.model import Buffer, ChunkRule

    from .records import RecordFile

    #: By channel: log times and places of its messages.
    Index = dict[int, list[tuple[int, int]]]

# Maximum length of a compression's name. A longer one is damaged.
_MAX_COMPRESSION_NAME = 64

CHUNK_HEAD_SIZE = RECORD.size + CHUNK.size + _MAX_COMPRESSION_NAME + UINT64.size


class ChunkSegment(Segment):
    """A chunk. `crc` is 0 until its header is read; loading uses the CRC in the header."""

    __slots__ = ()

    @property
    def stop(self) -> int:
        """Offset of the record after it."""
        return self.offset + self.length + self.padding

    @property
    def form(self) -> tuple[int, int, int, str, int]:
        """How it is stored, wherever it is."""
        head = self.offset - self.record_offset
        return head, self.length, self.padding, self.compression, self.uncompressed_size


def chunk_at(data: Buffer, position: int, record_offset: int, file: RecordFile, *, fits: bool = True) -> ChunkSegment:
    """Read the header of the chunk whose record begins at ``data[position]``.

    With ``fits``, its payload must not be longer than its record.
    """
    malformed = f"the chunk at byte {record_offset} has a malformed header"
    try:
        _, record_length = RECORD.unpack_from(data, position)
        start_ns, end_ns, size, crc, name_size = CHUNK.unpack_from(data, position + RECORD.size)
        name_at = position + RECORD.size + CHUNK.size
        (length,) = UINT64.unpack_from(data, name_at + min(name_size, _MAX_COMPRESSION_NAME))
        name = str(data[name_at : name_at + name_size], "utf-8")
    except (struct.error, UnicodeDecodeError) as err:
        raise file.damage(malformed) from err
    if name_size > _MAX_COMPRESSION_NAME:
        raise file.damage(f"{malformed}: its compression has a name of {name_size} bytes")
    head = CHUNK.size + name_size + UINT64.size
    padding = record_length - head - length
    if not length and padding > 0:
        raise file.damage(f"{malformed}: it declares no records in {record_length} bytes")
    if padding < 0 and fits:
        raise file.damage(
            f"the chunk at byte {record_offset} declares {length} bytes of records in {record_length} bytes",
        )
    return ChunkSegment(
        offset=record_offset + RECORD.size + head,
        length=length,
        compression=name or "none",
        uncompressed_size=size,
        crc=crc,
        start_ns=start_ns,
        end_ns=end_ns,
        record_offset=record_offset,
        padding=max(0, padding),
    )


def payload(file: RecordFile, segment: Segment, *, verify: bool = True) -> memoryview:
    """Read and decompress a segment's records.

    Raises
    ------
    RecordingError
        If bytes are missing, do not decompress to the declared size, or fail their CRC.
    """
    return memoryview(own_data(borrow_payload(file, segment, verify=verify).data))


def borrow_payload(file: RecordFile, segment: Segment, *, verify: bool = True) -> BorrowedBytes:
    """Return the result of `payload`, which may be borrowed; see `SourceFile.borrow`."""
    if not isinstance(segment, ChunkSegment):
        return file.borrow(segment.offset, segment.length)
    head = segment.offset - segment.record_offset
    record = file.borrow(segment.record_offset, head + segment.length)
    chunk = _check_header(record.data, segment, file)
    return record._replace(data=decompress_chunk(file, chunk, record.data[head:], verify=verify))


def stored_chunk(
    file: RecordFile, segment: ChunkSegment, behind: int = 0
) -> tuple[ChunkSegment, memoryview, memoryview]:
    """Read a chunk as it is stored.

    Parameters
    ----------
    behind
        Bytes after the chunk's record to read with it.

    Returns
    -------
    tuple[ChunkSegment, memoryview, memoryview]
        The chunk by its own header, its compressed records, and the bytes after its record.

    Raises
    ------
    RecordingError
        If bytes are missing, or the header differs from the index.
    """
    head = segment.offset - segment.record_offset
    following = head + segment.length + segment.padding
    record = memoryview(file.read(segment.record_offset, following + behind))
    return _check_header(record, segment, file), record[head : head + segment.length], record[following:]


def _check_header(record: memoryview, segment: ChunkSegment, file: RecordFile) -> ChunkSegment:
    """Return the chunk by its own header, which has a CRC, after comparing it with the index."""
    chunk = chunk_at(record, 0, segment.record_offset, file)
    if record[0] != OP_CHUNK or chunk.form != segment.form:
        raise file.damage(f"the index and the chunk at byte {segment.record_offset} contradict each other")
    return chunk


def decompress_chunk(file: RecordFile, chunk: ChunkSegment, data: memoryview, *, verify: bool = True) -> memoryview:
    """Decompress a chunk's records into exactly the declared size, and compare their CRC; see `payload`."""
    size = chunk.uncompressed_size
    where = f"the chunk at byte {chunk.record_offset}"
    if size == 0 == len(data):
        return memoryview(b"")
    if size > (allowed := allowed_bytes(file.size)):
        raise file.damage(
            f"{where} declares {size} bytes uncompressed, in a file of {file.size} at most {allowed} may be"
        )
    if chunk.compression not in COMPRESSIONS:
        raise file.damage(f"{where} has compression {chunk.compression!r}, known are {and_list(COMPRESSIONS)}")
    try:
        unpacked, complete = decompress(chunk.compression, data, size)
        if not complete:
            raise CompressionError("there is more" if len(unpacked) > size else f"it ends after {len(unpacked)} bytes")
    except (MemoryError, OverflowError) as err:
        raise file.damage(f"{where} declares {size} bytes uncompressed, which do not fit into memory") from err
    except CompressionError as err:
        raise file.damage(f"{where} cannot be decompressed to the declared {size} bytes: {err}") from err
    if len(unpacked) != size:
        raise file.damage(f"{where} decompresses to {len(unpacked)} bytes, declared are {size}")
    if verify and chunk.crc and (actual := crc32(unpacked)) != chunk.crc:
        raise file.damage(f"{where} has CRC {actual:08x}, recorded is {chunk.crc:08x}")
    return memoryview(unpacked)


# --- Chunks that are copied as a whole ---


def copy_by_index(file: RecordFile, segment: ChunkSegment, rule: ChunkRule) -> StoredChunk | None:
    """Read a chunk and the message indexes after it, without decompressing it.

    Returns
    -------
    StoredChunk | None
        None if it cannot keep its compression, the indexes do not have all of its messages or contradict its times, or
        there may be other declarations before the first one.

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
    found = StoredChunk(segment.compression, stored, segment.uncompressed_size, chunk.crc, index)
    is_sound = index.keys() == segment.connection_ids and found.span_ns() == (segment.start_ns, segment.end_ns)
    return found if is_sound else None


def copy_by_content(
    file: RecordFile,
    segment: ChunkSegment,
    rule: ChunkRule,
    *,
    verify: bool,
) -> StoredChunk | memoryview:
    """Read a chunk, and decompress it to compare its CRC and to index its messages.

    Returns
    -------
    StoredChunk | memoryview
        Its decompressed records, if ``rule`` does not allow to copy it.

    Raises
    ------
    RecordingError
        As `payload` does.
    """
    chunk, stored, _ = stored_chunk(file, segment)
    records = decompress_chunk(file, chunk, stored, verify=verify)
    index = _index_of(records, segment, rule.declarations)
    if index is None or not index.keys() <= rule.connection_ids:
        return records
    crc = chunk.crc or crc32(records)
    if chunk.compression not in rule.compressions:
        return StoredChunk("", records, len(records), crc, index)
    return StoredChunk(chunk.compression, stored, len(records), crc, index)


def _index_of(records: memoryview, segment: ChunkSegment, declarations: Collection[bytes]) -> Index | None:
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
            if len(times) > MAX_LISTED_ITEMS:
                return None
        position = following
    return index if position == size and times and _are_within(times, segment) else None


def _are_within(times: list[int], segment: ChunkSegment) -> bool:
    """Whether log times are within the declared ones."""
    return segment.start_ns <= min(times) and max(times) <= segment.end_ns


def _place(entry: tuple[int, int]) -> int:
    return entry[1]
