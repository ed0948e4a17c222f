"""What lies beside a database, merged with it as SQLite itself would; and what is left where SQLite stops."""

from __future__ import annotations

import random
import shutil
import sqlite3
from collections import Counter
from contextlib import ExitStack, closing
from itertools import chain, product
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.rosbag2.sqlite3.logs import side_logs, write_merged
from pc2scan.bags.rosbag2.sqlite3.read import Sqlite3Reader
from pc2scan.errors import DamageError
from support import sampled
from support.sqlite3_files import Rows, build, hot_log, recovered, rosbag2_pages

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.bags.rosbag2.sqlite3.logs import PageLog

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


@pytest.mark.parametrize(
    ("page_size", "mode", "synchronous"),
    sampled(product([512, 4096, 65536], ["WAL", "DELETE", "PERSIST", "TRUNCATE"], ["OFF", "FULL"]), 5),
)
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


# --- Damaged write-ahead logs ---


@pytest.fixture(scope="module")
def hot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Rows, list[int]]]:
    with pytest.MonkeyPatch.context() as monkeypatch:
        rosbag2_pages(monkeypatch)
        yield hot_log(tmp_path_factory.mktemp("hot"))


def changed(hot: Path, folder: Path, data: bytes) -> Path:
    path = folder / hot.name
    shutil.copyfile(hot, path)
    path.with_name("a.db3-wal").write_bytes(data)
    return path


@pytest.mark.parametrize("step", sampled([7, 1], 1))
def test_a_flipped_byte_in_a_log_loses_at_most_its_page(
    step: int, hot: tuple[Path, Rows, list[int]], tmp_path: Path
) -> None:
    source, rows, _ = hot
    log = Path(f"{source}-wal").read_bytes()
    noise = random.Random(2)
    # Headers are a small part of a log: those of the log and of some pages, and bytes anywhere.
    headers = (range(32), range(32, 56), range(32 + 40 * 4120, 56 + 40 * 4120), range(len(log) - 4120, len(log) - 4096))
    places = [*chain(*headers), *(noise.randrange(len(log)) for _ in range(150))]
    for place in places[::step]:
        data = bytearray(log)
        data[place] ^= noise.randrange(1, 256)
        path = changed(source, tmp_path, bytes(data))
        found, damage = recovered(path)
        assert damage, place
        missing = Counter((topic, time_ns) for topic, time_ns, _ in rows)
        missing.subtract((topic, time_ns) for topic, time_ns, _ in found)
        assert sum(map(abs, missing.values())) <= 1, place
        # Of a page whose checksum is wrong, messages may be wrong; and it is said so.
        assert sum(row not in found for row in rows) <= 30, place
        with pytest.raises(DamageError), closing(Sqlite3Reader(path, strict=True)) as reader:
            list(reader.messages())


def test_a_log_cut_anywhere_keeps_what_was_committed(hot: tuple[Path, Rows, list[int]], tmp_path: Path) -> None:
    source, rows, ends = hot
    log = Path(f"{source}-wal").read_bytes()
    noise = random.Random(3)
    for size in {1, 31, 33, *(noise.randrange(32, len(log)) for _ in range(20)), *(end - 4120 for end in ends)}:
        found, damage = recovered(changed(source, tmp_path, log[:size]))
        committed = 6 * sum(end <= size for end in ends)
        assert Counter(found) == Counter(rows[: 20 + committed]), size
        assert damage or size in ends, size


def test_an_overwritten_part_of_a_log_loses_its_own_pages(hot: tuple[Path, Rows, list[int]], tmp_path: Path) -> None:
    source, rows, _ = hot
    log = Path(f"{source}-wal").read_bytes()
    noise = random.Random(4)
    for _ in range(30):
        size = noise.choice([512, 4096, 10_000])
        place = noise.randrange(len(log) - size)
        data = log[:place] + noise.randbytes(size) + log[place + size :]
        found, damage = recovered(changed(source, tmp_path, data))
        assert damage, place
        # More than three pages can have.
        assert len(found) >= len(rows) - 35, place
        assert len(found) <= len(rows), place


def test_what_a_log_has_not_yet_overwritten_is_no_damage(tmp_path: Path) -> None:
    live = tmp_path / "live.db3"
    rows = build(live, 20)
    with closing(sqlite3.connect(live, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        for number in range(30):
            row = ("/a", 3_000_000 + number, b"\0\1\0\0" + bytes(5000))
            database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", row[1:])
            rows.append(row)
            if number == 25:
                database.execute("PRAGMA wal_checkpoint(RESTART)")
        shutil.copyfile(live, tmp_path / "a.db3")
        shutil.copyfile(f"{live}-wal", tmp_path / "a.db3-wal")
    found, damage = recovered(tmp_path / "a.db3")
    assert Counter(found) == Counter(rows)
    assert damage == ()


# --- Damaged rollback journals ---


def test_a_damaged_journal_is_reported(tmp_path: Path) -> None:
    path = interrupted(tmp_path, "DELETE", 1, 4096, "FULL")
    journal = Path(f"{path}-journal")
    good = journal.read_bytes()
    changes = {
        "damaged header": b"\xff" + good[1:],
        "is cut off: it has 100 bytes": good[:100],
        "is cut off: ": good[:9000],
        "a wrong number or checksum": good[:512] + b"\xff" + good[513:],
    }
    for expected, data in changes.items():
        journal.write_bytes(data)
        (log,) = side_logs(path)
        log.file.close()
        assert expected in log.problems[0].what
        assert log.broken
