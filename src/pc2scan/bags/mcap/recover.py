"""Recovers the records of a damaged MCAP file, and the records of a damaged chunk.

The file is walked from the front, record after record. Behind damage the walk goes on at the next opcode with a length
that leads to another record, at the latest at the next chunk of the index. What follows the end of a recording
(``cat a.mcap b.mcap``) is not read.
"""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from mcap.opcode import Opcode

from pc2scan.bags.chunks import Record, Segment, Segments, times_around
from pc2scan.bags.damage import DamageLog
from pc2scan.errors import DamageError
from pc2scan.files.compression import decompressed_prefix

from .index import McapIndex, RecordWalk, read_header, read_summary
from .records import (
    CHUNK_HEAD_SIZE,
    COMPRESSIONS,
    DECLARATIONS,
    MAGIC,
    MESSAGE,
    OP_CHUNK,
    OP_MESSAGE,
    RECORD,
    chunk_at,
    form_of,
    parse_fields,
)

if TYPE_CHECKING:
    from .records import RecordFile

#: The beginning of a record: an opcode, and a length below 2^36.
_BEGINNING = re.compile(rb"(?=[\x03-\x07\x09\x0c\x0f][\s\S]{4}[\0-\x0f]\0\0\0)")

#: Records that chunks are made of.
_INSIDE_CHUNKS = frozenset({OP_MESSAGE, *DECLARATIONS})


def recover_index(file: RecordFile, problem: DamageError, log: DamageLog) -> McapIndex:
    """Index a damaged file; ``problem`` is the error of indexing it as a sound one.

    Chunks may be cut off at the end of the file.
    """
    if log.strict:
        raise problem
    index, errors = McapIndex(log), list[DamageError]()
    position, end = len(MAGIC), file.size
    if file.read(end - len(MAGIC), len(MAGIC)) == MAGIC:
        end -= len(MAGIC)
    try:
        position = read_header(file, index)
    except DamageError as err:
        errors.append(err)
    profile = index.profile
    try:
        end = read_summary(file, index)
    except DamageError as err:
        errors.append(err)
        index = McapIndex(log, profile)
    gaps = _walk(file, index, position, end)
    segments, index.segments = index.segments, Segments()
    for segment in segments:
        # Message indexes may be missing, or be those of another chunk.
        index.segments.append(replace(segment, connection_ids=None))
    index.segments.sort()
    around = times_around(index.segments)
    for error in errors if errors or gaps else [problem]:
        log.note(error, key=error.message, **around(file.size, file.size))
    for start, stop, error in gaps:
        log.note(error, offset=start, bytes_lost=stop - start, **around(start, stop))
    return index


def _walk(file: RecordFile, index: McapIndex, position: int, end: int) -> list[tuple[int, int, DamageError]]:
    """Walk over all records up to a byte; return where none is, and why. The chunks in the index help."""
    gaps: list[tuple[int, int, DamageError]] = []
    indexed = {chunk.record_offset: chunk for chunk in index.segments}
    heads = [place for place, chunk in sorted(indexed.items()) if is_at_its_place(file, chunk)]
    index.segments = Segments()
    for place in heads:
        index.segments.append(indexed[place])
    while position < end:
        coming = range(bisect_left(heads, position), len(heads))
        walk = RecordWalk(file, index, ((heads[number], indexed[heads[number]].stop) for number in coming))
        try:
            walk.run(position, end)
            break
        except DamageError as err:
            failed, error = walk.offset, err
        if file.read(failed, min(len(MAGIC), end - failed)) == MAGIC:
            stop = failed + len(MAGIC)
            gaps.append((stop, file.size, file.damage("the recording ends here: what follows is not read")))
            break
        following = bisect_right(heads, failed)
        search = _Search(file, heads[following] if following < len(heads) else end)
        chunk = indexed.get(failed) or _chunk_in_front(file, failed, search.end)
        stop = _end_of_chunk(search, chunk) if chunk else 0
        if chunk is not None:
            index.segments.append(replace(chunk, length=min(chunk.length, stop - chunk.offset), padding=0))
        position = stop or search.next_record(failed)
        gaps.append((failed, failed if stop else position, error))
    return gaps


class _Search(NamedTuple):
    """A search for records in a file, before byte ``end``; see `_walk`."""

    file: RecordFile
    end: int

    def next_record(self, failed: int, *, after_chunk: bool = False) -> int:
        """Search behind damage for an opcode with a length that leads to another record; the end if there is none."""
        for position in self.file.search(_BEGINNING, failed + 1, self.end, RECORD.size):
            if after_chunk and self.file.nearby(position, 1)[0] in _INSIDE_CHUNKS:
                continue
            if (stop := self.stop_of(position)) is not None and self.is_record(stop):
                return position
        return self.end

    def is_record(self, offset: int) -> bool:
        """Whether a record can begin here, or the end is here."""
        return offset == self.end or self.stop_of(offset) is not None

    def stop_of(self, offset: int) -> int | None:
        """Return the end of the record that may begin here; None if none can."""
        if offset + RECORD.size > self.end:
            return None
        opcode, length = RECORD.unpack(self.file.read(offset, RECORD.size))
        stop = offset + RECORD.size + length
        is_short = opcode == OP_MESSAGE and length < MESSAGE.size - RECORD.size
        return int(stop) if 0 < opcode <= Opcode.DATA_END and stop <= self.end and not is_short else None


def _chunk_in_front(file: RecordFile, offset: int, end: int) -> Segment | None:
    """Return the chunk whose record begins here, if its header is plausible; only its lengths may be wrong."""
    data = file.read(offset, min(CHUNK_HEAD_SIZE, end - offset))
    if data[:1] != bytes([OP_CHUNK]):
        return None
    with suppress(DamageError):
        chunk = chunk_at(data, offset, file, fits=False)
        if chunk.compression in COMPRESSIONS and chunk.start_ns <= chunk.end_ns:
            return chunk
    return None


def is_at_its_place(file: RecordFile, chunk: Segment) -> bool:
    """Whether a chunk of the index is where the index places it."""
    head = _chunk_in_front(file, chunk.record_offset, file.size)
    return head is not None and form_of(head) == form_of(chunk) and head.start_ns == chunk.start_ns


def _end_of_chunk(search: _Search, chunk: Segment) -> int:
    """Return the offset of the record after a chunk, by any of its lengths."""
    _, length = RECORD.unpack(search.file.read(chunk.record_offset, RECORD.size))
    for stop in (chunk.offset + chunk.length, chunk.record_offset + RECORD.size + length):
        if chunk.offset < stop and search.is_record(stop):
            return int(stop)
    return search.next_record(chunk.offset, after_chunk=True)


# --- Chunks ---


def displaced_chunks(file: RecordFile, segments: Segments) -> dict[int, Segment]:
    """Find the chunks that are not where the index of a file places them, by their places in the index."""
    walked = McapIndex(DamageLog())
    _walk(file, walked, len(MAGIC), file.size - len(MAGIC))
    actual = {chunk.record_offset: chunk for chunk in walked.segments if chunk.record_offset}
    listed = {chunk.record_offset for chunk in segments}
    vacant, unlisted = sorted(listed - actual.keys()), sorted(actual.keys() - listed)
    return dict(zip(vacant, map(actual.__getitem__, unlisted), strict=False))


def payload_prefix(file: RecordFile, segment: Segment) -> memoryview:
    """Read the records of a damaged segment as far as they can be decompressed."""
    chunk = segment
    if segment.record_offset:
        head = _chunk_in_front(file, segment.record_offset, file.size)
        # A consistent header is right, not the index.
        if head is not None and head.stop <= file.size and (not head.padding or form_of(head) == form_of(segment)):
            chunk = head
    data = file.read(chunk.offset, min(chunk.length, file.size - chunk.offset))
    # As for the library, an unknown compression is none.
    compression = chunk.compression if chunk.compression in COMPRESSIONS else "none"
    return memoryview(decompressed_prefix(data, compression, chunk.uncompressed_size))


def record_at(data: memoryview, place: int) -> Record | None:
    """Return the record that begins at a place of a damaged chunk; None if none does."""
    if place + RECORD.size > len(data):
        return None
    opcode, length = RECORD.unpack_from(data, place)
    stop = place + RECORD.size + length
    if opcode == OP_MESSAGE and place + MESSAGE.size <= len(data):
        _, _, channel_id, sequence, log_time_ns, publish_time_ns = MESSAGE.unpack_from(data, place)
        start = place + MESSAGE.size
        return Record(
            stop if stop >= start else len(data) + 1, start, channel_id, log_time_ns, publish_time_ns, sequence
        )
    if opcode in DECLARATIONS:
        if stop > len(data) or (stop < len(data) and data[stop] not in _INSIDE_CHUNKS):
            # Its length is wrong: its fields say where it ends.
            with suppress(DamageError):
                stop = place + RECORD.size + parse_fields(DECLARATIONS[opcode], data[place + RECORD.size :], 0)[1]
        return Record(stop)
    # Unknown records are of later specifications, or private.
    return Record(stop) if opcode > Opcode.DATA_END else None
