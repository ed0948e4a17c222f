"""rosbag2's sqlite3 storage: databases of every schema version, with and without an index, and what is written."""

from __future__ import annotations

import sqlite3
import tracemalloc
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.rosbag2.sqlite3.read import Sqlite3Reader
from pc2scan.bags.rosbag2.sqlite3.write import Sqlite3Writer
from pc2scan.model import Connection, Definition
from support.builders import CONTENT, TF, definition, write_db3

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

#: The usual content: what schema versions add to it is QoS profiles (from 2 on) and definitions (from 4 on).
ROWS = [(item.stream.topic, item.log_time_ns, item.data[2]) for item in CONTENT.items]
TIMES = sorted(row[1] for row in ROWS)
WITHOUT_INDEX = "DROP INDEX timestamp_idx;"
#: The first version has no profiles; tables made of a query have no constraints.
FIRST_VERSION = """CREATE TABLE first AS SELECT id, name, type, serialization_format FROM topics;
    DROP TABLE topics; ALTER TABLE first RENAME TO topics;"""


def build(path: Path, schema: int = 4, script: str = "", rows: Iterable[tuple[int, int, bytes]] = ()) -> Path:
    """Write the usual content in a schema version, add rows, and run a script on it."""
    write_db3(path, CONTENT, schema=schema)
    with closing(sqlite3.connect(path)) as database, database:
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
        database.executescript(script)
    return path


@pytest.mark.parametrize("more", ["", WITHOUT_INDEX])
@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_every_schema_version_is_read(version: int, more: str, tmp_path: Path) -> None:
    path = build(tmp_path / "x.db3", max(version, 2), (FIRST_VERSION if version == 1 else "") + more)
    with closing(Sqlite3Reader(path)) as reader:
        by_topic = {each.topic: each for each in reader.connections}
        static = by_topic["/tf_static"]
        assert (static.msgtype, static.serialization, static.message_count) == (TF, "cdr", 2)
        # The builder's schema version 2 is of before the profiles.
        assert static.latching == bool(static.qos) == (version >= 3)
        assert static.definition.text == (definition(TF, 2) if version == 4 else "")
        found = list(reader.messages())
        assert [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in found] == ROWS
        assert all(m.publish_time_ns == m.log_time_ns for m in found)
        summary = reader.summary
        assert (summary.container, summary.compression, summary.message_count) == ("sqlite3", ("none",), len(ROWS))
        assert (summary.start_ns, summary.end_ns) == (TIMES[0], TIMES[-1])
        for selection, wanted in (
            ((None, TIMES[3], 2**70), [row for row in ROWS if row[1] >= TIMES[3]]),
            ((None, -(2**70), TIMES[3]), [row for row in ROWS if row[1] < TIMES[3]]),
        ):
            assert [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages(*selection)] == wanted
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.db3"]


def test_without_an_index_memory_does_not_grow(tmp_path: Path) -> None:
    rows = ((1, 1000 - number, bytes(100_000)) for number in range(100))
    path = build(tmp_path / "x.db3", script=WITHOUT_INDEX, rows=rows)
    tracemalloc.start()
    try:
        with closing(Sqlite3Reader(path)) as reader:
            times = [m.log_time_ns for m in reader.messages()]
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert times == sorted(times)
    assert len(times) == 100 + len(ROWS)
    assert peak < 2_000_000


# --- What is written ---

QOS = "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 1"
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
    writer.add_bag_metadata("version: 8")
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
