"""Recovers the records of a damaged MCAP file, and the messages of a damaged chunk.

If the walk over the records fails, the file is searched for the next certain beginning of a record; the same is done
inside chunks. Bytes that belong to no record are noted as lost.
"""

from __future__ import annotations

import re
import struct
from array import array
from collections import deque
from contextlib import suppress
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.chunked.salvaged import Salvaged, settled
from pc2scan.bags.chunked.segments import times_around
from pc2scan.bags.many import Many
from pc2scan.bags.parts import AnotherBeginsError
from pc2scan.errors import DamageError
from pc2scan.files.salvage import decompressed_prefix

from . import record_types as records
from .another import refuse_another
from .chunks import CHUNK_HEAD_SIZE, ChunkSegment, chunk_at
from .index import McapIndex, RecordWalk, read_header, read_summary
from .messages import message_at
from .record_types import Opcode
from .records import (
    COMPRESSIONS,
    FIRST_PRIVATE,
    MAGIC,
    MESSAGE,
    OP_CHUNK,
    OP_MESSAGE,
    OP_MESSAGE_INDEX,
    RECORD,
    has_meaning,
    parse,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping

    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.bags.damage import DamageLog
    from pc2scan.model import Connection

    from .records import RecordFile

__all__ = [
    "displaced_chunks",
    "is_at_its_place",
    "payload_prefix",
    "recovered_index",
    "salvaged_messages",
    "salvaged_records",
]

#: Bytes that are searched at a time.
_WINDOW = 1 << 20

# An opcode and a length below 2^32 (messages) or 2^36 (all others).
_MESSAGE_HEAD = re.compile(rb"(?=\x05[\s\S]{4}\0\0\0\0)")
_RECORD_HEAD = re.compile(rb"(?=[\x03-\x07\x09\x0c][\s\S]{4}[\0-\x0f]\0\0\0)")

#: Records that cannot be in a chunk.
_OUTSIDE_CHUNKS = frozenset({OP_CHUNK, OP_MESSAGE_INDEX, int(Opcode.ATTACHMENT), int(Opcode.METADATA)})
_ANYWHERE = _OUTSIDE_CHUNKS | {OP_MESSAGE, int(Opcode.SCHEMA), int(Opcode.CHANNEL)}

#: Records that chunks are made of.
_INSIDE_CHUNKS = frozenset({OP_MESSAGE, int(Opcode.SCHEMA), int(Opcode.CHANNEL)})


class _Gap(NamedTuple):
    """A part of the file that belongs to no record, and why."""

    start: int
    stop: int
    error: DamageError


def recovered_index(file: RecordFile, problem: DamageError, log: DamageLog, *, verify: bool) -> McapIndex:
    """Index a damaged file.

    Parameters
    ----------
    file
        The open file.
    problem
        The error of indexing it as a sound file.
    log
        Gets the damage.
    verify
        Whether a summary with a wrong CRC is ignored.

    Returns
    -------
    McapIndex
        Chunks may be cut off at the end of the file.
    """
    if log.strict:
        raise problem
    index = McapIndex()
    without_header: DamageError | None = None
    without_summary: DamageError | None = None
    try:
        read_header(file, index)
    except DamageError as err:
        without_header = err
    summary, end = McapIndex(), file.size - len(MAGIC) * _ends_with_magic(file)
    try:
        end, _ = read_summary(file, summary, verify=verify)
    except DamageError as err:
        without_summary = err
        # The walk then includes the records of the summary, and finds channels there.
        summary = McapIndex()
    index.statistics = summary.statistics
    gaps = list(_walked(file, index, summary.channels, end))
    for identity, schema in summary.schemas.items():
        index.schemas.setdefault(identity, schema)
    for identity, channel in summary.channels.items():
        index.channels.setdefault(identity, channel)
    index.channels_listed = summary.channels_listed
    _adopt(index, summary.segments, gaps)
    around = times_around(index.segments)
    if without_header is not None:
        # The walk begins where it should be, and no message is in it.
        log.note(without_header, offset=len(MAGIC), key="header", messages_lost=0)
    elif without_summary is None and not gaps:
        without_summary = problem
    if without_summary is not None:
        log.note(without_summary, **around(file.size, file.size))
    for gap in gaps:
        log.note(gap.error, offset=gap.start, bytes_lost=gap.stop - gap.start, **around(gap.start, gap.stop))
    return index


def _ends_with_magic(file: RecordFile) -> bool:
    return file.size >= 2 * len(MAGIC) and file.read(file.size - len(MAGIC), len(MAGIC)) == MAGIC


def _walked(file: RecordFile, index: McapIndex, summarized: Collection[int], end: int) -> Iterator[_Gap]:
    """Walk over all records up to a byte; if that fails, continue at the next one, and yield the gap.

    ``summarized`` are the channels in the summary.
    """
    position = len(MAGIC)
    while position < end:
        walk = RecordWalk(file, index)
        try:
            walk.run(position, end)
        except DamageError as err:
            failed, previous, error = walk.offset, walk.previous, err
        else:
            if walk.offset and (rest := _behind_data_end(file, walk.offset, end)) is not None:
                position = rest
                continue
            return
        known = index.channels.keys() | summarized
        chunk = _chunk_in_front(file, failed, end)
        if chunk is not None:
            position = _end_of_chunk(file, chunk, end, known)
            refuse_another(file, failed, position)
            index.segments.append(replace(chunk, length=min(chunk.length, position - chunk.offset), padding=0))
            index.all_counted = False
            if position < chunk.offset + chunk.length:
                # The damage of the chunk's contents is noted when it is read; here only that it is cut off.
                yield _Gap(failed, failed, error)
            continue
        # A record with a wrong length may include others.
        if previous:
            payload_stop = _payload_stop(file, previous, end)
            again = _next_record(file, payload_stop or previous + 1, end, known, limit=failed)
            if again < failed:
                _forget(index, previous)
                yield _Gap(payload_stop or previous, again, error)
                position = again
                continue
        position = _next_record(file, failed + 1, end, known)
        refuse_another(file, previous or failed, position)
        yield _Gap(failed, position, error)


def _forget(index: McapIndex, offset: int) -> None:
    """Remove the record that begins here, the last one of the walk, from the index."""
    for places in (index.attachments, index.metadata):
        if offset in places:
            places.remove(offset)
    run = index.segments[-1] if index.segments else None
    if run is not None and not isinstance(run, ChunkSegment) and run.offset <= offset < run.offset + run.length:
        index.segments.pop()
        if run.offset < offset:
            index.segments.append(replace(run, length=offset - run.offset))


def _behind_data_end(file: RecordFile, offset: int, end: int) -> int | None:
    """Return where to continue if the walk ended at a DataEnd before ``end``: a summary without a footer follows."""
    with suppress(DamageError):
        opcode, length = RECORD.unpack(file.read(offset, RECORD.size))
        if opcode == Opcode.DATA_END and offset + RECORD.size + length < end:
            return int(offset + RECORD.size + length)
    return None


def _payload_stop(file: RecordFile, offset: int, end: int) -> int | None:
    """Return where the payload of the chunk that begins here ends; None if none does."""
    chunk = _chunk_in_front(file, offset, end)
    return None if chunk is None else chunk.offset + chunk.length


def _chunk_in_front(file: RecordFile, offset: int, end: int) -> ChunkSegment | None:
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


def _end_of_chunk(file: RecordFile, chunk: ChunkSegment, end: int, known: Collection[int]) -> int:
    """Return the offset of the record after a chunk with contradicting lengths."""
    _, length = RECORD.unpack(file.read(chunk.record_offset, RECORD.size))
    for stop in (chunk.offset + chunk.length, chunk.record_offset + RECORD.size + length):
        if stop == end or (chunk.offset < stop < end and _is_record(file, stop, end)):
            return int(stop)
    return _next_record(file, chunk.offset, end, known, _OUTSIDE_CHUNKS)


def _is_record(file: RecordFile, offset: int, end: int) -> bool:
    """Whether a record can begin here: an opcode with a meaning, and a length that fits."""
    if offset + RECORD.size > end:
        return False
    opcode, length = RECORD.unpack(file.read(offset, RECORD.size))
    return bool(has_meaning(opcode) and offset + RECORD.size + length <= end)


def _next_record(
    file: RecordFile,
    start: int,
    end: int,
    known: Collection[int],
    kinds: frozenset[int] = _ANYWHERE,
    *,
    limit: int | None = None,
) -> int:
    """Search, up to ``limit``, for the certain beginning of a record; ``end`` if there is none."""
    overlap = RECORD.size - 1
    stop = end if limit is None else min(end, limit + overlap)
    while start < stop:
        window = file.read(start, min(_WINDOW + overlap, stop - start))
        for match in _RECORD_HEAD.finditer(window):
            position = match.start()
            opcode, length = RECORD.unpack_from(window, position)
            if opcode in kinds and _certain(file, opcode, start + position, length, end, known):
                return start + position
        if start + len(window) >= stop:
            break
        start += len(window) - overlap
    return end


def _certain(file: RecordFile, opcode: int, offset: int, length: int, end: int, known: Collection[int]) -> bool:
    """Whether a possible beginning of a record is certain."""
    following = offset + RECORD.size + length

    def followed() -> bool:
        return following == end or _is_record(file, following, end)

    if opcode == OP_CHUNK:
        head = _chunk_in_front(file, offset, end)
        return head is not None and head.stop == following and (not head.padding or followed())
    if following > end:
        return False
    if opcode == OP_MESSAGE:
        if length < MESSAGE.size - RECORD.size:
            return False
        (channel,) = struct.unpack("<H", file.read(offset + RECORD.size, 2))
        return channel in known and followed()
    if opcode == OP_MESSAGE_INDEX:
        if length < 6:
            return False
        _, size = struct.unpack("<HI", file.read(offset + RECORD.size, 6))
        return bool(size % 16 == 0 and (size == length - 6 or (size < length - 6 and followed())))
    # A parser allocates the declared lengths: no large records are tried but attachments.
    if (length > _WINDOW and opcode != Opcode.ATTACHMENT) or not followed():
        return False
    if opcode == Opcode.ATTACHMENT:
        return length >= 40
    kind = {Opcode.SCHEMA: records.Schema, Opcode.CHANNEL: records.Channel, Opcode.METADATA: records.Metadata}
    try:
        parse(kind[Opcode(opcode)], file.read(offset + RECORD.size, length), offset, file)
    except DamageError:
        return False
    return True


def _adopt(index: McapIndex, indexed: Iterable[Segment], gaps: list[_Gap]) -> None:
    """Add chunks of the summary's index that the walk did not find, because their headers are damaged."""
    found = sorted(index.segments, key=attrgetter("offset"))
    for segment in indexed:
        stop = segment.offset + segment.length
        if any(other.offset < stop and segment.offset < other.offset + other.length for other in found):
            continue
        index.segments.append(segment)
        index.all_counted = False
        for number, gap in enumerate(gaps):
            if gap.start <= segment.offset and stop <= gap.stop:
                # The index has its header, so nothing is lost here.
                gaps[number] = gap._replace(stop=gap.start)


def displaced_chunks(file: RecordFile, segments: Iterable[Segment]) -> dict[int, ChunkSegment]:
    """Find the chunks that are not where the index of a file places them.

    Parameters
    ----------
    file
        The open file.
    segments
        Those of the index.

    Returns
    -------
    dict[int, ChunkSegment]
        By the offset in the index: the chunk that has the same times and sizes, and is at no place of the index.
    """
    walked = McapIndex()
    with suppress(AnotherBeginsError):
        deque(_walked(file, walked, (), file.size - len(MAGIC) * _ends_with_magic(file)), maxlen=0)
    there = {chunk.record_offset: chunk for chunk in walked.segments if isinstance(chunk, ChunkSegment)}
    missing = []
    for chunk in segments:
        if isinstance(chunk, ChunkSegment):
            if (other := there.get(chunk.record_offset)) and _identity(other) == _identity(chunk):
                del there[chunk.record_offset]
            else:
                missing.append(chunk)
    unlisted: dict[tuple[object, ...], list[ChunkSegment]] = {}
    for place in sorted(there, reverse=True):
        unlisted.setdefault(_identity(there[place]), []).append(there[place])
    return {chunk.record_offset: places.pop() for chunk in missing if (places := unlisted.get(_identity(chunk)))}


def is_at_its_place(file: RecordFile, segment: ChunkSegment) -> bool:
    """Whether the chunk of an index is where the index places it."""
    head = _chunk_in_front(file, segment.record_offset, file.size)
    return head is not None and _identity(head) == _identity(segment)


def _identity(chunk: ChunkSegment) -> tuple[object, ...]:
    """Return what a chunk has in common with its index, wherever it is."""
    return chunk.start_ns, chunk.end_ns, chunk.form


# --- Inside chunks ---


def payload_prefix(file: RecordFile, segment: Segment, problem: DamageError) -> tuple[memoryview, DamageError]:
    """Read the records of a damaged segment as far as they can be decompressed, and improve the error."""
    chunk: Segment = segment
    if isinstance(segment, ChunkSegment):
        head = file.read(segment.record_offset, min(CHUNK_HEAD_SIZE, file.size - segment.record_offset))
        with suppress(DamageError):
            found = chunk_at(head, 0, segment.record_offset, file)
            if found.offset + found.length > file.size:
                there = file.size - found.offset
                problem = file.damage(
                    f"the chunk at byte {segment.record_offset} is cut off: it has {there} of {found.length} bytes"
                )
            # A consistent header is right; otherwise the segment is used as it was found.
            consistent = not found.padding or found.form == segment.form
            if head[0] == OP_CHUNK and consistent and found.compression in COMPRESSIONS and found.stop <= file.size:
                chunk = found
    data = file.read(chunk.offset, min(chunk.length, file.size - chunk.offset))
    return memoryview(decompressed_prefix(data, chunk.compression, chunk.uncompressed_size)), problem


def salvaged_messages(data: memoryview, known: Mapping[int, Connection], span: tuple[int, int] | None) -> Salvaged:
    """Find the messages of a damaged chunk.

    Parameters
    ----------
    data
        Its records, as far as they could be decompressed.
    known
        Every channel.
    span
        The first and the last log time that the chunk declares, if it does; see `settled`.
    """
    times, places = array("Q"), array("Q")
    unknown_channel = lost = 0
    for start, stop, sound in _framed(data, known, span):
        if not sound or (data[start] not in _INSIDE_CHUNKS and data[start] < FIRST_PRIVATE):
            lost += stop - start
        elif data[start] == OP_MESSAGE:
            _, _, channel_id, _, log_time_ns, _ = MESSAGE.unpack_from(data, start)
            if channel_id not in known:
                unknown_channel += 1
                continue
            times.append(log_time_ns)
            places.append(start)
    messages = Many(times, places, partial(message_at, data, known), len(data)).together()
    return Salvaged(settled(messages, span) if span else messages, lost, unknown_channel)


def salvaged_records(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the opcodes and contents of the records recovered from a chunk."""
    for start, stop, sound in _framed(data, None, None):
        if sound:
            yield data[start], data[start + RECORD.size : stop]


def _framed(
    data: memoryview, known: Collection[int] | None, span: tuple[int, int] | None
) -> Iterator[tuple[int, int, bool]]:
    """Yield records and the gaps between them: start, stop, and whether it is a record.

    ``known`` None means that no channel is known yet, and any is plausible.
    """
    size = len(data)
    position = 0
    # A record is kept back until the next one begins at its end: its length may be damaged.
    held: tuple[int, int] | None = None
    while position < size:
        stop = _record_end(data, position)
        if stop is not None:
            if held is not None:
                yield *held, True
            held = (position, stop)
            position = stop
            continue
        begin = position
        if held is not None:
            again = _next_message(data, held[0] + 1, position, known, span)
            if again is not None:
                begin, position = held[0], again
            else:
                yield *held, True
        held = None
        if begin == position:
            found = _next_message(data, position + 1, size, known, span)
            position = size if found is None else found
        yield begin, position, False
    if held is not None:
        yield *held, True


def _record_end(data: memoryview, position: int) -> int | None:
    """Return the end of the record that begins here; None if none does."""
    if position + RECORD.size > len(data):
        return None
    opcode, length = RECORD.unpack_from(data, position)
    stop = position + RECORD.size + length
    if stop > len(data) or not has_meaning(opcode):
        return None
    return None if opcode == OP_MESSAGE and length < MESSAGE.size - RECORD.size else int(stop)


def _next_message(
    data: memoryview, start: int, end: int, known: Collection[int] | None, span: tuple[int, int] | None
) -> int | None:
    """Search for the certain beginning of a message before ``end``."""
    for match in _MESSAGE_HEAD.finditer(data, start):
        position = match.start()
        if position >= end:
            return None
        stop = _record_end(data, position)
        if stop is None:
            continue
        _, _, channel_id, _, log_time_ns, _ = MESSAGE.unpack_from(data, position)
        if known is not None and channel_id not in known:
            continue
        if span is not None and not span[0] <= log_time_ns <= span[1]:
            continue
        if stop + RECORD.size > len(data) or _record_end(data, stop) is not None or span is not None:
            return position
    return None
