"""The index of an MCAP file: which chunks, messages outside chunks, channels and schemas it has, and where.

It is read from the summary at the end of the file. Records that the summary does not account for are found by a walk
over the headers of the records; a file without a summary is walked from end to end.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Footer, Header, Statistics

from pc2scan.bags.chunks import Segment, Segments
from pc2scan.bags.reader import ConnectionLimit
from pc2scan.errors import DamageError
from pc2scan.files.compression import crc32

from .records import (
    CHUNK,
    CHUNK_HEAD_SIZE,
    DECLARATIONS,
    MAGIC,
    MESSAGE,
    OP_CHUNK,
    OP_MESSAGE,
    OP_MESSAGE_INDEX,
    OP_PRIVATE,
    RECORD,
    UINT64,
    chunk_at,
    parse,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from mcap.records import Channel, Schema

    from pc2scan.bags.damage import DamageLog
    from pc2scan.model import Buffer

    from .records import RecordFile

_FOOTER_SIZE = RECORD.size + 20

#: A chunk's record up to its payload, without the name of its compression.
_CHUNK_HEAD = RECORD.size + CHUNK.size + UINT64.size

#: A message index up to its entries: opcode and length, the channel, and how many bytes of entries follow.
_INDEX_HEAD = struct.Struct("<BQHI")

#: Log time and place in the chunk of one message.
_ENTRY = struct.Struct("<QQ")

#: Records that no summary may have.
_DATA = frozenset({OP_MESSAGE, OP_CHUNK, Opcode.ATTACHMENT, Opcode.METADATA})

#: Messages outside chunks are read in segments of about this size, bytes.
RUN_SIZE = 4 << 20


@dataclass(slots=True)
class McapIndex:
    """What is where in a file, by its summary and by a walk over its records.

    Attributes
    ----------
    log
        Gets schemas and channels that are declared twice, and differently.
    profile
        The header's.
    schemas, channels
        By id, in the order found.
    listed
        The schemas and channels of a summary without CRC: what the data have wins over these.
    segments
        Chunks, and segments of messages outside chunks, in the order found.
    attachments, metadata
        Offsets of these records in the file.
    statistics
        The summary's, if it has them.
    channels_listed
        Whether the summary repeats the channels.
    data_end
        Where the data section ends, and its CRC (0 if none was written). None if there is no DataEnd record.
    limit
        Of the channels and schemas; None before the first.
    outside_chunks
        How many messages are outside chunks.
    """

    log: DamageLog
    profile: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    listed: list[tuple[Schema | Channel, int]] = field(default_factory=list)
    segments: Segments = field(default_factory=Segments)
    attachments: list[int] = field(default_factory=list)
    metadata: list[int] = field(default_factory=list)
    statistics: Statistics | None = None
    channels_listed: bool = False
    data_end: tuple[int, int] | None = None
    limit: ConnectionLimit | None = None
    outside_chunks: int = 0

    def declare(self, opcode: int, content: Buffer, offset: int, file: RecordFile) -> None:
        """Add a Schema or a Channel; other records are ignored. The first of an id is kept."""
        if opcode in DECLARATIONS:
            self.add(parse(DECLARATIONS[opcode], content, offset, file), offset, file, len(content))

    def add(self, record: Schema | Channel, offset: int, file: RecordFile, size: int = 0) -> None:
        """Add a Schema or a Channel that takes so many bytes."""
        known: dict[int, Any] = self.channels if isinstance(record, DECLARATIONS[Opcode.CHANNEL]) else self.schemas
        # "A Schema record with an id of zero is invalid and should be ignored."
        if not record.id and known is self.schemas:
            return
        held = known.setdefault(record.id, record)
        if held is record:
            self.limit = self.limit or ConnectionLimit(file.path, file.size)
            self.limit.add(size, count=known is self.channels)
        elif held != record:
            what = f"{type(record).__name__.lower()} {record.id}"
            self.log.note_index(file, offset, f"{what} is declared again, and differently, at byte {offset}")


def find_index(file: RecordFile, log: DamageLog) -> McapIndex:
    """Index a sound file, without channels that only chunks declare.

    Raises
    ------
    DamageError
        If it is cut off, or contradicts itself.
    """
    index = McapIndex(log)
    start = read_header(file, index)
    end = read_summary(file, index)
    rows = index.segments.rows
    # Message indexes may have any length, which must not overflow.
    behind = rows["offset"] + rows["length"] + rows["padding"] + np.minimum(rows["index_length"], 1 << 62)
    walk = RecordWalk(file, index, zip(rows["record_offset"].copy().data, behind.data, strict=True))
    del rows
    walk.run(start, end)
    return index


def read_header(file: RecordFile, index: McapIndex) -> int:
    """Read the profile, and return the offset of the first record after the header."""
    content = file.record(len(MAGIC), Opcode.HEADER)
    index.profile = parse(Header, content, len(MAGIC), file).profile
    return len(MAGIC) + RECORD.size + len(content)


def read_summary(file: RecordFile, index: McapIndex) -> int:
    """Read the summary at the end of the file; returns the end of the data section.

    The chunks are in the order of the file.
    """
    footer_offset = file.size - len(MAGIC) - _FOOTER_SIZE
    tail = file.read(footer_offset, _FOOTER_SIZE + len(MAGIC)) if footer_offset > len(MAGIC) else b""
    opcode, length = RECORD.unpack_from(tail) if tail else (0, 0)
    if not tail.endswith(MAGIC) or opcode != Opcode.FOOTER or length != _FOOTER_SIZE - RECORD.size:
        raise file.damage(f"has no footer at the end of its {file.size} bytes: the recording was cut off")
    footer = parse(Footer, tail[RECORD.size : _FOOTER_SIZE], footer_offset, file)
    start: int = footer.summary_start
    if start == 0:
        return footer_offset
    if not len(MAGIC) <= start <= footer_offset:
        raise file.damage(f"the footer places the summary at byte {start}, allowed is up to {footer_offset}")
    if footer.summary_crc:
        # The CRC includes the footer up to the CRC itself.
        actual = crc32(tail[: _FOOTER_SIZE - 4], file.crc(start, footer_offset))
        if actual != footer.summary_crc:
            raise file.damage(f"the summary's CRC is {actual:08x}, recorded is {footer.summary_crc:08x}")
    for kind, content in _records_between(file, start, footer_offset):
        if kind == Opcode.CHUNK_INDEX:
            index.segments.append(_indexed_chunk(content, start, file))
        elif kind == Opcode.STATISTICS:
            index.statistics = parse(Statistics, content, start, file)
        # Attachments and metadata are found by the walk, because it takes little time and the index that @mcap/core
        # 2.2.2 writes for files without chunks has wrong offsets.
        elif kind in _DATA:
            raise file.damage(f"the summary at byte {start} has a record with opcode {kind}, which only data may have")
        elif kind in DECLARATIONS:
            record = parse(DECLARATIONS[kind], content, start, file)
            index.listed.append((record, start))
            index.channels_listed |= kind == Opcode.CHANNEL
    if footer.summary_crc:
        declare_listed(file, index)
    index.segments.sort()
    places = index.segments.rows["record_offset"]
    if (places[1:] == places[:-1]).any():
        raise file.damage("the summary's index names a chunk twice")
    return start


def _records_between(file: RecordFile, start: int, stop: int) -> Iterator[tuple[int, memoryview]]:
    """Yield the opcodes and contents of the records of a summary, which a long recording has megabytes of."""
    offset = start
    while offset + RECORD.size <= stop:
        opcode, length = RECORD.unpack(file.nearby(offset, RECORD.size))
        following = offset + RECORD.size + length
        if following > stop:
            break
        yield opcode, memoryview(file.nearby(offset + RECORD.size, length))
        offset = following
    if offset != stop:
        raise file.damage(f"the records from byte {start} on do not end after {stop - start} bytes")


def declare_listed(file: RecordFile, index: McapIndex) -> None:
    """Add the schemas and channels of the summary."""
    for record, offset in index.listed:
        index.add(record, offset, file, len(getattr(record, "data", b"")))
    index.listed.clear()


def _indexed_chunk(content: memoryview, origin: int, file: RecordFile) -> Segment:
    """Return the chunk of a ChunkIndex."""
    # Not with the library's parser, which is many times slower: a long recording has 100,000 of them.
    try:
        start_ns, end_ns, offset, length, offsets_size = struct.unpack_from("<QQQQI", content)
        position = 36 + offsets_size
        ids = frozenset(channel for channel, _ in struct.iter_unpack("<HQ", content[36:position]))
        message_index_size, name_size = struct.unpack_from("<QI", content, position)
        position += 12 + name_size
        compressed, uncompressed = struct.unpack_from("<QQ", content, position)
        name = str(content[position - name_size : position], "utf-8")
    except (struct.error, UnicodeDecodeError) as err:
        raise file.damage(f"a ChunkIndex record in the summary at byte {origin} is malformed") from err
    payload = offset + _CHUNK_HEAD + name_size
    padding = offset + length - payload - compressed
    if padding < 0 or offset + length > origin:
        raise file.damage(
            f"the index places a chunk of {length} bytes at byte {offset}, the data ends at byte {origin}",
        )
    return Segment(
        offset=payload,
        length=compressed,
        compression=name or "none",
        uncompressed_size=uncompressed,
        start_ns=start_ns,
        end_ns=end_ns,
        # Without entries, there are either no message indexes or no messages.
        connection_ids=ids or None,
        record_offset=offset,
        index_length=message_index_size,
        padding=padding,
    )


class RecordWalk:
    """A walk over the headers of records, without reading their contents.

    Parameters
    ----------
    file
        The open file.
    index
        Gets the results. If the walk fails, it has everything before the damage.
    known
        The chunks that the index has already, in the order of the file: where each begins, and where to go on.
    """

    def __init__(self, file: RecordFile, index: McapIndex, known: Iterable[tuple[int, int]]) -> None:
        self._file = file
        self._index = index
        self._known = iter(known)
        #: The chunk, or the messages outside chunks, that is walked over, and its channels.
        self._segment: Segment | None = None
        self._ids: set[int] = set()
        self._is_behind_chunk = False
        #: Offset of the current record, for a walk that failed; or of unknown ones before it, which may be misread.
        self.offset = 0
        self._behind_unknown = 0

    def run(self, offset: int, end: int) -> None:
        """Walk from the record at byte ``offset`` to byte ``end``.

        Raises
        ------
        RecordingError
            If a record is malformed, or reaches beyond ``end`` or into a known chunk.
        """
        coming, behind = next(self._known, (end, end))
        complete = False
        try:
            while offset < end:
                self.offset = self.offset if offset == self._behind_unknown else offset
                is_known, limit = offset == coming, end if offset == coming else coming
                if is_known:
                    self._close()
                    self._is_behind_chunk = True
                    following = behind
                    coming, behind = next(self._known, (end, end))
                else:
                    head = self._file.nearby(offset, min(MESSAGE.size, self._file.size - offset))
                    opcode, length = RECORD.unpack_from(head) if offset + RECORD.size <= coming else (0, 0)
                    following = offset + RECORD.size + length
                if not offset < following <= limit:
                    raise self._file.damage(
                        f"the record at byte {offset} ends at byte {following}, the next chunk or the data at {limit}"
                    )
                if not is_known:
                    self._add(opcode, head, offset, following)
                offset = following
            complete = True
        finally:
            self._close(complete=complete)

    def _add(self, opcode: int, head: bytes, offset: int, following: int) -> None:
        """Add a record to the index."""
        index, size = self._index, following - offset
        if opcode > Opcode.DATA_END:
            self._behind_unknown = following
        if opcode == OP_MESSAGE:
            self._message(head, offset, following)
        elif opcode in DECLARATIONS:
            # These may be between messages of one segment; loading it skips them.
            index.declare(opcode, self._file.read(offset + RECORD.size, size - RECORD.size), offset, self._file)
        elif opcode == OP_MESSAGE_INDEX:
            if size < _INDEX_HEAD.size:
                raise self._file.damage(f"the message index at byte {offset} is too short")
            if not self._is_behind_chunk:
                raise self._file.damage(f"the message index at byte {offset} follows no chunk")
            channel_id = _INDEX_HEAD.unpack_from(head)[2]
            if channel_id in self._ids:
                what = f"the message index at byte {offset} is of a chunk that is not there"
                index.log.note(self._file.damage(what), offset=offset, bytes_lost=size)
            self._ids.add(channel_id)
        elif opcode == 0:
            raise self._file.damage(f"the record at byte {offset} has opcode 0, which no record may have")
        elif opcode <= Opcode.DATA_END:
            # Others end neither a run nor the message indexes after a chunk.
            self._close()
            if opcode == OP_CHUNK:
                self._segment = chunk_at(self._file.nearby(offset, min(CHUNK_HEAD_SIZE, size)), offset, self._file)
                self._is_behind_chunk = True
            elif opcode == Opcode.ATTACHMENT:
                index.attachments.append(offset)
            elif opcode == Opcode.METADATA:
                index.metadata.append(offset)
            elif opcode == Opcode.DATA_END:
                index.data_end = offset, int.from_bytes(head[RECORD.size : RECORD.size + 4], "little")
            elif index.data_end is None:
                raise self._file.damage(f"the record at byte {offset} has opcode {opcode}, which the data may not have")
        elif opcode < OP_PRIVATE:
            unknown = self._file.damage(f"the record at byte {offset} has opcode {opcode}, which MCAP does not have")
            index.log.note(unknown, offset=offset, bytes_lost=size)

    def _message(self, head: bytes, offset: int, following: int) -> None:
        if following - offset < MESSAGE.size:
            raise self._file.damage(
                f"the message at byte {offset} has {following - offset} bytes, at least 31 are needed"
            )
        _, _, channel_id, _, log_time_ns, _ = MESSAGE.unpack(head)
        run = self._segment
        if run is None or run.record_offset or following - run.offset > RUN_SIZE:
            self._close()
            run = self._segment = Segment(offset, 0, 0, log_time_ns, log_time_ns)
        run.length = run.uncompressed_size = following - run.offset
        run.start_ns, run.end_ns = min(run.start_ns, log_time_ns), max(run.end_ns, log_time_ns)
        self._ids.add(channel_id)
        self._index.outside_chunks += 1

    def _close(self, *, complete: bool = True) -> None:
        """Finish the segment; the message indexes of a chunk are ``complete`` if another record follows."""
        segment, self._segment = self._segment, None
        if segment is not None:
            are_known = self._ids and (complete or not segment.record_offset)
            segment.connection_ids = frozenset(self._ids) if are_known else None
            self._index.segments.append(segment)
        self._ids, self._is_behind_chunk = set(), False


def indexed_entries(file: RecordFile, segment: Segment) -> Iterator[tuple[int, Iterator[tuple[int, int]]]]:
    """Yield the channels, and the log times and places of their messages, of the message indexes after a chunk."""
    position = segment.stop if segment.record_offset else file.size
    while position + _INDEX_HEAD.size <= file.size:
        opcode, length, channel_id, size = _INDEX_HEAD.unpack(file.nearby(position, _INDEX_HEAD.size))
        start = position + _INDEX_HEAD.size
        position += RECORD.size + length
        if opcode == OP_MESSAGE_INDEX:
            if size % _ENTRY.size or start + size > min(position, file.size):
                return
            yield channel_id, _ENTRY.iter_unpack(file.nearby(start, size))
        elif opcode <= Opcode.DATA_END:
            return


def find_declarations(
    file: RecordFile,
    index: McapIndex,
    records_of: Callable[[Segment], Iterable[tuple[int, Buffer]]],
) -> None:
    """Find channels and schemas that only chunks declare; the summary has the others.

    ``records_of`` returns the opcodes and contents of a chunk's records; malformed ones are noted. Of chunks with
    message indexes, only those are read that have messages of unknown channels; all, while a schema is missing.
    Without a summary, a channel that has no messages may stay unknown.
    """
    # A long recording has 100,000 chunks, of a few kinds.
    is_any_due = any(_is_due(index, ids) for _, ids in index.segments.kinds)
    for chunk in index.segments if is_any_due else ():
        if chunk.record_offset and _is_due(index, chunk.connection_ids):
            for opcode, content in records_of(chunk):
                try:
                    index.declare(opcode, content, chunk.offset, file)
                except DamageError as err:
                    index.log.note(err, offset=chunk.record_offset, key=opcode, bytes_lost=len(content))
    declare_listed(file, index)


def _is_due(index: McapIndex, ids: frozenset[int] | None) -> bool:
    """Whether a chunk with messages of these channels may declare what is unknown."""
    are_known = index.channels_listed if ids is None else ids <= index.channels.keys()
    return not are_known or not {channel.schema_id for channel in index.channels.values()} <= {0, *index.schemas}
