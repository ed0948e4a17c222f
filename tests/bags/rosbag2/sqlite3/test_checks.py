"""Facts that a database has twice, and that contradict each other (`fuzz.test_said_twice` has more of them)."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from fuzz.mutants.database import database_layout
from pc2scan.bags.rosbag2.sqlite3.read import Sqlite3Reader
from support.builders import CONTENT, write_db3

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.damage import Damage

Rows = list[tuple[str, int, bytes]]

SOUND = [(item.stream.topic, item.log_time_ns, item.data[2]) for item in CONTENT.items]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_db3(tmp_path / "drive.db3", CONTENT)


def read(path: Path) -> tuple[Rows, tuple[Damage, ...]]:
    with closing(Sqlite3Reader(path)) as reader:
        return [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages()], reader.damage


def test_rows_that_the_index_does_not_have(path: Path) -> None:
    data = bytearray(path.read_bytes())
    cells = next(field for field in database_layout(bytes(data)).fields if field.kind == "index.cells")
    data[cells.start : cells.stop] = (cells.value(data) - 1).to_bytes(cells.stop - cells.start, "big")
    path.write_bytes(data)
    rows, (place, *_) = read(path)
    assert sorted(rows) == sorted(SOUND)
    assert f"the index of timestamps has {len(SOUND) - 1} messages, the table {len(SOUND)}" in place.what


def test_values_that_a_table_does_not_allow(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        (sql,) = database.execute("SELECT sql FROM sqlite_master WHERE name = 'topics'").fetchone()
        database.execute("PRAGMA writable_schema = ON")
        update = "UPDATE sqlite_master SET sql = ? WHERE name = 'topics'"
        database.execute(update, (sql.replace("NOT NULL", ""),))
        database.commit()
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE topics SET type = NULL WHERE id = 2")
        database.execute("PRAGMA writable_schema = ON")
        database.execute(update, (sql,))
    rows, (place,) = read(path)
    assert rows == SOUND
    assert place.what == "table topics contradicts itself: NULL value in topics.type"


@pytest.mark.parametrize("place", [-1, 20_000])
def test_more_bytes_than_the_header_declares(place: int, path: Path) -> None:
    data = path.read_bytes()
    place %= len(data) + 1
    path.write_bytes(data[:place] + bytes(8) + data[place:])
    _, (first, *_) = read(path)
    assert "8 more than its header declares" in first.what
