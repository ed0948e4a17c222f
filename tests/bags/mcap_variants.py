"""Valid MCAP files, in all combinations of what the specification leaves to writers.

Modelled on the conformance files of the specification, whose features these are: chunks, message indexes, chunk
indexes, statistics, repeated schemas and channels, indexes of attachments and metadata, summary offsets, and bytes
after the known fields of records. Beyond these: compressions, several chunks, padded records in chunks, records of
unknown kinds, and files without CRCs.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING, TypeAlias

import lz4.frame
import zstandard
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from pc2scan.bags.mcap.records import MAGIC
from support.mcap_files import encoded, record

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

__all__ = ["CONTENTS", "Variant", "file_of", "variants"]

Item: TypeAlias = Schema | Channel | Message | Attachment | Metadata

#: Bytes after the fields of a record that a later specification may define.
_PADDING = b"\x01\xff\xff"
#: Records of a later specification, and private ones.
_UNKNOWN = record(0x10, b"later") + record(0x7F, b"") + record(0x80, b"private") + record(0xFF, b"\x05" * 9)

_PACK = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.ZstdCompressor().compress}


@dataclass(frozen=True)
class Variant:
    """How a file is written.

    Attributes
    ----------
    compression
        Of the chunks; None if there are none.
    padding
        Which records have bytes after their fields: none, those outside chunks, or those in chunks, too.
    """

    compression: str | None = None
    message_index: bool = False
    chunk_index: bool = False
    statistics: bool = False
    schemas: bool = False
    channels: bool = False
    attachment_index: bool = False
    metadata_index: bool = False
    offsets: bool = False
    padding: str = ""
    unknown: bool = False
    crcs: bool = True

    def __str__(self) -> str:
        return ", ".join(f"{name}={value!r}" for name, value in vars(self).items() if value not in (False, "", None))

    @property
    def can_seek(self) -> bool:
        """Whether the library's seeking reader finds the messages."""
        return self.schemas and self.channels and not (self.compression is not None and not self.chunk_index)


def _schema(number: int) -> Schema:
    return Schema(id=number, name=f"Example{number}", encoding="c", data=bytes([4, 5, 6]))


def _channel(number: int, schema: int) -> Channel:
    metadata = {"foo": "bar"} if schema else {}
    return Channel(id=number, topic=f"/topic{number}", message_encoding="a", metadata=metadata, schema_id=schema)


def _message(channel: int, sequence: int, log_time: int) -> Message:
    return Message(
        channel_id=channel, log_time=log_time, data=bytes([1, 2, 3]), publish_time=log_time + 1, sequence=sequence
    )


_ATTACHMENT = Attachment(
    create_time=1, log_time=2, name="myFile", media_type="application/octet-stream", data=b"\1\2\3"
)
_METADATA = Metadata(name="myMetadata", metadata={"foo": "bar"})
_TEN = [_message(1, number, time) for number, time in enumerate((1, 3, 2, 4, 4, 6, 5, 8, 9, 10))]

#: What the files hold.
CONTENTS: dict[str, Sequence[Item]] = {
    "nothing": [],
    "a message without a schema": [_channel(1, 0), _message(1, 10, 2)],
    "a message": [_schema(1), _channel(1, 1), _message(1, 10, 2)],
    "an attachment": [_ATTACHMENT],
    "metadata": [_METADATA],
    "ten messages": [_schema(1), _channel(1, 1), *_TEN],
    "everything": [
        _schema(1),
        _channel(1, 1),
        _channel(2, 0),
        *(replace(message, channel_id=1 + message.sequence % 2) for message in _TEN[:6]),
        _ATTACHMENT,
        _schema(2),
        _channel(3, 2),
        *(replace(message, channel_id=3, log_time=message.log_time + 20) for message in _TEN),
        _METADATA,
        replace(_ATTACHMENT, name="another"),
        _message(1, 11, 40),
    ],
}


def variants(content: Sequence[Item]) -> Iterator[Variant]:
    """Every way to write a content, as far as it makes a difference."""
    kinds = {type(item) for item in content}
    number = 0
    for flags in product((False, True), repeat=9):
        chunked, message_index, chunk_index, statistics, schemas, channels, attached, metadata, offsets = flags
        summary = chunk_index or statistics or schemas or channels or attached or metadata
        if (
            (chunked and Channel not in kinds)
            or ((message_index or chunk_index) and not chunked)
            or (schemas and Schema not in kinds)
            or (channels and Channel not in kinds)
            or (attached and Attachment not in kinds)
            or (metadata and Metadata not in kinds)
            or (attached != metadata and {Attachment, Metadata} <= kinds)
            or (offsets and not summary)
        ):
            continue
        for padding in ("", "outside chunks", "everywhere") if chunked else ("", "outside chunks"):
            number += 1
            # What no other choice depends on alternates.
            compression = sorted(_PACK)[number // 2 % len(_PACK)] if chunked else None
            yield Variant(
                compression, message_index, chunk_index, statistics, schemas, channels, attached, metadata, offsets,
                padding, unknown=number % 2 == 0, crcs=number % 5 != 0,
            )  # fmt: skip


@dataclass
class _File:
    """A file while it is written: its bytes, and the records of its summary by kind."""

    variant: Variant
    data: bytearray = field(default_factory=lambda: bytearray(MAGIC))
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)

    def put(self, item: McapRecord) -> tuple[int, int]:
        """Write a record; returns its place and length."""
        start = len(self.data)
        data = encoded(item)
        # "The Footer and Message records will not be extended."
        if self.variant.padding and not isinstance(item, Message | Footer):
            data = _padded(data)
        self.data += data
        return start, len(data)

    def put_unknown(self) -> None:
        if self.variant.unknown:
            self.data += _UNKNOWN


def _padded(data: bytes) -> bytes:
    return record(data[0], data[9:] + _PADDING)


def file_of(content: Sequence[Item], variant: Variant) -> bytes:
    """Write a content in a way."""
    file = _File(variant)
    file.put(Header(profile="", library=""))
    # A second chunk begins after the first attachment.
    group: list[Schema | Channel | Message] = []
    for item in content:
        file.put_unknown()
        if isinstance(item, Schema | Channel | Message) and variant.compression is not None:
            group.append(item)
        elif isinstance(item, Attachment):
            _put_chunk(file, group)
            start, length = file.put(item)
            file.attachments.append(
                AttachmentIndex(
                    offset=start,
                    length=length,
                    create_time=item.create_time,
                    log_time=item.log_time,
                    data_size=len(item.data),
                    name=item.name,
                    media_type=item.media_type,
                )
            )
        elif isinstance(item, Metadata):
            start, length = file.put(item)
            file.metadata.append(MetadataIndex(offset=start, length=length, name=item.name))
        else:
            file.put(item)
    _put_chunk(file, group)
    file.put(DataEnd(data_section_crc=zlib.crc32(file.data) if variant.crcs else 0))
    _put_summary(file, content)
    return bytes(file.data)


def _put_chunk(file: _File, group: list[Schema | Channel | Message]) -> None:
    """Write the records of a group as a chunk, with message indexes."""
    if not group:
        return
    variant = file.variant
    records = bytearray()
    entries: dict[int, list[tuple[int, int]]] = {}
    for item in group:
        if isinstance(item, Message):
            entries.setdefault(item.channel_id, []).append((item.log_time, len(records)))
        data = encoded(item)
        records += _padded(data) if variant.padding == "everywhere" and not isinstance(item, Message) else data
        records += _UNKNOWN if variant.unknown else b""
    times = [time for found in entries.values() for time, _ in found]
    compression = variant.compression or ""
    packed = bytes(_PACK[compression](bytes(records)))
    chunk = Chunk(
        compression=compression,
        data=packed,
        message_start_time=min(times),
        message_end_time=max(times),
        uncompressed_crc=zlib.crc32(records) if variant.crcs else 0,
        uncompressed_size=len(records),
    )
    start, length = file.put(chunk)
    behind = len(file.data)
    places = {}
    if variant.message_index:
        for number, found in entries.items():
            places[number], _ = file.put(MessageIndex(channel_id=number, records=found))
    file.chunks.append(
        ChunkIndex(
            chunk_start_offset=start,
            chunk_length=length,
            message_start_time=min(times),
            message_end_time=max(times),
            message_index_offsets=places,
            message_index_length=len(file.data) - behind,
            compression=compression,
            compressed_size=len(packed),
            uncompressed_size=len(records),
        )
    )
    group.clear()


def _put_summary(file: _File, content: Sequence[Item]) -> None:
    """Write the summary, the summary offsets and the footer."""
    variant = file.variant
    begin = len(file.data)
    groups = []
    for wanted, items in (
        (variant.schemas, [item for item in content if isinstance(item, Schema)]),
        (variant.channels, [item for item in content if isinstance(item, Channel)]),
        (variant.statistics, [_statistics(file, content)]),
        (variant.metadata_index, file.metadata),
        (variant.attachment_index, file.attachments),
        (variant.chunk_index, file.chunks),
    ):
        start = len(file.data)
        for item in items if wanted else ():
            file.put(item)
        if len(file.data) > start:
            groups.append(SummaryOffset(file.data[start], start, len(file.data) - start))
            file.put_unknown()
    offsets_begin = len(file.data)
    for group in groups if variant.offsets else ():
        file.put(group)
    summary = bytes(file.data[begin:])
    footer = Footer(
        summary_start=begin if groups else 0,
        summary_offset_start=offsets_begin if variant.offsets else 0,
        summary_crc=0,
    )
    start = len(file.data)
    file.put(footer)
    crc = zlib.crc32(file.data[start:-4], zlib.crc32(summary))
    file.data[-4:] = struct.pack("<I", crc if variant.crcs else 0)
    file.data += MAGIC


def _statistics(file: _File, content: Sequence[Item]) -> Statistics:
    kinds = Counter(type(item) for item in content)
    messages = [item for item in content if isinstance(item, Message)]
    times = [message.log_time for message in messages] or [0]
    return Statistics(
        attachment_count=kinds[Attachment],
        channel_count=kinds[Channel],
        channel_message_counts=dict(Counter(message.channel_id for message in messages)),
        chunk_count=len(file.chunks),
        message_count=len(messages),
        message_end_time=max(times),
        message_start_time=min(times),
        metadata_count=kinds[Metadata],
        schema_count=kinds[Schema],
    )
