"""Writing bags: read back by us, by rosbags and by ROS 1 itself."""

from __future__ import annotations

import base64
import errno
import os
import resource
import struct
import tempfile
import tracemalloc
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Reader as OtherReader

from pc2scan.bags.rosbag1 import writer as rosbag1_writer
from pc2scan.bags.rosbag1.reader import Rosbag1Reader
from pc2scan.bags.rosbag1.writer import Rosbag1Writer
from pc2scan.errors import DestinationError, OutputError, UnwritableError
from pc2scan.model import Attachment, Definition, Metadata
from support import RECORDINGS, needs_shared

if TYPE_CHECKING:
    from pc2scan.bags.reader import Reader
from support.rosbag1_files import (
    COMPRESSIONS,
    ROSBAG,
    SECOND,
    STRING_MD5,
    by_time,
    connection,
    fails,
    given_bytes,
    header,
    read_rows,
    ros1,
    ros1_read,
    string,
    time,
    uint32,
    uint64,
    write,
)


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
        (pick % len(topics), time_ns, bytes([index % 256]) * size) for index, (pick, time_ns, size) in enumerate(picks)
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
            assert [row for row in found if row[0] == index] == [row for row in by_time(rows) if row[0] == index]
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
    counts = [struct.unpack("<II", body)[1] for fields, body in records_of(path.read_bytes()) if fields["op"] == b"\6"]
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
    with pytest.raises(UnwritableError, match=f"log time {time_ns} ns is outside the 0 to 4294967295 s") as raised:
        writer.write(handle, time_ns, b"", 0)
    assert raised.value.path == writer.path
    writer.finish()
    assert read_rows(writer.path) == [(0, 2**32 * SECOND - 1, b"last")]


def test_a_message_that_no_chunk_can_hold_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = Rosbag1Writer(tmp_path / "a.bag")
    handle = writer.add_connection(connection())
    monkeypatch.setattr(rosbag1_writer, "UINT32_MAX", 1000)
    with pytest.raises(UnwritableError, match="a message of 990 bytes does not fit into a ROS 1 bag"):
        writer.write(handle, 1, bytes(990), 1)
    writer.abort()


def test_compressions_that_bags_do_not_know_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DestinationError, match="cannot be compressed with zstd, only with none, bz2, lz4") as raised:
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
    assert "was never closed" in fails(writer.path)


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
