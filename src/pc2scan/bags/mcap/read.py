"""Reads MCAP files, one chunk at a time."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Metadata as MetadataRecord

from pc2scan.bags.chunks import ChunkedReader, segment_chunks, whole_chunks
from pc2scan.bags.damage import AnotherRecordingError, DamageLog
from pc2scan.bags.loading import LazyItems, map_items
from pc2scan.bags.topics import latches
from pc2scan.bags.zstd import decompress_messages
from pc2scan.errors import DamageError, stamp_text
from pc2scan.files.compression import crc32
from pc2scan.model import Attachment, Connection, Definition, Metadata, StoredChunk, Summary

from .chunks import ChunkSegment, borrow_payload, chunk_at, whole_chunk
from .index import (
    McapIndex,
    find_declarations,
    find_index,
    indexed_entries,
    indexed_times,
    name_of,
)
from .records import (
    ANY_TIME,
    DECLARATIONS,
    RECORD,
    RecordFile,
    parse,
    parse_fields,
    scan_messages,
)
from .recover import displaced_chunks, is_at_its_place, payload_prefix, recover_index, salvage_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping
    from pathlib import Path

    from pc2scan.bags.chunks import Segment
    from pc2scan.bags.formats import ReadOptions
    from pc2scan.bags.loading import Chunk, Item, Loaded
    from pc2scan.bags.reader import Reader
    from pc2scan.model import ChunkRule, RawMessage

    from .records import Messages


def open_reader(path: Path, options: ReadOptions) -> Reader:
    """Open an MCAP file; see `pc2scan.bags.formats.Format`."""
    return McapReader(path, strict=options.strict)


class _Selection(NamedTuple):
    """What is wanted of the segments.

    Attributes
    ----------
    wanted
        The connections, by channel.
    start_ns, stop_ns
        Only messages with ``start_ns <= log_time_ns < stop_ns``.
    rule
        Which chunks may be copied as a whole; None: none.
    """

    wanted: Mapping[int, Connection]
    start_ns: int
    stop_ns: int
    rule: ChunkRule | None


class McapReader(ChunkedReader):
    """Reads an open MCAP file; see `pc2scan.bags.reader.Reader`.

    Each channel becomes a connection: two channels of one topic stay two. Types, definitions and metadata are
    returned as recorded, whatever the profile.

    Parameters
    ----------
    path
        The file. If another one follows in it, it is not read, which is damage.
    strict
        Whether damage is an error; otherwise it is in `damage`, and the rest is recovered.

    Raises
    ------
    RecordingError
        If the file cannot be read or is not MCAP.
    DamageError
        With ``strict``, if it is cut off or contradicts itself. Damage inside chunks is found when they are read.
    """

    _file: RecordFile

    def __init__(self, path: Path, *, strict: bool = False) -> None:
        self.path = path
        self._file = RecordFile(path)
        self._log = DamageLog(strict=strict)
        #: The connections by channel.
        self._known: dict[int, Connection] = {}
        #: Chunks that are not where the index places them, by their places in the index; None until one is missing.
        self._displaced: dict[int, ChunkSegment] | None = None
        self._lock = Lock()
        try:
            try:
                self._index = self._found_index()
            except AnotherRecordingError as another:
                self._log.note_another(self._file, another.offset)
                self._index = self._found_index()
            find_declarations(self._file, self._index, self._records, self._log)
            if self._index.differing is not None:
                self._log.note_index(self._file, self._index.differing[1], _twice(*self._index.differing))
            compare_counts(self._index, self._file, self._log)
            #: In the order of the summary or, without one, of the file.
            self.connections = tuple(connections_of(self._index, self._file, self._log))
            self._known = {item.id: item for item in self.connections}
            self._segments = self._index.segments
            self._segments.sort()
            self._indexed_times = partial(indexed_times, self._file)
            self._are_times_verified = self._index.verified
            self._confirm_ends()
            compare_data_crc(self._index, self._file, self._log)
            self.summary = summary_of(self._index, self._file, self._log)
        except BaseException:
            self._file.close()
            raise

    def _found_index(self) -> McapIndex:
        """Index the file, sound or damaged."""
        try:
            return find_index(self._file)
        except DamageError as err:
            return recover_index(self._file, err, self._log)

    def chunks(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> Iterator[Chunk]:
        """Return chunks, and segments of records outside chunks, by start; see `pc2scan.bags.reader.Reader`."""
        known = wanted = self._known
        if connections is not None:
            wanted = {connection.id: known[connection.id] for connection in connections if connection.id in known}
        # An index that is damaged may have wrong ids.
        ids = None if connections is None or len(wanted) == len(known) else frozenset(wanted)
        if ids is not None and not ids:
            return iter(())
        rule = rule if rule and rule.container == "mcap" else None
        segments = self._segments_with(ids, start_ns, stop_ns)
        whole, due = whole_chunks(segments, rule, start_ns, stop_ns)
        times = (0 if start_ns is None else start_ns, 1 << 64 if stop_ns is None else stop_ns)
        selection = _Selection(wanted, *times, rule)
        return segment_chunks(segments, partial(self._load, selection), self._file, whole, due)

    def _load(
        self, selection: _Selection, segment: Segment, callback: Callable[[RawMessage], Item], *, whole: bool
    ) -> Loaded:
        """Load a segment; see `pc2scan.bags.loading.Load`."""
        found: StoredChunk | Messages | None = None
        # A damaged segment is read again to recover its messages; a damaged chunk is not copied.
        with suppress(DamageError):
            found = self._sound(selection, segment, whole=whole)
        if found is None:
            found = self._recovered(selection, segment)
        return found if isinstance(found, StoredChunk) else map_items(callback, found)

    def _sound(self, selection: _Selection, segment: Segment, *, whole: bool) -> StoredChunk | Messages:
        """Return the wanted messages of a segment, or the chunk as a whole.

        Raises
        ------
        DamageError
            If it is damaged, or a message of it cannot be decompressed.
        """
        seen: StoredChunk | memoryview | None = None
        if whole and selection.rule and isinstance(segment, ChunkSegment):
            seen = whole_chunk(self._file, segment, selection.rule)
        if isinstance(seen, StoredChunk):
            return seen
        data = borrow_payload(self._file, segment) if seen is None else seen
        messages = self._scan(selection, segment, data)
        return decompress_messages(messages, DamageLog(strict=True), segment.offset, self._file.path)

    def _scan(self, selection: _Selection, segment: Segment, data: memoryview) -> Messages:
        """Find the wanted messages among a segment's records.

        Raises
        ------
        DamageError
            If the records are not sound, or contradict what the segment declares.
        """
        wanted, start_ns, stop_ns, _ = selection
        span = _declared_span(segment)
        further = partial(self._compare_declaration, data, segment) if isinstance(segment, ChunkSegment) else None
        scan = scan_messages(data, wanted, start_ns, stop_ns, span or ANY_TIME, further)
        if scan.astray is not None and span:
            raise self._file.damage(
                f"the chunk at byte {segment.offset} has a message of log time {stamp_text(scan.astray)}, "
                f"declared are {stamp_text(span[0])} to {stamp_text(span[1])}"
            )
        if scan.size != len(data):
            raise self._file.damage(
                f"the records from byte {segment.offset} on are sound for {scan.size} of {len(data)} bytes"
            )
        if scan.others and (unknown := scan.others - self._known.keys()):
            raise self._file.damage(
                f"channel {min(unknown)} has messages near byte {segment.offset}, but is not declared"
            )
        return scan.messages

    def _recovered(self, selection: _Selection, segment: Segment) -> Messages:
        """Read a damaged segment, and return what can be recovered of it; the damage is noted."""
        place = self._locate(segment)
        data, problem = self._prefix(place)
        messages: Messages = []
        try:
            if problem is None:
                messages = self._scan(selection, place, data)
        except DamageError as err:
            problem = err
        if problem is not None:
            messages = self._salvage(selection, place, data, problem)
        return decompress_messages(messages, self._log, place.offset, self._file.path)

    def _salvage(self, selection: _Selection, segment: Segment, data: memoryview, problem: DamageError) -> Messages:
        """Note a damaged segment, and recover its messages."""
        if self._log.strict:
            raise problem
        entries = [entry for _, more in indexed_entries(self._file, segment) for entry in more] or None
        wanted, start_ns, stop_ns, _ = selection
        messages, lost = salvage_of(data, self._known, self._file).messages(data, segment, self._known, entries)
        offset = segment.record_offset if isinstance(segment, ChunkSegment) else segment.offset
        self._log.note(problem, offset=offset, **lost)
        ids = wanted.keys()
        return messages.filter(
            lambda item: item.connection.id in ids and start_ns <= item.log_time_ns < stop_ns
        ).as_list()

    def _prefix(self, segment: Segment) -> tuple[memoryview, DamageError | None]:
        """A segment's records as far as they can be decompressed, and why that is not all."""
        try:
            return borrow_payload(self._file, segment), None
        except DamageError as err:
            if self._log.strict:
                raise
            return payload_prefix(self._file, segment, err)

    def _locate(self, segment: Segment) -> Segment:
        """Return a damaged segment, or the chunk elsewhere in the file that the index has in its place."""
        if self._log.strict or not isinstance(segment, ChunkSegment) or is_at_its_place(self._file, segment):
            return segment
        with self._lock:
            if self._displaced is None:
                self._displaced = displaced_chunks(self._file, self._index.segments)
        chunk = self._displaced.get(segment.record_offset, segment)
        problem = f"the index places a chunk at byte {segment.record_offset}, it is at byte {chunk.record_offset}"
        if chunk is not segment:
            lost = 0 if self._index.statistics else None
            self._log.note(self._file.damage(problem), offset=segment.record_offset, key="place", messages_lost=lost)
        return chunk

    def _records(self, chunk: Segment) -> Iterator[tuple[int, memoryview]]:
        """Yield the opcodes and contents of a chunk's records, as far as they can be read."""
        data, _ = self._prefix(self._locate(chunk))
        for start, stop in salvage_of(data, {}, self._file).records(data, (), complete=False):
            yield data[start], data[start + RECORD.size : stop]

    def _compare_declaration(self, data: memoryview, chunk: ChunkSegment, position: int) -> None:
        """Compare a schema or a channel in a chunk with the rest of the file, and note it if it is another.

        Raises
        ------
        DamageError
            If the record is of a kind that no chunk may have. Unknown kinds are ignored.
        """
        opcode, length = RECORD.unpack_from(data, position)
        if opcode not in DECLARATIONS:
            if opcode > Opcode.DATA_END:
                return
            raise self._file.damage(f"the chunk at byte {chunk.record_offset} has a record of kind {opcode} in it")
        start = position + RECORD.size
        try:
            record = parse(DECLARATIONS[opcode], data[start : start + length], chunk.record_offset, self._file)
        except DamageError as err:
            self._log.note(err, offset=chunk.record_offset, key=position, messages_lost=0)
            return
        if self._index.known(record).get(record.id, record) != record:
            self._log.note_index(self._file, chunk.record_offset, _twice(name_of(record), chunk.record_offset))

    def _repeated_span(self, segment: Segment) -> tuple[int, int] | None:
        """Return the times in the message indexes after a chunk, or in its header."""
        if not isinstance(segment, ChunkSegment):
            return segment.start_ns, segment.end_ns
        if span := super()._repeated_span(segment):
            return span
        if self._index.summarized:
            with suppress(DamageError):
                head = self._file.read(segment.record_offset, segment.offset - segment.record_offset)
                chunk = chunk_at(head, segment.record_offset, self._file)
                return chunk.start_ns, chunk.end_ns
        return None

    def _contained_span(self, segment: Segment) -> tuple[int, int] | None:
        """Read a chunk and return the log times of its messages."""
        data, problem = self._prefix(segment)
        messages = scan_messages(data, self._known, 0, 1 << 64).messages
        times = messages.times if isinstance(messages, LazyItems) else [message.log_time_ns for message in messages]
        return (min(times), max(times)) if times and problem is None else None

    def attachments(self) -> Iterator[Attachment]:
        """Yield attachments in the order of the file; each is read when it is needed."""
        for offset in sorted(self._index.attachments):
            content = self._file.record(offset, Opcode.ATTACHMENT)
            try:
                record, size = parse_fields(AttachmentRecord, content, offset, self._file)
            except DamageError as err:
                self._log.note(err, offset=offset, bytes_lost=len(content))
                continue
            # The last field, which the library skips.
            crc = int.from_bytes(content[size - 4 : size], "little")
            if crc and (actual := crc32(content[: size - 4])) != crc:
                problem = f"attachment {record.name!r} has CRC {actual:08x}, recorded is {crc:08x}"
                self._log.note(self._file.damage(problem), offset=offset)
            yield Attachment(record.name, record.media_type, record.log_time, record.create_time, record.data)

    def metadata(self) -> Iterator[Metadata]:
        """Yield metadata records in the order of the file."""
        for offset in sorted(self._index.metadata):
            content = self._file.record(offset, Opcode.METADATA)
            try:
                record = parse(MetadataRecord, content, offset, self._file)
            except DamageError as err:
                self._log.note(err, offset=offset, bytes_lost=len(content))
                continue
            yield Metadata(record.name, record.metadata)


def _twice(what: str, offset: int) -> str:
    return f"{what} is declared again, and differently, at byte {offset}"


def _declared_span(segment: Segment) -> tuple[int, int] | None:
    """Return the first and the last log time that a chunk declares; None if it declares none."""
    if isinstance(segment, ChunkSegment) and 0 < segment.start_ns <= segment.end_ns:
        return segment.start_ns, segment.end_ns
    return None


# --- What the index has ---

_SERIALIZATION_OF_SCHEMA = {"ros1msg": "ros1", "ros2msg": "cdr", "ros2idl": "cdr"}


_SERIALIZATION_OF_PROFILE = {"ros1": "ros1", "ros2": "cdr"}


def connections_of(index: McapIndex, file: RecordFile, log: DamageLog) -> Iterator[Connection]:
    """Yield a connection for each channel; a schema that is missing is noted as damage."""
    statistics = index.statistics
    for channel in index.channels.values():
        schema = index.schemas.get(channel.schema_id)
        if schema is None and channel.schema_id:
            missing = f"channel {channel.id} has schema {channel.schema_id}, which is not in the file"
            log.note(file.damage(missing), key=channel.id)
        metadata = channel.metadata
        encoding = schema.encoding if schema else ""
        serialization = (
            channel.message_encoding
            or _SERIALIZATION_OF_SCHEMA.get(encoding)
            or _SERIALIZATION_OF_PROFILE.get(index.profile, "")
        )
        qos = metadata.get("offered_qos_profiles", "")
        ros1 = serialization == "ros1"
        if statistics is None:
            count = index.counts[channel.id] if index.all_counted else None
        elif statistics.message_count and not statistics.channel_message_counts:
            # Writers may omit the counts by channel.
            count = None
        else:
            count = statistics.channel_message_counts.get(channel.id, 0)
        yield Connection(
            id=channel.id,
            topic=channel.topic,
            msgtype=schema.name if schema else "",
            serialization=serialization,
            definition=Definition(encoding, schema.data) if schema else Definition(),
            digest=metadata.get("topic_type_hash") or metadata.get("md5sum", ""),
            callerid=metadata.get("callerid"),
            latching=metadata.get("latching") in ("1", "true", "True") if ros1 else latches(qos),
            qos=qos,
            metadata=metadata,
            message_count=count,
            schema_id=channel.schema_id,
        )


def summary_of(index: McapIndex, file: RecordFile, log: DamageLog) -> Summary:
    """Return the summary; statistics that contradict the messages' log times are noted."""
    statistics = index.statistics
    if statistics is not None:
        count: int | None = statistics.message_count
        times = (statistics.message_start_time, statistics.message_end_time) if count else None
    else:
        count, times = index.counts.total() if index.all_counted else None, None
    # A chunk without messages has both times zero.
    rows, are_known = index.segments.rows, np.array([ids is not None for _, _, ids in index.segments.kinds], bool)
    held = rows[are_known[rows["kind"]] | (rows["end_ns"] > 0)]
    found = (int(held["start_ns"].min()), int(held["end_ns"].max())) if len(held) else None
    covers = times is not None and found is not None and times[0] <= found[0] <= found[1] <= times[1]
    if times and found and not covers:
        declared, actual = (f"{stamp_text(first)} to {stamp_text(last)}" for first, last in (times, found))
        log.note_index(file, 0, f"the statistics have log times {declared}, the messages {actual}")
    # For a damaged recording, the statistics are more complete.
    times = times if covers and log.found else found or times
    return Summary(
        container="mcap",
        storage="",
        compression=tuple(sorted({kind.compression for kind in index.segments.kinds})),
        size_bytes=file.size,
        message_count=count,
        start_ns=times[0] if times else None,
        end_ns=times[1] if times else None,
        profile=index.profile,
    )


def compare_counts(index: McapIndex, file: RecordFile, log: DamageLog) -> None:
    """Note attachments, metadata records and chunks that the summary counts and the file does not have."""
    statistics = index.statistics
    if statistics is None or log.found:
        return
    chunks = int(np.count_nonzero(index.segments.rows["record_offset"]))
    # Messages are counted, too.
    for kind, declared, found, lost in (
        ("attachments", statistics.attachment_count, len(index.attachments), None),
        ("metadata records", statistics.metadata_count, len(index.metadata), None),
        ("chunks", statistics.chunk_count, chunks, 0),
    ):
        if found < declared:
            error = file.damage(f"the statistics count {declared} {kind}, {found} were found")
            log.note(error, key=kind, messages_lost=lost)


def compare_data_crc(index: McapIndex, file: RecordFile, log: DamageLog) -> None:
    """Note a data section that fails its CRC; chunks have their own, and are not read for it."""
    if index.data_end is None or log.found:
        return
    stop, recorded = index.data_end
    if not recorded or index.segments.rows["record_offset"].any():
        return
    value = file.crc(0, stop)
    if value != recorded:
        lost = None if index.statistics is None else 0
        error = file.damage(f"the data section has CRC {value:08x}, recorded is {recorded:08x}")
        log.note(error, key="data", messages_lost=lost)
