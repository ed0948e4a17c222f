"""Reads MCAP files, one chunk at a time."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from functools import partial
from operator import attrgetter
from threading import Lock
from typing import TYPE_CHECKING

from pc2scan.bags.chunked.index_checks import SpanCheck
from pc2scan.bags.chunked.segments import count_messages, isolated_chunks, segment_units
from pc2scan.bags.concatenation import NextRecordingError, PartReader, note_next, open_parts
from pc2scan.bags.damage import DamageLog
from pc2scan.bags.lazy_items import LazyItems, map_items
from pc2scan.bags.zstd import decompress_messages, is_frame
from pc2scan.errors import DamageError, stamp_text
from pc2scan.files.compression import combine_crc32, crc32
from pc2scan.files.limits import MAX_CONNECTIONS
from pc2scan.files.source import BorrowedBytes
from pc2scan.model import StoredChunk

from .chunks import ChunkSegment, borrow_payload, chunk_at, payload
from .copies import copy_by_content, copy_by_index, shared_channels
from .index import McapIndex, find_declarations, find_index
from .message_index import index_check, indexed_places
from .messages import ANY_TIME, scan_messages
from .records import RECORD, Opcode, RecordFile, split
from .summary import compare_counts, connections_of, summary_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Container, Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.chunked.index_checks import IndexCheck
    from pc2scan.bags.chunked.salvage import SalvagedMessages
    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.bags.damage import Damage
    from pc2scan.bags.formats import ReadOptions
    from pc2scan.bags.reader import Reader
    from pc2scan.bags.units import Item, Loaded, Unit
    from pc2scan.model import Attachment, Buffer, ChunkRule, Connection, Metadata, RawMessage, Summary

    from .messages import Messages


def open_reader(path: Path, options: ReadOptions) -> Reader:
    """Open an MCAP file; see `pc2scan.bags.formats.Format`."""
    return open_parts(lambda start: McapReader(path, verify=options.verify, strict=options.strict, start=start))


class McapReader(PartReader):
    """Reads an open MCAP file; see `pc2scan.bags.reader.Reader`.

    Each channel becomes a connection: two channels of one topic stay two. Types, definitions and metadata are
    returned as recorded, whatever the profile.

    Parameters
    ----------
    path
        The file.
    verify
        Whether to compare the recorded CRCs of the summary, the chunks and the attachments, and in a file without
        chunks that of the data section. The last is compared when all messages were read.
    strict
        Whether damage is an error; otherwise it is in `damage`, and the rest is recovered.

    Raises
    ------
    RecordingError
        If the file cannot be read or is not MCAP.
    DamageError
        With ``strict``, if it is cut off or contradicts itself. Damage inside chunks is found when they are read.
    """

    def __init__(self, path: Path, *, verify: bool = True, strict: bool = False, start: int = 0) -> None:
        self._file = RecordFile(path, start)
        self._log = DamageLog(strict=strict, start=start)
        self._verify = verify
        self._bytes_read = 0
        self._connections: tuple[Connection, ...] = ()
        #: Whether nothing is damaged outside of the chunks.
        self._is_whole = False
        #: Declarations in chunks that agree with those of the file.
        self._agreed: set[bytes] = set()
        #: Places of messages in a chunk by its message indexes, for the latest chunk with records of unknown kinds.
        self._indexed: tuple[int, frozenset[int]] = (-1, frozenset())
        #: Chunks that are not where the index places them, by their places in the index; None until one is missing.
        self._displaced: dict[int, ChunkSegment] | None = None
        self._lock = Lock()
        try:
            try:
                self._index = self._found_index()
            except NextRecordingError as other:
                self._file.end_at(other.offset)
                self._index = self._found_index()
            note_next(self._file, self._log)
            find_declarations(self._file, self._index, self._records, self._log)
            self._note_differing(self._index.differing)
            compare_counts(self._index, self._file, self._log)
            self._connections = tuple(connections_of(self._index, self._file, self._log))
            self._spans = SpanCheck(
                self._index.segments,
                self._indexed_span,
                self._contained_span,
                self._file,
                self._log,
                trusted=self._index.verified,
            )
            self._spans.compare_ends()
            sound = verify and not self._log.found
            self._data_crc = data_crc(self._file, self._index, self._log) if sound else None
            self._summary = summary_of(self._index, self._file, self._log)
            self._is_whole = not self._log.found
        except BaseException:
            self._file.close()
            raise

    def _found_index(self) -> McapIndex:
        """Index the file, sound or damaged."""
        try:
            return find_index(self._file, verify=self._verify)
        except DamageError as err:
            problem = err
        from .recovery import recover_index  # noqa: PLC0415  # only damaged files pay for it

        return recover_index(self._file, problem, self._log, verify=self._verify)

    has_chunks = True

    @property
    def next_start(self) -> int | None:
        """Offset of the MCAP file that follows this one in the file."""
        return self._file.next_start

    @property
    def path(self) -> Path:
        """The path of the file."""
        return self._file.path

    @property
    def connections(self) -> Sequence[Connection]:
        """A connection for each channel, in the order of the summary or, without one, of the file."""
        return self._connections

    @property
    def summary(self) -> Summary:
        """The summary, made without reading messages."""
        return self._summary

    @property
    def bytes_read(self) -> int:
        """Bytes of the segments loaded so far; those read twice count twice."""
        return self._bytes_read

    def units(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> list[Unit]:
        """Return chunks, and segments of records outside chunks, by start; see `pc2scan.bags.reader.Reader`.

        Without verification, whole chunks with complete message indexes are not decompressed.
        """
        known = {connection.id: connection for connection in self._connections}
        wanted = known
        if connections is not None:
            wanted = {connection.id: known[connection.id] for connection in connections if connection.id in known}
        # An index that is damaged may have wrong ids.
        ids = None if connections is None or len(wanted) == len(known) else frozenset(wanted)
        first = 0 if start_ns is None else start_ns
        stop = 1 << 64 if stop_ns is None else stop_ns
        if ids is not None and not ids:
            return []
        rule = rule if rule and rule.container == "mcap" else None
        self._spans.compare_beside(ids, start_ns, stop_ns)
        segments = [s for s in self._index.segments if s.may_hold(ids, start_ns, stop_ns)]
        alone = isolated_chunks(segments, rule, start_ns, stop_ns) if rule else frozenset()
        blindly: frozenset[int] = frozenset()
        if rule and alone and not self._verify and not self._packs(segments[0]):
            blindly = shared_channels(self._index, rule)

        intolerant = DamageLog(strict=True)

        def sound(segment: Segment, data: memoryview) -> Messages:
            span = _declared_span(segment)
            further = partial(self._compare_declaration, data, segment) if isinstance(segment, ChunkSegment) else None
            check = self._check_index(segment, wanted, data)
            scan = scan_messages(data, wanted, first, stop, span or ANY_TIME, further)
            if scan.astray is not None and span:
                raise self._file.damage(
                    f"the chunk at byte {segment.offset} has a message of log time {stamp_text(scan.astray)}, "
                    f"declared are {stamp_text(span[0])} to {stamp_text(span[1])}"
                )
            if scan.size != len(data):
                raise self._file.damage(
                    f"the records from byte {segment.offset} on are sound for {scan.size} of {len(data)} bytes"
                )
            if unknown := scan.others - known.keys():
                raise self._file.damage(
                    f"channel {min(unknown)} has messages near byte {segment.offset}, but is not declared"
                )
            if check is not None:
                is_cut = segment.start_ns < first or stop <= segment.end_ns
                self._compare_index(segment, check, None if is_cut else len(scan.messages))
            return scan.messages

        def read(segment: Segment, callback: Callable[[RawMessage], Item], *, whole: bool) -> Loaded[Item]:
            def compare(records: memoryview, found: int) -> None:
                self._compare_index(segment, self._check_index(segment, wanted, records), found)

            self._bytes_read += segment.length
            seen: StoredChunk | memoryview | None = None
            if rule and whole and isinstance(segment, ChunkSegment):
                # Damaged chunks are not copied.
                with suppress(DamageError):
                    if segment.connection_ids and segment.connection_ids <= blindly:
                        seen = copy_by_index(self._file, segment, rule)
                    seen = seen or copy_by_content(self._file, segment, rule, verify=self._verify, compare=compare)
            if isinstance(seen, StoredChunk):
                return seen

            # A damaged segment is read again to recover its messages.
            with suppress(DamageError):
                # The messages refer to the records, which are overwritten as soon as nothing refers to `payload`.
                payload = (
                    borrow_payload(self._file, segment, verify=self._verify)
                    if seen is None
                    else BorrowedBytes(seen, None)
                )
                if self._data_crc is not None:
                    self._data_crc.add(segment, payload.data)
                messages = sound(segment, payload.data)
                return map_items(callback, decompress_messages(messages, intolerant, segment.offset, self._file.path))
            place = self._locate(segment)
            data, problem = self._prefix(place)
            found: Messages = []
            try:
                if problem is None:
                    found = sound(place, data)
            except DamageError as err:
                problem = err
            if problem is not None:
                found = self._salvage(place, data, problem).select(wanted, first, stop)
            return map_items(callback, decompress_messages(found, self._log, place.offset, self._file.path))

        section = self._data_crc
        if section is None:
            return segment_units(segments, read, alone, self._file)

        def read_and_compare(segment: Segment, callback: Callable[[RawMessage], Item], *, whole: bool) -> Loaded[Item]:
            items = read(segment, callback, whole=whole)
            section.compare()
            return items

        return segment_units(segments, read_and_compare, alone, self._file)

    def _prefix(self, segment: Segment) -> tuple[memoryview, DamageError | None]:
        """A segment's records as far as they can be decompressed, and why that is not all."""
        try:
            return payload(self._file, segment, verify=self._verify), None
        except DamageError as err:
            if self._log.strict:
                raise
            if (found := self._locate(segment)) is not segment:
                return self._prefix(found)
            from .recovery import payload_prefix  # noqa: PLC0415

            return payload_prefix(self._file, segment, err)

    def _locate(self, segment: Segment) -> Segment:
        """Return a damaged segment, or the chunk elsewhere in the file that the index has in its place."""
        if self._log.strict or not isinstance(segment, ChunkSegment):
            return segment
        from .recovery import displaced_chunks, is_at_its_place  # noqa: PLC0415

        if is_at_its_place(self._file, segment):
            return segment
        with self._lock:
            if self._displaced is None:
                self._displaced = displaced_chunks(self._file, self._index.segments)
        found = self._displaced.get(segment.record_offset)
        if found is None:
            return segment
        self._is_whole = False
        problem = f"the index places a chunk at byte {segment.record_offset}, it is at byte {found.record_offset}"
        lost = 0 if self._is_counted else None
        self._log.note(self._file.damage(problem), offset=segment.record_offset, key="place", messages_lost=lost)
        return found

    @property
    def _is_counted(self) -> bool:
        """Whether the file declares how many messages it has, apart from where they are."""
        return self._index.statistics is not None

    def _packs(self, segment: Segment) -> bool:
        """Whether messages are single zstd frames, which one segment shows for all."""
        data, _ = self._prefix(segment)
        known = {connection.id: connection for connection in self._connections}
        return any(map(is_frame, scan_messages(data, known, 0, 1 << 64).messages))

    def _records(self, chunk: Segment) -> Iterator[tuple[int, memoryview]]:
        """A chunk's records, as far as they can be read."""
        data, problem = self._prefix(chunk)
        if problem is None:
            try:
                # All of them first, and none is kept: there may be millions.
                deque(split(data, chunk.offset, self._file), maxlen=0)
                return split(data, chunk.offset, self._file)
            except DamageError as err:
                problem = err
        from .recovery import salvage_records  # noqa: PLC0415

        self._salvage(chunk, data, problem)
        return salvage_records(data)

    def _check_index(self, segment: Segment, ids: Container[int], records: memoryview) -> IndexCheck | None:
        """Compare the message indexes after a chunk with it; None for those of a damaged file."""
        if self._verify and self._is_whole and isinstance(segment, ChunkSegment):
            return index_check(self._file, segment, records, ids)
        return None

    def _compare_index(self, segment: Segment, check: IndexCheck | None, found: int | None) -> None:
        """Note wrong message indexes after a chunk, given how many messages it has."""
        if check is not None and isinstance(segment, ChunkSegment) and (trouble := check.trouble(found)):
            self._log.note(
                self._file.damage(
                    f"the message index behind the chunk at byte {segment.record_offset} contradicts it: {trouble}"
                ),
                offset=segment.record_offset,
                key="index",
                messages_lost=check.lost(found),
                first_ns=segment.start_ns,
                last_ns=segment.end_ns,
            )

    def _compare_declaration(self, data: memoryview, chunk: ChunkSegment, position: int) -> None:
        """Note a schema or a channel that a chunk declares differently from the rest of the file.

        Raises
        ------
        DamageError
            If the record is of a kind that no chunk may have. Unknown kinds are ignored, unless the message index has
            a message there.
        """
        opcode, length = RECORD.unpack_from(data, position)
        if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
            if opcode > Opcode.DATA_END and not self._is_indexed(chunk, position):
                return
            raise self._file.damage(f"the chunk at byte {chunk.record_offset} has a record of kind {opcode} in it")
        start = position + RECORD.size
        record = bytes(data[position : start + length])
        if record in self._agreed:
            return
        try:
            what = self._index.contradicted_by(opcode, record[RECORD.size :], chunk.record_offset, self._file)
        except DamageError as err:
            self._log.note(err, offset=chunk.record_offset, key=record[:64], messages_lost=0)
            return
        if what is not None:
            self._note_differing({what: chunk.record_offset})
        elif len(self._agreed) < MAX_CONNECTIONS:
            self._agreed.add(record)

    def _is_indexed(self, chunk: ChunkSegment, position: int) -> bool:
        """Whether the message indexes after a chunk have a message at this place in it."""
        if not (self._verify and self._is_whole):
            return False
        offset, places = self._indexed
        if offset != chunk.record_offset:
            places = indexed_places(self._file, chunk)
            self._indexed = chunk.record_offset, places
        return position in places

    def _note_differing(self, places: Mapping[str, int]) -> None:
        for what, offset in places.items():
            error = self._file.damage(f"{what} is declared again, and differently, at byte {offset}")
            self._log.note(error, offset=offset, key=what, messages_lost=0)

    def _indexed_span(self, segment: Segment) -> tuple[int, int] | None:
        """Return the log times of a chunk's messages by its message indexes, or by its header; see `SpanCheck`."""
        if not isinstance(segment, ChunkSegment):
            return segment.start_ns, segment.end_ns
        from .message_index import indexed_span  # noqa: PLC0415

        span = indexed_span(self._file, segment)
        if span is None and self._index.summarized:
            with suppress(DamageError):
                head = self._file.read(segment.record_offset, segment.offset - segment.record_offset)
                chunk = chunk_at(head, 0, segment.record_offset, self._file)
                span = chunk.start_ns, chunk.end_ns
        return span

    def _contained_span(self, segment: Segment) -> tuple[int, int] | None:
        """Read a chunk and return the log times of its messages."""
        data, problem = self._prefix(segment)
        known = {connection.id: connection for connection in self._connections}
        messages = scan_messages(data, known, 0, 1 << 64).messages
        times = messages.times if isinstance(messages, LazyItems) else [message.log_time_ns for message in messages]
        return (min(times), max(times)) if times and problem is None else None

    def _salvage(self, segment: Segment, data: memoryview, problem: DamageError) -> SalvagedMessages:
        """Note a damaged segment, and recover its messages."""
        if self._log.strict:
            raise problem
        from pc2scan.bags.chunked.salvage import note_salvaged  # noqa: PLC0415  # only damaged files pay for it

        from .recovery import salvage_messages  # noqa: PLC0415

        known = {connection.id: connection for connection in self._connections}
        complete = len(data) == segment.uncompressed_size
        left = salvage_messages(data, known, _declared_span(segment), complete=complete)
        offset = segment.record_offset if isinstance(segment, ChunkSegment) else segment.offset
        check = self._check_index(segment, known, data)
        indexed = check.total if check else None
        note_salvaged(self._log, problem, segment, offset, len(data), left, indexed, counted=self._is_counted)
        return left

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage in the parts that were read."""
        return self._log.found

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count by the statistics, or for a cut by message indexes; see `pc2scan.bags.reader.Reader`."""

        def by_index(ids: frozenset[int]) -> dict[int, int]:
            from .message_index import counts_between  # noqa: PLC0415  # only topics that are skipped need it

            return counts_between(self._file, self._index.segments, ids, start_ns, stop_ns)

        return count_messages(connections, start_ns, stop_ns, by_index)

    def attachments(self) -> Iterator[Attachment]:
        """Yield attachments in the order of the file; each is read when it is needed."""
        if not self._index.attachments:
            return iter(())
        from .summary import attachments_of  # noqa: PLC0415  # few files have any

        return attachments_of(self._file, self._index, self._log, verify=self._verify)

    def metadata(self) -> Iterator[Metadata]:
        """Yield metadata records in the order of the file."""
        if not self._index.metadata:
            return iter(())
        from .summary import metadata_of  # noqa: PLC0415  # few files have any

        return metadata_of(self._file, self._index, self._log)

    def close(self) -> None:
        """Release the file."""
        self._file.close()


def _declared_span(segment: Segment) -> tuple[int, int] | None:
    """Return the first and the last log time that a chunk declares; None if it declares none."""
    if isinstance(segment, ChunkSegment) and 0 < segment.start_ns <= segment.end_ns:
        return segment.start_ns, segment.end_ns
    return None


#: Bytes between messages are read in pieces of this size.
_PIECE = 4 << 20


class DataCrc:
    """Compares the CRC of a data section when all of its messages were read.

    Parameters
    ----------
    file
        The file.
    segments
        All segments with messages.
    stop
        The end of the data section.
    recorded
        Its recorded CRC.
    log
        Gets a difference.
    counted
        Whether statistics tell if messages are missing.
    """

    def __init__(
        self,
        file: RecordFile,
        segments: Sequence[Segment],
        stop: int,
        recorded: int,
        log: DamageLog,
        *,
        counted: bool,
    ) -> None:
        self._file = file
        self._segments = sorted(segments, key=attrgetter("offset"))
        self._stop = stop
        self._recorded = recorded
        self._log = log
        self._counted = counted
        self._found: dict[int, int] = {}
        self._lock = Lock()

    def add(self, segment: Segment, data: Buffer) -> None:
        """Add a segment that was read; may be called on any thread, and again."""
        self._found[segment.offset] = crc32(data)

    def compare(self) -> None:
        """Compare the CRC when all segments were read.

        Raises
        ------
        DamageError
            If it differs, and damage is an error.
        """
        with self._lock:
            if len(self._found) < len(self._segments):
                return
            found, self._found = self._found, {}
        value = position = 0
        for segment in self._segments:
            value = self._between(value, position, segment.offset)
            value = combine_crc32(value, found[segment.offset], segment.length)
            position = segment.offset + segment.length
        value = self._between(value, position, self._stop)
        if value != self._recorded:
            error = f"the data section has CRC {value:08x}, recorded is {self._recorded:08x}"
            self._log.note(self._file.damage(error), key="data", messages_lost=0 if self._counted else None)

    def _between(self, value: int, start: int, stop: int) -> int:
        for position in range(start, stop, _PIECE):
            value = crc32(self._file.read(position, min(_PIECE, stop - position)), value)
        return value


def data_crc(file: RecordFile, index: McapIndex, log: DamageLog) -> DataCrc | None:
    """Return the comparison for a file; None if it has no CRC, or its chunks have their own."""
    if index.data_end is None or not index.segments:
        return None
    stop, recorded = index.data_end
    if not recorded or any(isinstance(segment, ChunkSegment) for segment in index.segments):
        return None
    return DataCrc(file, index.segments, stop, recorded, log, counted=index.statistics is not None)
