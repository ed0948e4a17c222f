"""Writes MCAP files: chunks with CRCs, all indexes and a summary."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, replace
from functools import partial
from io import BytesIO
from itertools import chain
from typing import TYPE_CHECKING

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from pc2scan.errors import OutputError, UnwritableError
from pc2scan.files.compression import compress, crc32
from pc2scan.files.new_file import FreeIds, NewFile, WriteAhead
from pc2scan.model import StoredChunk, normalized_type, ros1_type

from .records import (
    CHUNK,
    MAGIC,
    MESSAGE,
    OP_CHUNK,
    OP_MESSAGE,
    OP_MESSAGE_INDEX,
    RECORD,
    UINT64,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable
    from pathlib import Path

    from pc2scan.model import Attachment, Buffer, Connection, Metadata
    from pc2scan.threads import Threads

# The order of the summary.
_SUMMARY_GROUPS = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)


class McapWriter:
    """Writes an MCAP file with CRCs, all indexes and a summary; see `pc2scan.model.Writer`.

    The same calls write the same bytes: nothing of the machine or the moment is recorded.

    Parameters
    ----------
    path
        The file; it must not exist.
    compression
        ``none``, ``lz4`` or ``zstd``.
    profile
        ``ros2``, ``ros1`` or empty.
    chunk_size
        A chunk ends before it exceeds this many bytes, uncompressed. A message larger than that has a
        chunk of its own, so that readers of small topics need not read it.
    metadata
        Records to begin with.

    Raises
    ------
    OutputError
        If the file exists or cannot be written (from every method).
    """

    def __init__(
        self,
        path: Path,
        compression: str = "zstd",
        profile: str = "ros2",
        chunk_size: int = 1 << 20,
        metadata: Iterable[Metadata] = (),
    ) -> None:
        self._path = path
        self._compression = "" if compression == "none" else compression
        self._compress = partial(compress, compression)
        self._chunk_size = chunk_size
        # The ids of equal definitions, by the id asked for (0: any).
        self._schemas: dict[tuple[str, str, bytes], dict[int, int]] = {}
        self._channels: dict[int, records.Channel] = {}
        self._schema_ids = FreeIds(1)
        self._channel_ids = FreeIds(1)
        self._keeping = False
        self._counts: dict[int, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        # The encoded records of the summary by kind, how many indexes each kind has, and the schemas and channels.
        self._groups = {opcode: bytearray() for opcode in _SUMMARY_GROUPS}
        self._numbers = dict.fromkeys(_SUMMARY_GROUPS, 0)
        self._declared: set[bytes] = set()
        self._ahead = WriteAhead()
        self._spare: list[BytesIO] = []
        self._chunk = _OpenChunk(BytesIO())
        try:
            self._file = NewFile(path)
        except OSError as err:
            raise OutputError(f"cannot be written: {err.strerror}", path=path) from err
        self._file.put(MAGIC, _packed(records.Header(profile, "pc2scan")))
        for record in metadata:
            self.add_metadata(record)

    def keep_ids(self, connections: Collection[Connection]) -> None:
        """Reserve the ids of these channels and their schemas, so that they keep them when they are declared."""
        self._keeping = True
        self._channel_ids.keep([connection.id for connection in connections])
        # 0 stands for no schema, and is no id.
        self._schema_ids.keep([connection.schema_id for connection in connections if connection.schema_id])

    def compress_ahead(self, pool: Threads) -> None:
        """Compress chunks on these threads from now on; the file stays the same."""
        self._ahead.use(pool)

    def add_connection(self, connection: Connection) -> int:
        """Declare a channel of its own for the connection; returns its id.

        The type is spelled as its serialization's ROS version does. Metadata are the connection's; what it
        knows beyond them is added under the keys that rosbag2 and ``mcap convert`` use.
        """
        channel_id = self._channel_ids.take(connection.id)
        connection = connection.in_utf8
        # Declared outside the chunks, so that readers without the index find them without decompressing.
        channel = records.Channel(
            id=channel_id,
            topic=connection.topic,
            message_encoding=connection.serialization,
            metadata=_channel_metadata(connection),
            schema_id=self._schema_id(connection),
        )
        self._channels[channel_id] = channel
        self._counts[channel_id] = 0
        self._declare(Opcode.CHANNEL, channel)
        return channel_id

    def _schema_id(self, connection: Connection) -> int:
        """Write the connection's schema unless it is written already; returns its id, 0 for none."""
        name = connection.msgtype
        definition = connection.definition
        # A definition of DDS names its type as DDS does.
        if connection.serialization in ("ros1", "cdr") and definition.encoding != "omgidl":
            name = ros1_type(name) if connection.serialization == "ros1" else normalized_type(name)
        # A name without a definition is kept: rosbag2 writes it for types that it cannot find.
        if not name and not definition.encoding:
            return 0
        equal = self._schemas.setdefault((name, definition.encoding, definition.data), {})
        wanted = connection.schema_id if self._keeping else 0
        if equal and not wanted:
            return next(iter(equal.values()))
        if wanted not in equal:
            equal[wanted] = self._schema_ids.take(wanted)
            schema = records.Schema(id=equal[wanted], data=definition.data, encoding=definition.encoding, name=name)
            self._declare(Opcode.SCHEMA, schema)
        return equal[wanted]

    def _declare(self, opcode: Opcode, record: records.McapRecord) -> None:
        packed = _packed(record)
        self._put(packed)
        self._declared.add(packed)
        self._groups[opcode] += packed

    def declarations(self) -> frozenset[bytes]:
        """Return the records of all schemas and channels declared so far."""
        return frozenset(self._declared)

    def write(self, handle: int, log_time_ns: int, data: Buffer, publish_time_ns: int, sequence: int = 0) -> None:
        """Append a message; ``data`` is copied.

        Raises
        ------
        UnwritableError
            If a time is negative or beyond 64 bits, or the sequence beyond 32; nothing is written then.
        """
        try:
            head = MESSAGE.pack(OP_MESSAGE, 22 + len(data), handle, sequence, log_time_ns, publish_time_ns)
        except struct.error as err:
            raise UnwritableError(
                f"log time {log_time_ns} ns, publish time {publish_time_ns} ns or sequence {sequence} "
                "cannot be written: MCAP has unsigned numbers of 64, 64 and 32 bits",
                path=self._path,
                topic=self._channels[handle].topic,
            ) from err
        self._counts[handle] += 1
        if self._chunk.size and self._chunk.size + len(head) + len(data) > self._chunk_size:
            self._finish_chunk()
        chunk = self._chunk
        chunk.index.setdefault(handle, []).append((log_time_ns, chunk.size))
        chunk.size += chunk.buffer.write(head) + chunk.buffer.write(data)
        if chunk.size >= self._chunk_size:
            self._finish_chunk()

    def write_chunk(self, chunk: StoredChunk) -> None:
        """Append a whole chunk, compressed if it is not yet, with its message indexes."""
        self._finish_chunk()
        for channel_id, entries in chunk.index.items():
            self._counts[channel_id] += len(entries)
        if chunk.compression:
            self._ahead.put_ready(partial(self._put_chunk, chunk), len(chunk.stored))
        else:
            self._ahead.put(partial(self._recompress, chunk), self._put_chunk, chunk.size)

    def _finish_chunk(self) -> None:
        """Queue the open chunk to be compressed and written, and begin another one."""
        chunk = self._chunk
        if 0 < 2 * chunk.size < len(chunk.buffer.getbuffer()):
            # The buffer has grown for a large message: the next one uses it, instead of one more, while this waits.
            data = bytes(chunk.buffer.getbuffer()[: chunk.size])
            small = StoredChunk("", data, chunk.size, crc32(data), chunk.index)
            self._ahead.put(partial(self._recompress, small), self._put_chunk, chunk.size)
            chunk.buffer.seek(0)
            self._chunk = _OpenChunk(chunk.buffer)
        elif chunk.size:
            put = partial(self._put_chunk, buffer=chunk.buffer)
            self._ahead.put(partial(self._compress_chunk, chunk), put, chunk.size)
            self._chunk = _OpenChunk(self._spare.pop() if self._spare else BytesIO())

    def _compress_chunk(self, chunk: _OpenChunk) -> StoredChunk:
        """Compress a chunk; runs on any thread."""
        data = chunk.buffer.getbuffer()[: chunk.size]
        compression = self._compression or "none"
        return StoredChunk(compression, self._compress(data), chunk.size, crc32(data), chunk.index)

    def _recompress(self, chunk: StoredChunk) -> StoredChunk:
        return replace(chunk, compression=self._compression or "none", stored=self._compress(memoryview(chunk.stored)))

    def _put_chunk(self, chunk: StoredChunk, buffer: BytesIO | None = None) -> None:
        """Write a chunk and its message indexes; another chunk may use its ``buffer`` then."""
        compression = "" if chunk.compression == "none" else chunk.compression
        name = compression.encode()
        start_ns, end_ns = chunk.span_ns()
        head_size = CHUNK.size + len(name) + UINT64.size
        offset = self._file.put(
            RECORD.pack(OP_CHUNK, head_size + len(chunk.stored)),
            CHUNK.pack(start_ns, end_ns, chunk.size, chunk.crc, len(name)),
            name,
            UINT64.pack(len(chunk.stored)),
            chunk.stored,
        )
        length = self._file.position - offset
        places = {}
        for channel_id, entries in chunk.index.items():
            places[channel_id] = self._file.put(
                struct.pack("<BQHI", OP_MESSAGE_INDEX, 6 + 16 * len(entries), channel_id, 16 * len(entries)),
                struct.pack(f"<{2 * len(entries)}Q", *chain.from_iterable(sorted(entries))),
            )
        index = records.ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression=compression,
            compressed_size=len(chunk.stored),
            message_end_time=end_ns,
            message_index_length=self._file.position - offset - length,
            message_index_offsets=places,
            message_start_time=start_ns,
            uncompressed_size=chunk.size,
        )
        self._groups[Opcode.CHUNK_INDEX] += _packed(index)
        self._numbers[Opcode.CHUNK_INDEX] += 1
        self._first_ns = start_ns if self._first_ns is None else min(self._first_ns, start_ns)
        self._last_ns = max(self._last_ns, end_ns)
        if buffer is not None:
            if isinstance(chunk.stored, memoryview):
                # A buffer with a view of it cannot be written.
                chunk.stored.release()
            buffer.seek(0)
            self._spare.append(buffer)

    def add_attachment(self, attachment: Attachment) -> None:
        """Append an attachment, with CRC and index."""
        record = records.Attachment(
            create_time=attachment.create_time_ns,
            log_time=attachment.log_time_ns,
            name=attachment.name,
            media_type=attachment.media_type,
            data=attachment.data,
        )
        packed = _packed(record)
        index = records.AttachmentIndex(
            offset=self._put(packed),
            length=len(packed),
            log_time=record.log_time,
            create_time=record.create_time,
            data_size=len(record.data),
            name=record.name,
            media_type=record.media_type,
        )
        self._groups[Opcode.ATTACHMENT_INDEX] += _packed(index)
        self._numbers[Opcode.ATTACHMENT_INDEX] += 1

    def add_metadata(self, metadata: Metadata) -> None:
        """Append a metadata record, with index."""
        packed = _packed(records.Metadata(metadata.name, dict(metadata.entries)))
        index = records.MetadataIndex(offset=self._put(packed), length=len(packed), name=metadata.name)
        self._groups[Opcode.METADATA_INDEX] += _packed(index)
        self._numbers[Opcode.METADATA_INDEX] += 1

    def finish(self) -> None:
        """Write the last chunk and the summary, and put everything on the disk."""
        self._finish_chunk()
        self._put(_packed(records.DataEnd(0)))
        statistics = records.Statistics(
            attachment_count=self._numbers[Opcode.ATTACHMENT_INDEX],
            channel_count=len(self._channels),
            channel_message_counts={channel_id: count for channel_id, count in self._counts.items() if count},
            chunk_count=self._numbers[Opcode.CHUNK_INDEX],
            message_count=sum(self._counts.values()),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns or 0,
            metadata_count=self._numbers[Opcode.METADATA_INDEX],
            schema_count=sum(map(len, self._schemas.values())),
        )
        self._groups[Opcode.STATISTICS] += _packed(statistics)
        start, crc, offsets = self._file.position, 0, []
        for opcode, packed in self._groups.items():
            if group := memoryview(packed):
                offsets.append(_packed(records.SummaryOffset(opcode, self._file.put(group), len(group))))
                crc = crc32(group, crc)
        tail = b"".join((*offsets, _packed(records.Footer(start, self._file.position, 0))))
        # The footer's last field is the CRC of the summary and of the footer's other fields.
        self._file.put(tail[:-4], struct.pack("<I", crc32(tail[:-4], crc)), MAGIC)
        self._file.finish()

    def abort(self) -> None:
        """Release the file; the caller removes it."""
        self._ahead.cancel()
        self._file.abort()

    def _put(self, data: bytes) -> int:
        """Write at the end, after all complete chunks; returns the offset."""
        self._ahead.finish()
        return self._file.put(data)


@dataclass(slots=True, eq=False)
class _OpenChunk:
    """The messages of the next chunk.

    Attributes
    ----------
    buffer
        Is written from its start on. Chunks share it, because new memory for every chunk takes a third of the time
        of lz4.
    size
        How many bytes of it are written.
    index
        As in `StoredChunk`.
    """

    buffer: BytesIO
    size: int = 0
    index: dict[int, list[tuple[int, int]]] = field(default_factory=dict)


def _packed(record: records.McapRecord) -> bytes:
    """Pack a record, with its opcode and length.

    Raises
    ------
    struct.error
        If a number is negative or too large.
    """
    builder = RecordBuilder()
    record.write(builder)
    packed: bytes = builder.end()  # type: ignore[no-untyped-call]
    return packed


def _channel_metadata(connection: Connection) -> dict[str, str]:
    """Return the connection's metadata, completed by values from another container."""
    known = {}
    if connection.ros_version == 1:
        if connection.callerid is not None:
            known["callerid"] = connection.callerid
        if connection.latching:
            known["latching"] = "1"
        if connection.digest and "md5sum" not in connection.metadata:
            known |= {"md5sum": connection.digest, "topic": connection.topic}
    elif connection.ros_version == 2:
        if connection.qos:
            known["offered_qos_profiles"] = connection.qos
        if connection.digest.startswith("RIHS01_"):
            known["topic_type_hash"] = connection.digest
    return {**connection.metadata, **{k: v for k, v in known.items() if k not in connection.metadata}}
