from __future__ import annotations

import base64
import bz2
import errno
import itertools
import json
import os
import resource
import struct
import subprocess
import sys
import tempfile
import tracemalloc
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lz4.frame
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Reader as OtherReader
from rosbags.rosbag1 import Writer as OtherWriter

from pc2scan.bags import rosbag1
from pc2scan.bags.model import Attachment, Connection, Definition, Metadata, RawMessage
from pc2scan.bags.rosbag1 import Rosbag1Reader, Rosbag1Writer
from pc2scan.errors import DestinationError, OutputError, RecordingError
from support import RECORDINGS, needs_shared

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from pc2scan.bags.model import Reader, Writer

COMPRESSIONS = ("none", "bz2", "lz4")
STRING = Definition("ros1msg", b"string data\n")
STRING_MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"
SECOND = 1_000_000_000

Row = tuple[int, int, bytes]
"""Handle, log time in ns, data."""


def connection(topic: str = "/chatter", **changes: Any) -> Connection:
    """A connection as ROS 1 itself would have it."""
    return replace(Connection(0, topic, "std_msgs/String", "ros1", STRING, STRING_MD5), **changes)


def string(text: str) -> bytes:
    """A serialised std_msgs/String."""
    return struct.pack("<I", len(text)) + text.encode()


def write(
    path: Path,
    connections: Sequence[Connection],
    rows: Iterable[Row],
    compression: str = "lz4",
    chunk_size: int = 768 * 1024,
) -> Path:
    writer: Writer = Rosbag1Writer(path, compression, chunk_size)
    handles = [writer.add_connection(item) for item in connections]
    for index, time_ns, data in rows:
        writer.write(handles[index], time_ns, data, time_ns)
    writer.finish()
    return path


def read(path: Path) -> list[tuple[str, int, bytes]]:
    with closing(Rosbag1Reader(path)) as reader:
        return [(item.connection.topic, item.log_time_ns, bytes(item.data)) for item in reader.messages()]


def read_rows(path: Path) -> list[Row]:
    with closing(Rosbag1Reader(path)) as reader:
        return [(item.connection.id, item.log_time_ns, bytes(item.data)) for item in reader.messages()]


def by_time(rows: Iterable[Row]) -> list[Row]:
    return sorted(rows, key=lambda row: row[1])


# --------------------------------------------------- bags put together here, so that they can be wrong


def uint32(value: int) -> bytes:
    return struct.pack("<I", value)


def uint64(value: int) -> bytes:
    return struct.pack("<Q", value)


def time(time_ns: int) -> bytes:
    return struct.pack("<II", *divmod(time_ns, SECOND))


def header(**fields: bytes) -> bytes:
    packed = b"".join(
        uint32(len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in fields.items()
    )
    return uint32(len(packed)) + packed


def record(body: bytes = b"", **fields: bytes) -> bytes:
    return header(**fields) + uint32(len(body)) + body


def connection_record(identity: int = 0, **fields: bytes) -> bytes:
    body = {
        "topic": b"/chatter",
        "type": b"std_msgs/String",
        "md5sum": b"*",
        "message_definition": b"string data\n",
    }
    inner = header(**{**body, **fields})[4:]
    return record(inner, op=b"\x07", conn=uint32(identity), topic=b"/chatter")


def message(
    time_ns: int, data: bytes = b"data", identity: int = 0, order: Sequence[str] = ("op", "conn", "time")
) -> bytes:
    fields = {"op": b"\x02", "conn": uint32(identity), "time": time(time_ns)}
    return record(data, **{name: fields[name] for name in order})


def chunk(
    payload: bytes, compression: str = "none", size: int | None = None, stored: bytes | None = None
) -> bytes:
    if stored is None:
        pack: dict[str, Callable[[bytes], bytes]] = {"bz2": bz2.compress, "lz4": lz4.frame.compress}
        stored = pack.get(compression, bytes)(payload)
    size = len(payload) if size is None else size
    return record(stored, op=b"\x05", compression=compression.encode(), size=uint32(size))


def chunk_info(
    position: int,
    start_ns: int,
    end_ns: int,
    counts: dict[int, int],
    *,
    version: int = 1,
    count: int | None = None,
) -> bytes:
    return record(
        b"".join(uint32(value) for item in counts.items() for value in item),
        op=b"\x06",
        ver=uint32(version),
        chunk_pos=uint64(position),
        start_time=time(start_ns),
        end_time=time(end_ns),
        count=uint32(len(counts) if count is None else count),
    )


def bag_header(index_pos: int, connections: int, chunks: int, **more: bytes) -> bytes:
    fields = {
        "index_pos": uint64(index_pos),
        "conn_count": uint32(connections),
        "chunk_count": uint32(chunks),
    }
    return b"#ROSBAG V2.0\n" + record(b" " * 50, op=b"\x03", **fields, **more)


FIRST_CHUNK = len(bag_header(0, 0, 0))


def simple_bag(
    path: Path,
    payload: bytes,
    *,
    compression: str = "none",
    times: tuple[int, int] = (1, 9),
    counts: dict[int, int] | None = None,
    connections: Sequence[bytes] = (connection_record(),),
    **chunk_changes: Any,
) -> Path:
    """A bag of one chunk."""
    body = chunk(payload, compression, **chunk_changes)
    info = chunk_info(FIRST_CHUNK, *times, {0: 1} if counts is None else counts)
    index = b"".join(connections) + info
    path.write_bytes(bag_header(FIRST_CHUNK + len(body), len(connections), 1) + body + index)
    return path


# ---------------------------------------------------------------------------------------- ROS 1 itself

ROS1 = Path("/usr/bin/python3")
ROSBAG = Path("/usr/bin/rosbag")
SCRIPT = Path(__file__).with_name("rosbag1_reader.py")


def ros1(*command: str | Path, stdin: str = "") -> subprocess.CompletedProcess[str]:
    """Run a program of the system's Python, away from this one's environment."""
    hidden = {"VIRTUAL_ENV", "PYTHONPATH", "PYTHONHOME"}
    env = {key: value for key, value in os.environ.items() if key not in hidden}
    return subprocess.run(
        [str(part) for part in command],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**env, "PATH": "/usr/bin:/bin"},
    )


@cache
def ros1_missing() -> str:
    if not ROS1.exists():
        return f"{ROS1} is not here"
    found = ros1(ROS1, "-c", "import rosbag, std_msgs.msg")
    return found.stderr.strip().rpartition("\n")[2]


@pytest.fixture
def needs_ros1() -> None:
    if reason := ros1_missing():
        pytest.skip(f"ROS 1's own rosbag (Debian: python3-rosbag, python3-std-msgs) is not here: {reason}")


def ros1_read(path: Path) -> list[list[Any]]:
    done = ros1(ROS1, SCRIPT, "read", path)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


# ----------------------------------------------------------------------------------------- round trips


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_what_was_written_is_read(tmp_path: Path, compression: str) -> None:
    connections = [
        connection("/a", callerid="/node"),
        connection("/a", callerid="/node"),
        connection("no_slash//double", msgtype="std_msgs/msg/String", digest="", latching=True),
        connection("/ü", callerid="", metadata={"latching": "0", "tcp_nodelay": "1", "topic": "/remapped"}),
        connection("/silent", definition=Definition("ros1msg", b"\xff\xfe not text\r\n")),
    ]
    rows = [(index % 4, 5 * SECOND + index // 3, bytes([index]) * (index * 7)) for index in range(200)]
    path = write(tmp_path / "a.bag", connections, rows, compression, chunk_size=3000)

    with closing(Rosbag1Reader(path)) as opened:
        reader: Reader = opened
        expected = [
            replace(
                item,
                id=index,
                msgtype="std_msgs/String",
                digest=item.digest or "*",
                message_count=sum(row[0] == index for row in rows),
            )
            for index, item in enumerate(connections)
        ]
        assert list(reader.connections) == expected
        messages = list(reader.messages())
        assert [(item.connection.id, item.log_time_ns, bytes(item.data)) for item in messages] == rows
        assert all(item.publish_time_ns == item.log_time_ns for item in messages)
        summary = reader.summary
        assert (summary.container, summary.storage, summary.compression) == ("rosbag1", "", (compression,))
        assert (summary.message_count, summary.start_ns, summary.end_ns) == (200, rows[0][1], rows[-1][1])
        assert summary.size_bytes == path.stat().st_size
        assert 0 < reader.bytes_read <= summary.size_bytes
        assert list(reader.attachments()) == []
        assert list(reader.metadata()) == []
        assert reader.path == path


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    topics=st.lists(st.sampled_from(["/a", "/b", "/c"]), min_size=1, max_size=5),
    picks=st.lists(
        st.tuples(
            st.integers(0, 4),
            st.one_of(st.integers(0, 5), st.integers(0, 2**32 * SECOND - 1)),
            st.integers(0, 300),
        ),
        max_size=60,
    ),
    compression=st.sampled_from(COMPRESSIONS),
    chunk_size=st.integers(1, 1000),
)
def test_any_bag_is_read_in_the_stable_order_of_time(
    topics: list[str], picks: list[tuple[int, int, int]], compression: str, chunk_size: int
) -> None:
    connections = [connection(topic) for topic in topics]
    rows = [
        (pick % len(topics), time_ns, bytes([index % 256]) * size)
        for index, (pick, time_ns, size) in enumerate(picks)
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder) / "a.bag", connections, rows, compression, chunk_size)
        assert read_rows(path) == by_time(rows)


def test_a_bag_without_messages_keeps_its_connections(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bag", [connection()], [])
    with closing(Rosbag1Reader(path)) as reader:
        assert [item.topic for item in reader.connections] == ["/chatter"]
        assert list(reader.messages()) == []
        summary = reader.summary
        assert (summary.message_count, summary.start_ns, summary.end_ns) == (0, None, None)
        assert summary.compression == ()


def test_the_same_calls_make_the_same_bytes(tmp_path: Path) -> None:
    rows = [(index % 2, index, bytes(range(256)) * 4) for index in range(50)]
    pair = [
        write(tmp_path / name, [connection("/a"), connection("/b")], rows, "lz4", 9000).read_bytes()
        for name in ("a.bag", "b.bag")
    ]
    assert pair[0] == pair[1]


# --------------------------------------------------------------------------------- other people's bags


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_bags_of_rosbags_are_read(tmp_path: Path, compression: str) -> None:
    path = tmp_path / "a.bag"
    expected = []
    writer = OtherWriter(path)
    if compression != "none":
        writer.set_compression(OtherWriter.CompressionFormat[compression.upper()])
    writer.chunk_threshold = 2000
    with writer:
        made = [
            writer.add_connection(
                topic, "std_msgs/msg/String", msgdef="string data\n", md5sum=STRING_MD5, callerid="/n"
            )
            for topic in ("/a", "/b")
        ]
        for index in range(100):
            pick, time_ns, data = index % 2, (index * 37) % 50, string(str(index) * 20)
            writer.write(made[pick], time_ns, data)
            expected.append((pick, time_ns, data))
    assert read_rows(path) == by_time(expected)
    with closing(Rosbag1Reader(path)) as reader:
        first = replace(reader.connections[0], message_count=None)
        assert first == connection("/a", callerid="/n")


@pytest.mark.usefixtures("needs_ros1")
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_bags_of_ros1_are_read(tmp_path: Path, compression: str) -> None:
    path = tmp_path / "a.bag"
    rows = [(f"/t{index % 3}", 7 * SECOND + (index * 37) % 50, f"{index} " * 30) for index in range(100)]
    done = ros1(
        ROS1,
        SCRIPT,
        "write",
        path,
        compression,
        "2000",
        stdin="".join(json.dumps(row) + "\n" for row in rows),
    )
    assert done.returncode == 0, done.stderr
    expected = sorted(((topic, stamp, string(text)) for topic, stamp, text in rows), key=lambda row: row[1])
    assert read(path) == expected
    with closing(Rosbag1Reader(path)) as reader:
        assert reader.connections[0].msgtype == "std_msgs/String"
        assert reader.connections[0].digest == STRING_MD5
        assert reader.connections[0].callerid is None
        assert reader.summary.compression == (compression,)


@needs_shared
@pytest.mark.parametrize(
    "name", ["guardian_pallet", "jarvis_two_lasers", "luminar_highway", "velodyne_vlp32"]
)
def test_real_recordings_are_read_as_rosbags_reads_them(name: str) -> None:
    path = RECORDINGS / f"{name}.bag"
    expected: dict[str, list[tuple[int, bytes]]] = {}
    connections = {}
    try:
        with OtherReader(path) as other:
            for item, stamp, data in other.messages():
                expected.setdefault(item.topic, []).append((stamp, data))
            connections = {item.id: item for item in other.connections}
    except AssertionError:
        pytest.skip(f"rosbags cannot read {path.name}")
    with closing(Rosbag1Reader(path)) as reader:
        found: dict[str, list[tuple[int, bytes]]] = {}
        last = 0
        for message in reader.messages():
            assert message.log_time_ns >= last
            last = message.log_time_ns
            found.setdefault(message.connection.topic, []).append((message.log_time_ns, bytes(message.data)))
        assert found == expected
        assert len(reader.connections) == len(connections)
        for own in reader.connections:
            other_one = connections[own.id]
            assert (own.topic, own.ros_type, own.digest) == (
                other_one.topic,
                other_one.msgtype,
                other_one.digest,
            )
            assert (own.definition.text, own.message_count) == (other_one.msgdef.data, other_one.msgcount)


@needs_shared
@pytest.mark.usefixtures("needs_ros1")
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_rewritten_real_recording_is_read_by_others(tmp_path: Path, compression: str) -> None:
    path = tmp_path / "a.bag"
    with closing(Rosbag1Reader(RECORDINGS / "luminar_highway.bag")) as reader:
        original = [(item.connection.id, item.log_time_ns, bytes(item.data)) for item in reader.messages()]
        write(path, reader.connections, original, compression)
    assert read_rows(path) == original
    with OtherReader(path) as other:
        assert [(item.id, stamp, data) for item, stamp, data in other.messages()] == original
    assert [(row[1], base64.b64decode(row[5])) for row in ros1_read(path)] == [row[1:] for row in original]


# -------------------------------------------------------------------------------- read by other people


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_rosbags_reads_our_bags(tmp_path: Path, compression: str) -> None:
    connections = [
        connection("/a", callerid="/n"),
        connection("/a", callerid="/n"),
        connection("/b", latching=True),
    ]
    rows = [(index % 3, (index * 37) % 50, string(str(index) * 20)) for index in range(100)]
    path = write(tmp_path / "a.bag", connections, rows, compression, 2000)
    with OtherReader(path) as reader:
        found = [(item.id, stamp, data) for item, stamp, data in reader.messages()]
        # It keeps the order of equal stamps within a connection only.
        for index in range(3):
            assert [row for row in found if row[0] == index] == [
                row for row in by_time(rows) if row[0] == index
            ]
        assert [row[1] for row in found] == [row[1] for row in by_time(rows)]
        assert [item.topic for item in reader.connections] == ["/a", "/a", "/b"]
        assert reader.connections[2].digest == STRING_MD5


@pytest.mark.usefixtures("needs_ros1")
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_ros1_reads_our_bags(tmp_path: Path, compression: str) -> None:
    connections = [
        connection("/a", callerid="/n"),
        connection("/a", callerid="/n"),
        connection("/b", latching=True, metadata={"tcp_nodelay": "1"}),
    ]
    rows = [(index % 3, 9 * SECOND + index * 5 * SECOND // 7, string(str(index) * 20)) for index in range(99)]
    big = (0, 80 * SECOND, string("big" * 1_000_000))
    path = write(tmp_path / "a.bag", connections, [*rows, big], compression, 2000)

    found = ros1_read(path)
    topics = ["/a", "/a", "/b"]
    expected = [(topics[index], stamp, data) for index, stamp, data in by_time([*rows, big])]
    assert [(row[0], row[1], base64.b64decode(row[5])) for row in found] == expected
    assert {(row[2], row[3]) for row in found} == {("std_msgs/String", STRING_MD5)}
    headers = {row[0]: row[4] for row in found}
    assert headers["/b"] == {
        "latching": "1",
        "md5sum": STRING_MD5,
        "message_definition": "string data\n",
        "tcp_nodelay": "1",
        "topic": "/b",
        "type": "std_msgs/String",
    }
    assert headers["/a"]["callerid"] == "/n"
    assert "latching" not in headers["/a"]

    info = ros1(ROSBAG, "info", "--yaml", path)
    assert info.returncode == 0, info.stderr
    assert "messages: 100\n" in info.stdout
    assert f"compression: {compression}\n" in info.stdout
    check = ros1(ROSBAG, "check", path)
    assert check.returncode == 0, check.stdout + check.stderr


@pytest.mark.usefixtures("needs_ros1")
def test_ros1_finds_messages_that_were_written_out_of_order(tmp_path: Path) -> None:
    rows = [(0, (1 + (index * 37) % 50) * SECOND, string(str(index))) for index in range(50)]
    path = write(tmp_path / "a.bag", [connection()], rows)
    assert [row[1] for row in ros1_read(path)] == [row[1] for row in by_time(rows)]


# ------------------------------------------------------------------------------------------ the reader


@pytest.mark.parametrize("order", list(itertools.permutations(("op", "conn", "time"))), ids=" ".join)
def test_fields_of_messages_may_stand_in_any_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, order: tuple[str, ...]
) -> None:
    payload = b"".join(message(stamp, bytes([stamp]) * stamp, order=order) for stamp in range(1, 10))
    path = simple_bag(tmp_path / "a.bag", payload)
    general = 0
    real = rosbag1._record

    def counted(*arguments: Any) -> Any:
        nonlocal general
        general += 1
        return real(*arguments)

    monkeypatch.setattr(rosbag1, "_record", counted)
    assert read_rows(path) == [(0, stamp, bytes([stamp]) * stamp) for stamp in range(1, 10)]
    # The usual order is expected from the start, another one after its first message.
    assert general == (0 if order == ("conn", "op", "time") else 1)


def test_orders_of_fields_may_change_and_fields_may_be_added(tmp_path: Path) -> None:
    orders = list(itertools.permutations(("op", "conn", "time")))
    payload = connection_record() + message(1)
    payload += record(b"more", op=b"\x02", conn=uint32(0), time=time(2), added=b"field=")
    payload += b"".join(message(3, bytes([index]), order=order) for index, order in enumerate(orders * 2))
    payload += connection_record() + message(4, b"")
    path = simple_bag(tmp_path / "a.bag", payload)
    expected = [(0, 1, b"data"), (0, 2, b"more")]
    expected += [(0, 3, bytes([index])) for index in range(12)]
    assert read_rows(path) == [*expected, (0, 4, b"")]


@pytest.mark.parametrize("size", [0, 1, 3, 37, 38, 39, 45, 46, 47])
def test_a_message_may_hold_what_looks_like_a_record(tmp_path: Path, size: int) -> None:
    data = message(1, b"inside")[:size]
    path = simple_bag(tmp_path / "a.bag", message(1, data) + message(2, data, order=("conn", "op", "time")))
    assert read_rows(path) == [(0, 1, data), (0, 2, data)]


def filtered(
    path: Path, topics: set[str] | None, start_ns: int | None, stop_ns: int | None
) -> list[RawMessage]:
    with closing(Rosbag1Reader(path)) as reader:
        wanted = None if topics is None else [item for item in reader.connections if item.topic in topics]
        return list(reader.messages(wanted, start_ns, stop_ns))


@pytest.mark.parametrize("topics", [None, set(), {"/a"}, {"/b", "/c"}])
@pytest.mark.parametrize(
    "bounds", [(None, None), (10, None), (None, 40), (10, 40), (10, 10), (99, None), (None, 0)]
)
def test_only_what_was_asked_for_is_read(
    tmp_path: Path, topics: set[str] | None, bounds: tuple[int | None, int | None]
) -> None:
    names = ["/a", "/b", "/c"]
    rows = [(index % 3, (index * 37) % 50, bytes([index])) for index in range(100)]
    path = write(tmp_path / "a.bag", [connection(name) for name in names], rows, chunk_size=500)
    low, high = bounds
    expected = [
        row
        for row in by_time(rows)
        if (topics is None or names[row[0]] in topics)
        and (low is None or row[1] >= low)
        and (high is None or row[1] < high)
    ]
    found = filtered(path, topics, low, high)
    assert [(item.connection.id, item.log_time_ns, bytes(item.data)) for item in found] == expected


def test_chunks_without_anything_wanted_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Ten chunks of one message each, on topics /t0 to /t4 in turn.
    rows = [(index % 5, (1 + index) * SECOND, bytes([index]) * 100_000) for index in range(10)]
    path = write(tmp_path / "a.bag", [connection(f"/t{index}") for index in range(5)], rows, "none", 50_000)
    sizes: list[int] = []
    real = os.pread

    def counted(fd: int, length: int, offset: int) -> bytes:
        sizes.append(length)
        return real(fd, length, offset)

    monkeypatch.setattr(os, "pread", counted)
    with closing(Rosbag1Reader(path)) as reader:
        assert max(sizes) < 10_000  # opening reads no chunk

        def large_reads(**query: Any) -> int:
            sizes.clear()
            list(reader.messages(**query))
            assert reader.bytes_read == sum(size for size in sizes if size >= 100_000)
            return sum(size >= 100_000 for size in sizes)

        assert large_reads() == 10
        assert large_reads(connections=[reader.connections[1]]) == 2
        assert large_reads(start_ns=9 * SECOND) == 2
        assert large_reads(stop_ns=2 * SECOND) == 1
        assert large_reads(connections=[]) == 0


def test_chunks_are_read_when_they_are_due(tmp_path: Path) -> None:
    rows = [(0, index * SECOND, bytes(100_000)) for index in range(10)]
    path = write(tmp_path / "a.bag", [connection()], rows, "none", 50_000)
    with closing(Rosbag1Reader(path)) as reader:
        messages = reader.messages()
        assert reader.bytes_read == 0
        next(messages)
        assert 100_000 < reader.bytes_read < 220_000
        next(messages)
        assert 200_000 < reader.bytes_read < 320_000


def test_reading_holds_little_however_long_the_bag(tmp_path: Path) -> None:
    rows = ((0, index * SECOND, bytes(400_000)) for index in range(60))
    path = write(tmp_path / "a.bag", [connection()], rows, "lz4")
    with closing(Rosbag1Reader(path)) as reader:
        tracemalloc.start()
        try:
            assert sum(len(item.data) for item in reader.messages()) == 24_000_000
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    assert peak < 4_000_000


def test_messages_stay_valid_when_the_reader_is_closed(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bag", [connection()], [(0, 1, b"kept")])
    reader = Rosbag1Reader(path)
    messages = list(reader.messages())
    reader.close()
    reader.close()
    assert bytes(messages[0].data) == b"kept"
    with pytest.raises(RecordingError, match="cannot be read: Bad file descriptor"):
        list(reader.messages())


def test_lying_index_records_are_not_looked_at(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bag", [connection()], [(0, 1, b"a"), (0, 2, b"b")], "none")
    raw = bytearray(path.read_bytes())
    # conn, count, op and ver make 47 bytes, followed by the length of two entries of 12 bytes.
    place = raw.index(header(conn=uint32(0), count=uint32(2), op=b"\x04", ver=uint32(1)))
    assert raw[place + 51 : place + 55] == uint32(24)
    raw[place + 51 : place + 55] = uint32(12)
    path.write_bytes(raw)
    assert read_rows(path) == [(0, 1, b"a"), (0, 2, b"b")]


@pytest.mark.parametrize("times", [(0, 0), (9, 1), (2**32 * SECOND - 1, 0)])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_times_that_the_index_does_not_know_are_found_out(
    tmp_path: Path, times: tuple[int, int], compression: str
) -> None:
    payload = connection_record() + message(30) + message(20) + message(25)
    path = simple_bag(tmp_path / "a.bag", payload, times=times, compression=compression, counts={0: 3})
    with closing(Rosbag1Reader(path)) as reader:
        assert (reader.summary.start_ns, reader.summary.end_ns) == (20, 30)
        assert [item.log_time_ns for item in reader.messages()] == [20, 25, 30]
        assert [item.log_time_ns for item in reader.messages(start_ns=30)] == [30]


def test_connections_that_only_a_chunk_describes_are_found(tmp_path: Path) -> None:
    payload = connection_record(5, callerid=b"/first") + message(2, identity=5) + message(3)
    path = simple_bag(tmp_path / "a.bag", payload, counts={0: 1, 5: 1})
    with closing(Rosbag1Reader(path)) as reader:
        assert [(item.id, item.callerid, item.message_count) for item in reader.connections] == [
            (0, None, 1),
            (5, "/first", 1),
        ]
        assert [item.connection.id for item in reader.messages()] == [5, 0]


def test_the_first_of_two_connections_with_one_id_counts(tmp_path: Path) -> None:
    both = [connection_record(callerid=b"/first"), connection_record(callerid=b"/second")]
    path = simple_bag(tmp_path / "a.bag", message(2), connections=both)
    with closing(Rosbag1Reader(path)) as reader:
        assert [item.callerid for item in reader.connections] == ["/first"]


def test_chunks_without_messages_are_passed_over(tmp_path: Path) -> None:
    path = simple_bag(tmp_path / "a.bag", connection_record(), counts={}, times=(0, 0))
    with closing(Rosbag1Reader(path)) as reader:
        assert reader.summary.start_ns is None
        assert list(reader.messages()) == []
    path = simple_bag(tmp_path / "b.bag", connection_record(), times=(0, 0))
    with closing(Rosbag1Reader(path)) as reader:
        assert list(reader.messages()) == []


def test_a_connection_without_a_definition_has_none(tmp_path: Path) -> None:
    inner = header(type=b"std_msgs/String")[4:]
    bare = record(inner, op=b"\x07", conn=uint32(0), topic=b"/bare")
    path = simple_bag(tmp_path / "a.bag", message(1), connections=[bare])
    with closing(Rosbag1Reader(path)) as reader:
        assert reader.connections == (Connection(0, "/bare", "std_msgs/String", "ros1", message_count=1),)


# --------------------------------------------------------------------------------- what cannot be read


def fails(path: Path, *, hint: str = "") -> str:
    """The message of the error that opening and reading a bag raises; it must name the bag."""
    with pytest.raises(RecordingError) as raised, closing(Rosbag1Reader(path)) as reader:
        list(reader.messages())
    assert raised.value.path == path
    assert hint in (raised.value.hint or "")
    return raised.value.message


def given_bytes(tmp_path: Path, data: bytes) -> Path:
    path = tmp_path / "given.bag"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("first", [b"", b"#ROS", b"#ROSBAG V3.0\n", b"SQLite format 3\0", b"#ROSBAG V2.0 "])
def test_a_file_that_is_no_bag_is_refused(tmp_path: Path, first: bytes) -> None:
    assert "a ROS 1 bag begins with b'#ROSBAG V2.0\\n'" in fails(given_bytes(tmp_path, first))


@pytest.mark.parametrize("first", [b"#ROSBAG V1.2\n", b"#ROSRECORD V1.1\n", b"#ROSBAG V1.1\n"])
def test_old_formats_are_refused(tmp_path: Path, first: bytes) -> None:
    assert "only bags of format 2.0" in fails(given_bytes(tmp_path, first + bytes(99)), hint="rosbag fix")


def test_what_cannot_be_opened_is_refused(tmp_path: Path) -> None:
    assert "No such file" in fails(tmp_path / "missing.bag")
    assert "Is a directory" in fails(tmp_path)


def test_an_encrypted_bag_is_refused(tmp_path: Path) -> None:
    raw = bag_header(9999, 1, 1, encryptor=b"rosbag/AesCbcEncryptor")
    assert "encrypted (rosbag/AesCbcEncryptor)" in fails(given_bytes(tmp_path, raw), hint="rosbag decrypt")
    plain = given_bytes(tmp_path, bag_header(FIRST_CHUNK + 14, 0, 0, encryptor=b""))
    with closing(Rosbag1Reader(plain)) as reader:
        assert reader.connections == ()


def test_a_bag_that_was_never_closed_is_refused(tmp_path: Path) -> None:
    message_text = fails(given_bytes(tmp_path, bag_header(0, 0, 0) + chunk(b"")), hint="rosbag reindex")
    assert "index_pos is 0" in message_text


def test_a_cut_bag_is_refused_wherever_it_is_cut(tmp_path: Path) -> None:
    rows = [(index % 2, index, b"x" * 300) for index in range(40)]
    path = write(tmp_path / "a.bag", [connection("/a"), connection("/b")], rows, "bz2", 4000)
    whole = path.read_bytes()
    for length in [*range(0, len(whole), 53), *range(len(whole) - 60, len(whole))]:
        message_text = fails(given_bytes(tmp_path, whole[:length]))
        if length > 5000:
            assert f"the file has {length} bytes" in message_text


@settings(max_examples=300, deadline=None)
@given(place=st.floats(0, 1, exclude_max=True), value=st.binary(min_size=1, max_size=4), data=st.data())
def test_a_damaged_bag_is_read_or_refused(place: float, value: bytes, data: st.DataObject) -> None:
    compression = data.draw(st.sampled_from(COMPRESSIONS))
    raw = bytearray(small_bag(compression))
    # Not in the padding, where nothing happens.
    at = data.draw(st.integers(0, 90)) if place < 0.2 else 4117 + int(place * (len(raw) - 4117))
    raw[at : at + len(value)] = value
    with tempfile.TemporaryDirectory() as folder:
        path = given_bytes(Path(folder), bytes(raw))
        try:
            read_rows(path)
        except RecordingError as error:
            assert error.path == path  # noqa: PT017  # any outcome but another exception will do


@cache
def small_bag(compression: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        rows = [(index % 2, index, b"x" * 50) for index in range(10)]
        path = write(Path(folder) / "a.bag", [connection("/a"), connection("/b")], rows, compression, 500)
        return path.read_bytes()


def test_a_bag_that_shrinks_while_it_is_read_is_an_error(tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.bag", [connection()], [(0, index, bytes(9000)) for index in range(9)], "none", 9000
    )
    with closing(Rosbag1Reader(path)) as reader:
        messages = reader.messages()
        next(messages)
        os.truncate(path, 10_000)
        with pytest.raises(RecordingError, match=r"nothing at byte \d+: the file was cut"):
            list(messages)


def test_an_index_that_is_somewhere_else_is_refused(tmp_path: Path) -> None:
    body = chunk(message(1))
    raw = bag_header(FIRST_CHUNK, 1, 1) + body
    assert "is a chunk, a connection should be there" in fails(given_bytes(tmp_path, raw), hint="reindex")
    raw = bag_header(FIRST_CHUNK, 0, 0)
    at = raw.index(b"op=\x03")
    assert "is a 9, a bag header should be there" in fails(
        given_bytes(tmp_path, raw[: at + 3] + b"\x09" + raw[at + 4 :])
    )
    raw = bag_header(10**12, 1, 1)
    assert "should be at byte 1000000000000, the file has" in fails(
        given_bytes(tmp_path, raw), hint="reindex"
    )


@pytest.mark.parametrize(
    ("info", "expected"),
    [
        (chunk_info(FIRST_CHUNK, 1, 1, {0: 1}, version=2), "version 2, only 1"),
        (chunk_info(FIRST_CHUNK, 1, 1, {0: 1}, count=3), "of 8 bytes declares 3 counts"),
        (chunk_info(FIRST_CHUNK, 1, 1, {3: 1}), "connection 3 has messages and is described nowhere"),
        (chunk_info(2**50, 1, 1, {0: 1}), "4 bytes are declared from byte 1125899906842624"),
        (chunk_info(len(b"#ROSBAG V2.0\n"), 1, 1, {0: 1}), "is a bag header, a chunk should be there"),
        (record(op=b"\x06", ver=b"\1"), "'ver' has 1 bytes, 4 are needed"),
        (record(op=b"\x06"), "no field 'ver'"),
        (record(b"x" * 9, op=b"\x06")[:-1], "the chunk info at byte"),
        (uint32(8) + uint32(2) + b"op" + uint32(0)[:2], "has no '='"),
        (uint32(6) + uint32(9) + b"op" + uint32(0), "does not fit into its header of 6 bytes"),
        (uint32(2) + b"op" + uint32(0), "ends inside a field's length"),
    ],
)
def test_a_damaged_index_is_refused(tmp_path: Path, info: bytes, expected: str) -> None:
    body = chunk(message(1))
    raw = bag_header(FIRST_CHUNK + len(body), 1, 1) + body + connection_record() + info
    assert expected in fails(given_bytes(tmp_path, raw), hint="rosbag reindex")


def test_a_connection_without_a_type_is_refused(tmp_path: Path) -> None:
    bare = record(header(topic=b"/a")[4:], op=b"\x07", conn=uint32(0), topic=b"/a")
    assert "no field 'type'" in fails(simple_bag(tmp_path / "a.bag", message(1), connections=[bare]))


def test_an_unknown_compression_is_refused(tmp_path: Path) -> None:
    path = simple_bag(tmp_path / "a.bag", message(1), compression="zstd")
    assert "compressed with 'zstd', a ROS 1 bag knows none, bz2, lz4" in fails(path, hint="later format")


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("wrong", [-1, 1, 1000])
def test_a_chunk_of_another_size_than_declared_is_refused(
    tmp_path: Path, compression: str, wrong: int
) -> None:
    payload = message(1)
    path = simple_bag(tmp_path / "a.bag", payload, compression=compression, size=len(payload) + wrong)
    observed = f"more than {len(payload) - 1}" if wrong < 0 else str(len(payload))
    assert f"holds {observed} bytes when decompressed, {len(payload) + wrong} are declared" in fails(path)


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_a_decompression_bomb_is_not_let_off(tmp_path: Path, compression: str) -> None:
    bomb = bytes(50_000_000)
    path = simple_bag(tmp_path / "a.bag", bomb, compression=compression, size=1000)
    tracemalloc.start()
    try:
        assert "holds more than 1000 bytes" in fails(path)
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
@pytest.mark.parametrize("size", [100, 2**32 - 1])
def test_compressed_data_that_is_none_is_refused(tmp_path: Path, compression: str, size: int) -> None:
    path = simple_bag(
        tmp_path / "a.bag", b"", compression=compression, size=size, stored=b"not compressed at all"
    )
    assert f"its {compression} data cannot be decompressed" in fails(path)


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_compressed_data_without_its_end_is_refused(tmp_path: Path, compression: str) -> None:
    payload = message(1) * 100
    pack: Callable[[bytes], bytes] = bz2.compress if compression == "bz2" else lz4.frame.compress
    for stored in (pack(payload)[:-1], b""):
        path = simple_bag(tmp_path / "a.bag", payload, compression=compression, stored=stored)
        assert "data ends early" in fails(path)


@pytest.mark.parametrize(
    ("payload", "expected"),
    [
        (message(1, identity=7), "a message of connection 7, which the index does not know"),
        (message(1, order=("conn", "op", "time"))[:-1], "a message reaches to byte 50 of a chunk of 49"),
        (message(1)[:-1], "a record reaches to byte 50 of a chunk of 49"),
        (message(1)[:20], "a record reaches to byte 42 of a chunk of 20"),
        (message(1)[:2], "a record's length does not fit into the 2 bytes"),
        (message(1) + b"\0", "a record's length does not fit"),
        (record(op=b"\x04"), "a record of kind 4"),
        (record(conn=uint32(0)), "no field 'op'"),
        (record(op=b"\x02", time=time(1)), "no field 'conn'"),
        (record(op=b"\x02", conn=b"", time=time(1)), "'conn' has 0 bytes, 4 are needed"),
        (record(op=b"\x02", conn=uint32(0)), "no field 'time'"),
    ],
)
def test_a_damaged_chunk_is_refused(tmp_path: Path, payload: bytes, expected: str) -> None:
    message_text = fails(simple_bag(tmp_path / "a.bag", payload), hint="damaged")
    assert expected in message_text
    assert f"the chunk with data at byte {FIRST_CHUNK + len(chunk(b''))} cannot be read" in message_text


def test_a_damaged_chunk_without_anything_wanted_does_no_harm(tmp_path: Path) -> None:
    path = simple_bag(tmp_path / "a.bag", b"rubbish", connections=[connection_record(), connection_record(1)])
    with closing(Rosbag1Reader(path)) as reader:
        assert list(reader.messages([reader.connections[1]])) == []


# ------------------------------------------------------------------------------------------ the writer


def records_of(raw: bytes) -> list[tuple[dict[str, bytes], bytes]]:
    """All records of a bag, by a walk of its own."""
    found = []
    position = len(b"#ROSBAG V2.0\n")
    while position < len(raw):
        (size,) = struct.unpack_from("<I", raw, position)
        fields = {}
        place, stop = position + 4, position + 4 + size
        while place < stop:
            (length,) = struct.unpack_from("<I", raw, place)
            name, _, value = raw[place + 4 : place + 4 + length].partition(b"=")
            fields[name.decode()] = value
            place += 4 + length
        (size,) = struct.unpack_from("<I", raw, stop)
        found.append((fields, raw[stop + 4 : stop + 4 + size]))
        position = stop + 4 + size
    return found


def test_records_are_laid_out_as_ros1_does(tmp_path: Path) -> None:
    rows = [(0, 5, b"1"), (1, 3, b"2"), (0, 4, b"3"), (0, 9, bytes(2000))]
    path = write(tmp_path / "a.bag", [connection("/a"), connection("/b")], rows, "none", 1500)
    raw = path.read_bytes()
    records = records_of(raw)
    assert [item[0]["op"][0] for item in records] == [3, 5, 4, 4, 5, 4, 7, 7, 6, 6]
    assert all(list(fields) == sorted(fields) for fields, _ in records)
    chunk_pos = len(b"#ROSBAG V2.0\n") + 4096 + 8
    assert raw[chunk_pos:].startswith(header(compression=b"none", op=b"\5", size=uint32(len(records[1][1]))))
    inside = records_of(b"#ROSBAG V2.0\n" + records[1][1])
    assert [item[0]["op"][0] for item in inside] == [7, 2, 7, 2, 2]
    assert [inside[0], inside[2]] == records[6:8]
    # Entries by time, each pointing at its message.
    entries = list(struct.iter_unpack("<III", records[2][1]))
    assert [entry[:2] for entry in entries] == [(0, 4), (0, 5)]
    pointed = [records_of(b"#ROSBAG V2.0\n" + records[1][1][entry[2] :])[0] for entry in entries]
    assert [body for _, body in pointed] == [b"3", b"1"]
    assert records[8] == (
        {
            "chunk_pos": uint64(chunk_pos),
            "count": uint32(2),
            "end_time": time(5),
            "op": b"\6",
            "start_time": time(3),
            "ver": uint32(1),
        },
        uint32(0) + uint32(2) + uint32(1) + uint32(1),
    )


def test_a_large_message_has_a_chunk_of_its_own(tmp_path: Path) -> None:
    rows = [(0, 1, b"a"), (0, 2, bytes(5000)), (0, 3, b"b"), (0, 4, b"c")]
    path = write(tmp_path / "a.bag", [connection()], rows, "none", 1000)
    counts = [
        struct.unpack("<II", body)[1]
        for fields, body in records_of(path.read_bytes())
        if fields["op"] == b"\6"
    ]
    assert counts == [1, 1, 2]


def test_equal_connections_are_never_merged(tmp_path: Path) -> None:
    twins = [connection(callerid="/n")] * 3
    path = write(tmp_path / "a.bag", twins, [(index, index, b"") for index in range(3)])
    with closing(Rosbag1Reader(path)) as reader:
        assert [item.id for item in reader.connections] == [0, 1, 2]
        assert [item.connection.id for item in reader.messages()] == [0, 1, 2]


def test_the_writer_holds_one_chunk(tmp_path: Path) -> None:
    writer = Rosbag1Writer(tmp_path / "a.bag", "none", 100_000)
    handle = writer.add_connection(connection())
    data = bytes(100)

    def chunks(count: int) -> None:
        for _ in range(count * 700):
            writer.write(handle, 1, data, 1)

    chunks(5)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        chunks(60)
        grown = tracemalloc.get_traced_memory()[0] - before
        held = len(writer._chunk.parts)
    finally:
        tracemalloc.stop()
    writer.finish()
    # 42,000 messages later: at most the open chunk, and 60 small records.
    assert grown < 700 * 500 + 60 * 400
    assert held <= 2 * 700


def test_what_is_given_is_not_referred_to_afterwards(tmp_path: Path) -> None:
    writer = Rosbag1Writer(tmp_path / "a.bag", "none", 1000)
    handle = writer.add_connection(connection())
    for size in (10, 5000):
        source = bytearray(b"x" * size)
        writer.write(handle, 1, memoryview(source), 1)
        source[:] = b"y" * size
        source.clear()  # a view that is still held makes this a BufferError
    writer.finish()
    assert [data for _, _, data in read_rows(writer.path)] == [b"x" * 10, b"x" * 5000]


def test_views_of_other_items_are_written_as_bytes(tmp_path: Path) -> None:
    view = memoryview(struct.pack("<3d", 1, 2, 3)).cast("d")
    path = write(tmp_path / "a.bag", [connection()], [(0, 1, view)])  # type: ignore[list-item]
    assert read_rows(path) == [(0, 1, struct.pack("<3d", 1, 2, 3))]


@pytest.mark.parametrize("time_ns", [-1, 2**32 * SECOND])
def test_times_that_a_bag_cannot_hold_are_refused(tmp_path: Path, time_ns: int) -> None:
    writer = Rosbag1Writer(tmp_path / "a.bag")
    handle = writer.add_connection(connection())
    writer.write(handle, 2**32 * SECOND - 1, b"last", 0)
    with pytest.raises(
        OutputError, match=f"log time {time_ns} ns is outside the 0 to 4294967295 s"
    ) as raised:
        writer.write(handle, time_ns, b"", 0)
    assert raised.value.path == writer.path
    writer.finish()
    assert read_rows(writer.path) == [(0, 2**32 * SECOND - 1, b"last")]


def test_a_message_that_no_chunk_can_hold_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = Rosbag1Writer(tmp_path / "a.bag")
    handle = writer.add_connection(connection())
    monkeypatch.setattr(rosbag1, "_UINT32_MAX", 1000)
    with pytest.raises(OutputError, match="a message of 990 bytes does not fit into a ROS 1 bag"):
        writer.write(handle, 1, bytes(990), 1)
    writer.abort()


def test_compressions_that_bags_do_not_know_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        DestinationError, match="cannot be compressed with zstd, only with none, bz2, lz4"
    ) as raised:
        Rosbag1Writer(tmp_path / "a.bag", "zstd")
    assert raised.value.hint
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = given_bytes(tmp_path, b"precious")
    with pytest.raises(DestinationError, match="exists already"):
        Rosbag1Writer(path)
    assert path.read_bytes() == b"precious"


def test_a_bag_that_cannot_be_created_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be created: No such file or directory") as raised:
        Rosbag1Writer(tmp_path / "missing" / "a.bag")
    assert raised.value.path == tmp_path / "missing" / "a.bag"


@pytest.mark.parametrize("size", [500, 50_000])
def test_a_full_disk_is_an_error(tmp_path: Path, size: int) -> None:
    writer = Rosbag1Writer(tmp_path / "a.bag", "none", 40_000)
    handle = writer.add_connection(connection())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))

    def fill() -> None:
        writer.write(handle, 1, bytes(size), 1)
        writer.finish()

    try:
        writer.write(handle, 1, bytes(20_000), 1)
        with pytest.raises(OutputError, match="cannot be written: File too large") as raised:
            fill()
        writer.abort()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert raised.value.path == writer.path


def test_a_disk_that_fails_at_the_end_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fsync(_fd: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    writer = Rosbag1Writer(tmp_path / "a.bag")
    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(OutputError, match="cannot be written: No space left on device"):
        writer.finish()
    writer.abort()


def test_an_aborted_bag_is_no_bag(tmp_path: Path) -> None:
    writer = Rosbag1Writer(tmp_path / "a.bag", "none", 100)
    handle = writer.add_connection(connection())
    writer.write(handle, 1, bytes(200), 1)
    writer.abort()
    writer.abort()
    assert "has no index" in fails(writer.path)


def test_finish_puts_the_bag_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = []
    monkeypatch.setattr(os, "fsync", lambda fd: sizes.append(os.fstat(fd).st_size))
    path = write(tmp_path / "a.bag", [connection()], [(0, 1, b"x")])
    assert sizes == [path.stat().st_size]


def test_messages_of_another_serialisation_are_refused(tmp_path: Path) -> None:
    writer = Rosbag1Writer(tmp_path / "a.bag")
    with pytest.raises(DestinationError, match="serialised as 'ros1', these are 'cdr'") as raised:
        writer.add_connection(connection(serialization="cdr"))
    assert raised.value.topic == "/chatter"
    with pytest.raises(DestinationError, match="'a=b' has a '='"):
        writer.add_connection(connection(metadata={"a=b": "c"}))
    writer.abort()


def test_attachments_and_metadata_are_left_out(tmp_path: Path) -> None:
    writer = Rosbag1Writer(tmp_path / "a.bag")
    writer.add_attachment(Attachment("name", "text/plain", 1, 1, b"data"))
    writer.add_metadata(Metadata("name", {}))
    writer.finish()
    assert read_rows(writer.path) == []


def test_importing_the_module_is_cheap() -> None:
    heavy = {"bz2", "lz4.frame", "rosbags", "zstandard"}
    code = "import sys, pc2scan.bags.rosbag1; print(*sys.modules)"
    source = Path(rosbag1.__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(source)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert heavy.isdisjoint(done.stdout.split())
