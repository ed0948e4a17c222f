"""Reads MCAP files, one chunk at a time."""

from __future__ import annotations

from functools import partial
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Metadata as MetadataRecord

from pc2scan.bags.chunks import ChunkedReader, sound_records
from pc2scan.bags.damage import DamageLog
from pc2scan.bags.topics import latches
from pc2scan.bags.zstd import decompress_messages
from pc2scan.errors import DamageError
from pc2scan.files.compression import crc32
from pc2scan.model import Attachment, Connection, Definition, Metadata, StoredChunk, Summary

from .index import McapIndex, find_declarations, find_index, indexed_entries
from .records import (
    ANY_TIME,
    DECLARATIONS,
    OP_PRIVATE,
    RECORD,
    RecordFile,
    parse,
    parse_fields,
    read_chunk,
    scan_messages,
    whole_chunk,
)
from .recover import displaced_chunks, is_at_its_place, payload_prefix, record_at, recover_index

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from pc2scan.bags.chunks import Segment, Selection
    from pc2scan.model import RawMessage


class McapReader(ChunkedReader):
    """Reads an open MCAP file; see `pc2scan.bags.reader.Reader`.

    Each channel becomes a connection: two channels of one topic stay two. Types, definitions and metadata are
    returned as recorded, whatever the profile.

    Parameters
    ----------
    path
        The file.
    strict
        Whether damage is an error; otherwise it is in `damage`, and the rest is recovered.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    DamageError
        With ``strict``, if it is cut off or contradicts itself. Damage inside chunks is found when they are read.
    """

    _file: RecordFile
    has_extras = True
    _container = "mcap"
    _record_at = staticmethod(record_at)

    def __init__(self, path: Path, *, strict: bool = False) -> None:
        self.path = path
        self._file = RecordFile(path)
        self._log = DamageLog(strict=strict)
        #: Chunks that are not where the index places them, by their places in the index; empty until one is missing.
        self._displaced: dict[int, Segment] = {}
        self._lock = Lock()
        try:
            try:
                self._index = find_index(self._file, self._log)
            except DamageError as err:
                self._index = recover_index(self._file, err, self._log)
            find_declarations(self._file, self._index, self._records)
            #: In the order of the summary or, without one, of the file.
            self.connections = tuple(connections_of(self._index, self._file, self._log))
            self._known = {item.id: item for item in self.connections}
            self._segments = self._index.segments
            self._segments.sort()
            self._mend_times(self._times_in)
            compare_content(self._index, self._file, self._log)
            self.summary = summary_of(self._index, self._file)
        except BaseException:
            self._file.close()
            raise

    def _read(self, selection: Selection, segment: Segment, *, whole: bool) -> StoredChunk | list[RawMessage]:
        """Return the wanted messages of a segment, or the chunk as a whole."""
        if whole and selection.rule and segment.record_offset:
            data = whole_chunk(self._file, segment, selection.rule)
            if isinstance(data, StoredChunk):
                return data
        elif segment.record_offset:
            _, _, data = read_chunk(self._file, segment)
        else:
            data = self._file.borrow(segment.offset, segment.length)
        span = (segment.start_ns, segment.end_ns) if segment.record_offset and segment.end_ns else ANY_TIME
        further = partial(self._declare, data, segment) if segment.record_offset else None
        try:
            cut = selection.start_ns, selection.stop_ns
            messages, others = scan_messages(data, selection.wanted, cut, span, further)
        except ValueError as err:
            raise self._file.damage(f"the chunk at byte {segment.offset}: {err}") from err
        if unknown := others - self._known.keys():
            raise self._file.damage(
                f"channel {min(unknown)} has messages near byte {segment.offset}, but is not declared"
            )
        return self._unpacked(segment, messages)

    def _unpacked(self, segment: Segment, messages: list[RawMessage]) -> list[RawMessage]:
        return decompress_messages(messages, self._log, segment.offset, self._file.path)

    def _prefix(self, segment: Segment, problem: DamageError) -> tuple[Segment, memoryview, DamageError]:
        if segment.record_offset and not is_at_its_place(self._file, segment):
            with self._lock:
                self._displaced = self._displaced or displaced_chunks(self._file, self._segments)
            segment = self._displaced.get(segment.record_offset, segment)
        return segment, payload_prefix(self._file, segment), problem

    def _entries(self, segment: Segment) -> Iterator[tuple[int, Iterator[tuple[int, int]]]]:
        return indexed_entries(self._file, segment)

    def _records(self, chunk: Segment) -> Iterator[tuple[int, memoryview]]:
        """Yield the opcodes and contents of a chunk's records, as far as they can be read."""
        data = payload_prefix(self._file, chunk)
        for start, stop, _ in sound_records(data, record_at):
            yield data[start], data[start + RECORD.size : stop]

    def _declare(self, data: memoryview, chunk: Segment, position: int) -> None:
        """Compare a schema or a channel in a chunk with the rest of the file; private records are ignored.

        Raises
        ------
        DamageError
            If the record is malformed, or of a kind that no chunk may have.
        """
        opcode, length = RECORD.unpack_from(data, position)
        start = position + RECORD.size
        self._index.declare(opcode, data[start : start + length], chunk.record_offset, self._file)
        if opcode not in DECLARATIONS and opcode < OP_PRIVATE:
            raise self._file.damage(f"the chunk at byte {chunk.record_offset} has a record with opcode {opcode} in it")

    def _times_in(self, segment: Segment) -> list[int]:
        """Read a segment for the log times of its messages."""
        records = sound_records(payload_prefix(self._file, segment), record_at)
        return [record.log_time_ns for _, _, record in records if record.connection_id in self._known]

    def attachments(self) -> Iterator[Attachment]:
        """Yield attachments in the order of the file; each is read when it is needed."""
        for offset in sorted(self._index.attachments):
            content = self._file.record(offset, Opcode.ATTACHMENT)
            try:
                record, size = parse_fields(AttachmentRecord, content, offset, self.path)
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
        count = None
        # Writers may omit the counts by channel.
        if statistics is not None and (statistics.channel_message_counts or not statistics.message_count):
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


def summary_of(index: McapIndex, file: RecordFile) -> Summary:
    """Return the summary; times are those of the index, or of the statistics if no message is in it."""
    statistics = index.statistics
    # A chunk without messages has both times zero.
    rows, are_known = index.segments.rows, np.array([ids is not None for _, ids in index.segments.kinds], bool)
    held = rows[are_known[rows["kind"]] | (rows["end_ns"] > 0)]
    times = (int(held["start_ns"].min()), int(held["end_ns"].max())) if len(held) else None
    if times is None and statistics is not None and statistics.message_count:
        times = statistics.message_start_time, statistics.message_end_time
    return Summary(
        container="mcap",
        storage="",
        compression=tuple(sorted({compression for compression, _ in index.segments.kinds})),
        size_bytes=file.size,
        message_count=None if statistics is None else statistics.message_count,
        start_ns=times[0] if times else None,
        end_ns=times[1] if times else None,
        profile=index.profile,
    )


def compare_content(index: McapIndex, file: RecordFile, log: DamageLog) -> None:
    """Report what the summary counts and a sound file lacks, and a data section that fails its CRC.

    Messages are counted by chunk; chunks have CRCs of their own, and are not read for that of the data section.
    """
    if log.places:
        return
    chunks = int(np.count_nonzero(index.segments.rows["record_offset"]))
    counts = index.statistics
    for kind, declared, stored, lost in (
        (
            ("attachments", counts.attachment_count, len(index.attachments), None),
            ("metadata records", counts.metadata_count, len(index.metadata), None),
            ("chunks", counts.chunk_count, chunks, 0),
            ("messages", 0 if chunks else counts.message_count, index.outside_chunks, None),
        )
        if counts
        else ()
    ):
        if stored < declared:
            error = file.damage(f"the statistics count {declared} {kind}, {stored} were found")
            log.note(error, key=kind, messages_lost=lost)
    stop, recorded = index.data_end or (0, 0)
    if recorded and not chunks and (value := file.crc(0, stop)) != recorded:
        error = file.damage(f"the data section has CRC {value:08x}, recorded is {recorded:08x}")
        log.note(error, key="data", messages_lost=0 if counts else None)
