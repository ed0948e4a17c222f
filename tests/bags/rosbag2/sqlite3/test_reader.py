"""rosbag2's sqlite3 storage: databases of every schema version, made by the standard library's sqlite3."""

from __future__ import annotations

import sqlite3
import tracemalloc
from contextlib import closing
from typing import TYPE_CHECKING

import pytest
import zstandard

from pc2scan.bags.rosbag2.sqlite3.reader import Sqlite3Reader
from pc2scan.bags.rosbag2.sqlite3.writer import Sqlite3Writer
from pc2scan.errors import RecordingError
from pc2scan.model import Connection, Definition

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

QOS = "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 1"
TOPICS = {
    1: "id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL",
    2: ", offered_qos_profiles TEXT NOT NULL",
    4: ", type_description_hash TEXT NOT NULL",
}
MESSAGES = [(1, 20, b"\0\1\0\0b"), (2, 10, b"\0\1\0\0a"), (1, 20, b"\0\1\0\0c"), (1, 5, b"\0\1\0\0first")]
INSERT = "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)"


def build(
    path: Path, version: int, script: str = "", rows: Iterable[tuple[int, int, bytes]] = (), *, index: bool = True
) -> Path:
    """Make what rosbag2 of that schema version made, with further rows, and run a script on it."""
    with closing(sqlite3.connect(path)) as database, database:
        columns = "".join(text for since, text in TOPICS.items() if since <= version)
        database.execute(f"CREATE TABLE topics({columns})")
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
            "timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
        )
        if index:
            database.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        if version >= 3:
            database.execute("CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL)")
            database.execute("INSERT INTO schema VALUES (?, 'iron')", (version,))
        if version >= 4:
            database.execute(
                "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT, "
                "encoded_message_definition TEXT, type_description_hash TEXT)"
            )
            database.execute("INSERT INTO message_definitions VALUES (1, 'a/msg/A', 'ros2msg', 'int8 x\n', 'RIHS01_a')")
            database.execute("INSERT INTO message_definitions VALUES (2, 'a/msg/B', '', '', '')")
        for number, (name, qos, digest) in enumerate((("A", QOS, "RIHS01_a"), ("B", "", "")), 1):
            row = [number, f"/{name.lower()}", f"a/msg/{name}", "cdr", qos, digest][
                : 4 + (version >= 2) + (version >= 4)
            ]
            database.execute(f"INSERT INTO topics VALUES ({', '.join('?' * len(row))})", row)
        database.executemany(INSERT, [*MESSAGES, *rows])
        database.executescript(script)
    return path


def times_of(path: Path) -> list[int]:
    with closing(Sqlite3Reader(path)) as reader:
        return [m.log_time_ns for m in reader.messages()]


@pytest.mark.parametrize("index", [True, False])
@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_every_schema_version_is_read(version: int, index: bool, tmp_path: Path) -> None:
    with closing(Sqlite3Reader(build(tmp_path / "x.db3", version, index=index))) as reader:
        first, second = reader.connections
        assert (first.id, first.topic, first.msgtype, first.serialization) == (1, "/a", "a/msg/A", "cdr")
        assert (first.message_count, second.message_count) == (3, 1)
        assert (first.qos, first.latching, second.latching) == (QOS if version >= 2 else "", version >= 2, False)
        assert first.digest == ("RIHS01_a" if version >= 4 else "")
        assert first.definition == (Definition("ros2msg", b"int8 x\n") if version >= 4 else Definition())
        assert second.definition == Definition()
        found = [(m.log_time_ns, m.publish_time_ns, bytes(m.data)[4:]) for m in reader.messages()]
        assert found == [(5, 5, b"first"), (10, 10, b"a"), (20, 20, b"b"), (20, 20, b"c")]
        summary = reader.summary
        assert (summary.container, summary.compression, summary.message_count) == ("sqlite3", ("none",), 4)
        assert (summary.start_ns, summary.end_ns) == (5, 20)
        assert 0 < reader.bytes_read <= summary.size_bytes
        for selection, times in (
            (([second],), [10]),
            (([first], 5, 20), [5]),
            ((None, 10, 2**70), [10, 20, 20]),
            ((None, -(2**70), 10), [5]),
            (([],), []),
        ):
            assert [m.log_time_ns for m in reader.messages(*selection)] == times
        messages = reader.messages()
        next(messages)
    # As an error does whose traceback outlives the reader: Python would complain on stderr.
    messages.close()
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.db3"]


def test_a_file_of_more_than_2_gib_is_read(tmp_path: Path) -> None:
    path = build(tmp_path / "x.db3", 4)
    with path.open("r+b") as file:
        file.truncate((2 << 30) + 4096)  # a hole, which takes no room
    assert len(times_of(path)) == len(MESSAGES)


def test_a_selection_of_topics_does_not_lose_the_index(tmp_path: Path) -> None:
    path = build(tmp_path / "x.db3", 4, "CREATE INDEX by_topic ON messages (topic_id); ANALYZE")
    with closing(Sqlite3Reader(path)) as reader:
        seen: list[str] = []
        opened = reader._database._connection
        assert opened is not None
        opened.set_trace_callback(seen.append)
        assert len(list(reader.messages([reader.connections[0]]))) == 3
        opened.set_trace_callback(None)
        (plan,) = opened.execute(f"EXPLAIN QUERY PLAN {seen[-1]}").fetchall()
        assert "timestamp_idx" in plan[3]


def test_a_definition_is_chosen_by_hash(tmp_path: Path) -> None:
    script = """UPDATE message_definitions SET type_description_hash = 'RIHS01_old' WHERE id = 1;
        INSERT INTO message_definitions VALUES (3, 'a/msg/A', 'ros2idl', 'idl', 'RIHS01_a');
        INSERT INTO message_definitions VALUES (4, 'a/msg/B', 'unknown', '', '')"""
    with closing(Sqlite3Reader(build(tmp_path / "x.db3", 4, script))) as reader:
        assert [each.definition for each in reader.connections] == [Definition("ros2idl", b"idl"), Definition()]


def test_messages_of_unknown_topics_are_no_messages(tmp_path: Path) -> None:
    with closing(Sqlite3Reader(build(tmp_path / "x.db3", 2, rows=[(77, 1, b"\0")]))) as reader:
        assert (reader.summary.message_count, reader.summary.start_ns) == (4, 5)
        assert len(list(reader.messages())) == 4


def test_names_that_are_not_utf8_do_not_stop_reading(tmp_path: Path) -> None:
    script = "UPDATE topics SET name = CAST(x'2f61ff' AS TEXT) WHERE id = 1"
    with closing(Sqlite3Reader(build(tmp_path / "x.db3", 2, script))) as reader:
        assert reader.connections[0].topic == "/a\ufffd"


def test_a_hot_rollback_journal_is_rolled_back(tmp_path: Path) -> None:
    live, folder = tmp_path / "live.db3", tmp_path / "copy"
    folder.mkdir()
    build(live, 2)
    with closing(sqlite3.connect(live, isolation_level=None)) as database:
        database.execute("PRAGMA cache_size=1")
        database.execute("BEGIN")
        database.execute("UPDATE messages SET timestamp = 99")
        for number in range(200):
            database.execute("INSERT INTO messages VALUES (?, 1, 99, zeroblob(4000))", (number + 10,))
        for suffix in ("", "-journal"):
            (folder / f"x.db3{suffix}").write_bytes((tmp_path / f"live.db3{suffix}").read_bytes())
    assert (folder / "x.db3-journal").stat().st_size
    assert times_of(folder / "x.db3") == [5, 10, 20, 20]


def test_without_an_index_memory_does_not_grow(tmp_path: Path) -> None:
    rows = ((1, 1000 - number, bytes(100_000)) for number in range(100))
    path = build(tmp_path / "x.db3", 2, rows=rows, index=False)
    tracemalloc.start()
    try:
        with closing(Sqlite3Reader(path)) as reader:
            times = [m.log_time_ns for m in reader.messages()]
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert times == sorted(times)
    assert len(times) == 104
    assert peak < 2_000_000


@pytest.mark.parametrize("index", [True, False])
def test_a_unit_may_be_loaded_again(index: bool, tmp_path: Path) -> None:
    """Its rows are not kept for that."""
    rows = [(1, 30, bytes([number]) * 300_000) for number in range(9)]
    with closing(Sqlite3Reader(build(tmp_path / "x.db3", 2, rows=rows, index=index))) as reader:
        units = list(reader.units(start_ns=6))
        loaded = [unit.load(lambda message: message, whole=False) for unit in units]
        assert [len(found) for found in loaded] == [5, 2, 2, 2, 1]  # type: ignore[arg-type]
        assert [unit.load(lambda message: message, whole=False) for unit in reversed(units)] == loaded[::-1]
        assert [message for found in loaded for message in found] == list(reader.messages(start_ns=6))  # type: ignore[union-attr]


@pytest.mark.parametrize("content_size", [True, False])
@pytest.mark.parametrize("declared", ["zstd", "none"])
def test_compressed_messages_are_recognised(declared: str, content_size: bool, tmp_path: Path) -> None:
    path = build(tmp_path / "x.db3", 2)
    pack = zstandard.ZstdCompressor(write_content_size=content_size).compress
    with closing(sqlite3.connect(path)) as database, database:
        database.create_function("pack", 1, pack)
        database.execute("UPDATE messages SET data = pack(data)")
    with closing(Sqlite3Reader(path, message_compression=declared)) as reader:
        assert reader.summary.compression == ("zstd",)
        assert [bytes(m.data)[4:] for m in reader.messages()] == [b"first", b"a", b"b", b"c"]


CUT_OFF = zstandard.compress(b"hello" * 100)[:-3].hex()


@pytest.mark.parametrize(
    ("script", "compression", "told"),
    [
        (f"UPDATE messages SET data = x'{CUT_OFF}'", "none", r"/a: .*full frame"),
        ("", "zstd", "cannot be decompressed"),
        ("UPDATE messages SET data = 'text'", "none", "row 4 of messages, of topic '/a', has data 'text', not a blob"),
    ],
)
def test_damaged_messages_are_named(script: str, compression: str, told: str, tmp_path: Path) -> None:
    path = build(tmp_path / "x.db3", 2, script)
    reader = Sqlite3Reader(path, message_compression=compression, strict=True)
    with closing(reader), pytest.raises(RecordingError, match=told):
        list(reader.messages())


def test_what_is_not_rosbag2_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    with pytest.raises(RecordingError, match="No such file"):
        Sqlite3Reader(path)
    path.write_bytes(b"SQLite format 3\0" + bytes(4000))
    with pytest.raises(RecordingError, match="nothing of it can be recovered: SQLite cannot read it"):
        Sqlite3Reader(path)
    path.unlink()
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("CREATE TABLE topics(id)")
    with pytest.raises(RecordingError, match="table topics lacks name, serialization_format, type"):
        Sqlite3Reader(path)


# --- What is written ---

CLOUD = Connection(
    9, "/a", "a/msg/A", "cdr", Definition("ros2msg", b"int8 x\n"), digest="RIHS01_a", qos=QOS, latching=True
)


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_a_database_is_what_rosbag2_writes(compression: str, tmp_path: Path) -> None:
    path = tmp_path / "x ?#%.db3"
    writer = Sqlite3Writer(path, compression=compression)
    handles = [writer.add_connection(CLOUD) for _ in range(2)]
    writer.write(handles[0], 20, memoryview(b"\0\1\0\0late"), 19)
    writer.write(handles[1], 10, b"\0\1\0\0early" * 50, 9, sequence=4)
    writer.add_bag_metadata(8, "version: 8")
    writer.finish()
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    with closing(sqlite3.connect(path)) as database:
        for query, rows in (
            ("PRAGMA integrity_check", [("ok",)]),
            ("PRAGMA journal_mode", [("delete",)]),
            ("SELECT * FROM schema", [(4, "")]),
            ("SELECT * FROM metadata", [(1, 8, "version: 8")]),
            ("SELECT topic_type, encoding, encoded_message_definition, type_description_hash FROM message_definitions",
             [("a/msg/A", "ros2msg", "int8 x\n", "RIHS01_a")]),
            ("SELECT * FROM topics", [(handle, "/a", "a/msg/A", "cdr", QOS, "RIHS01_a") for handle in handles]),
            ("SELECT topic_id, timestamp FROM messages ORDER BY timestamp", [(handles[1], 10), (handles[0], 20)]),
        ):  # fmt: skip
            assert database.execute(query).fetchall() == rows
        stored = database.execute("SELECT data FROM messages ORDER BY timestamp").fetchone()[0]
        assert (stored == b"\0\1\0\0early" * 50) == (compression == "none")
    with closing(Sqlite3Reader(path)) as reader:
        assert [(m.connection.id, m.log_time_ns, m.data) for m in reader.messages()] == [
            (handles[1], 10, b"\0\1\0\0early" * 50),
            (handles[0], 20, b"\0\1\0\0late"),
        ]


def test_long_recordings_are_written_in_batches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pc2scan.bags.rosbag2.sqlite3.writer._BATCH_BYTES", 1000)
    writer = Sqlite3Writer(tmp_path / "x.db3")
    handle = writer.add_connection(CLOUD)
    for number in range(10):
        writer.write(handle, number, bytes(600), number)
    with closing(sqlite3.connect(tmp_path / "x.db3")) as database:
        assert database.execute("SELECT count(*) FROM messages").fetchone() == (10,)
    writer.finish()
