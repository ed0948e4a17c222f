"""MCAP files for tests: ours, the mcap library's, and some put together by hand so that they can be wrong."""

from __future__ import annotations

import struct
import zlib
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
import zstandard
from mcap.records import Chunk, DataEnd, Footer, Header, McapRecord
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as LibraryWriter

from pc2scan.bags.mcap.read import McapReader
from pc2scan.bags.mcap.records import MAGIC
from pc2scan.bags.mcap.write import McapWriter
from pc2scan.errors import RecordingError
from pc2scan.model import Connection, Definition

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


COMPRESSIONS = ("none", "lz4", "zstd")


CLOUD = "sensor_msgs/msg/PointCloud2"


QOS = "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1"


SAMPLE = [(i % 2, 1000 + 10 * (i // 2) + (i * 7) % 13, bytes([i]) * (i * 5)) for i in range(60)]


_NO_SUMMARY: dict[str, Any] = {
    **dict.fromkeys(("repeat_channels", "repeat_schemas", "use_statistics", "use_summary_offsets"), False),
    "index_types": IndexType.NONE,
}

LIBRARY_OPTIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "lz4": {"compression": CompressionType.LZ4},
    "uncompressed": {"compression": CompressionType.NONE},
    "unchunked": {"use_chunking": False},
    "unchunked without summary": {"use_chunking": False, **_NO_SUMMARY},
    "channels only in chunks": {"repeat_channels": False, "repeat_schemas": False},
    "schemas only in chunks": {"repeat_schemas": False},
    "no statistics": {"use_statistics": False},
    "no indexes": {"index_types": IndexType.NONE},
    "only chunk indexes": {"index_types": IndexType.CHUNK},
    "no message indexes": {"index_types": IndexType.CHUNK | IndexType.ATTACHMENT | IndexType.METADATA},
    "no attachment indexes": {"index_types": IndexType.CHUNK | IndexType.MESSAGE},
    "no crc": {"enable_crcs": False},
    "data crc": {"enable_data_crcs": True},
    "no summary": _NO_SUMMARY,
    "no summary but message indexes": {**_NO_SUMMARY, "index_types": IndexType.MESSAGE},
}


def connection(topic: str = "/points", **changes: Any) -> Connection:
    """Make a ROS 2 connection."""
    return replace(Connection(99, topic, CLOUD, "cdr", Definition("ros2msg", b"uint8[] data")), **changes)


def write(path: Path, messages: Iterable[tuple[int, int, bytes]], topics: int = 2, **options: Any) -> Path:
    """Write (handle - 1, log time, data) with our writer."""
    writer = McapWriter(path, **options)
    handles = [writer.add_connection(connection(f"/topic{i}")) for i in range(topics)]
    for sequence, (index, log_time, data) in enumerate(messages):
        writer.write(handles[index], log_time, data, log_time + 5, sequence)
    writer.finish()
    return path


def content(reader: McapReader, **selection: Any) -> list[tuple[int, int, int, int, bytes]]:
    """Everything that a reader returns, as plain values."""
    return [
        (m.connection.id, m.sequence, m.log_time_ns, m.publish_time_ns, bytes(m.data))
        for m in reader.messages(**selection)
    ]


def read(path: Path) -> list[tuple[int, int, int, int, bytes]]:
    with closing(McapReader(path)) as reader:
        return content(reader)


def read_all(path: Path, **options: Any) -> None:
    with closing(McapReader(path, **options)) as reader:
        content(reader)
        list(reader.attachments())
        list(reader.metadata())


def failing(path: Path, match: str, **options: Any) -> RecordingError:
    """Read everything strictly, and return the error."""
    with pytest.raises(RecordingError, match=match) as caught:
        read_all(path, **{"strict": True, **options})
    assert caught.value.path == path
    return caught.value


def streamed(path: Path) -> list[Any]:
    """Read every record with the mcap library, end to end."""
    with path.open("rb") as file:
        return list(StreamReader(file, validate_crcs=True).records)


def library_file(
    path: Path,
    messages: Iterable[tuple[int, int, bytes]],
    *,
    topics: int = 2,
    profile: str = "ros2",
    extras: bool = False,
    **options: Any,
) -> Path:
    """Write (channel - 1, log time, data) with the mcap library's writer."""
    with path.open("wb") as file:
        writer = LibraryWriter(file, **options)
        writer.start(profile, "test")
        schema = writer.register_schema(CLOUD, "ros2msg", b"uint8[] data")
        channels = [writer.register_channel(f"/topic{i}", "cdr", schema, {}) for i in range(topics)]
        for sequence, (index, log_time, data) in enumerate(messages):
            if extras and sequence == 3:
                writer.add_attachment(7, 8, "calibration.yaml", "text/yaml", b"a: 1")
                writer.add_metadata("robot", {"name": "r2"})
            writer.add_message(channels[index], log_time, data, log_time + 5, sequence)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def encoded(item: McapRecord) -> bytes:
    from mcap.data_stream import RecordBuilder

    builder = RecordBuilder()
    item.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def raw_file(path: Path, *data_section: bytes) -> Path:
    """Make a file without a summary out of records."""
    ends = encoded(DataEnd(0)), encoded(Footer(0, 0, 0)), MAGIC
    path.write_bytes(b"".join((MAGIC, encoded(Header("", "raw")), *data_section, *ends)))
    return path


def raw_chunk(records: bytes, *, compression: str = "", packed: bytes | None = None, **changes: Any) -> bytes:
    values: dict[str, Any] = {
        "compression": compression,
        "data": records if packed is None else packed,
        "message_start_time": 1,
        "message_end_time": 1,
        "uncompressed_crc": zlib.crc32(records),
        "uncompressed_size": len(records),
    }
    return encoded(Chunk(**(values | changes)))


def raw_channel(id_: int = 1, topic: str = "/t", schema: int = 0) -> bytes:
    from mcap.records import Channel

    return encoded(Channel(id=id_, topic=topic, message_encoding="cdr", metadata={}, schema_id=schema))


def raw_message(channel: int = 1, log_time: int = 1, data: bytes = b"data") -> bytes:
    return record(5, struct.pack("<HIQQ", channel, 0, log_time, log_time) + data)


BODY = raw_channel() + raw_message()


def zstd(data: bytes, *, size: bool = True) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=size).compress(data)
