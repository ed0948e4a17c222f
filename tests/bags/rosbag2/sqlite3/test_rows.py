"""Rows whose values have types that rosbag2 never writes: SQLite stores any value in any column."""

from __future__ import annotations

import sqlite3
import struct
from collections import Counter
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.bags.opening import open_recording
from pc2scan.bags.rosbag2.sqlite3.read import Sqlite3Reader
from support.builders import CONTENT, write_db3

if TYPE_CHECKING:
    from pc2scan.bags.damage import Damage

Value = int | float | str | bytes | None
Row = tuple[int, int, bytes]


#: Tables made of a query have columns without types and constraints; it also runs on tables with them.
LOOSE = "CREATE TABLE loose AS SELECT * FROM {0}; DROP TABLE {0}; ALTER TABLE loose RENAME TO {0};"


def change(path: Path, script: str, *, loose: tuple[str, ...] = ()) -> Path:
    """Change a database by SQL statements, with tables that constrain nothing where asked."""
    with closing(sqlite3.connect(path)) as database:
        database.executescript("".join(map(LOOSE.format, loose)) + script)
    return path


def unreachable(path: Path) -> None:
    """Let the header declare more pages than there are, so that the rows are searched for."""
    data = bytearray(path.read_bytes())
    struct.pack_into(">I", data, 28, 1_000_000)
    path.write_bytes(data)


@pytest.mark.parametrize("value", ["'x'", "NULL", "1.5", "1"])
def test_a_topic_with_a_wrong_id_leaves_the_others(value: str, tmp_path: Path) -> None:
    path = write_db3(tmp_path / "drive.db3", CONTENT)
    with closing(open_recording(path)) as reader:
        expected = [m.data for m in reader.messages() if m.connection.id != 2]
    change(path, f"UPDATE topics SET id = {value} WHERE id = 2;", loose=("topics",))
    with closing(open_recording(path)) as reader:
        assert [m.data for m in reader.messages()] == expected
        damage = reader.damage
    assert sum(place.messages_lost or 0 for place in damage) == len(CONTENT.items) - len(expected)
    assert any("has no id of its own" in place.what for place in damage)


# --- Rows of any type, compared with what SQLite says of their types ---

TOPICS = (1, 2, 3)


class Case(NamedTuple):
    """A database: its rows, how it is stored, and what is asked of it."""

    rows: list[tuple[Value, Value, Value]]
    loose: bool
    indexed: bool
    pages: bool
    topics: frozenset[int]
    start_ns: int | None
    stop_ns: int | None


WRONG = st.sampled_from([None, 1e300, -1e300, 2.5, 3.0, 9.3e18, "", "x", "12abc", "3", b"", b"\0", b"3"])
BOUND = st.none() | st.integers(-3, 12) | st.sampled_from([-(2**63), 2**62])
ROWS = st.tuples(
    st.integers(1, 4) | WRONG,
    st.integers(0, 9) | st.sampled_from([-(2**63), -1, 2**62]) | WRONG,
    st.binary(max_size=5) | WRONG,
)
CASES = st.builds(
    Case,
    rows=st.lists(ROWS, max_size=12),
    loose=st.booleans(),
    indexed=st.booleans(),
    pages=st.booleans(),
    topics=st.frozensets(st.sampled_from(TOPICS)),
    start_ns=BOUND,
    stop_ns=BOUND,
)


def build(path: Path, case: Case) -> None:
    """Make the database; one that is cut off has the tables that rosbag2 makes."""
    typed = not case.loose or case.pages
    columns = "topic_id INTEGER, timestamp INTEGER, data BLOB" if typed else "topic_id, timestamp, data"
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        database.executemany("INSERT INTO topics VALUES (?, ?, 'a/msg/A', 'x')", [(n, f"/{n}") for n in TOPICS])
        database.execute(f"CREATE TABLE messages(id INTEGER PRIMARY KEY, {columns})")
        if case.indexed:
            database.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", case.rows)


def oracle(path: Path, case: Case) -> tuple[list[Row], Counter[int], int, int]:
    """What can be read, how many of each topic are counted, and how many rows have no place, and no data."""
    placed: list[tuple[int, int, int, bytes | None]] = []
    unsound = 0
    with closing(sqlite3.connect(path)) as database:
        for number, topic, time, data, *kinds in database.execute(
            "SELECT id, topic_id, timestamp, data, typeof(topic_id), typeof(timestamp), typeof(data) FROM messages"
        ):
            if kinds[:2] != ["integer", "integer"]:
                unsound += 1
            elif topic in TOPICS:
                placed.append((time, number, topic, data if kinds[2] == "blob" else None))
    first = -(2**63) if case.start_ns is None else case.start_ns
    stop = 2**63 if case.stop_ns is None else case.stop_ns
    due = [row for row in sorted(placed, key=lambda row: row[:2]) if first <= row[0] < stop and row[2] in case.topics]
    rows = [(topic, time, data) for time, _, topic, data in due if data is not None]
    counts = Counter(topic for _, _, topic, _ in due)
    return rows, counts, unsound, sum(data is None for *_, data in due)


def lost(damage: tuple[Damage, ...]) -> int:
    """How many messages are lost, without those of topics that are not described."""
    return sum(place.messages_lost or 0 for place in damage if "not described" not in place.what)


@given(CASES)
def test_rows_of_any_type_are_read_as_sqlite_types_them(case: Case) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder, "a.db3")
        build(path, case)
        rows, counts, unsound, without_data = oracle(path, case)
        if case.pages:
            unreachable(path)
        with closing(Sqlite3Reader(path)) as reader:
            chosen = [connection for connection in reader.connections if connection.id in case.topics]
            assert lost(reader.damage) == unsound
            counted = reader.counts(chosen, case.start_ns, case.stop_ns)
            assert {number: count for number, count in counted.items() if count} == counts
            found = [
                (m.connection.id, m.log_time_ns, bytes(m.data))
                for m in reader.messages(chosen, case.start_ns, case.stop_ns)
            ]
            assert found == rows
            assert lost(reader.damage) == unsound + without_data
