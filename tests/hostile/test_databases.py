"""SQLite databases whose tables are not what they seem."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import closing
from itertools import product
from pathlib import Path

import pytest

from support import sampled
from support.bounded import run_bounded
from support.builders import CONTENT, write_db3
from support.tables import rows

TABLES = Path(__file__).with_name("databases.txt")


def changed(folder: Path, script: str) -> Path:
    source = write_db3(folder / "drive.db3", CONTENT)
    with closing(sqlite3.connect(source)) as database:
        database.executescript(script)
    return source


@pytest.mark.parametrize("script", [pytest.param(script, id=name) for name, script in rows(TABLES, "made up")])
def test_tables_that_are_made_up(script: str, tmp_path: Path) -> None:
    done = run_bounded("convert", changed(tmp_path, script))
    assert done.status == 1, done.stdout
    assert "drive.db3" in done.stderr


@pytest.mark.parametrize(("name", "script"), rows(TABLES, "unfolding"), ids=["data", "name"])
@pytest.mark.parametrize("command", ["info", "repair"])
def test_a_default_value_that_unfolds(name: str, script: str, command: str, tmp_path: Path) -> None:
    source = changed(tmp_path, script.replace("LONG", "00" * 1_000_000))
    output = ("-o", tmp_path / "out.mcap") if command == "repair" else ()
    done = run_bounded(command, source, *output)
    assert done.status == 1, done.stdout
    assert f"has a column {name!r} with a default value" in done.stderr


def with_shared_pages(source: Path) -> None:
    """Add rows to the only one of a table, all of which lead to the same chain of pages."""
    with closing(sqlite3.connect(source)) as database:
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    data = bytearray(source.read_bytes())
    place = (root - 1) * 4096
    assert struct.unpack_from(">BxxH", data, place) == (0x0D, 1)
    (at,) = struct.unpack_from(">H", data, place + 8)
    # Its length, its id in one byte, and what lies in the page itself.
    cell = data[place + at : place + 4096]
    assert cell[3] == 1
    cells = [cell[:3] + bytes([number]) + cell[4:] for number in range(1, 8)]
    page = b"".join(reversed(cells)).rjust(4096, b"\0")
    places = [4096 - sum(map(len, cells[: number + 1])) for number in range(7)]
    head = struct.pack(">BHHHB", 0x0D, 0, 7, places[-1], 0) + struct.pack(">7H", *places)
    data[place : place + 4096] = head + page[len(head) :]
    source.write_bytes(data)


@pytest.mark.parametrize("cut", [0, 1])
def test_rows_that_share_their_pages(cut: int, tmp_path: Path) -> None:
    # So long that as little of it as possible lies in the table's own page.
    size = 489 + 250 * 4092 - 14
    source = changed(
        tmp_path,
        f"DELETE FROM messages; DROP INDEX timestamp_idx; PRAGMA page_size = 4096; VACUUM; INSERT INTO messages"
        f"(id, topic_id, timestamp, data) VALUES (1, 4, 1000000000000000000, zeroblob({size}));",
    )
    with_shared_pages(source)
    if cut:
        # Cut off, by its header.
        source.write_bytes(source.read_bytes() + bytes(4096))
        with source.open("r+b") as file:
            file.seek(28)
            file.write(struct.pack(">I", 10_000))
    done = run_bounded("repair", source, "-o", tmp_path / "out.mcap")
    assert done.status == 1, done.stdout
    assert "has more values than the bytes of its file can hold" in done.stderr


def test_a_row_with_text_for_a_time_is_one_damaged_row(tmp_path: Path) -> None:
    commands: dict[str, tuple[str | Path, ...]] = {"info": (), "tf": (), "repair": ("-o", tmp_path / "out.mcap")}
    source = Path(__file__).with_name("files") / "st.db3"
    for command, further in commands.items():
        done = run_bounded(command, source, *further)
        assert done.status in (0, 3)
        assert "has 1 row of messages with an id, a topic or a time that is no integer (1 message lost)" in done.stderr


OTHER_KINDS = [
    "UPDATE topics SET name = x'ff00ff'",
    "UPDATE topics SET name = NULL",
    "UPDATE topics SET type = 7",
    "UPDATE topics SET serialization_format = 1.5",
    "UPDATE topics SET offered_qos_profiles = x'80'",
    "UPDATE messages SET timestamp = 'tomorrow'",
    "UPDATE messages SET timestamp = 1.5 WHERE id = 4",
    "UPDATE messages SET timestamp = x'00' WHERE id = 4",
    "UPDATE messages SET timestamp = -9223372036854775808 WHERE id = 4",
    "UPDATE messages SET timestamp = 9223372036854775807 WHERE id = 4",
    "UPDATE messages SET topic_id = 'x'",
    "UPDATE messages SET topic_id = 1.5",
    "UPDATE messages SET data = 7",
    "UPDATE messages SET data = x''",
    "UPDATE messages SET data = 'text'",
    "UPDATE message_definitions SET encoded_message_definition = 7",
    "UPDATE message_definitions SET encoding = x'ff'",
    "UPDATE message_definitions SET topic_type = NULL",
    "DELETE FROM topics",
]


DESTINATIONS = ("out.bag", "out.mcap", "out")


@pytest.mark.parametrize(("statement", "destination"), sampled(product(OTHER_KINDS, DESTINATIONS), 20))
def test_values_of_other_kinds(statement: str, destination: str, tmp_path: Path) -> None:
    loose = "".join(
        f"ALTER TABLE {table} RENAME TO old; CREATE TABLE {table} AS SELECT * FROM old; DROP TABLE old;"
        for table in ("topics", "messages", "message_definitions")
    )
    # Tables made of a query constrain nothing.
    source = changed(tmp_path, f"{loose} {statement};")
    done = run_bounded("convert", source, "-o", tmp_path / destination, "--keep-clouds")
    assert done.status in (0, 1, 2, 3)
    assert (tmp_path / destination).exists() == (done.status in (0, 3))


def test_a_tree_of_pages_that_leads_back_to_itself(tmp_path: Path) -> None:
    """Every inner page's children are that page: SQLite would go down twenty levels, and never be done."""
    source = changed(
        tmp_path,
        "INSERT INTO messages(topic_id, timestamp, data) WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 "
        "FROM n WHERE i < 3000) SELECT 4, i, randomblob(900) FROM n; DROP INDEX timestamp_idx;",
    )
    with closing(sqlite3.connect(source)) as database:
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
        (size,) = database.execute("PRAGMA page_size").fetchone()
    data = bytearray(source.read_bytes())
    page = (root - 1) * size
    assert data[page] == 5, "the root is an inner page of a table"
    (cells,) = struct.unpack_from(">H", data, page + 3)
    leaf = struct.unpack_from(">I", data, page + 8)[0]
    inner = bytearray(data[page : page + size])
    for number in range(cells):
        (cell,) = struct.unpack_from(">H", inner, 12 + 2 * number)
        struct.pack_into(">I", inner, cell, leaf)
    # Twenty inner pages, each of whose children are the next; the last one's are one leaf.
    count = len(data) // size
    pages = [bytearray(inner) for _ in range(15)]
    for number, copy in enumerate(pages):
        child = count + number + 2 if number + 1 < len(pages) else leaf
        for place in (8, *(struct.unpack_from(">H", inner, 12 + 2 * n)[0] for n in range(cells))):
            struct.pack_into(">I", copy, place, child)
    top = bytearray(inner)
    for place in (8, *(struct.unpack_from(">H", inner, 12 + 2 * n)[0] for n in range(cells))):
        struct.pack_into(">I", top, place, count + 1)
    data[page : page + size] = top
    data += b"".join(pages)
    struct.pack_into(">I", data, 28, len(data) // size)
    source.write_bytes(data)
    done = run_bounded("convert", source)
    assert done.status in (1, 3)
