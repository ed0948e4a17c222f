"""Searches a damaged MCAP file, or the records of a damaged chunk, for the certain beginning of a record."""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING

from pc2scan.bags.concatenation import NextRecordingError
from pc2scan.errors import DamageError

from . import records
from .chunks import CHUNK_HEAD_SIZE, chunk_at
from .records import (
    COMPRESSIONS,
    MAGIC,
    MESSAGE,
    OP_CHUNK,
    OP_MESSAGE,
    OP_MESSAGE_INDEX,
    RECORD,
    Opcode,
    has_meaning,
    pack,
    parse,
    unpack,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from .chunks import ChunkSegment
    from .records import RecordFile

#: Bytes that are searched at a time.
WINDOW = 1 << 20

# An opcode and a length below 2^32 (messages) or 2^36 (all others).
_MESSAGE_HEAD = re.compile(rb"(?=\x05[\s\S]{4}\0\0\0\0)")
_RECORD_HEAD = re.compile(rb"(?=[\x03-\x07\x09\x0c][\s\S]{4}[\0-\x0f]\0\0\0)")

#: Records that cannot be in a chunk.
_OUTSIDE_CHUNKS = frozenset({OP_CHUNK, OP_MESSAGE_INDEX, int(Opcode.ATTACHMENT), int(Opcode.METADATA)})
_ANYWHERE = _OUTSIDE_CHUNKS | {OP_MESSAGE, int(Opcode.SCHEMA), int(Opcode.CHANNEL)}

#: Consecutive records that are not there by chance.
_MANY = 8

_DECLARATIONS: Mapping[int, type[records.Schema | records.Channel]] = {
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
}


def is_record(file: RecordFile, offset: int, end: int) -> bool:
    """Whether a record can begin here: an opcode with a meaning, and a length that fits."""
    return _stop_of(file, offset, end) is not None


def _stop_of(file: RecordFile, offset: int, end: int) -> int | None:
    """Return the end of the record that may begin here; None if none can."""
    if offset + RECORD.size > end:
        return None
    opcode, length = RECORD.unpack(file.read(offset, RECORD.size))
    stop = offset + RECORD.size + length
    return int(stop) if has_meaning(opcode) and stop <= end else None


def next_record(
    file: RecordFile,
    start: int,
    end: int,
    known: Collection[int],
    kinds: frozenset[int] = _ANYWHERE,
    *,
    limit: int | None = None,
) -> int:
    """Search, up to ``limit``, for the certain beginning of a record; ``end`` if there is none.

    ``known`` are the channels that were found so far: none if only chunks declare them.
    """
    overlap = RECORD.size - 1
    stop = end if limit is None else min(end, limit + overlap)
    while start < stop:
        window = file.read(start, min(WINDOW + overlap, stop - start))
        for match in _RECORD_HEAD.finditer(window):
            position = match.start()
            opcode, length = RECORD.unpack_from(window, position)
            if opcode in kinds and _certain(file, opcode, start + position, length, end, known):
                return start + position
        if start + len(window) >= stop:
            break
        start += len(window) - overlap
    return end


def included_record(file: RecordFile, start: int, stop: int, end: int, known: Collection[int]) -> int | None:
    """Search what is said to be one record, up to ``stop``, for the first of others that it includes.

    They go on behind ``stop``, or are many. Otherwise they are the record's contents.
    """
    while (found := next_record(file, start, end, known, limit=stop)) < stop:
        position: int | None = found
        for _ in range(_MANY):
            if position is None or position >= stop:
                break
            position = _stop_of(file, position, end)
        if position is not None and position != stop:
            return found
        start = found + 1
    return None


def _certain(file: RecordFile, opcode: int, offset: int, length: int, end: int, known: Collection[int]) -> bool:
    """Whether a possible beginning of a record is certain."""
    following = offset + RECORD.size + length

    def followed(times: int = 1) -> bool:
        stop: int | None = following
        for _ in range(times):
            stop = stop if stop is None or stop == end else _stop_of(file, stop, end)
        return stop is not None

    if opcode == OP_CHUNK:
        head = chunk_in_front(file, offset, end)
        return head is not None and head.stop == following and (not head.padding or followed())
    if following > end:
        return False
    if opcode == OP_MESSAGE:
        if length < MESSAGE.size - RECORD.size:
            return False
        (channel,) = struct.unpack("<H", file.read(offset + RECORD.size, 2))
        return channel in known and followed() if known else followed(times=2)
    if opcode == OP_MESSAGE_INDEX:
        if length < 6:
            return False
        _, size = struct.unpack("<HI", file.read(offset + RECORD.size, 6))
        return bool(size % 16 == 0 and (size == length - 6 or (size < length - 6 and followed())))
    # A parser allocates the declared lengths: no large records are tried but attachments.
    if (length > WINDOW and opcode != Opcode.ATTACHMENT) or not followed():
        return False
    if opcode == Opcode.ATTACHMENT:
        return length >= 40
    kind = {Opcode.SCHEMA: records.Schema, Opcode.CHANNEL: records.Channel, Opcode.METADATA: records.MetadataRecord}
    try:
        parse(kind[Opcode(opcode)], file.read(offset + RECORD.size, length), offset, file)
    except DamageError:
        return False
    return True


def chunk_in_front(file: RecordFile, offset: int, end: int) -> ChunkSegment | None:
    """Return the chunk whose record begins here, if its header is plausible; only its length may be wrong."""
    size = min(CHUNK_HEAD_SIZE, end - offset)
    if size < RECORD.size:
        return None
    data = file.read(offset, size)
    if data[0] != OP_CHUNK:
        return None
    try:
        chunk = chunk_at(data, 0, offset, file, fits=False)
    except DamageError:
        return None
    return chunk if chunk.compression in COMPRESSIONS and chunk.start_ns <= chunk.end_ns else None


def payload_stop(file: RecordFile, offset: int, end: int) -> int | None:
    """Return where the payload of the chunk that begins here ends; None if none does."""
    chunk = chunk_in_front(file, offset, end)
    return None if chunk is None else chunk.offset + chunk.length


def end_of_chunk(file: RecordFile, chunk: ChunkSegment, end: int, known: Collection[int]) -> int:
    """Return the offset of the record after a chunk with contradicting lengths."""
    _, length = RECORD.unpack(file.read(chunk.record_offset, RECORD.size))
    for stop in (chunk.offset + chunk.length, chunk.record_offset + RECORD.size + length):
        if stop == end or (chunk.offset < stop < end and is_record(file, stop, end)):
            return int(stop)
    return next_record(file, chunk.offset, end, known, _OUTSIDE_CHUNKS)


def end_of_declaration(data: memoryview) -> int | None:
    """Return where the fields of the schema or channel at the front end, whatever its length is; None if none is."""
    kind = _DECLARATIONS.get(data[0]) if len(data) > RECORD.size else None
    if kind is None:
        return None
    try:
        record = unpack(kind, data[RECORD.size :])
    except (struct.error, UnicodeDecodeError):
        return None
    named = record.name if isinstance(record, records.Schema) else record.topic
    return RECORD.size + len(pack(record)[1]) if named else None


def record_end(data: memoryview, position: int) -> int | None:
    """Return the end of the record that begins here; None if none does."""
    if position + RECORD.size > len(data):
        return None
    opcode, length = RECORD.unpack_from(data, position)
    stop = position + RECORD.size + length
    if stop > len(data) or not has_meaning(opcode):
        return None
    return None if opcode == OP_MESSAGE and length < MESSAGE.size - RECORD.size else int(stop)


def end_of_framed(data: memoryview, position: int) -> int | None:
    """Return the end of the record that begins here, by its fields if that of a declaration is wrong."""
    stop = record_end(data, position)
    if stop is not None and (stop == len(data) or record_end(data, stop) is not None):
        return stop
    fields = end_of_declaration(data[position:])
    if fields is not None and (position + fields == len(data) or record_end(data, position + fields) is not None):
        return position + fields
    return stop


def is_message(data: memoryview, position: int, known: Collection[int] | None, span: tuple[int, int] | None) -> bool:
    """Whether a message begins here that is of a known channel and of a time in the span, whatever its length is."""
    if position + MESSAGE.size > len(data) or data[position] != OP_MESSAGE:
        return False
    _, _, channel_id, _, log_time_ns, _ = MESSAGE.unpack_from(data, position)
    return (known is None or channel_id in known) and (span is None or span[0] <= log_time_ns <= span[1])


def next_message(
    data: memoryview, start: int, end: int, known: Collection[int] | None, span: tuple[int, int] | None
) -> int | None:
    """Search for the certain beginning of a message before ``end``."""
    for match in _MESSAGE_HEAD.finditer(data, start):
        position = match.start()
        if position >= end:
            return None
        stop = record_end(data, position)
        if stop is None or not is_message(data, position, known, span):
            continue
        if stop + RECORD.size > len(data) or record_end(data, stop) is not None or span is not None:
            return position
    return None


#: Bytes that are searched at a time.
_WINDOW = 1 << 20

#: Limit of a Header's size: it has the names of a profile and of a library.
_MAX_HEADER = 1 << 16


def refuse_another(file: RecordFile, start: int, stop: int) -> None:
    """Raise if another file begins in this part of the file, with the magic and a Header."""
    overlap = len(MAGIC) + RECORD.size - 1
    for begin in range(start, stop, _WINDOW):
        window = file.read(begin, min(_WINDOW + overlap, file.size - begin))
        at = window.find(MAGIC)
        while 0 <= at <= len(window) - overlap - 1:
            opcode, length = RECORD.unpack_from(window, at + len(MAGIC))
            if begin + at > 0 and opcode == Opcode.HEADER and length <= _MAX_HEADER:
                raise NextRecordingError(begin + at)
            at = window.find(MAGIC, at + 1)
