"""The index of an MCAP file: which chunks, messages outside chunks, channels and schemas it has, and where.

It is read from the summary at the end of the file. Records that the summary does not account for are found by a walk
over the headers of the records; a file without a summary is walked from end to end.
"""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.bags.chunks import Segment, Segments
from pc2scan.bags.reader import ConnectionLimit
from pc2scan.errors import DamageError
from pc2scan.files.compression import crc32

from . import records
from .chunks import CHUNK_HEAD_SIZE, ChunkSegment, chunk_at
from .records import CHUNK, MAGIC, MESSAGE, OP_CHUNK, OP_MESSAGE, OP_MESSAGE_INDEX, RECORD, UINT64, Opcode, parse

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

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

#: Records that no summary may have, and records that no data section may have.
_DATA = frozenset({OP_MESSAGE, OP_CHUNK, Opcode.ATTACHMENT, Opcode.METADATA})
_NO_DATA = frozenset(
    {
        Opcode.HEADER,
        Opcode.FOOTER,
        Opcode.STATISTICS,
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT_INDEX,
        Opcode.METADATA_INDEX,
        Opcode.SUMMARY_OFFSET,
    }
)

#: Messages outside chunks are read in segments of about this size, bytes.
RUN_SIZE = 4 << 20


@dataclass(slots=True)
class McapIndex:
    """What is where in a file, by its summary or by a walk over its records.

    Attributes
    ----------
    profile
        The header's.
    schemas, channels
        By id, in the order found.
    segments
        Chunks, and segments of messages outside chunks, in the order found.
    attachments, metadata
        Offsets of these records in the file.
    statistics
        The summary's, if it has them.
    counts
        Messages by channel, as far as they were counted.
    all_counted
        Whether `counts` has every message.
    channels_listed
        Whether the summary repeats the channels.
    summarized
        Whether a summary has the chunks.
    verified
        Whether the summary's CRC was compared.
    data_end
        Where the data section ends, and its CRC (0 if none was written). None if there is no DataEnd record.
    differing
        A schema or a channel that is declared again differently: its name, and the offset; None if none is.
    rest
        Where bytes between the data section and the summary begin and end; None if there are none.
    limit
        Of the channels and schemas; None before the first.
    """

    profile: str = ""
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    segments: Segments = field(default_factory=Segments)
    attachments: list[int] = field(default_factory=list)
    metadata: list[int] = field(default_factory=list)
    statistics: records.Statistics | None = None
    counts: Counter[int] = field(default_factory=Counter)
    all_counted: bool = True
    channels_listed: bool = False
    summarized: bool = False
    verified: bool = False
    data_end: tuple[int, int] | None = None
    differing: tuple[str, int] | None = None
    rest: tuple[int, int] | None = None
    limit: ConnectionLimit | None = None

    def declare(self, opcode: int, content: Buffer, offset: int, file: RecordFile) -> None:
        """Add a Schema or a Channel; other records are ignored. The first of an id is kept."""
        if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
            return
        record, known = self._declared(opcode, content, offset, file)
        # "A Schema record with an id of zero is invalid and should be ignored."
        if not record.id and opcode == Opcode.SCHEMA:
            return
        held = known.setdefault(record.id, record)
        if held is record:
            self.limit = self.limit or ConnectionLimit(file.path, file.size)
            self.limit.add(len(content), count=opcode == Opcode.CHANNEL)
        elif held != record and self.differing is None:
            self.differing = _name_of(record), offset

    def contradicted_by(self, opcode: int, content: Buffer, offset: int, file: RecordFile) -> str:
        """Return the name of the schema or channel that this record declares differently; empty if it does not."""
        record, known = self._declared(opcode, content, offset, file)
        return _name_of(record) if known.get(record.id, record) != record else ""

    def _declared(
        self, opcode: int, content: Buffer, offset: int, file: RecordFile
    ) -> tuple[records.Schema | records.Channel, dict[int, Any]]:
        """Parse a Schema or a Channel; return it and those that are known."""
        if opcode == Opcode.SCHEMA:
            return parse(records.Schema, content, offset, file), self.schemas
        return parse(records.Channel, content, offset, file), self.channels


def _name_of(record: records.Schema | records.Channel) -> str:
    return f"{type(record).__name__.lower()} {record.id}"


def find_index(file: RecordFile) -> McapIndex:
    """Index a sound file, without channels that only chunks declare.

    Parameters
    ----------
    file
        The open file.

    Raises
    ------
    RecordingError
        If the file is not MCAP.
    DamageError
        If it is cut off, or contradicts itself.
    """
    index = McapIndex()
    start = read_header(file, index)
    end = read_summary(file, index)
    walk = RecordWalk(file, index, index.segments)
    stop = walk.run(start, end)
    if walk.stray:
        raise file.damage(walk.stray)
    if stop != end:
        index.rest = stop, end
    return index


def read_header(file: RecordFile, index: McapIndex) -> int:
    """Check the magic, read the profile, and return the offset of the first record after the header."""
    magic = file.read(0, min(len(MAGIC), file.size))
    if magic != MAGIC:
        raise file.error(
            f"is not an MCAP file: it begins with {magic.hex(' ') or 'nothing'}, expected {MAGIC.hex(' ')}"
        )
    content = file.record(len(MAGIC), Opcode.HEADER)
    index.profile = parse(records.Header, content, len(MAGIC), file).profile
    return len(MAGIC) + RECORD.size + len(content)


def read_summary(file: RecordFile, index: McapIndex, *, verify: bool = True) -> int:
    """Read the summary at the end of the file; returns the end of the data section.

    The chunks are in the order of the file.
    """
    footer_offset = file.size - len(MAGIC) - _FOOTER_SIZE
    tail = file.read(footer_offset, _FOOTER_SIZE + len(MAGIC)) if footer_offset > len(MAGIC) else b""
    opcode, length = RECORD.unpack_from(tail) if tail else (0, 0)
    if not tail.endswith(MAGIC) or opcode != Opcode.FOOTER or length != _FOOTER_SIZE - RECORD.size:
        raise file.damage(f"has no footer at the end of its {file.size} bytes: the recording was cut off")
    footer = parse(records.Footer, tail[RECORD.size : _FOOTER_SIZE], footer_offset, file)
    start = footer.summary_start
    if start == 0:
        return footer_offset
    if not len(MAGIC) <= start <= footer_offset:
        raise file.damage(f"the footer places the summary at byte {start}, allowed is up to {footer_offset}")
    if verify and footer.summary_crc:
        # The CRC includes the footer up to the CRC itself.
        actual = crc32(tail[: _FOOTER_SIZE - 4], file.crc(start, footer_offset))
        if actual != footer.summary_crc:
            raise file.damage(f"the summary's CRC is {actual:08x}, recorded is {footer.summary_crc:08x}")
        index.verified = True
    for kind, content in _records_between(file, start, footer_offset):
        if kind == Opcode.CHUNK_INDEX:
            index.segments.append(_indexed_chunk(content, start, file))
            index.all_counted = False
        elif kind == Opcode.STATISTICS:
            index.statistics = parse(records.Statistics, content, start, file)
        # Attachments and metadata are found by the walk, because it takes little time and the index that @mcap/core
        # 2.2.2 writes for files without chunks has wrong offsets.
        elif kind in _DATA:
            raise file.damage(f"the summary at byte {start} has a record of kind {kind}, which only the data may have")
        else:
            index.declare(kind, content, start, file)
    index.segments.sort()
    places = index.segments.rows["record_offset"]
    if (places[1:] == places[:-1]).any():
        raise file.damage("the summary's index names a chunk twice")
    index.channels_listed = bool(index.channels)
    index.summarized = len(places) > 0
    return start


def _records_between(file: RecordFile, start: int, stop: int) -> Iterator[tuple[int, memoryview]]:
    """Yield the opcodes and contents of the records of a summary, which a long recording has megabytes of."""
    window, offset = _Window(file), start
    while offset + RECORD.size <= stop:
        position = window.locate(offset, RECORD.size)
        opcode, length = RECORD.unpack_from(window.data, position)
        following = offset + RECORD.size + length
        if following > stop:
            break
        position = window.locate(offset, following - offset)
        yield opcode, memoryview(window.data)[position + RECORD.size : position + following - offset]
        offset = following
    if offset != stop:
        raise file.damage(f"the records from byte {start} on do not end after {stop - start} bytes")


def _indexed_chunk(content: memoryview, origin: int, file: RecordFile) -> ChunkSegment:
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
    return ChunkSegment(
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
        message_count=max(0, message_index_size - len(ids) * _INDEX_HEAD.size) // _ENTRY.size,
    )


class _Window:
    """A buffered part of the file that follows a walk, so that small records need no system call each."""

    def __init__(self, file: RecordFile) -> None:
        self._file = file
        self._start = 0
        self.data = b""

    def locate(self, offset: int, length: int) -> int:
        """Return the position in `data` of the bytes from ``offset`` on (at most as many as the file has)."""
        position = offset - self._start
        length = min(length, self._file.size - offset)
        if position < 0 or position + length > len(self.data):
            # After a large record that was skipped, another one is likely: little is read ahead.
            ahead = (1 << 18) if position <= len(self.data) else (1 << 12)
            self.data = self._file.read(offset, min(max(length, ahead), self._file.size - offset))
            self._start = offset
            position = 0
        return position


class _MessageRun:
    """Consecutive messages outside any chunk, collected by a walk."""

    __slots__ = ("end", "end_ns", "ids", "start", "start_ns")

    def __init__(self, start: int, log_time_ns: int) -> None:
        self.start = self.end = start
        self.start_ns = self.end_ns = log_time_ns
        self.ids: set[int] = set()

    def add(self, channel_id: int, log_time_ns: int, end: int) -> None:
        self.ids.add(channel_id)
        self.end = end
        self.start_ns = min(self.start_ns, log_time_ns)
        self.end_ns = max(self.end_ns, log_time_ns)

    def segment(self) -> Segment:
        size = self.end - self.start
        return Segment(self.start, size, size, self.start_ns, self.end_ns, connection_ids=frozenset(self.ids))


class RecordWalk:
    """A walk over the headers of records, without reading their contents.

    Parameters
    ----------
    file
        The open file.
    index
        Gets the results. If the walk fails, it has everything before the damage.
    chunks
        Those that are known already, in the order of the file.
    """

    def __init__(self, file: RecordFile, index: McapIndex, chunks: Segments | None = None) -> None:
        self._file = file
        self._index = index
        rows = (Segments() if chunks is None else chunks).rows
        # Message indexes may have any length, which must not overflow.
        behind = rows["offset"] + rows["length"] + rows["padding"] + np.minimum(rows["index_length"], 1 << 62)
        #: Where each of them begins, and where the record after its message indexes does.
        self._known = zip(rows["record_offset"].copy().data, behind.data, strict=True)
        self._run: _MessageRun | None = None
        self._chunk: ChunkSegment | None = None
        self._indexed: Counter[int] = Counter()
        self._is_behind_chunk = False
        #: Offsets of the current record and the one before it, for a walk that failed.
        self.offset = self.previous = 0
        #: What is wrong with the first record that may not be where it is, though it can be skipped.
        self.stray = ""

    def run(self, offset: int, end: int) -> int:
        """Walk from the record at byte ``offset`` to DataEnd or byte ``end``; returns the end.

        Raises
        ------
        RecordingError
            If a record reaches beyond ``end`` or is malformed.
        """
        window, known = _Window(self._file), self._known
        coming, behind = next(known, (end, end))
        complete = is_missing = False
        try:
            while offset < end:
                self.previous, self.offset = self.offset, offset
                while coming < offset:
                    (coming, behind), is_missing = next(known, (end, end)), True
                if coming == offset:
                    self._close()
                    self._is_behind_chunk = True
                    if not offset < behind <= end:
                        raise self._beyond(offset, behind, end)
                    offset = behind
                    coming, behind = next(known, (end, end))
                    continue
                position = window.locate(offset, MESSAGE.size)
                if offset + RECORD.size > end:
                    raise self._beyond(offset, offset + RECORD.size, end)
                opcode, length = RECORD.unpack_from(window.data, position)
                following = offset + RECORD.size + length
                if following > end:
                    raise self._beyond(offset, following, end)
                if opcode == OP_MESSAGE:
                    self._message(window.data, position, offset, following)
                elif opcode == Opcode.DATA_END:
                    if length >= 4:
                        (crc,) = struct.unpack_from("<I", window.data, window.locate(offset, 13) + RECORD.size)
                        self._index.data_end = offset, crc
                    offset = following
                    break
                else:
                    self._other(opcode, window, offset, following)
                offset = following
            if is_missing or coming != end:
                raise self._file.damage("the summary's index names places where no chunk begins")
            complete = True
        finally:
            self._close(complete=complete)
        return offset

    def _beyond(self, offset: int, following: int, end: int) -> DamageError:
        return self._file.damage(f"the record at byte {offset} ends at byte {following}, the data at byte {end}")

    def _message(self, data: bytes, position: int, offset: int, following: int) -> None:
        if following - offset < MESSAGE.size:
            raise self._file.damage(
                f"the message at byte {offset} has {following - offset} bytes, at least 31 are needed"
            )
        _, _, channel_id, _, log_time_ns, _ = MESSAGE.unpack_from(data, position)
        run = self._run
        if run is None or following - run.start > RUN_SIZE:
            self._close()
            run = self._run = _MessageRun(offset, log_time_ns)
        run.add(channel_id, log_time_ns, following)
        self._index.counts[channel_id] += 1

    def _other(self, opcode: int, window: _Window, offset: int, following: int) -> None:
        """Add a record that is not a message."""
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            # These may be between messages of one segment; loading it skips them.
            content = self._file.read(offset + RECORD.size, following - offset - RECORD.size)
            self._index.declare(opcode, content, offset, self._file)
        elif opcode == OP_MESSAGE_INDEX:
            position = window.locate(offset, RECORD.size + 6) + RECORD.size
            if following - offset < RECORD.size + 6:
                raise self._file.damage(f"the message index at byte {offset} is too short")
            if not self._is_behind_chunk:
                self.stray = self.stray or f"the message index at byte {offset} follows no chunk"
            channel_id, size = struct.unpack_from("<HI", window.data, position)
            if channel_id in self._indexed:
                self.stray = self.stray or f"the message index at byte {offset} is the second of channel {channel_id}"
            self._indexed[channel_id] += size // 16
        elif opcode == 0:
            raise self._file.damage(f"the record at byte {offset} has opcode 0, which no record may have")
        elif opcode <= Opcode.DATA_END:
            # Unknown records end neither a run nor the message indexes after a chunk.
            self._close()
            if opcode == OP_CHUNK:
                position = window.locate(offset, min(CHUNK_HEAD_SIZE, following - offset))
                self._chunk = chunk_at(window.data, position, offset, self._file)
                self._is_behind_chunk = True
            elif opcode == Opcode.ATTACHMENT:
                self._index.attachments.append(offset)
            elif opcode == Opcode.METADATA:
                self._index.metadata.append(offset)
            elif opcode in _NO_DATA:
                self.stray = self.stray or f"the record at byte {offset} is of kind {opcode}, which no data may have"

    def _close(self, *, complete: bool = True) -> None:
        """Finish the run or the chunk; its message indexes are ``complete`` if another record follows."""
        index = self._index
        if self._run is not None:
            index.segments.append(self._run.segment())
            self._run = None
        if self._chunk is not None:
            ids = frozenset(self._indexed) if complete and self._indexed else None
            index.segments.append(replace(self._chunk, connection_ids=ids))
            index.counts.update(self._indexed)
            index.all_counted = index.all_counted and ids is not None
            self._chunk = None
        self._indexed.clear()
        self._is_behind_chunk = False


#: Bytes of message indexes that are read at a time if their number is unknown.
_AHEAD = 4096


def indexed_times(file: RecordFile, segment: Segment, ids: frozenset[int] | None = None) -> dict[int, list[int]] | None:
    """Return the log times of a chunk's messages by channel, from the message indexes after it.

    Parameters
    ----------
    ids
        Only of these channels; None means all.

    Returns
    -------
    dict[int, list[int]] | None
        None if the message indexes do not have all of these channels, or contradict their own lengths.
    """
    if not isinstance(segment, ChunkSegment):
        return None
    known = segment.connection_ids or frozenset()
    missing = set(known if ids is None else known & ids)
    times: dict[int, list[int]] = {}
    position = segment.stop
    # Usually, one call reads all of them.
    origin, ahead = position, b""
    while position + _INDEX_HEAD.size <= file.size:
        if position + _INDEX_HEAD.size > origin + len(ahead):
            length = max(0 if ahead else segment.index_length, _AHEAD)
            origin, ahead = position, file.read(position, min(length, file.size - position))
        opcode, length, channel_id, size = _INDEX_HEAD.unpack_from(ahead, position - origin)
        start = position + _INDEX_HEAD.size
        position += RECORD.size + length
        if opcode != OP_MESSAGE_INDEX:
            if opcode <= Opcode.DATA_END:
                break
            continue
        if size % _ENTRY.size or start + size > position or start + size > file.size:
            return None
        if ids is None or channel_id in ids:
            missing.discard(channel_id)
            inside = start + size <= origin + len(ahead)
            entries = ahead[start - origin : start - origin + size] if inside else file.read(start, size)
            times.setdefault(channel_id, []).extend(time_ns for time_ns, _ in _ENTRY.iter_unpack(entries))
    return None if missing else times


def find_declarations(
    file: RecordFile,
    index: McapIndex,
    records_of: Callable[[ChunkSegment], Iterable[tuple[int, Buffer]]],
    log: DamageLog,
) -> None:
    """Find channels and schemas inside chunks that were not found outside.

    ``records_of`` returns the opcodes and contents of a chunk's records; ``log`` gets malformed ones.

    Chunks are read in the order of the file, those with messages of unknown channels first, and only as many as
    needed. Without a summary, a channel that has no messages may stay unknown.
    """
    kinds = index.segments.kinds
    # The channels with messages, as far as message indexes have them; and whether these, or a summary, have all.
    used = frozenset[int]().union(*(kind.connection_ids for kind in kinds if kind.connection_ids))
    all_used_known = index.channels_listed or all(kind.connection_ids is not None for kind in kinds)
    read: set[int] = set()
    for are_all_due in (False, True):
        for chunk in index.segments:
            channels, statistics = index.channels, index.statistics
            if (
                (all_used_known if statistics is None else len(channels) >= statistics.channel_count)
                and used <= channels.keys()
                and all(channel.schema_id in index.schemas for channel in channels.values() if channel.schema_id)
            ):
                return
            ids = chunk.connection_ids
            is_due = not index.channels_listed if ids is None else not ids <= channels.keys()
            if isinstance(chunk, ChunkSegment) and (is_due or are_all_due) and chunk.offset not in read:
                read.add(chunk.offset)
                _declare_from(chunk, file, index, records_of, log)


def _declare_from(
    chunk: ChunkSegment,
    file: RecordFile,
    index: McapIndex,
    records_of: Callable[[ChunkSegment], Iterable[tuple[int, Buffer]]],
    log: DamageLog,
) -> None:
    """Add the channels and schemas that a chunk declares."""
    for opcode, content in records_of(chunk):
        try:
            index.declare(opcode, content, chunk.offset, file)
        except DamageError as err:
            log.note(err, offset=chunk.record_offset, key=opcode, bytes_lost=len(content))
