"""What every reader keeps to, of recordings that others wrote: messages, order, selection, counts, and harmlessness."""

from __future__ import annotations

import json
import os
import random
from collections import Counter
from contextlib import closing
from typing import TYPE_CHECKING, Any, Literal

import pytest
import zstandard
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as TheirWriter

from pc2scan.bags.opening import open_recording, sniff
from pc2scan.errors import RecordingError
from pc2scan.model import Attachment, Definition, Metadata
from support import sampled
from support.builders import CONTENT, SOURCES, STRING, Recording, definition, ros_version_of
from support.containers import FORMATS, KINDS, Row, recorded
from support.mcap_files import LIBRARY_OPTIONS, SAMPLE, library_file
from support.rosbag1_files import ROS1, SCRIPT, ros1, ros1_missing, string
from support.rosbag2_files import STORE, text

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.reader import Reader

#: Options of MCAP's library with which there is nothing to count by, at least for a part of the time.
SILENT = {"unchunked", "unchunked without summary", "no indexes", "only chunk indexes", "no message indexes",
          "no summary"}  # fmt: skip
UNCOUNTED = {"no statistics", "no summary", "unchunked without summary", "no summary but message indexes"}


def content_in(ros_version: int, recording: Recording = CONTENT) -> list[Row]:
    return [(item.stream.topic, item.log_time_ns, item.data[ros_version]) for item in recording.items]


def in_time_order(rows: list[Row]) -> list[Row]:
    return sorted(rows, key=lambda row: row[1])


def selected(reader: Reader, *selection: Any) -> list[Row]:
    return [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages(*selection)]


def check_reader(path: Path, expected: list[Row], *, silent: bool = False) -> None:
    """Hold a reader to its contract: all messages, any selection, and counts that agree with them, or are silent."""
    with closing(open_recording(path, strict=True)) as reader:
        assert selected(reader) == expected
        assert reader.damage == ()
        times = [row[1] for row in expected]
        rng = random.Random(1)
        cuts: list[tuple[int | None, int | None]] = [
            (None, None),
            (min(times), max(times)),
            (min(times) + 1, None),
            (None, max(times) + 1),
            (max(times) + 1, None),
        ]
        cuts += [(min(pair), max(pair)) for pair in (rng.choices(times, k=2) for _ in range(4))]
        for chosen in (reader.connections[::2], reader.connections[1::2], []):
            topics = {connection.topic for connection in chosen}
            for start_ns, stop_ns in cuts:
                wanted = [
                    row
                    for row in expected
                    if row[0] in topics
                    and (start_ns is None or start_ns <= row[1])
                    and (stop_ns is None or row[1] < stop_ns)
                ]
                # Publishers of one topic may be on both sides.
                ids = {connection.id for connection in chosen}
                found = list(reader.messages(chosen, start_ns, stop_ns))
                assert {m.connection.id for m in found} <= ids
                if Counter(c.topic for c in reader.connections).most_common(1)[0][1] == 1:
                    assert [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in found] == wanted
                counted = reader.counts(chosen, start_ns, stop_ns)
                numbers = Counter(m.connection.id for m in found)
                assert counted == {key: numbers[key] for key in counted}
                assert silent or counted.keys() == ids
        summary = reader.summary
        assert (summary.start_ns, summary.end_ns) == (min(times), max(times))
        assert summary.message_count in (None, len(expected))


@pytest.mark.parametrize("name", SOURCES)
def test_recordings_of_others_are_read(name: str, tmp_path: Path) -> None:
    ros_version = ros_version_of(name)
    path = SOURCES[name](tmp_path, CONTENT)
    before = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*")}
    check_reader(path, content_in(ros_version), silent="unchunked" in name)
    assert {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*")} == before
    with closing(open_recording(path)) as reader:
        assert {c.serialization for c in reader.connections} == {"ros1" if ros_version == 1 else "cdr"}
        if name != "rosbag2-sqlite3-v2":
            assert {c.topic for c in reader.connections if c.latching} == {"/tf_static"}
        for stream in CONTENT.streams:
            found = [c for c in reader.connections if c.topic == stream.topic]
            assert {c.ros_type for c in found} == {stream.type_in(ros_version)}
            texts = {c.definition.text for c in found}
            if not name.startswith(("rosbag2-sqlite3-v2", "rosbag2-sqlite3-v4", "rosbag2-sqlite3-v5")):
                assert texts == {definition(stream.type_in(ros_version), ros_version)}


@pytest.mark.parametrize("name", LIBRARY_OPTIONS)
def test_every_shape_of_an_mcap_file_is_read(name: str, tmp_path: Path) -> None:
    options = LIBRARY_OPTIONS[name]
    path = library_file(tmp_path / "a.mcap", SAMPLE, extras=True, chunk_size=300, **options)
    check_reader(path, in_time_order([(f"/topic{i}", time, data) for i, time, data in SAMPLE]), silent=name in SILENT)
    with closing(open_recording(path)) as reader:
        assert [(m.sequence, m.publish_time_ns - m.log_time_ns) for m in reader.messages()] == [
            (number, 5) for number, _ in sorted(enumerate(SAMPLE), key=lambda entry: entry[1][1])
        ]
        assert {c.definition for c in reader.connections} == {Definition("ros2msg", b"uint8[] data")}
        assert list(reader.attachments()) == [Attachment("calibration.yaml", "text/yaml", 8, 7, b"a: 1")]
        assert list(reader.metadata()) == [Metadata("robot", {"name": "r2"})]
        # Only the statistics count them without reading more.
        assert reader.summary.message_count == (None if name in UNCOUNTED else 60)
        assert [c.message_count for c in reader.connections] == ([None] * 2 if name in UNCOUNTED else [30] * 2)


THEIR_QOS = Qos(
    QosHistory.KEEP_LAST, 5, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, QosTime(1, 2), QosTime(3, 4),
    QosLiveliness.AUTOMATIC, QosTime(5, 6), False,
)  # fmt: skip


@pytest.mark.parametrize(
    ("version", "plugin", "mode"),
    # Version, storage and compression in pairs; sqlite3 has no compression of its own.
    [
        (8, StoragePlugin.SQLITE3, CompressionMode.NONE),
        (9, StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        (8, StoragePlugin.SQLITE3, CompressionMode.FILE),
        (9, StoragePlugin.MCAP, CompressionMode.NONE),
        (8, StoragePlugin.MCAP, CompressionMode.MESSAGE),
        (9, StoragePlugin.MCAP, CompressionMode.FILE),
        (8, StoragePlugin.MCAP, CompressionMode.STORAGE),
    ],
)
def test_what_rosbags_writes_is_read(
    version: Literal[8, 9], plugin: StoragePlugin, mode: CompressionMode, tmp_path: Path
) -> None:
    theirs = TheirWriter(tmp_path / "bag", version=version, storage_plugin=plugin)
    theirs.set_compression(mode, CompressionFormat.ZSTD)
    theirs.set_custom_data("robot", "r2")
    rows = [("/b" if number % 2 else "/a", 100 + number, text(f"message {number}")) for number in range(6)]
    with theirs:
        handles = {
            "/a": theirs.add_connection("/a", STRING, typestore=STORE, offered_qos_profiles=[THEIR_QOS]),
            "/b": theirs.add_connection("/b", STRING, typestore=STORE),
        }
        for topic, time_ns, data in rows:
            theirs.write(handles[topic], time_ns, data)
    check_reader(tmp_path / "bag", rows)
    with closing(open_recording(tmp_path / "bag")) as reader:
        a, b = reader.connections
        assert (a.topic, a.msgtype, a.serialization, a.message_count) == ("/a", STRING, "cdr", 3)
        assert (a.latching, b.latching) == (True, False)
        assert (a.definition.encoding, a.digest) == ("ros2msg", STORE.hash_rihs01(STRING))
        assert ("transient_local" in a.qos) == (version == 9)
        assert reader.summary.compression == (("none",) if mode == CompressionMode.NONE else ("zstd",))


@pytest.mark.skipif(bool(ros1_missing()), reason="needs ROS 1's rosbag (Debian: python3-rosbag)")
@pytest.mark.parametrize("compression", sampled(["lz4", "bz2", "none"], 1))
def test_what_ros1_writes_is_read(compression: str, tmp_path: Path) -> None:
    rows = [(f"/t{index % 3}", 7_000_000_000 + (index * 37) % 50, f"{index} " * 30) for index in range(100)]
    lines = "".join(json.dumps(row) + "\n" for row in rows)
    done = ros1(ROS1, SCRIPT, "write", tmp_path / "a.bag", compression, "2000", stdin=lines)
    assert done.returncode == 0, done.stderr
    check_reader(tmp_path / "a.bag", in_time_order([(topic, time_ns, string(data)) for topic, time_ns, data in rows]))
    with closing(open_recording(tmp_path / "a.bag")) as reader:
        first = reader.connections[0]
        assert (first.msgtype, first.callerid) == ("std_msgs/String", None)
        assert reader.summary.compression == (compression,)


# --- Opening: what is refused is in ``tests/transcripts/opening.txt`` ---


MADE = {"rosbag1": "bag-lz4", "mcap": "mcap-zstd", "rosbag2": "rosbag2-mcap-v8", "sqlite3": "db3"}


@pytest.mark.parametrize("kind", ["rosbag1", "mcap", "sqlite3"])
def test_files_compressed_as_a_whole_are_read(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    monkeypatch.setattr("tempfile.tempdir", None)
    made = SOURCES[MADE[kind]](tmp_path, CONTENT)
    packed = tmp_path / "packed"
    packed.write_bytes(zstandard.compress(made.read_bytes()))
    assert sniff(packed) == f"{kind}+zstd"
    check_reader(packed, content_in(1 if kind == "rosbag1" else 2))
    with closing(open_recording(packed)) as reader:
        assert list(temporary.iterdir())
        summary = reader.summary
        assert (reader.path, summary.container, summary.size_bytes) == (packed, kind, packed.stat().st_size)
        assert "zstd" in summary.compression
        assert "none" not in summary.compression
        assert [*reader.attachments(), *reader.metadata()] == []
    assert not list(temporary.iterdir())
    packed.write_bytes(zstandard.compress(made.read_bytes()[:600]))
    with pytest.raises(RecordingError):
        open_recording(packed, strict=True)
    assert not list(temporary.iterdir())


# --- Harmlessness ---

LONG = {**FORMATS, "bag-lz4": KINDS["bag-lz4"], "mcap-zstd": KINDS["mcap-ros2-zstd"]}
DATA = random.Random(1).randbytes(900_000)


def long_recording(name: str, folder: Path) -> Path:
    """Ten messages of five topics, each of which has a chunk of its own, ten nanoseconds apart."""
    return recorded(LONG[name], folder, [(f"/{number % 5}", 10 * number, DATA) for number in range(10)])


@pytest.mark.parametrize("name", LONG)
def test_messages_outlive_their_reader(name: str, tmp_path: Path) -> None:
    reader = open_recording(long_recording(name, tmp_path))
    messages = reader.messages()
    found = [next(messages), next(messages)]
    reader.close()
    reader.close()
    # As an error does whose traceback outlives the reader: Python would complain on stderr.
    messages.close()
    assert [bytes(each.data) for each in found] == [DATA] * 2
    with pytest.raises(RecordingError, match="is closed" if "sqlite3" in name else "Bad file descriptor"):
        list(reader.messages())


@pytest.mark.parametrize("name", ["bag", "mcap", "rosbag2-mcap"])
def test_a_file_that_shrinks_while_it_is_read_is_an_error(name: str, tmp_path: Path) -> None:
    path = long_recording(name, tmp_path)
    with closing(open_recording(path)) as reader:
        messages = reader.messages()
        next(messages)
        os.truncate(path if path.is_file() else path / "out_0.mcap", 1_000_000)
        with pytest.raises(RecordingError, match=r"ended at byte 1000000 while it was read"):
            list(messages)
