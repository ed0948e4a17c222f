"""Writing MCAP: read back by us, by the mcap library and by the npm reader."""

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
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, given, settings
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, Header, Message, MessageIndex
from mcap.stream_reader import StreamReader

import pc2scan
from pc2scan.bags.mcap.reader import McapReader
from pc2scan.bags.mcap.writer import McapWriter
from pc2scan.errors import DestinationError, OutputError, RecordingError, UnwritableError
from pc2scan.model import Attachment, Definition, Metadata

if TYPE_CHECKING:
    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Writer
from support.mcap_files import (
    CLOUD,
    COMPRESSIONS,
    QOS,
    SAMPLE,
    connection,
    content,
    encoded,
    library,
    read,
    streamed,
    write,
)


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
    messages=st.lists(
        # As CDR, a message begins with a zero byte.
        st.tuples(st.integers(0, 2), st.integers(0, 6), st.binary(max_size=300).map(lambda data: b"\0" + data)),
        max_size=40,
    ),
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
    handle = writer.add_connection(connection(msgtype=msgtype, serialization=serialization, definition=definition))
    writer.write(handle, 1, b"x", 1)
    writer.finish()
    with closing(McapReader(path)) as reader:
        (only,) = reader.connections
    assert (only.msgtype, only.serialization, only.definition) == (written, serialization, definition)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.channels[1].schema_id == (1 if written else 0)


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
        assert [(a.name, a.data) for a in theirs.iter_attachments()] == [(a.name, a.data) for a in attachments]
        assert [m.metadata for m in theirs.iter_metadata()] == [{"k": "v", "ü": "ß"}, {}]


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


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_the_same_calls_write_the_same_bytes(tmp_path: Path, compression: str) -> None:
    one = write(tmp_path / "a.mcap", SAMPLE, compression=compression, chunk_size=1000)
    two = write(tmp_path / "b.mcap", SAMPLE, compression=compression, chunk_size=1000)
    assert one.read_bytes() == two.read_bytes()


def test_schemas_with_and_without_an_id_are_counted_once_each(tmp_path: Path) -> None:
    """Ids are kept for chunks that are copied; what other files add has none, and 0 is none."""
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    connections = [
        connection("/one", id=1, schema_id=7),
        connection("/two", id=2, schema_id=8),
        connection("/three", id=3, schema_id=0, msgtype="std_msgs/msg/String"),
        connection("/four", id=4, schema_id=0, msgtype="", definition=Definition()),
    ]
    writer.keep_ids(connections)
    for each in connections:
        writer.add_connection(each)
    writer.finish()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.schema_count == len(summary.schemas) == 3
    assert {c.topic: c.schema_id for c in summary.channels.values()} == {"/one": 7, "/two": 8, "/three": 1, "/four": 0}
    with closing(McapReader(path, strict=True)) as reader:
        assert [c.ros_type for c in reader.connections] == [c.ros_type for c in connections]


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
        assert [(c.topic, m.data) for _, c, m in NonSeekingReader(file, validate_crcs=True).iter_messages()] == [
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
    with pytest.raises(UnwritableError, match="unsigned") as caught:
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
from pc2scan.bags.mcap.writer import McapWriter
from pc2scan.model import Connection
from pc2scan.errors import OutputError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
sys.dont_write_bytecode = True
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
    return Path(pc2scan.__file__).resolve().parents[1]


def test_abort_leaves_no_valid_recording(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    writer.add_connection(connection())
    writer.abort()
    writer.abort()
    with pytest.raises(RecordingError, match="cut off"):
        McapReader(path, strict=True)


MODULES = os.environ.get("PC2SCAN_NODE_MODULES", "")


needs_npm_reader = pytest.mark.skipif(
    shutil.which("node") is None or not all((Path(MODULES) / "@mcap" / name).is_dir() for name in ("core", "support")),
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

    script = Path(__file__).parents[1] / "mcap_reader.mjs"
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
    script = Path(__file__).parents[1] / "mcap_reader.mjs"
    result = subprocess.run(["node", script, MODULES, path], capture_output=True, text=True, check=False)
    assert result.returncode
    assert "Incorrect chunk CRC" in result.stderr or "crc" in result.stderr.lower()
