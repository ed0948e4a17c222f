"""Reads records of MCAP files at their places, and chunks; finds and indexes the messages among them.

The library `mcap` has the classes of the records. Source of the format: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
from io import BytesIO
from typing import TYPE_CHECKING, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Footer, Header, Metadata, Schema, Statistics

from pc2scan.bags.chunks import NearbyFile, Segment, unpacked
from pc2scan.bags.damage import RECOVER
from pc2scan.bags.formats import FORMATS, and_list
from pc2scan.bags.reader import MAX_CHUNK_MESSAGES, check_number
from pc2scan.errors import DamageError, stamp_text
from pc2scan.files.compression import ZSTD_MAGIC, CompressionError, crc32
from pc2scan.model import RawMessage, StoredChunk

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping
    from pathlib import Path

    from pc2scan.model import Buffer, ChunkRule, Connection

    #: By channel: log times and places of its messages.
    Index = dict[int, list[tuple[int, int]]]

#: The first and the last eight bytes of every file.
MAGIC = FORMATS["mcap"].magic
COMPRESSIONS = FORMATS["mcap"].compressions

# Opcode and length of the content: the beginning of every record.
RECORD = struct.Struct("<BQ")
# The same with a message's channel id, sequence, log time and publish time.
MESSAGE = struct.Struct("<BQHIQQ")
# A chunk's first and last log time, uncompressed size, CRC, and the length of its compression's name.
CHUNK = struct.Struct("<QQQII")
UINT64 = struct.Struct("<Q")

# Plain integers: comparing an IntEnum member costs a method call for each message.
OP_MESSAGE, OP_CHUNK, OP_MESSAGE_INDEX = 0x05, 0x06, 0x07
#: Opcodes from here on are free for private records, which are passed over.
OP_PRIVATE = 0x80
DECLARATIONS: Mapping[int, type[Schema | Channel]] = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}

#: Bytes that are read at a time for a CRC.
_PIECE = 1 << 20

_Record = TypeVar("_Record", Attachment, Footer, Header, Metadata, Schema | Channel, Statistics)


class RecordFile(NearbyFile):
    """Reads records of an MCAP file; all errors are `RecordingError`."""

    def damage(self, message: str) -> DamageError:
        """Return the error for a damaged file."""
        return DamageError(message, path=self.path, hint=RECOVER)

    def record(self, offset: int, opcode: Opcode) -> bytes:
        """Read the content of a record of a known kind."""
        actual, length = RECORD.unpack(self.read(offset, RECORD.size))
        if actual != opcode:
            raise self.damage(f"the record at byte {offset} has opcode {actual}, expected {opcode} ({opcode.name})")
        return self.read(offset + RECORD.size, length)

    def crc(self, start: int, stop: int, value: int = 0) -> int:
        """Return the CRC-32 of a part of the file that follows what has the CRC ``value``."""
        for position in range(start, stop, _PIECE):
            value = crc32(self.read(position, min(_PIECE, stop - position)), value)
        return value


class _Content(BytesIO):
    """A record's content: fields that it ends in are an error, where the library would shorten them."""

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        if len(data) != size:
            raise EndOfFile
        return data


def parse_fields(kind: type[_Record], content: Buffer, offset: int, path: Path | None = None) -> tuple[_Record, int]:
    """Parse a record's content; return it, and the length of its fields. ``offset`` and ``path`` are for the error."""
    stream = ReadDataStream(_Content(content))
    try:
        return kind.read(stream), stream.count
    except (EndOfFile, OverflowError, UnicodeDecodeError) as err:
        what = f"the {kind.__name__} record at byte {offset} ({len(content)} bytes) contradicts its own lengths"
        raise DamageError(what, path=path, hint=RECOVER) from err


def parse(kind: type[_Record], content: Buffer, offset: int, file: RecordFile) -> _Record:
    """Parse a record's content; ``offset`` is its place in the file, for the error."""
    return parse_fields(kind, content, offset, file.path)[0]


# --- Messages ---

#: The first and the last log time that a message can have.
ANY_TIME = (0, (1 << 64) - 1)


def scan_messages(
    data: memoryview,
    wanted: Mapping[int, Connection],
    cut: tuple[int, int],
    span: tuple[int, int] = ANY_TIME,
    further: Callable[[int], None] | None = None,
) -> tuple[list[RawMessage], set[int]]:
    """Scan records for messages; return the wanted ones in the order of the file, and the other channels.

    ``cut`` is the first log time that is wanted, and the first one behind it; ``span`` has the declared log times.
    ``further`` is called with the offset of every other record.

    Raises
    ------
    ValueError
        If the records are not sound up to the end, or a wanted message is outside of ``span``.
    """
    first_ns, last_ns = span
    # One comparison for cut and span; only if it fails, the two are distinguished.
    start_ns, stop_ns = max(cut[0], first_ns), min(cut[1], last_ns + 1)
    messages: list[RawMessage] = []
    others: set[int] = set()
    append, unpack = messages.append, MESSAGE.unpack_from
    # The class's constructor takes twice as long, which matters for small messages.
    new: Callable[[type[RawMessage], tuple[object, ...]], RawMessage] = tuple.__new__
    position, size = 0, len(data)
    last = size - MESSAGE.size
    while position < size:
        pause = min(last, position + MAX_CHUNK_MESSAGES * MESSAGE.size)
        while position <= pause:
            opcode, length, channel_id, sequence, log_time_ns, publish_time_ns = unpack(data, position)
            following = position + 9 + length
            if following > size or (opcode == OP_MESSAGE and length < 22):
                raise ValueError(f"the records are sound for {position} of {size} bytes")
            if opcode == OP_MESSAGE:
                connection = wanted.get(channel_id)
                if connection is None:
                    others.add(channel_id)
                elif start_ns <= log_time_ns < stop_ns:
                    data_view = data[position + 31 : following]
                    append(new(RawMessage, (connection, log_time_ns, data_view, publish_time_ns, sequence)))
                elif not first_ns <= log_time_ns <= last_ns:
                    times = " to ".join(map(stamp_text, span))
                    raise ValueError(f"it has a message of log time {stamp_text(log_time_ns)}, and declares {times}")
            elif further is not None:
                further(position)
            position = following
        check_number(messages)
        if last < position < size:
            # The rest is too short for a message, but may be another record.
            opcode, length = RECORD.unpack_from(data, position) if size - position >= RECORD.size else (OP_MESSAGE, 0)
            if opcode == OP_MESSAGE or length > size - position - RECORD.size:
                raise ValueError(f"the records are sound for {position} of {size} bytes")
            if further is not None:
                further(position)
            position += RECORD.size + length
    return messages, others


# --- Chunks ---

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


def read_chunk(file: RecordFile, segment: Segment) -> tuple[Segment, memoryview, memoryview]:
    """Read a chunk; return it by its own header, its payload, and its decompressed records.

    Raises
    ------
    DamageError
        If bytes are missing, do not decompress to the declared size, or fail their CRC, or if the index contradicts it.
    """
    where = f"the chunk at byte {segment.record_offset}"
    head = segment.offset - segment.record_offset
    record = file.borrow(segment.record_offset, head + segment.length)
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
    chunk, stored, records = read_chunk(file, segment)
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
