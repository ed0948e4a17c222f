"""rosbag2's sqlite3 storage, against databases built by hand and the standard library's sqlite3."""

from __future__ import annotations

import sqlite3
import tracemalloc
from contextlib import closing
from pathlib import Path

import pytest
import zstandard

from pc2scan.bags.rosbag2.sqlite3.reader import Sqlite3Reader
from pc2scan.bags.rosbag2.sqlite3.writer import Sqlite3Writer
from pc2scan.errors import OutputError, RecordingError, UnwritableError
from pc2scan.model import Connection, Definition

QOS = "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 1"
TOPICS = {
    1: "id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL",
    2: ", offered_qos_profiles TEXT NOT NULL",
    4: ", type_description_hash TEXT NOT NULL",
}
MESSAGES = [(1, 20, b"\0\1\0\0b"), (2, 10, b"\0\1\0\0a"), (1, 20, b"\0\1\0\0c"), (1, 5, b"\0\1\0\0first")]


def names(folder: str | Path) -> list[str]:
    return sorted(entry.name for entry in Path(folder).iterdir())


def build(path: Path, version: int, *, index: bool = True) -> None:
    """Make what rosbag2 of that schema version made."""
    with closing(sqlite3.connect(path)) as database:
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
        extra: list[list[str]] = [[], []]
        if version >= 2:
            extra = [[QOS], [""]]
        if version >= 4:
            extra = [[QOS, "RIHS01_a"], ["", ""]]
        for number, (name, values) in enumerate(zip("AB", extra, strict=True), 1):
            row = [number, f"/{name.lower()}", f"a/msg/{name}", "cdr", *values]
            database.execute(f"INSERT INTO topics VALUES ({', '.join('?' * len(row))})", row)
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", MESSAGES)
        database.commit()


def test_a_file_of_more_than_2_gib_is_read(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    build(path, 4)
    with path.open("r+b") as file:
        file.truncate((2 << 30) + 4096)  # a hole, which takes no room
    with closing(Sqlite3Reader(path)) as reader:
        assert len(list(reader.messages())) == len(MESSAGES)


@pytest.mark.parametrize("index", [True, False])
@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_every_schema_version_is_read(tmp_path: Path, version: int, index: bool) -> None:
    build(tmp_path / "x.db3", version, index=index)
    with closing(Sqlite3Reader(tmp_path / "x.db3")) as reader:
        first, second = reader.connections
        assert (first.id, first.topic, first.msgtype, first.serialization) == (1, "/a", "a/msg/A", "cdr")
        assert first.message_count == 3
        assert second.message_count == 1
        assert first.qos == (QOS if version >= 2 else "")
        assert first.latching == (version >= 2)
        assert not second.latching
        assert first.digest == ("RIHS01_a" if version >= 4 else "")
        assert first.definition == (Definition("ros2msg", b"int8 x\n") if version >= 4 else Definition())
        assert second.definition == Definition()
        assert [(m.log_time_ns, m.publish_time_ns, bytes(m.data)[4:]) for m in reader.messages()] == [
            (5, 5, b"first"),
            (10, 10, b"a"),
            (20, 20, b"b"),
            (20, 20, b"c"),
        ]
        summary = reader.summary
        assert (summary.container, summary.compression, summary.message_count) == ("sqlite3", ("none",), 4)
        assert (summary.start_ns, summary.end_ns) == (5, 20)
        assert 0 < reader.bytes_read <= summary.size_bytes
    assert names(tmp_path) == ["x.db3"]


@pytest.mark.parametrize("index", [True, False])
def test_filters(tmp_path: Path, index: bool) -> None:
    build(tmp_path / "x.db3", 4, index=index)
    with closing(Sqlite3Reader(tmp_path / "x.db3")) as reader:
        first, second = reader.connections
        assert [m.log_time_ns for m in reader.messages([second])] == [10]
        assert [m.log_time_ns for m in reader.messages([first], 5, 20)] == [5]
        assert [m.log_time_ns for m in reader.messages(None, 10, 2**70)] == [10, 20, 20]
        assert list(reader.messages([])) == []
        assert {m.connection.topic for m in reader.messages([first])} == {"/a"}


def test_topic_filter_does_not_lose_the_time_index(tmp_path: Path) -> None:
    build(tmp_path / "x.db3", 4)
    with closing(sqlite3.connect(tmp_path / "x.db3")) as database:
        database.execute("CREATE INDEX by_topic ON messages (topic_id)")
        database.execute("ANALYZE")
        database.commit()
    with closing(Sqlite3Reader(tmp_path / "x.db3")) as reader:
        seen: list[str] = []
        opened = reader._database._connection
        assert opened is not None
        opened.set_trace_callback(seen.append)
        assert len(list(reader.messages([reader.connections[0]]))) == 3
        opened.set_trace_callback(None)
        (plan,) = opened.execute(f"EXPLAIN QUERY PLAN {seen[-1]}").fetchall()
        assert "timestamp_idx" in plan[3]


def test_a_definition_is_chosen_by_hash(tmp_path: Path) -> None:
    build(tmp_path / "x.db3", 4)
    with closing(sqlite3.connect(tmp_path / "x.db3")) as database:
        database.execute("UPDATE message_definitions SET type_description_hash = 'RIHS01_old' WHERE id = 1")
        database.execute("INSERT INTO message_definitions VALUES (3, 'a/msg/A', 'ros2idl', 'idl', 'RIHS01_a')")
        database.execute("INSERT INTO message_definitions VALUES (4, 'a/msg/B', 'unknown', '', '')")
        database.commit()
    with closing(Sqlite3Reader(tmp_path / "x.db3")) as reader:
        assert reader.connections[0].definition == Definition("ros2idl", b"idl")
        assert reader.connections[1].definition == Definition()


def test_messages_of_unknown_topics_are_no_messages(tmp_path: Path) -> None:
    build(tmp_path / "x.db3", 2)
    with closing(sqlite3.connect(tmp_path / "x.db3")) as database:
        database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (77, 1, x'00')")
        database.commit()
    with closing(Sqlite3Reader(tmp_path / "x.db3")) as reader:
        assert reader.summary.message_count == 4
        assert reader.summary.start_ns == 5
        assert len(list(reader.messages())) == 4


def test_a_hot_write_ahead_log_counts_and_nothing_is_touched(tmp_path: Path) -> None:
    live, folder = tmp_path / "live.db3", tmp_path / "copy"
    folder.mkdir()
    build(live, 4)
    with closing(sqlite3.connect(live)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (2, 30, x'00010000')")
        database.commit()
        for suffix in ("", "-wal"):
            (folder / f"x.db3{suffix}").write_bytes((tmp_path / f"live.db3{suffix}").read_bytes())
    before = {entry.name: entry.read_bytes() for entry in folder.iterdir()}
    assert len(before) == 2
    with closing(Sqlite3Reader(folder / "x.db3")) as reader:
        assert reader.summary.message_count == 5
        assert [m.log_time_ns for m in reader.messages()][-1] == 30
        copy = reader._database._copy
        assert copy is not None
    assert {entry.name: entry.read_bytes() for entry in folder.iterdir()} == before
    assert not Path(copy.name).exists()


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
    with closing(Sqlite3Reader(folder / "x.db3")) as reader:
        assert [m.log_time_ns for m in reader.messages()] == [5, 10, 20, 20]


@pytest.mark.parametrize("index", [True, False])
def test_memory_does_not_grow_with_the_recording(tmp_path: Path, index: bool) -> None:
    build(tmp_path / "x.db3", 2, index=index)
    with closing(sqlite3.connect(tmp_path / "x.db3")) as database:
        rows = ((1, 1000 - number, bytes(100_000)) for number in range(200))
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
        database.commit()
    with closing(Sqlite3Reader(tmp_path / "x.db3")) as reader:
        tracemalloc.start()
        try:
            times = [m.log_time_ns for m in reader.messages()]
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    assert times == sorted(times)
    assert len(times) == 204
    assert peak < 2_000_000


@pytest.mark.parametrize("index", [True, False])
def test_a_unit_may_be_loaded_again(tmp_path: Path, index: bool) -> None:
    """Its rows are not kept for that."""
    build(tmp_path / "x.db3", 2, index=index)
    with closing(sqlite3.connect(tmp_path / "x.db3")) as database:
        rows = ((1, 30, bytes([number]) * 300_000) for number in range(9))
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
        database.commit()
    with closing(Sqlite3Reader(tmp_path / "x.db3")) as reader:
        units = list(reader.units(start_ns=6))
        loaded = [unit.load(lambda message: message, whole=False) for unit in units]
        assert [len(found) for found in loaded] == [5, 2, 2, 2, 1]  # type: ignore[arg-type]
        assert [unit.load(lambda message: message, whole=False) for unit in reversed(units)] == loaded[::-1]
        assert [message for found in loaded for message in found] == list(reader.messages(start_ns=6))  # type: ignore[union-attr]


@pytest.mark.parametrize("content_size", [True, False])
@pytest.mark.parametrize("declared", ["zstd", "none"])
def test_compressed_messages_are_recognised(tmp_path: Path, declared: str, content_size: bool) -> None:
    build(tmp_path / "x.db3", 2)
    pack = zstandard.ZstdCompressor(write_content_size=content_size).compress
    with closing(sqlite3.connect(tmp_path / "x.db3")) as database:
        for number, _, data in database.execute("SELECT id, timestamp, data FROM messages").fetchall():
            database.execute("UPDATE messages SET data = ? WHERE id = ?", (pack(data), number))
        database.commit()
    with closing(Sqlite3Reader(tmp_path / "x.db3", message_compression=declared)) as reader:
        assert reader.summary.compression == ("zstd",)
        assert [bytes(m.data)[4:] for m in reader.messages()] == [b"first", b"a", b"b", b"c"]


def test_damaged_compressed_messages_are_named(tmp_path: Path) -> None:
    build(tmp_path / "x.db3", 2)
    with closing(sqlite3.connect(tmp_path / "x.db3")) as database:
        database.execute("UPDATE messages SET data = ?", (zstandard.compress(b"hello" * 100)[:-3],))
        database.commit()
    with (
        closing(Sqlite3Reader(tmp_path / "x.db3", strict=True)) as reader,
        pytest.raises(RecordingError, match=r"/a: .*full frame"),
    ):
        list(reader.messages())
    build(tmp_path / "y.db3", 2)
    with (
        closing(Sqlite3Reader(tmp_path / "y.db3", message_compression="zstd", strict=True)) as reader,
        pytest.raises(RecordingError, match="cannot be decompressed"),
    ):
        list(reader.messages())


def test_what_is_not_rosbag2_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    with pytest.raises(RecordingError, match="No such file"):
        Sqlite3Reader(path)
    path.write_bytes(b"SQLite format 3\0" + bytes(4000))
    with pytest.raises(RecordingError, match="nothing of it can be recovered: SQLite cannot read it"):
        Sqlite3Reader(path)
    path.unlink()
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE topics(id)")
        database.commit()
    with pytest.raises(RecordingError, match="table topics lacks name, serialization_format, type"):
        Sqlite3Reader(path)


def test_a_truncated_database_is_a_recording_error(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    build(path, 2)
    with closing(sqlite3.connect(path)) as database:
        database.executemany(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, zeroblob(9000))",
            [(n,) for n in range(50)],
        )
        database.commit()
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size // 2)

    def read() -> None:
        with closing(Sqlite3Reader(path, strict=True)) as reader:
            list(reader.messages())

    with pytest.raises(RecordingError, match="is cut off: it has"):
        read()


def test_text_where_bytes_belong(tmp_path: Path) -> None:
    build(tmp_path / "x.db3", 2)
    with closing(sqlite3.connect(tmp_path / "x.db3")) as database:
        database.execute("UPDATE messages SET data = 'text'")
        database.commit()
    with (
        closing(Sqlite3Reader(tmp_path / "x.db3", strict=True)) as reader,
        pytest.raises(RecordingError, match="row 4 of messages, of topic '/a', has data 'text', not a blob"),
    ):
        list(reader.messages())


def test_names_that_are_not_utf8_do_not_stop_reading(tmp_path: Path) -> None:
    build(tmp_path / "x.db3", 2)
    with closing(sqlite3.connect(tmp_path / "x.db3")) as database:
        database.execute("UPDATE topics SET name = CAST(x'2f61ff' AS TEXT) WHERE id = 1")
        database.commit()
    with closing(Sqlite3Reader(tmp_path / "x.db3")) as reader:
        assert reader.connections[0].topic == "/a\ufffd"


CLOUD = Connection(
    id=9,
    topic="/a b?#%",
    msgtype="a/msg/A",
    serialization="cdr",
    definition=Definition("ros2msg", b"# caf\xe9\r\nint8 x\n"),
    digest="RIHS01_a",
    qos="- depth: 3 # half a profile\n  durability: 1",
    latching=True,
)


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_round_trip(tmp_path: Path, compression: str) -> None:
    path = tmp_path / "x ?#%.db3"
    writer = Sqlite3Writer(path, compression=compression)
    handle = writer.add_connection(CLOUD)
    again = writer.add_connection(CLOUD)
    writer.write(handle, 20, memoryview(b"\0\1\0\0late"), 19)
    writer.write(again, 10, b"\0\1\0\0early" * 50, 9, sequence=4)
    writer.add_bag_metadata(8, "version: 8")
    writer.finish()
    assert names(tmp_path) == [path.name]
    with closing(Sqlite3Reader(path)) as reader:
        assert [c.id for c in reader.connections] == [handle, again]
        for connection in reader.connections:
            for name in ("topic", "msgtype", "serialization", "definition", "digest", "qos", "latching"):
                assert getattr(connection, name) == getattr(CLOUD, name), name
        assert [(m.connection.id, m.log_time_ns, m.data) for m in reader.messages()] == [
            (again, 10, b"\0\1\0\0early" * 50),
            (handle, 20, b"\0\1\0\0late"),
        ]
        assert reader.summary.compression == (compression,)
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert database.execute("PRAGMA journal_mode").fetchone() == ("delete",)
        assert database.execute("SELECT * FROM schema").fetchall() == [(4, "")]
        assert database.execute("SELECT * FROM metadata").fetchall() == [(1, 8, "version: 8")]
        assert database.execute("SELECT count(*) FROM message_definitions").fetchone() == (1,)
        stored = database.execute("SELECT data FROM messages ORDER BY timestamp").fetchone()[0]
        assert (stored == b"\0\1\0\0early" * 50) == (compression == "none")


@pytest.mark.parametrize("index", [True, False])
def test_messages_may_be_given_up_after_the_reader_was_closed(tmp_path: Path, index: bool) -> None:
    """As an error does whose traceback outlives the reader: Python would complain on stderr."""
    build(tmp_path / "x.db3", 4, index=index)
    reader = Sqlite3Reader(tmp_path / "x.db3")
    messages = reader.messages()
    next(messages)
    reader.close()
    messages.close()


def test_the_same_messages_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("x", "y"):
        writer = Sqlite3Writer(tmp_path / name)
        writer.write(writer.add_connection(CLOUD), 1, b"\0\1\0\0", 1)
        writer.finish()
    assert (tmp_path / "x").read_bytes() == (tmp_path / "y").read_bytes()


def test_long_recordings_are_written_in_batches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pc2scan.bags.rosbag2.sqlite3.writer._BATCH_BYTES", 1000)
    writer = Sqlite3Writer(tmp_path / "x.db3")
    handle = writer.add_connection(CLOUD)
    for number in range(10):
        writer.write(handle, number, bytes(600), number)
    with closing(sqlite3.connect(tmp_path / "x.db3")) as database:
        assert database.execute("SELECT count(*) FROM messages").fetchone() == (10,)
    writer.finish()


def test_what_cannot_be_written_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No such file"):
        Sqlite3Writer(tmp_path / "missing" / "x.db3")
    writer = Sqlite3Writer(tmp_path / "x.db3")
    with pytest.raises(OutputError, match="File exists"):
        Sqlite3Writer(tmp_path / "x.db3")
    with pytest.raises(UnwritableError, match="too large"):
        writer.write(1, 2**63, b"", 0)
    writer.abort()
    writer.abort()
    with pytest.raises(OutputError, match="closed"):
        writer.finish()


def test_a_full_disk_is_an_output_error(tmp_path: Path) -> None:
    writer = Sqlite3Writer(tmp_path / "x.db3")
    handle = writer.add_connection(CLOUD)
    writer._database.execute("PRAGMA max_page_count=10")

    def fill() -> None:
        for number in range(100):
            writer.write(handle, number, bytes(4000), number)

    with pytest.raises(OutputError, match="full"):
        fill()
    writer.abort()
