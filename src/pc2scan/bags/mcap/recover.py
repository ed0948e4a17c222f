"""Recovers the records of a damaged MCAP file, and the messages of a damaged chunk.

If the walk over the records fails, it continues at the next certain beginning of a record; the same is done inside
chunks. Bytes that belong to no record are noted as lost. The beginning of another file (``cat a.mcap b.mcap``) ends the
first.
"""

from __future__ import annotations

import re
import struct
from array import array
from bisect import bisect_right
from collections import deque
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.bags.chunks import Segments, times_around
from pc2scan.bags.damage import AnotherRecordingError
from pc2scan.bags.loading import LazyItems
from pc2scan.bags.salvage import SalvagedMessages, clamp_times
from pc2scan.errors import DamageError
from pc2scan.files.salvage import decompressed_prefix

from . import records
from .chunks import CHUNK_HEAD_SIZE, ChunkSegment, chunk_at
from .index import McapIndex, RecordWalk, read_header, read_summary
from .records import (
    COMPRESSIONS,
    FIRST_PRIVATE,
    MAGIC,
    MESSAGE,
    OP_CHUNK,
    OP_MESSAGE,
    OP_MESSAGE_INDEX,
    RECORD,
    Opcode,
    has_meaning,
    message_at,
    pack,
    parse,
    unpack,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping

    from pc2scan.bags.chunks import Segment
    from pc2scan.bags.damage import DamageLog
    from pc2scan.model import Connection, RawMessage

    from .records import RecordFile

# --- Search ---

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

#: Limit of a Header's size: it has the names of a profile and of a library.
_MAX_HEADER = 1 << 16


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


def refuse_another(file: RecordFile, start: int, stop: int) -> None:
    """Raise if another file begins in this part of the file, with the magic and a Header."""
    overlap = len(MAGIC) + RECORD.size - 1
    for begin in range(start, stop, WINDOW):
        window = file.read(begin, min(WINDOW + overlap, file.size - begin))
        at = window.find(MAGIC)
        while 0 <= at <= len(window) - overlap - 1:
            opcode, length = RECORD.unpack_from(window, at + len(MAGIC))
            if begin + at > 0 and opcode == Opcode.HEADER and length <= _MAX_HEADER:
                raise AnotherRecordingError(begin + at)
            at = window.find(MAGIC, at + 1)


def refuse_more(file: RecordFile, start: int, end: int) -> None:
    """Raise if another file or more data follow the data section; unknown records may.

    Raises
    ------
    AnotherRecordingError
        If another file begins there.
    DamageError
        If there are more data.
    """
    refuse_another(file, start, end)
    rest, position = McapIndex(), start
    while position < end:
        position = RecordWalk(file, rest).run(position, end)
    if rest.segments or rest.attachments or rest.metadata:
        raise file.damage(f"the data section ends at byte {start}, and more data follow up to byte {end}")


# --- The file ---

#: Records that chunks are made of.
_INSIDE_CHUNKS = frozenset({OP_MESSAGE, int(Opcode.SCHEMA), int(Opcode.CHANNEL)})


class _Gap(NamedTuple):
    """A part of the file that belongs to no record, and why."""

    start: int
    stop: int
    error: DamageError


def recover_index(file: RecordFile, problem: DamageError, log: DamageLog) -> McapIndex:
    """Index a damaged file.

    Parameters
    ----------
    file
        The open file.
    problem
        The error of indexing it as a sound file.
    log
        Gets the damage.

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
    indexed: Iterable[Segment] = ()
    try:
        end = read_summary(file, summary)
    except DamageError as err:
        without_summary = err
        # The walk then includes the records of the summary, and finds channels there.
        summary, doubtful = McapIndex(), McapIndex()
        with suppress(DamageError):
            read_summary(file, doubtful, verify=False)
            # With a wrong CRC, these may still be the only ones that know where a chunk is.
            indexed = doubtful.segments
    else:
        indexed = summary.segments
    index.statistics = summary.statistics
    has_summary = summary.summarized or summary.statistics is not None
    gaps = list(_walk(file, index, summary.channels, end, own=end if has_summary else 0))
    for identity, schema in summary.schemas.items():
        index.schemas.setdefault(identity, schema)
    for identity, channel in summary.channels.items():
        index.channels.setdefault(identity, channel)
    index.channels_listed = summary.channels_listed
    _adopt(index, indexed, gaps)
    # Message indexes may be missing, or be those of another chunk.
    index.segments = Segments(replace(segment, connection_ids=None) for segment in index.segments)
    index.segments.sort()
    around = times_around(index.segments)
    if without_header is not None:
        # The walk begins where it should be. No message is in it, but what took it may have taken more.
        lost = 0 if index.statistics else None
        log.note(without_header, offset=len(MAGIC), key="header", messages_lost=lost)
    elif without_summary is None and not gaps:
        without_summary = problem
    if without_summary is not None:
        log.note(without_summary, **around(file.size, file.size))
    for gap in gaps:
        log.note(gap.error, offset=gap.start, bytes_lost=gap.stop - gap.start, **around(gap.start, gap.stop))
    return index


def _ends_with_magic(file: RecordFile) -> bool:
    return file.size >= 2 * len(MAGIC) and file.read(file.size - len(MAGIC), len(MAGIC)) == MAGIC


def _walk(file: RecordFile, index: McapIndex, summarized: Collection[int], end: int, *, own: int) -> Iterator[_Gap]:
    """Walk over all records up to a byte; if that fails, continue at the next one, and yield the gap.

    Parameters
    ----------
    file, index, end
        As for `RecordWalk`.
    summarized
        The channels in the summary.
    own
        Up to here everything belongs to this recording, because its summary follows: another one is part of a message.
        0 if that is unknown.

    Raises
    ------
    AnotherRecordingError
        If another one begins where something is damaged.
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
        chunk = chunk_in_front(file, failed, end)
        if chunk is not None:
            position = end_of_chunk(file, chunk, end, known)
            refuse_another(file, max(failed, own), position)
            index.segments.append(replace(chunk, length=min(chunk.length, position - chunk.offset), padding=0))
            index.all_counted = False
            if position < chunk.offset + chunk.length:
                # The damage of the chunk's contents is noted when it is read; here only that it is cut off.
                yield _Gap(failed, failed, error)
            continue
        declared = _declaration_in_front(file, index, failed, end)
        if declared is not None:
            yield _Gap(failed, failed, error)
            position = declared
            continue
        # A record with a wrong length may include others.
        if previous:
            stop = payload_stop(file, previous, end)
            again = included_record(file, stop or previous + 1, failed, end, known)
            if again is not None:
                refuse_another(file, max(stop or previous, own), again)
                _forget(index, previous)
                yield _Gap(stop or previous, again, error)
                position = again
                continue
        position = next_record(file, failed + 1, end, known)
        refuse_another(file, max(previous or failed, own), position)
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


def _declaration_in_front(file: RecordFile, index: McapIndex, offset: int, end: int) -> int | None:
    """Declare the schema or channel that begins here, if its fields end where a record begins; return its end."""
    data = memoryview(file.read(offset, min(WINDOW, end - offset)))
    stop = end_of_declaration(data)
    if stop is None or not (offset + stop == end or is_record(file, offset + stop, end)):
        return None
    index.declare(data[0], data[RECORD.size : stop], offset, file)
    return offset + stop


def _adopt(index: McapIndex, indexed: Iterable[Segment], gaps: list[_Gap]) -> None:
    """Add chunks of the summary's index that the walk did not find, because their headers are damaged."""
    index.segments.sort()
    rows = index.segments.rows.copy()
    offsets, stops = rows["offset"], np.maximum.accumulate(rows["offset"] + rows["length"])
    beginnings = [gap.start for gap in gaps]
    for segment in indexed:
        stop = segment.offset + segment.length
        # Of those that begin before its end, none may end behind its beginning.
        before = np.searchsorted(offsets, np.uint64(stop))
        if before and stops[before - 1] > segment.offset:
            continue
        index.segments.append(segment)
        index.all_counted = False
        number = bisect_right(beginnings, segment.offset) - 1
        if number >= 0 and stop <= gaps[number].stop:
            # The index has its header, so nothing is lost here.
            gaps[number] = gaps[number]._replace(stop=gaps[number].start)


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
        By the offset in the index: the chunk with the same times and sizes that is at no place of the index, or else
        the next chunk that the index does not have at all.
    """
    walked = McapIndex()
    deque(_walk(file, walked, (), file.size - len(MAGIC) * _ends_with_magic(file), own=file.size), maxlen=0)
    there = _chunks_by_identity(walked.segments)
    missing = _chunks_by_identity(segments)
    # Chunks at their places, then chunks elsewhere, and then chunks in the places of others or of none.
    for identity in missing.keys() & there.keys():
        for place in missing[identity].keys() & there[identity].keys():
            del missing[identity][place], there[identity][place]
    found = {
        place: chunk
        for identity, indexed in missing.items()
        for place, chunk in zip(sorted(indexed), _in_order(there.get(identity, {})), strict=False)
    }
    changed = [chunk for identity, chunks in there.items() if identity not in missing for chunk in chunks.values()]
    rest = {place for indexed in missing.values() for place in indexed} - found.keys()
    unlisted = {chunk.record_offset: chunk for chunk in changed}
    for place in rest & unlisted.keys():
        # Its header is damaged, and it is where it belongs.
        rest.remove(place)
        del unlisted[place]
    return found | dict(zip(sorted(rest), _in_order(unlisted), strict=False))


def _chunks_by_identity(segments: Iterable[Segment]) -> dict[tuple[object, ...], dict[int, ChunkSegment]]:
    """Return the chunks that are alike, by their places."""
    chunks: dict[tuple[object, ...], dict[int, ChunkSegment]] = {}
    for segment in segments:
        if isinstance(segment, ChunkSegment):
            chunks.setdefault(_identity(segment), {})[segment.record_offset] = segment
    return chunks


def _in_order(chunks: Mapping[int, ChunkSegment]) -> list[ChunkSegment]:
    return [chunks[place] for place in sorted(chunks)]


def is_at_its_place(file: RecordFile, segment: ChunkSegment) -> bool:
    """Whether the chunk of an index is where the index places it."""
    head = chunk_in_front(file, segment.record_offset, file.size)
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
            if found.compression not in COMPRESSIONS and found.length == found.uncompressed_size:
                found = replace(found, compression="none")
            if head[0] == OP_CHUNK and consistent and found.compression in COMPRESSIONS and found.stop <= file.size:
                chunk = found
    data = file.read(chunk.offset, min(chunk.length, file.size - chunk.offset))
    return memoryview(decompressed_prefix(data, chunk.compression, chunk.uncompressed_size)), problem


def salvage_messages(
    data: memoryview, known: Mapping[int, Connection], span: tuple[int, int] | None, *, complete: bool
) -> SalvagedMessages:
    """Find the messages of a damaged chunk.

    Parameters
    ----------
    data
        Its records, as far as they could be decompressed.
    known
        Every channel.
    span
        The first and the last log time that the chunk declares, if it does; see `clamp_times`.
    complete
        Whether these are all of its records: a message with a wrong length at their end is then the last one.
    """
    times, places = array("Q"), array("Q")
    unknown_channel = lost = 0
    for start, stop, framed in _find_records(data, known, span):
        sound = framed or (complete and stop == len(data) and is_message(data, start, known, span))
        if not sound or (data[start] not in _INSIDE_CHUNKS and data[start] < FIRST_PRIVATE):
            lost += stop - start
        elif data[start] == OP_MESSAGE:
            _, _, channel_id, _, log_time_ns, _ = MESSAGE.unpack_from(data, start)
            if channel_id not in known:
                unknown_channel += 1
                continue
            times.append(log_time_ns)
            places.append(start)
    messages = LazyItems(times, places, partial(_message_there, data, known), len(data)).as_list()
    return SalvagedMessages(clamp_times(messages, span) if span else messages, lost, unknown_channel)


def _message_there(data: memoryview, known: Mapping[int, Connection], place: int) -> RawMessage:
    """Return the message at a place; one with an impossible length ends with the data."""
    message = message_at(data, known, place)
    return message if record_end(data, place) is not None else message._replace(data=data[place + MESSAGE.size :])


def salvage_records(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the opcodes and contents of the records recovered from a chunk."""
    for start, stop, sound in _find_records(data, None, None):
        if sound:
            yield data[start], data[start + RECORD.size : stop]


def _find_records(
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
        stop = end_of_framed(data, position)
        if stop is not None:
            if held is not None:
                yield *held, True
            held = (position, stop)
            position = stop
            continue
        begin = position
        if held is not None:
            again = next_message(data, held[0] + 1, position, known, span)
            if again is not None:
                begin, position = held[0], again
            else:
                yield *held, True
        held = None
        if begin == position:
            found = next_message(data, position + 1, size, known, span)
            position = size if found is None else found
        yield begin, position, False
    if held is not None:
        yield *held, True
