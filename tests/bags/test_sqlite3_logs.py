"""What lies beside a database, merged with it as SQLite itself would; and what is left where SQLite stops."""

from __future__ import annotations

import random
import shutil
import sqlite3
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.sqlite3_logs import PageLog, side_logs, write_merged

if TYPE_CHECKING:
    from pathlib import Path

_TABLE = "CREATE TABLE t(id INTEGER PRIMARY KEY, x INTEGER, data BLOB)"
_SUFFIXES = ("", "-wal", "-journal")


def interrupted(folder: Path, mode: str, seed: int, page_size: int, synchronous: str) -> Path:
    """A database and its log as a writer leaves them that dies at some point between two statements."""
    noise = random.Random(seed)
    live, dead = folder / "live.db3", folder / "dead.db3"
    with closing(sqlite3.connect(live, isolation_level=None)) as database:
        database.execute(f"PRAGMA page_size = {page_size}")
        database.execute(f"PRAGMA journal_mode = {mode}")
        database.execute(f"PRAGMA synchronous = {synchronous}")
        # What does not fit goes to the disk in the middle of a transaction.
        database.execute("PRAGMA cache_size = 10")
        database.execute("PRAGMA wal_autocheckpoint = 20")
        database.execute(_TABLE)
        for _ in range(noise.randrange(8)):
            database.execute("BEGIN")
            for _ in range(noise.randrange(200)):
                write(database, noise)
            database.execute(noise.choice(["COMMIT", "COMMIT", "COMMIT", "ROLLBACK"]))
        if noise.random() < 0.8:
            database.execute("BEGIN")
            for _ in range(noise.randrange(300)):
                write(database, noise)
        for suffix in _SUFFIXES:
            if live.with_name(f"live.db3{suffix}").exists():
                shutil.copyfile(f"{live}{suffix}", f"{dead}{suffix}")
    return dead


def write(database: sqlite3.Connection, noise: random.Random) -> None:
    size = noise.choice([10, 100, 5000])
    statement = noise.choice(
        ["INSERT INTO t(x, data) VALUES (?, ?)"] * 4 + ["UPDATE t SET x = ?, data = ? WHERE id = 3"]
    )
    database.execute(statement, (noise.randrange(1000), noise.randbytes(size)))
    if noise.random() < 0.02:
        database.execute("DELETE FROM t WHERE id % 3 = 0")


def rows_by_sqlite(path: Path, folder: Path) -> list[tuple[int, int, bytes]]:
    """The rows after SQLite's own recovery of a copy."""
    folder.mkdir()
    for suffix in _SUFFIXES:
        if path.with_name(path.name + suffix).exists():
            shutil.copyfile(f"{path}{suffix}", folder / f"copy.db3{suffix}")
    with closing(sqlite3.connect(folder / "copy.db3")) as database:
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        return database.execute("SELECT * FROM t ORDER BY id").fetchall()


def merged(path: Path, target: Path) -> tuple[list[tuple[int, int, bytes]], list[PageLog]]:
    with ExitStack() as stack:
        logs = side_logs(path)
        for log in logs:
            stack.callback(log.file.close)
        write_merged(path, logs, target)
    with closing(sqlite3.connect(f"{target.as_uri()}?immutable=1", uri=True)) as database:
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        return database.execute("SELECT * FROM t ORDER BY id").fetchall(), logs


@pytest.mark.parametrize("synchronous", ["OFF", "FULL"])
@pytest.mark.parametrize("mode", ["WAL", "DELETE", "PERSIST", "TRUNCATE"])
@pytest.mark.parametrize("page_size", [512, 4096, 65536])
def test_logs_are_merged_as_sqlite_does(page_size: int, mode: str, synchronous: str, tmp_path: Path) -> None:
    used = 0
    for seed in range(12):
        folder = tmp_path / str(seed)
        folder.mkdir()
        path = interrupted(folder, mode, seed, page_size, synchronous)
        rows, logs = merged(path, folder / "merged.db3")
        assert rows == rows_by_sqlite(path, folder / "sqlite"), seed
        assert not any(log.broken for log in logs), (seed, logs)
        used += any(log.places for log in logs)
    assert used > 2
