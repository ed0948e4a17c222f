"""MCAP: against the mcap library in both directions, against the npm reader, and against damage."""

from __future__ import annotations

import hashlib
import io
import itertools
import json
import os
import shutil
import struct
import subprocess
import sys
import zlib
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hypothesis.strategies as st
import lz4.frame
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, DataEnd, Footer, Header, McapRecord, Message, MessageIndex
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as LibraryWriter

from pc2scan.bags import mcap as module
from pc2scan.bags.mcap import MAGIC, McapReader, McapWriter, latches
from pc2scan.bags.model import Attachment, Connection, Definition, Metadata, RawMessage
from pc2scan.errors import DestinationError, OutputError, RecordingError
from support import RECORDINGS, needs_shared

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from pc2scan.bags.model import Reader, Writer
    from pc2scan.bags.segments import Segment

COMPRESSIONS = ("none", "lz4", "zstd")
CLOUD = "sensor_msgs/msg/PointCloud2"
QOS = "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1"


def connection(topic: str = "/points", **changes: Any) -> Connection:
    """Make a ROS 2 connection."""
    values: dict[str, Any] = {
        "id": 99,
        "topic": topic,
        "msgtype": CLOUD,
        "serialization": "cdr",
        "definition": Definition("ros2msg", b"uint8[] data"),
    }
    return Connection(**(values | changes))


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


def library(path: Path) -> list[tuple[int, int, int, int, bytes]]:
    """Read the same with the mcap library's reader."""
    with path.open("rb") as file:
        return [
            (m.channel_id, m.sequence, m.log_time, m.publish_time, m.data)
            for _, _, m in make_reader(file, validate_crcs=True).iter_messages()
        ]


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
    path.write_bytes(
        b"".join(
            (
                MAGIC,
                encoded(Header("", "raw")),
                *data_section,
                encoded(DataEnd(0)),
                encoded(Footer(0, 0, 0)),
                MAGIC,
            )
        )
    )
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
    return encoded(
        Message(channel_id=channel, log_time=log_time, data=data, publish_time=log_time, sequence=0)
    )


SAMPLE = [(i % 2, 1000 + 10 * (i // 2) + (i * 7) % 13, bytes([i]) * (i * 5)) for i in range(60)]


@pytest.fixture
def loads(monkeypatch: pytest.MonkeyPatch) -> list[Segment]:
    """Every segment whose payload is read."""
    seen: list[Segment] = []
    original = module.payload

    def counting(file: module.RecordFile, segment: Segment, *, verify: bool = True) -> memoryview:
        seen.append(segment)
        return original(file, segment, verify=verify)

    monkeypatch.setattr(module, "payload", counting)
    return seen


# --- both directions ---


def test_the_protocols_are_satisfied(tmp_path: Path) -> None:
    writer: Writer = McapWriter(tmp_path / "a.mcap")
    writer.finish()
    reader: Reader = McapReader(tmp_path / "a.mcap")
    reader.close()


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_round_trip(tmp_path: Path, compression: str) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE, compression=compression, chunk_size=1000)
    expected = sorted(
        ((i + 1, n, t, t + 5, data) for n, (i, t, data) in enumerate(SAMPLE)), key=lambda message: message[2]
    )
    assert read(path) == expected
    assert library(path) == expected
    with closing(McapReader(path)) as reader:
        summary = reader.summary
        assert (summary.container, summary.storage, summary.profile) == ("mcap", "", "ros2")
        assert summary.compression == (compression,)
        assert (summary.message_count, summary.start_ns, summary.end_ns) == (
            60,
            expected[0][2],
            expected[-1][2],
        )
        assert summary.size_bytes == path.stat().st_size
        assert [c.message_count for c in reader.connections] == [30, 30]
        assert reader.path == path


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    messages=st.lists(st.tuples(st.integers(0, 2), st.integers(0, 6), st.binary(max_size=300)), max_size=40),
    compression=st.sampled_from(COMPRESSIONS),
    chunk_size=st.sampled_from((1, 200, 1000, 1 << 20)),
)
def test_reading_back_is_a_stable_sort(
    tmp_path_factory: pytest.TempPathFactory,
    messages: list[tuple[int, int, bytes]],
    compression: str,
    chunk_size: int,
) -> None:
    path = tmp_path_factory.mktemp("h") / "a.mcap"
    write(path, messages, topics=3, compression=compression, chunk_size=chunk_size)
    expected = sorted(
        ((i + 1, n, t, t + 5, data) for n, (i, t, data) in enumerate(messages)),
        key=lambda message: message[2],
    )
    assert read(path) == expected
    assert [(m.channel_id, m.sequence, m.data) for m in streamed(path) if isinstance(m, Message)] == [
        (i + 1, n, data) for n, (i, _, data) in enumerate(messages)
    ]
    with closing(McapReader(path)) as reader:
        one = [c for c in reader.connections if c.id == 2]
        assert content(reader, connections=one, start_ns=2, stop_ns=5) == [
            m for m in expected if m[0] == 2 and 2 <= m[2] < 5
        ]


LIBRARY_OPTIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "lz4": {"compression": CompressionType.LZ4},
    "uncompressed": {"compression": CompressionType.NONE},
    "unchunked": {"use_chunking": False},
    "unchunked without summary": {
        "use_chunking": False,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
        "index_types": IndexType.NONE,
    },
    "channels only in chunks": {"repeat_channels": False, "repeat_schemas": False},
    "schemas only in chunks": {"repeat_schemas": False},
    "no statistics": {"use_statistics": False},
    "no indexes": {"index_types": IndexType.NONE},
    "only chunk indexes": {"index_types": IndexType.CHUNK},
    "no message indexes": {"index_types": IndexType.CHUNK | IndexType.ATTACHMENT | IndexType.METADATA},
    "no attachment indexes": {"index_types": IndexType.CHUNK | IndexType.MESSAGE},
    "no crc": {"enable_crcs": False},
    "data crc": {"enable_data_crcs": True},
    "no summary": {
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
        "index_types": IndexType.NONE,
    },
    "no summary but message indexes": {
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
        "index_types": IndexType.MESSAGE,
    },
}


@pytest.mark.parametrize("case", LIBRARY_OPTIONS)
def test_every_shape_that_the_library_writes(tmp_path: Path, case: str) -> None:
    path = tmp_path / "a.mcap"
    library_file(path, SAMPLE, extras=True, chunk_size=1000, **LIBRARY_OPTIONS[case])
    expected = sorted(
        ((i + 1, n, t, t + 5, data) for n, (i, t, data) in enumerate(SAMPLE)), key=lambda message: message[2]
    )
    with closing(McapReader(path)) as reader:
        assert content(reader) == expected
        assert [(c.id, c.topic, c.msgtype, c.serialization) for c in reader.connections] == [
            (1, "/topic0", CLOUD, "cdr"),
            (2, "/topic1", CLOUD, "cdr"),
        ]
        assert {c.definition for c in reader.connections} == {Definition("ros2msg", b"uint8[] data")}
        assert list(reader.attachments()) == [Attachment("calibration.yaml", "text/yaml", 8, 7, b"a: 1")]
        assert list(reader.metadata()) == [Metadata("robot", {"name": "r2"})]
        summary = reader.summary
        assert (summary.start_ns, summary.end_ns) == (expected[0][2], expected[-1][2])
        # Without statistics, only message indexes or a walk over the messages count them.
        uncounted = case in ("no statistics", "no summary")
        assert summary.message_count == (None if uncounted else 60)
        assert [c.message_count for c in reader.connections] == ([None, None] if uncounted else [30, 30])


@pytest.mark.parametrize("case", LIBRARY_OPTIONS)
def test_selection_in_every_shape(tmp_path: Path, case: str) -> None:
    path = tmp_path / "a.mcap"
    library_file(path, SAMPLE, chunk_size=1000, **LIBRARY_OPTIONS[case])
    everything = read(path)
    with closing(McapReader(path)) as reader:
        second = [reader.connections[1]]
        assert content(reader, connections=second) == [m for m in everything if m[0] == 2]
        assert content(reader, start_ns=1100, stop_ns=1200) == [m for m in everything if 1100 <= m[2] < 1200]
        assert content(reader, connections=[]) == []
        assert content(reader, connections=[connection(id=7)]) == []
        assert content(reader, start_ns=5000) == []


# --- what a connection says ---


def test_two_channels_of_one_topic_stay_two(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    one = writer.add_connection(connection(metadata={"publisher": "a"}))
    two = writer.add_connection(connection(metadata={"publisher": "b"}))
    writer.write(two, 1, b"2", 1)
    writer.write(one, 2, b"1", 2)
    writer.finish()
    with closing(McapReader(path)) as reader:
        assert [(c.topic, c.metadata["publisher"]) for c in reader.connections] == [
            ("/points", "a"),
            ("/points", "b"),
        ]
        assert [bytes(m.data) for m in reader.messages()] == [b"2", b"1"]
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    # One schema for both.
    assert len(summary.schemas) == 1
    assert len(summary.channels) == 2


def test_ros2_knowledge_survives(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    digest = "RIHS01_" + "ab" * 32
    writer.add_connection(connection(qos=QOS, digest=digest, latching=True))
    writer.add_connection(connection(digest="no hash", definition=Definition("ros2idl", b"module")))
    writer.finish()
    with closing(McapReader(path)) as reader:
        first, second = reader.connections
    assert (first.qos, first.digest, first.latching) == (QOS, digest, True)
    assert first.metadata == {"offered_qos_profiles": QOS, "topic_type_hash": digest}
    assert first.message_count == 0
    assert second.metadata == {}
    assert second.definition == Definition("ros2idl", b"module")
    assert not second.latching


def test_ros1_knowledge_survives(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path, profile="ros1")
    writer.add_connection(
        connection(
            serialization="ros1",
            definition=Definition("ros1msg", b"uint8[] data"),
            callerid="/driver",
            latching=True,
            digest="1158d486dd51d683ce2f1be655c3c181",
        )
    )
    writer.finish()
    with closing(McapReader(path)) as reader:
        (only,) = reader.connections
        assert reader.summary.profile == "ros1"
        assert (reader.summary.message_count, reader.summary.start_ns, reader.summary.end_ns) == (
            0,
            None,
            None,
        )
    assert (only.msgtype, only.ros_type, only.serialization) == ("sensor_msgs/PointCloud2", CLOUD, "ros1")
    assert (only.callerid, only.latching, only.digest) == (
        "/driver",
        True,
        "1158d486dd51d683ce2f1be655c3c181",
    )
    assert only.metadata == {
        "callerid": "/driver",
        "latching": "1",
        "md5sum": "1158d486dd51d683ce2f1be655c3c181",
        "topic": "/points",
    }


def test_metadata_of_an_mcap_channel_stay_verbatim(tmp_path: Path) -> None:
    recorded = {"latching": "true", "callerid": "/a", "md5sum": "0", "zebra": "1", "ant": "2"}
    ros1: dict[str, Any] = {"serialization": "ros1", "definition": Definition("ros1msg", b"")}
    first, second = tmp_path / "a.mcap", tmp_path / "b.mcap"
    writer = McapWriter(first, profile="ros1")
    writer.add_connection(connection(metadata=recorded, **ros1))
    writer.add_connection(connection(metadata={}, **ros1))
    writer.finish()
    with closing(McapReader(first)) as reader:
        assert [c.latching for c in reader.connections] == [True, False]
        writer = McapWriter(second, profile="ros1")
        for read_back in reader.connections:
            writer.add_connection(read_back)
        writer.finish()
    with closing(McapReader(second)) as reader:
        assert [list(c.metadata.items()) for c in reader.connections] == [list(recorded.items()), []]
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize(
    ("value", "expected"),
    [("1", True), ("true", True), ("True", True), ("0", False), ("false", False), (None, False)],
)
def test_ros1_latching(tmp_path: Path, value: str | None, *, expected: bool) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = LibraryWriter(file)
        writer.start("ros1", "test")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data")
        writer.register_channel("/a", "ros1", schema, {} if value is None else {"latching": value})
        writer.finish()  # type: ignore[no-untyped-call]
    with closing(McapReader(path)) as reader:
        assert reader.connections[0].latching is expected


@pytest.mark.parametrize(
    ("qos", "expected"),
    [
        ("", False),
        (QOS, True),
        ("- history: 3\n  depth: 0\n  reliability: 1\n  durability: 2\n  deadline:\n    sec: 1", False),
        ("- durability: volatile\n- durability: transient_local\n", True),
        ("- durability: transient_local_ish", False),
        ("- durability: 10", False),
        ("- {history: 1, durability: 1}", True),
        ('- {"durability": "transient_local"}', True),
        ("- durability:\n  depth: 1", False),
        ("- some_durability: 1", False),
        ("- reliability: 1", False),
        ("durability: TRANSIENT_LOCAL", True),
    ],
)
def test_latches(qos: str, *, expected: bool) -> None:
    assert latches(qos) is expected


@pytest.mark.parametrize(
    ("profile", "schema", "expected"),
    [
        ("", "ros1msg", "ros1"),
        ("", "ros2msg", "cdr"),
        ("", "ros2idl", "cdr"),
        ("ros1", "", "ros1"),
        ("ros2", "", "cdr"),
        ("ros1", "ros2msg", "cdr"),
        ("", "protobuf", ""),
    ],
)
def test_an_empty_message_encoding_is_deduced(
    tmp_path: Path, profile: str, schema: str, expected: str
) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = LibraryWriter(file)
        writer.start(profile, "test")
        writer.register_channel("/a", "", writer.register_schema("a/B", schema, b""), {})
        writer.finish()  # type: ignore[no-untyped-call]
    with closing(McapReader(path)) as reader:
        assert reader.connections[0].serialization == expected


@pytest.mark.parametrize(
    ("msgtype", "serialization", "definition", "written"),
    [
        ("foxglove.PointCloud", "protobuf", Definition("protobuf", b"\x00\xff"), "foxglove.PointCloud"),
        ("a/B", "json", Definition("jsonschema", b"{}"), "a/B"),
        ("a/B", "cdr", Definition("ros2msg", b""), "a/msg/B"),
        ("a/msg/B", "ros1", Definition("ros1msg", b""), "a/B"),
        ("", "json", Definition(), ""),
        # A type that is known by name only.
        ("a/msg/B", "cdr", Definition(), "a/msg/B"),
    ],
)
def test_types_and_definitions_of_all_kinds(
    tmp_path: Path, msgtype: str, serialization: str, definition: Definition, written: str
) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path, profile="")
    handle = writer.add_connection(
        connection(msgtype=msgtype, serialization=serialization, definition=definition)
    )
    writer.write(handle, 1, b"x", 1)
    writer.finish()
    with closing(McapReader(path)) as reader:
        (only,) = reader.connections
    assert (only.msgtype, only.serialization, only.definition) == (written, serialization, definition)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.channels[1].schema_id == (1 if written else 0)


# --- attachments, metadata ---


def test_attachments_and_metadata(tmp_path: Path, loads: list[Segment]) -> None:
    attachments = [Attachment("a.bin", "x/y", 3, 4, bytes(range(256))), Attachment("", "", 0, 0, b"")]
    path = tmp_path / "a.mcap"
    first = Metadata("first", {"k": "v", "ü": "ß"})
    writer = McapWriter(path, metadata=[first])
    handle = writer.add_connection(connection())
    writer.write(handle, 1, b"x", 1)
    for attachment in attachments:
        writer.add_attachment(attachment)
    writer.add_metadata(Metadata("second", {}))
    writer.finish()
    with closing(McapReader(path)) as reader:
        assert list(reader.attachments()) == attachments
        assert list(reader.metadata()) == [first, Metadata("second", {})]
        assert not loads
    with path.open("rb") as file:
        theirs = make_reader(file)
        assert [(a.name, a.data) for a in theirs.iter_attachments()] == [
            (a.name, a.data) for a in attachments
        ]
        assert [m.metadata for m in theirs.iter_metadata()] == [{"k": "v", "ü": "ß"}, {}]


def test_a_damaged_attachment(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    writer.add_attachment(Attachment("a.bin", "", 0, 0, b"spotless"))
    writer.finish()
    path.write_bytes(path.read_bytes().replace(b"spotless", b"spottier"))
    with closing(McapReader(path)) as reader, pytest.raises(RecordingError, match=r"'a\.bin' has CRC"):
        list(reader.attachments())
    with closing(McapReader(path, verify=False)) as reader:
        assert [a.data for a in reader.attachments()] == [b"spottier"]


# --- chunks ---


def test_only_chunks_with_wanted_messages_are_read(tmp_path: Path, loads: list[Segment]) -> None:
    messages = [(0, t, b"c" * 3000) if t % 10 == 0 else (1, t, b"s") for t in range(100)]
    path = write(tmp_path / "a.mcap", messages, chunk_size=1000)
    with closing(McapReader(path)) as reader:
        assert not loads
        assert reader.bytes_read == 0
        assert len(content(reader, connections=[reader.connections[0]])) == 10
        # The large messages have chunks of their own.
        assert len(loads) == 10
        assert reader.bytes_read == sum(segment.length for segment in loads)
        loads.clear()
        assert len(content(reader, start_ns=15, stop_ns=22)) == 7
        assert len(loads) == 3
        loads.clear()
        assert len(content(reader)) == 100
        assert len(loads) == 20


@pytest.mark.parametrize("case", ["default", "no statistics", "only chunk indexes", "unchunked"])
def test_nothing_is_decompressed_to_open(tmp_path: Path, loads: list[Segment], case: str) -> None:
    path = library_file(tmp_path / "a.mcap", SAMPLE, chunk_size=300, **LIBRARY_OPTIONS[case])
    McapReader(path).close()
    assert not loads


def test_no_more_is_decompressed_to_open_than_channels_need(tmp_path: Path, loads: list[Segment]) -> None:
    options = LIBRARY_OPTIONS["no summary but message indexes"]
    path = library_file(tmp_path / "a.mcap", SAMPLE, chunk_size=300, **options)
    McapReader(path).close()
    assert len(loads) == 1


def test_unindexed_messages_beside_indexed_chunks_are_found(tmp_path: Path) -> None:
    """The specification advises against it, and readers that trust the index lose these messages."""
    path = write(tmp_path / "a.mcap", [(0, 10, b"chunked"), (1, 30, b"chunked")], chunk_size=1)
    data = path.read_bytes()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    at = summary.chunk_indexes[0].chunk_start_offset
    # Put in front of the first chunk, it moves every chunk: rewrite the file behind it with the library.
    stray = raw_message(2, 20, b"stray")
    sections = streamed_chunks(data[at:])
    rebuilt = tmp_path / "b.mcap"
    rebuild_with_index(rebuilt, data[:at] + stray, sections)
    with closing(McapReader(rebuilt)) as reader:
        assert [(m.log_time_ns, bytes(m.data)) for m in reader.messages()] == [
            (10, b"chunked"),
            (20, b"stray"),
            (30, b"chunked"),
        ]


def streamed_chunks(data: bytes) -> list[Chunk]:
    """Chunks of a data section that begins without magic."""
    stream = StreamReader(io.BytesIO(data), skip_magic=True, emit_chunks=True)
    return [
        item
        for item in itertools.takewhile(lambda r: not isinstance(r, DataEnd), stream.records)
        if isinstance(item, Chunk)
    ]


def rebuild_with_index(path: Path, head: bytes, chunks: list[Chunk]) -> None:
    from mcap.records import ChunkIndex

    indexes = []
    data = head
    for chunk in chunks:
        body = encoded(chunk)
        indexes.append(
            ChunkIndex(
                chunk_length=len(body),
                chunk_start_offset=len(data),
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=0,
                message_index_offsets={},
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        data += body
    data += encoded(DataEnd(0))
    start = len(data)
    data += b"".join(map(encoded, indexes)) + encoded(Footer(start, 0, 0)) + MAGIC
    path.write_bytes(data)


def test_runs_outside_chunks_are_split(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, loads: list[Segment]
) -> None:
    monkeypatch.setattr(module, "RUN_SIZE", 500)
    path = library_file(tmp_path / "a.mcap", SAMPLE, use_chunking=False)
    expected = sorted(
        ((i + 1, n, t, t + 5, data) for n, (i, t, data) in enumerate(SAMPLE)), key=lambda message: message[2]
    )
    with closing(McapReader(path)) as reader:
        assert content(reader) == expected
        assert all(segment.length <= 500 for segment in loads)
        assert len(loads) > 10
        assert reader.summary.compression == ("none",)
        loads.clear()
        assert [m[2] for m in content(reader, start_ns=1000, stop_ns=1005)] == [
            m[2] for m in expected if m[2] < 1005
        ]
        assert len(loads) < 5


def test_data_are_views(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [(0, 1, b"abc"), (0, 2, b"def")])
    with closing(McapReader(path)) as reader:
        first, second = reader.messages()
    assert isinstance(first, RawMessage)
    assert isinstance(first.data, memoryview)
    assert isinstance(second.data, memoryview)
    assert first.data.obj is second.data.obj


def test_a_large_message_has_a_chunk_of_its_own(tmp_path: Path) -> None:
    messages = [(0, 1, b"s"), (1, 2, b"L" * 5000), (0, 3, b"s"), (0, 4, b"s"), (1, 5, b"L" * 5000)]
    path = write(tmp_path / "a.mcap", messages, chunk_size=1000)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert [sorted(c.message_index_offsets) for c in summary.chunk_indexes] == [[1], [2], [1], [2]]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_chunk_holds_what_the_buffers_held(tmp_path: Path, compression: str) -> None:
    """The caller may reuse a message's memory as soon as the call returns."""
    sizes = [10, 70_000, 3, 65_536, 65_535, 0, 200_000]
    data = [bytes([i]) * size for i, size in enumerate(sizes)]
    path = tmp_path / "a.mcap"
    writer = McapWriter(path, compression=compression)
    handle = writer.add_connection(connection())
    for i, each in enumerate(data):
        buffer = bytearray(each)
        writer.write(handle, i, memoryview(buffer), i)
        buffer[:] = bytes(len(buffer))
    writer.finish()
    assert [m[4] for m in library(path)] == data
    assert [m[4] for m in read(path)] == data


# --- the writer ---


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_the_same_calls_write_the_same_bytes(tmp_path: Path, compression: str) -> None:
    one = write(tmp_path / "a.mcap", SAMPLE, compression=compression, chunk_size=1000)
    two = write(tmp_path / "b.mcap", SAMPLE, compression=compression, chunk_size=1000)
    assert one.read_bytes() == two.read_bytes()


def test_indexes_and_statistics_agree_with_the_library(tmp_path: Path) -> None:
    """What the library's writer puts into its summary for the same chunks, ours puts there too."""
    path = write(tmp_path / "a.mcap", SAMPLE, compression="none", chunk_size=1000)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.channel_message_counts == {1: 30, 2: 30}
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (
        min(t for _, t, _ in SAMPLE),
        max(t for _, t, _ in SAMPLE),
    )
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 3
    assert summary.statistics.channel_count == 2
    assert summary.statistics.schema_count == 1
    data = path.read_bytes()
    for index in summary.chunk_indexes:
        stream = StreamReader(io.BytesIO(data[index.chunk_start_offset :]), skip_magic=True, emit_chunks=True)
        found = iter(stream.records)
        chunk = next(found)
        assert isinstance(chunk, Chunk)
        assert chunk.message_start_time == index.message_start_time
        assert chunk.message_end_time == index.message_end_time
        assert index.compressed_size == len(chunk.data) == index.uncompressed_size
        size = 0
        for channel_id, offset in index.message_index_offsets.items():
            (entry,) = itertools.islice(StreamReader(io.BytesIO(data[offset:]), skip_magic=True).records, 1)
            assert isinstance(entry, MessageIndex)
            assert entry.channel_id == channel_id
            size += len(encoded(entry))
            for log_time, at in entry.records:
                opcode, _, channel, _, time = struct.unpack_from("<BQHIQ", chunk.data, at)
                assert (opcode, channel, time) == (5, channel_id, log_time)
        assert size == index.message_index_length


def test_channels_precede_their_messages_for_readers_without_the_index(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    one = writer.add_connection(connection("/one"))
    writer.write(one, 1, b"1", 1)
    two = writer.add_connection(connection("/two", msgtype="a/msg/B"))
    writer.write(two, 2, b"2", 2)
    writer.finish()
    with path.open("rb") as file:
        assert [
            (c.topic, m.data) for _, c, m in NonSeekingReader(file, validate_crcs=True).iter_messages()
        ] == [
            ("/one", b"1"),
            ("/two", b"2"),
        ]


def test_an_empty_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    McapWriter(path).finish()
    with closing(McapReader(path)) as reader:
        assert (list(reader.messages()), list(reader.attachments()), list(reader.metadata())) == ([], [], [])
        assert not reader.connections
        assert reader.summary.compression == ()
    assert isinstance(streamed(path)[0], Header)


@pytest.mark.parametrize("compression", ["bz2", "gzip", ""])
def test_unknown_compression(tmp_path: Path, compression: str) -> None:
    with pytest.raises(DestinationError, match="allowed are none, lz4, zstd"):
        McapWriter(tmp_path / "a.mcap", compression=compression)
    assert not (tmp_path / "a.mcap").exists()


def test_an_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(OutputError, match="File exists"):
        McapWriter(path)
    assert path.read_bytes() == b"precious"


@pytest.mark.parametrize(
    ("log_time", "publish_time", "sequence"), [(-1, 0, 0), (0, -1, 0), (1 << 64, 0, 0), (0, 0, 1 << 32)]
)
def test_numbers_that_do_not_fit(tmp_path: Path, log_time: int, publish_time: int, sequence: int) -> None:
    writer = McapWriter(tmp_path / "a.mcap")
    handle = writer.add_connection(connection("/odd"))
    with pytest.raises(OutputError, match="unsigned") as caught:
        writer.write(handle, log_time, b"", publish_time, sequence)
    assert caught.value.topic == "/odd"
    with pytest.raises(OutputError, match="unsigned"):
        writer.add_attachment(Attachment("a", "", -1, 0, b""))
    writer.abort()


def test_the_largest_numbers_fit(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    handle = writer.add_connection(connection())
    writer.write(handle, (1 << 64) - 1, b"", (1 << 64) - 1, (1 << 32) - 1)
    writer.write(handle, 0, b"", 0)
    writer.finish()
    assert [m[1:4] for m in read(path)] == [(0, 0, 0), ((1 << 32) - 1, (1 << 64) - 1, (1 << 64) - 1)]


def test_too_many_channels(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    same = connection()
    for _ in range(65535):
        handle = writer.add_connection(same)
    assert handle == 65535
    with pytest.raises(OutputError, match="65535 channels"):
        writer.add_connection(same)
    writer.write(handle, 1, b"last", 1)
    writer.finish()
    with closing(McapReader(path)) as reader:
        assert len(reader.connections) == 65535
        assert [m.connection.id for m in reader.messages()] == [65535]


FULL_DISK = """
import resource, signal, sys
from pathlib import Path
from pc2scan.bags.mcap import McapWriter
from pc2scan.bags.model import Connection
from pc2scan.errors import OutputError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
writer = McapWriter(Path(sys.argv[1]), compression="none")
handle = writer.add_connection(Connection(0, "/a", "a/msg/B", "cdr"))
try:
    for i in range(100):
        writer.write(handle, i, bytes(50_000), i)
    writer.finish()
except OutputError as error:
    print(error)
writer.abort()
"""


def test_a_full_disk(tmp_path: Path, root: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", FULL_DISK, tmp_path / "a.mcap"],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(root)},
    )
    assert result.stdout == f"{tmp_path / 'a.mcap'}: cannot be written: File too large\n"
    assert not result.stderr


@pytest.fixture
def root() -> Path:
    """The folder to import pc2scan from, in another process too."""
    return Path(module.__file__).resolve().parents[2]


def test_abort_leaves_no_valid_recording(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    writer.add_connection(connection())
    writer.abort()
    writer.abort()
    with pytest.raises(RecordingError, match="cut off"):
        McapReader(path)


# --- damage ---


def read_all(path: Path, **options: Any) -> None:
    with closing(McapReader(path, **options)) as reader:
        content(reader)
        list(reader.attachments())
        list(reader.metadata())


def failing(path: Path, match: str, **options: Any) -> RecordingError:
    """Read everything, and return the error."""
    with pytest.raises(RecordingError, match=match) as caught:
        read_all(path, **options)
    assert caught.value.path == path
    return caught.value


def test_files_that_are_not_mcap(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"")
    failing(path, "begins with nothing")
    path.write_bytes(b"#ROSBAG V2.0\n")
    failing(path, "begins with 23 52 4f 53")
    path.write_bytes(MAGIC + record(3, b"ab"))
    failing(path, "HEADER")
    failing(tmp_path / "none.mcap", "No such file")
    failing(tmp_path, "directory")


@pytest.mark.parametrize("case", ["default", "unchunked", "no summary"])
def test_every_truncation_is_an_error(tmp_path: Path, case: str) -> None:
    data = library_file(tmp_path / "a.mcap", SAMPLE[:8], extras=True, **LIBRARY_OPTIONS[case]).read_bytes()
    path = tmp_path / "b.mcap"
    for size in range(len(data)):
        path.write_bytes(data[:size])
        failing(path, r"cut off|begins with|the file has|declared")


@pytest.mark.parametrize("case", ["default", "unchunked", "no summary", "lz4", "uncompressed"])
def test_no_flipped_byte_escapes_as_another_error(tmp_path: Path, case: str) -> None:
    data = library_file(tmp_path / "a.mcap", SAMPLE[:8], extras=True, **LIBRARY_OPTIONS[case]).read_bytes()
    path = tmp_path / "b.mcap"
    failures = 0
    for position, value in itertools.product(range(len(data)), (0x00, 0x7F, 0xFF)):
        damaged = bytearray(data)
        damaged[position] = value
        path.write_bytes(damaged)
        try:
            read_all(path)
        except RecordingError:
            failures += 1
    assert failures > len(data)


def test_truncated_while_reading(tmp_path: Path) -> None:
    messages = [(0, t, os.urandom(5000)) for t in range(20)]
    path = write(tmp_path / "a.mcap", messages, chunk_size=1000)
    with closing(McapReader(path)) as reader:
        found = reader.messages()
        next(found)
        os.truncate(path, 20_000)
        with pytest.raises(RecordingError, match="ended at byte 20000 while it was read"):
            list(found)


def test_reading_after_close(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE)
    reader = McapReader(path)
    reader.close()
    reader.close()
    with pytest.raises(RecordingError, match="Bad file descriptor"):
        content(reader)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_flipped_bit_in_a_chunk(tmp_path: Path, compression: str) -> None:
    path = write(tmp_path / "a.mcap", [(0, 1, os.urandom(5000))], compression=compression)
    data = bytearray(path.read_bytes())
    data[3000] ^= 1
    path.write_bytes(data)
    failing(path, "has CRC|cannot be decompressed")
    if compression != "lz4":  # its frames have no checksum of their own, zstd's by default neither
        with closing(McapReader(path, verify=False)) as reader:
            assert len(content(reader)) == 1


def test_the_summary_has_a_crc(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE)
    data = bytearray(path.read_bytes())
    at = data.rindex(b"/topic1")
    data[at + 6] = ord("9")
    path.write_bytes(data)
    failing(path, "the summary's CRC is")
    with closing(McapReader(path, verify=False)) as reader:
        assert reader.connections[1].topic == "/topic9"


BODY = raw_channel() + raw_message()
DEEP = raw_channel() + raw_message(data=bytes(1 << 20))


def zstd(data: bytes, *, size: bool = True) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=size).compress(data)


@pytest.mark.parametrize(
    ("chunk", "match"),
    [
        (raw_chunk(BODY, compression="bz2"), "compression 'bz2', known are none, lz4 and zstd"),
        (raw_chunk(BODY, compression="z" * 1000), "malformed header: its compression has a name of 1000"),
        (raw_chunk(BODY, uncompressed_size=len(BODY) + 1), "decompresses to"),
        (raw_chunk(BODY, uncompressed_crc=1), "has CRC .*, recorded is 00000001"),
        (raw_chunk(BODY, compression="zstd", packed=b"nonsense"), "cannot be decompressed"),
        (raw_chunk(BODY, compression="lz4", packed=b"nonsense"), "cannot be decompressed"),
        (raw_chunk(BODY, compression="zstd", packed=zstd(BODY)[:-3]), "cannot be decompressed"),
        (raw_chunk(BODY, compression="lz4", packed=lz4.frame.compress(BODY)[:-3]), "cannot be decompressed"),
        (raw_chunk(BODY, compression="zstd", packed=zstd(BODY + b"x")), "the compressed data declare"),
        (raw_chunk(BODY, compression="lz4", packed=lz4.frame.compress(DEEP)), "there is more"),
        (raw_chunk(BODY, compression="zstd", packed=zstd(DEEP, size=False)), "cannot be decompressed"),
        (raw_chunk(DEEP, compression="zstd", packed=zstd(BODY, size=False)), "decompresses to"),
        (raw_chunk(DEEP, compression="lz4", packed=lz4.frame.compress(BODY)), "decompresses to"),
        (
            raw_chunk(BODY, compression="zstd", packed=zstd(BODY, size=False), uncompressed_size=1 << 60),
            "do not fit into memory",
        ),
        (
            raw_chunk(BODY, compression="lz4", packed=lz4.frame.compress(BODY), uncompressed_size=1 << 63),
            "do not fit into memory",
        ),
        (raw_chunk(BODY + raw_message(channel=7)), "channel 7 has messages"),
        (raw_chunk(BODY + b"\x05"), "do not end|sound for"),
        (raw_chunk(BODY[:-1]), "do not end|sound for"),
        (raw_chunk(raw_channel(schema=3)), "channel 1 has schema 3"),
        (raw_channel() + record(5, bytes(21)), "the message at byte"),
        (raw_channel() + record(5, bytes(22)), "channel 0 has messages"),
        (raw_channel()[:-1] + raw_message(), "record at byte"),
        (record(4, b"\x01\x00"), "the Channel record"),
        (record(4, struct.pack("<HHI", 1, 0, 1 << 30)), "the Channel record"),
        (record(4, struct.pack("<HHI", 1, 0, 2) + b"\xff\xff"), "the Channel record"),
        (record(6, bytes(10)), "malformed header|declares"),
        (record(7, b""), "message index"),
    ],
)
def test_damaged_records(tmp_path: Path, chunk: bytes, match: str) -> None:
    failing(raw_file(tmp_path / "a.mcap", chunk), match)


def test_a_length_beyond_the_file(tmp_path: Path) -> None:
    failing(raw_file(tmp_path / "a.mcap", struct.pack("<BQ", 5, 1 << 62)), "the record at byte")


def test_a_zstd_frame_may_omit_its_size(tmp_path: Path) -> None:
    """Streaming compressors (Go's) do not know it beforehand."""
    path = raw_file(tmp_path / "a.mcap", raw_chunk(BODY, compression="zstd", packed=zstd(BODY, size=False)))
    assert [m[4] for m in read(path)] == [b"data"]


def test_unknown_records_are_stepped_over(tmp_path: Path) -> None:
    odd = record(0x80, b"application") + record(0x7F, b"")
    path = raw_file(
        tmp_path / "a.mcap",
        odd,
        raw_channel(),
        raw_message(log_time=1),
        odd,
        raw_chunk(odd + raw_message() + odd),
    )
    assert len(read(path)) == 2


def test_records_with_more_fields_than_today(tmp_path: Path) -> None:
    """ "Records may be extended by adding new fields at the end of existing fields."""
    extended = bytearray(raw_channel())
    extended += b"new"
    struct.pack_into("<Q", extended, 1, len(extended) - 9)
    path = raw_file(tmp_path / "a.mcap", bytes(extended), raw_message())
    assert len(read(path)) == 1


def test_chunks_without_messages(tmp_path: Path) -> None:
    empty: dict[str, Any] = {"message_start_time": 0, "message_end_time": 0}
    path = raw_file(
        tmp_path / "a.mcap",
        raw_chunk(raw_channel(), **empty),
        raw_chunk(b"", **empty),
        raw_chunk(b"", compression="zstd", **empty),
        raw_chunk(raw_message(log_time=9), message_start_time=9, message_end_time=9),
    )
    with closing(McapReader(path)) as reader:
        assert len(content(reader)) == 1
        assert (reader.summary.start_ns, reader.summary.end_ns) == (9, 9)


def altered_index(path: Path, kind: str, change: Callable[[Any], None], *, times: int = 1) -> Path:
    """Change the first summary record of a kind and put the summary back, with a CRC that is right."""
    data = path.read_bytes()
    start, offset_start, _ = struct.unpack_from("<QQI", data, len(data) - 28)
    parts = []
    changed = False
    for item in StreamReader(io.BytesIO(data[start:-8]), skip_magic=True, validate_crcs=False).records:
        if isinstance(item, Footer):
            break
        if type(item).__name__ == kind and not changed:
            change(item)
            changed = True
            parts += [encoded(item)] * times
        else:
            parts.append(encoded(item))
    assert changed
    summary = b"".join(parts)
    footer = struct.pack("<BQQQ", 2, 20, start, offset_start)
    crc = zlib.crc32(footer, zlib.crc32(summary))
    path.write_bytes(data[:start] + summary + footer + struct.pack("<I", crc) + MAGIC)
    return path


@pytest.mark.parametrize("kind", ["AttachmentIndex", "MetadataIndex"])
def test_wrong_offsets_of_attachments_do_no_harm(tmp_path: Path, kind: str) -> None:
    """Files without chunks that @mcap/core 2.2.2 wrote have them."""
    path = library_file(tmp_path / "a.mcap", SAMPLE, extras=True, use_chunking=False)

    def change(index: Any) -> None:
        index.offset = 28

    with closing(McapReader(altered_index(path, kind, change))) as reader:
        assert len(content(reader)) == 60
        assert [each.name for each in reader.attachments()] == ["calibration.yaml"]
        assert [each.name for each in reader.metadata()] == ["robot"]


@pytest.mark.parametrize(
    ("attribute", "delta", "match"),
    [
        ("chunk_start_offset", 1, "no chunk begins|record at byte|data ends|places"),
        ("chunk_start_offset", 1 << 40, "the data ends at byte"),
        ("chunk_length", 1 << 40, "the data ends at byte"),
        ("compressed_size", 1, "the data ends|contradict"),
        ("compressed_size", -1, "contradict"),
        ("uncompressed_size", 1, "contradict"),
        ("message_index_length", 1 << 40, "the record at byte"),
    ],
)
def test_an_index_that_lies(tmp_path: Path, attribute: str, delta: int, match: str) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE, chunk_size=500)

    def change(index: Any) -> None:
        setattr(index, attribute, getattr(index, attribute) + delta)

    failing(altered_index(path, "ChunkIndex", change), match)


def test_a_chunk_that_is_indexed_twice(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE, chunk_size=500)
    failing(altered_index(path, "ChunkIndex", lambda _: None, times=2), "names a chunk twice")


def test_a_malformed_chunk_index(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE)
    data = path.read_bytes()
    start = struct.unpack_from("<Q", data, len(data) - 28)[0]
    summary = record(8, bytes(40))
    footer = struct.pack("<BQQQI", 2, 20, start, 0, 0)
    path.write_bytes(data[:start] + summary + footer + MAGIC)
    failing(path, "a ChunkIndex record in the summary at byte")


def test_statistics_without_counts_by_channel(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE)

    def change(statistics: Any) -> None:
        statistics.channel_message_counts.clear()

    with closing(McapReader(altered_index(path, "Statistics", change))) as reader:
        assert reader.summary.message_count == 60
        assert [c.message_count for c in reader.connections] == [None, None]


@pytest.mark.parametrize(
    ("records", "match"),
    [
        (raw_message() + raw_message()[:-1], "are sound for 35 of 69 bytes"),
        (raw_message() + b"\x05" + bytes(8), "are sound for 35 of 44 bytes"),
        (raw_message() + record(5, bytes(21)) + raw_message(), "are sound for 35 of 100 bytes"),
        (raw_message() + b"\x03\xff" + bytes(7), "are sound for 35 of 44 bytes"),
        (raw_message() + raw_message(channel=2), "channel 2 has messages"),
    ],
)
def test_damage_among_the_messages_of_a_sound_chunk(tmp_path: Path, records: bytes, match: str) -> None:
    index = encoded(MessageIndex(channel_id=1, records=[(1, 0)]))
    path = raw_file(tmp_path / "a.mcap", raw_channel(), raw_chunk(records), index)
    with closing(McapReader(path)) as reader:
        assert [c.topic for c in reader.connections] == ["/t"]
        with pytest.raises(RecordingError, match=match):
            content(reader)


def test_what_precedes_damage_is_kept_for_recovery(tmp_path: Path) -> None:
    data = library_file(
        tmp_path / "a.mcap", SAMPLE, chunk_size=300, **LIBRARY_OPTIONS["no summary"]
    ).read_bytes()
    path = tmp_path / "b.mcap"
    path.write_bytes(data[: len(data) // 2])
    file = module.RecordFile(path)
    contents = module.Contents()
    with pytest.raises(RecordingError, match="the record at byte"):
        module.Walk(file, contents).run(module.read_header(file, contents), file.size)
    module.find_declarations(file, contents)
    assert len(contents.segments) > 3
    assert [channel.topic for channel in contents.channels.values()] == ["/topic0", "/topic1"]
    assert all(len(module.payload(file, segment)) for segment in contents.segments)
    file.close()


# --- other people's files, other people's readers ---


@needs_shared
@pytest.mark.parametrize("name", ["ouster_os1_32.mcap", "d435_depth.mcap"])
def test_real_recordings(name: str, tmp_path: Path) -> None:
    path = RECORDINGS / name
    ours = read(path)
    assert ours == library(path)
    copy = tmp_path / "copy.mcap"
    with closing(McapReader(path)) as reader:
        writer = McapWriter(copy, profile=reader.summary.profile)
        handles = {c.id: writer.add_connection(c) for c in reader.connections}
        for message in reader.messages():
            writer.write(handles[message.connection.id], *message[1:])
        writer.finish()
        with closing(McapReader(copy)) as again:
            assert again.connections == reader.connections
            assert again.summary.message_count == reader.summary.message_count
        assert [c.latching for c in reader.connections if c.topic == "/tf_static"] in ([], [True])
    assert read(copy) == ours
    assert library(copy) == ours


MODULES = os.environ.get("PC2SCAN_NODE_MODULES", "")
needs_npm_reader = pytest.mark.skipif(
    shutil.which("node") is None
    or not all((Path(MODULES) / "@mcap" / name).is_dir() for name in ("core", "support")),
    reason="needs node, and PC2SCAN_NODE_MODULES: a node_modules folder with @mcap/core and @mcap/support",
)


@needs_npm_reader
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_the_npm_reader_agrees(tmp_path: Path, compression: str) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path, compression=compression, chunk_size=1000)
    connections = [
        connection("/tf_static", qos=QOS),
        connection("/tf_static", msgtype="tf2_msgs/msg/TFMessage", metadata={"publisher": "b"}),
        connection("/json", msgtype="", serialization="json", definition=Definition()),
        connection("/unused", definition=Definition()),
    ]
    handles = [writer.add_connection(each) for each in connections]
    messages = [
        *((i, t, d) for i, t, d in SAMPLE),
        (2, 1_700_000_000_123_456_789, b"{}"),
        (0, 1500, os.urandom(90_000)),
    ]
    for sequence, (i, log_time, data) in enumerate(messages):
        writer.write(handles[i], log_time, data, log_time + 7, sequence)
    writer.add_attachment(Attachment("a.bin", "x/y", 3, 4, bytes(range(256))))
    writer.add_metadata(Metadata("robot", {"name": "ü"}))
    writer.finish()

    script = Path(__file__).with_name("mcap_reader.mjs")
    output = subprocess.run(["node", script, MODULES, path], capture_output=True, check=True).stdout
    theirs = json.loads(output)

    def sha(data: bytes) -> str:
        return hashlib.sha256(data).hexdigest()

    written = [[handles[i], n, str(t), str(t + 7), sha(data)] for n, (i, t, data) in enumerate(messages)]
    indexed = theirs["indexed"]
    assert indexed["messages"] == sorted(written, key=lambda message: int(message[2]))  # type: ignore[call-overload]
    assert theirs["streamed"] == {"done": True, "messages": written}
    assert (indexed["profile"], indexed["library"]) == ("ros2", "pc2scan")
    assert [c[2:] for c in indexed["channels"]] == [
        ["/tf_static", "cdr", {"offered_qos_profiles": QOS}],
        ["/tf_static", "cdr", {"publisher": "b"}],
        ["/json", "json", {}],
        ["/unused", "cdr", {}],
    ]
    assert [s[1:] for s in indexed["schemas"]] == [
        [CLOUD, "ros2msg", sha(b"uint8[] data")],
        ["tf2_msgs/msg/TFMessage", "ros2msg", sha(b"uint8[] data")],
        [CLOUD, "", sha(b"")],
    ]
    assert indexed["attachments"] == [["a.bin", "x/y", "3", "4", sha(bytes(range(256)))]]
    assert indexed["metadata"] == [["robot", {"name": "ü"}]]
    assert indexed["summaryOffsets"] == 6
    assert int(indexed["statistics"][0]) == len(messages)


@needs_npm_reader
def test_the_npm_reader_finds_damage(tmp_path: Path) -> None:
    """Without this its agreement would say little."""
    path = write(tmp_path / "a.mcap", [(0, 1, os.urandom(5000))], compression="none")
    data = bytearray(path.read_bytes())
    data[3000] ^= 1
    path.write_bytes(data)
    script = Path(__file__).with_name("mcap_reader.mjs")
    result = subprocess.run(["node", script, MODULES, path], capture_output=True, text=True, check=False)
    assert result.returncode
    assert "Incorrect chunk CRC" in result.stderr or "crc" in result.stderr.lower()
