"""Reads the summary of an MCAP file: connections, counts, attachments and metadata.

What the summary declares is compared with the content.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.bags.qos import latches
from pc2scan.errors import DamageError, stamp_text
from pc2scan.files.compression import crc32
from pc2scan.model import Attachment, Connection, Definition, Metadata, Summary

from . import records
from .chunks import ChunkSegment
from .records import RECORD, Opcode, parse

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.bags.damage import DamageLog

    from .index import ExtraIndex, McapIndex
    from .records import RecordFile

_SERIALIZATION_OF_SCHEMA = {"ros1msg": "ros1", "ros2msg": "cdr", "ros2idl": "cdr"}


_SERIALIZATION_OF_PROFILE = {"ros1": "ros1", "ros2": "cdr"}


def connections_of(index: McapIndex, file: RecordFile, log: DamageLog) -> Iterator[Connection]:
    """Yield a connection for each channel; a schema that is missing is noted as damage."""
    for channel in index.channels.values():
        schema = index.schemas.get(channel.schema_id)
        if schema is None and channel.schema_id:
            missing = f"channel {channel.id} has schema {channel.schema_id}, which is not in the file"
            log.note(file.damage(missing), key=channel.id)
        yield _connection(channel, schema, index)


def _connection(channel: records.Channel, schema: records.Schema | None, index: McapIndex) -> Connection:
    metadata = channel.metadata
    encoding = schema.encoding if schema else ""
    serialization = (
        channel.message_encoding
        or _SERIALIZATION_OF_SCHEMA.get(encoding)
        or _SERIALIZATION_OF_PROFILE.get(index.profile, "")
    )
    qos = metadata.get("offered_qos_profiles", "")
    ros1 = serialization == "ros1"
    return Connection(
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
        message_count=_message_count(channel.id, index),
        schema_id=channel.schema_id,
    )


def _message_count(channel_id: int, index: McapIndex) -> int | None:
    statistics = index.statistics
    if statistics is None:
        return index.counts[channel_id] if index.all_counted else None
    # Writers may omit the counts by channel.
    if statistics.message_count and not statistics.channel_message_counts:
        return None
    return statistics.channel_message_counts.get(channel_id, 0)


def summary_of(index: McapIndex, file: RecordFile, log: DamageLog) -> Summary:
    """Return the summary; statistics that contradict the messages' log times are noted as damage."""
    statistics = index.statistics
    if statistics is not None:
        count: int | None = statistics.message_count
        times = (statistics.message_start_time, statistics.message_end_time) if count else None
    else:
        count, times = index.counts.total() if index.all_counted else None, None
    # A chunk without messages has both times zero.
    held = [s for s in index.segments if s.connection_ids is not None or s.end_ns]
    found = (min(s.start_ns for s in held), max(s.end_ns for s in held)) if held else None
    covers = times is not None and found is not None and times[0] <= found[0] <= found[1] <= times[1]
    if times and found and not covers:
        log.note(
            file.damage(
                f"the statistics have log times {stamp_text(times[0])} to {stamp_text(times[1])}, "
                f"the messages {stamp_text(found[0])} to {stamp_text(found[1])}"
            ),
            key="statistics",
            messages_lost=0,
        )
    # For a damaged recording, the statistics are more complete.
    times = times if covers and log.found else found or times
    return Summary(
        container="mcap",
        storage="",
        compression=tuple(sorted({segment.compression for segment in index.segments})),
        size_bytes=file.size,
        message_count=count,
        start_ns=times[0] if times else None,
        end_ns=times[1] if times else None,
        profile=index.profile,
    )


def compare_counts(index: McapIndex, file: RecordFile, log: DamageLog) -> None:
    """Note wrong counts and offsets in the summary, except those of messages."""
    statistics = index.statistics
    if log.found:
        return
    if statistics is not None:
        for kind, declared, places in (
            ("attachments", statistics.attachment_count, index.attachments),
            ("metadata records", statistics.metadata_count, index.metadata),
        ):
            if len(places) < declared:
                error = f"the statistics count {declared} {kind}, {len(places)} were found"
                log.note(file.damage(error), key=kind)
        for kind, declared, fewest, most in _declaration_counts(index, statistics):
            # Some writers count nothing, some only declarations with messages, and some unwritten ones, too.
            if declared and not (fewest <= declared and (declared <= most or not index.channels_listed)):
                error = f"the statistics count {declared} {kind}, {most} were found"
                log.note(file.damage(error), key=kind, messages_lost=0)
    begun = {*index.attachments, *index.metadata}
    # The index that @mcap/core 2.2.2 writes for files without chunks has wrong offsets.
    for offset, entry in index.extra_indexes.items() if index.summarized else ():
        if offset not in begun:
            kind = "attachment" if isinstance(entry, records.AttachmentIndex) else "metadata record"
            error = f"the summary has the {kind} {entry.name!r:.80} at byte {offset}, where none is"
            log.note(file.damage(error), offset=offset, key="index", messages_lost=0)


def _declaration_counts(index: McapIndex, statistics: records.Statistics) -> Iterator[tuple[str, int, int, int]]:
    """Yield for channels, schemas and chunks the count of the statistics, and the smallest and largest right count."""
    used = {number for number, count in statistics.channel_message_counts.items() if count}
    channels = [index.channels[number] for number in used if number in index.channels]
    schemas = {channel.schema_id for channel in channels} - {0}
    chunks = sum(isinstance(segment, ChunkSegment) for segment in index.segments)
    yield "channels", statistics.channel_count, len(used), len(index.channels)
    yield "schemas", statistics.schema_count, len(schemas), len(index.schemas)
    yield "chunks", statistics.chunk_count, chunks, chunks


def attachments_of(file: RecordFile, index: McapIndex, log: DamageLog, *, verify: bool) -> Iterator[Attachment]:
    """Yield attachments in the order of the file; each is read when it is needed."""
    for offset in sorted(index.attachments):
        content = file.record(offset, Opcode.ATTACHMENT)
        try:
            record = parse(records.AttachmentRecord, content, offset, file)
            # The CRC follows the data, which follow two times, two strings and their own length.
            texts = len(record.name.encode()) + len(record.media_type.encode())
            covered = 8 + 8 + 4 + 4 + texts + 8 + len(record.data)
        except DamageError as err:
            log.note(err, offset=offset, bytes_lost=len(content))
            continue
        if verify and record.crc and (actual := crc32(memoryview(content)[:covered])) != record.crc:
            log.note(
                file.damage(f"attachment {record.name!r} has CRC {actual:08x}, recorded is {record.crc:08x}"),
                offset=offset,
            )
        expected = records.AttachmentIndex(
            offset=offset,
            length=RECORD.size + len(content),
            log_time=record.log_time,
            create_time=record.create_time,
            data_size=len(record.data),
            name=record.name,
            media_type=record.media_type,
        )
        _compare(file, index, log, offset, expected, record.name)
        yield Attachment(record.name, record.media_type, record.log_time, record.create_time, record.data)


def metadata_of(file: RecordFile, index: McapIndex, log: DamageLog) -> Iterator[Metadata]:
    """Yield metadata records in the order of the file."""
    for offset in sorted(index.metadata):
        content = file.record(offset, Opcode.METADATA)
        try:
            record = parse(records.MetadataRecord, content, offset, file)
        except DamageError as err:
            log.note(err, offset=offset, bytes_lost=len(content))
            continue
        expected = records.MetadataIndex(offset, RECORD.size + len(content), record.name)
        _compare(file, index, log, offset, expected, record.name)
        yield Metadata(record.name, record.metadata)


def _compare(file: RecordFile, index: McapIndex, log: DamageLog, offset: int, expected: ExtraIndex, name: str) -> None:
    """Note an attachment or a metadata record that the summary contradicts."""
    if index.extra_indexes.get(offset, expected) != expected:
        kind = "attachment" if isinstance(expected, records.AttachmentIndex) else "metadata record"
        error = file.damage(f"the summary contradicts the {kind} {name!r:.80} at byte {offset}")
        log.note(error, offset=offset, key="index", messages_lost=0)
