"""Reading bags: other people's, selection, memory, and damage."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import tracemalloc
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Reader as OtherReader
from rosbags.rosbag1 import Writer as OtherWriter

import pc2scan
from pc2scan.bags.rosbag1.reader import Rosbag1Reader
from pc2scan.errors import RecordingError
from support import RECORDINGS, needs_shared
from support.rosbag1_files import (
    COMPRESSIONS,
    ROS1,
    SCRIPT,
    SECOND,
    STRING_MD5,
    by_time,
    connection,
    given_bytes,
    read,
    read_rows,
    ros1,
    string,
    write,
)

if TYPE_CHECKING:
    from pc2scan.model import RawMessage


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
@pytest.mark.parametrize("name", ["guardian_pallet", "jarvis_two_lasers", "luminar_highway", "velodyne_vlp32"])
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


def filtered(path: Path, topics: set[str] | None, start_ns: int | None, stop_ns: int | None) -> list[RawMessage]:
    with closing(Rosbag1Reader(path)) as reader:
        wanted = None if topics is None else [item for item in reader.connections if item.topic in topics]
        return list(reader.messages(wanted, start_ns, stop_ns))


@pytest.mark.parametrize("topics", [None, set(), {"/a"}, {"/b", "/c"}])
@pytest.mark.parametrize("bounds", [(None, None), (10, None), (None, 40), (10, 40), (10, 10), (99, None), (None, 0)])
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
    with pytest.raises(RecordingError, match=r"cannot be read at byte \d+: Bad file descriptor"):
        list(reader.messages())


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
    path = write(tmp_path / "a.bag", [connection()], [(0, index, bytes(9000)) for index in range(9)], "none", 9000)
    with closing(Rosbag1Reader(path)) as reader:
        messages = reader.messages()
        next(messages)
        os.truncate(path, 10_000)
        with pytest.raises(RecordingError, match=r"ended at byte \d+ while it was read"):
            list(messages)


def test_importing_the_module_is_cheap() -> None:
    heavy = {"bz2", "lz4.frame", "rosbags", "zstandard"}
    code = "import sys, pc2scan.bags.rosbag1.reader, pc2scan.bags.rosbag1.writer; print(*sys.modules)"
    source = Path(pc2scan.__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(source)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert heavy.isdisjoint(done.stdout.split())
