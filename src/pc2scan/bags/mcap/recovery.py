"""Recovers the records of a damaged MCAP file, and the messages of a damaged chunk.

If the walk over the records fails, it continues at the next certain beginning of a record (`search`); the same is done
inside chunks. Bytes that belong to no record are noted as lost.
"""

from __future__ import annotations

from array import array
from collections import deque
from contextlib import suppress
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.chunked.salvage import SalvagedMessages, clamp_times
from pc2scan.bags.chunked.segments import times_around
from pc2scan.bags.concatenation import NextRecordingError
from pc2scan.bags.lazy_items import LazyItems
from pc2scan.errors import DamageError
from pc2scan.files.salvage import decompressed_prefix

from .chunks import CHUNK_HEAD_SIZE, ChunkSegment, chunk_at
from .index import McapIndex, RecordWalk, read_header, read_summary
from .messages import message_at
from .records import (
    COMPRESSIONS,
    FIRST_PRIVATE,
    MAGIC,
    MESSAGE,
    OP_CHUNK,
    OP_MESSAGE,
    RECORD,
    Opcode,
)
from .search import (
    WINDOW,
    chunk_in_front,
    end_of_chunk,
    end_of_declaration,
    end_of_framed,
    included_record,
    is_message,
    is_record,
    next_message,
    next_record,
    payload_stop,
    record_end,
    refuse_another,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.bags.damage import DamageLog
    from pc2scan.model import Connection, RawMessage

    from .records import RecordFile

#: Records that chunks are made of.
_INSIDE_CHUNKS = frozenset({OP_MESSAGE, int(Opcode.SCHEMA), int(Opcode.CHANNEL)})


class _Gap(NamedTuple):
    """A part of the file that belongs to no record, and why."""

    start: int
    stop: int
    error: DamageError


def recover_index(file: RecordFile, problem: DamageError, log: DamageLog, *, verify: bool) -> McapIndex:
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
    indexed: Sequence[Segment] = ()
    try:
        end, _ = read_summary(file, summary, verify=verify)
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
    gaps = list(_walk(file, index, summary.channels, end))
    for identity, schema in summary.schemas.items():
        index.schemas.setdefault(identity, schema)
    for identity, channel in summary.channels.items():
        index.channels.setdefault(identity, channel)
    index.channels_listed = summary.channels_listed
    _adopt(index, indexed, gaps)
    # Message indexes may be missing, or be those of another chunk.
    index.segments = [replace(segment, connection_ids=None) for segment in index.segments]
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


def _walk(file: RecordFile, index: McapIndex, summarized: Collection[int], end: int) -> Iterator[_Gap]:
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
        chunk = chunk_in_front(file, failed, end)
        if chunk is not None:
            position = end_of_chunk(file, chunk, end, known)
            refuse_another(file, failed, position)
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
                _forget(index, previous)
                yield _Gap(stop or previous, again, error)
                position = again
                continue
        position = next_record(file, failed + 1, end, known)
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
        By the offset in the index: the chunk with the same times and sizes that is at no place of the index, or else
        the next chunk that the index does not have at all.
    """
    walked = McapIndex()
    with suppress(NextRecordingError):
        deque(_walk(file, walked, (), file.size - len(MAGIC) * _ends_with_magic(file)), maxlen=0)
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
