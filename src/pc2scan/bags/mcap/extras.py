"""Reads the attachments and the metadata records of an MCAP file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import DamageError
from pc2scan.files.crc32 import crc32
from pc2scan.model import Attachment, Metadata

from . import record_types as records
from .record_types import Opcode
from .records import RECORD, parse

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.bags.damage import DamageLog

    from .index import ExtraIndex, McapIndex
    from .records import RecordFile


def attachments_of(file: RecordFile, index: McapIndex, log: DamageLog, *, verify: bool) -> Iterator[Attachment]:
    """Yield attachments in the order of the file; each is read when it is needed."""
    for offset in sorted(index.attachments):
        content = file.record(offset, Opcode.ATTACHMENT)
        try:
            record = parse(records.Attachment, content, offset, file)
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
            record = parse(records.Metadata, content, offset, file)
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
