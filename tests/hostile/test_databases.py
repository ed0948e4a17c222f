"""SQLite databases whose tables are not what they seem."""

from __future__ import annotations

import sqlite3
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


def test_a_row_with_text_for_a_time_is_one_damaged_row(tmp_path: Path) -> None:
    commands: dict[str, tuple[str | Path, ...]] = {"info": (), "tf": (), "repair": ("-o", tmp_path / "out.mcap")}
    source = Path(__file__).with_name("files") / "st.db3"
    for command, further in commands.items():
        done = run_bounded(command, source, *further)
        assert done.status in (0, 3)
        assert "has 1 row of messages with a topic or a time that is no integer (1 message lost)" in done.stderr


DESTINATIONS = ("out.bag", "out.mcap", "out")


@pytest.mark.parametrize(("row", "destination"), sampled(product(rows(TABLES, "other kinds"), DESTINATIONS), 9))
def test_values_of_other_kinds(row: tuple[str], destination: str, tmp_path: Path) -> None:
    loose = "".join(
        f"ALTER TABLE {table} RENAME TO old; CREATE TABLE {table} AS SELECT * FROM old; DROP TABLE old;"
        for table in ("topics", "messages", "message_definitions")
    )
    # Tables made of a query constrain nothing.
    source = changed(tmp_path, f"{loose} {row[0]};")
    done = run_bounded("convert", source, "-o", tmp_path / destination, "--keep-clouds")
    assert done.status in (0, 1, 2, 3)
    assert (tmp_path / destination).exists() == (done.status in (0, 3))
