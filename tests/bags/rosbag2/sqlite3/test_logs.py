"""What lies beside a database: merged with it by SQLite in a private copy; what SQLite does not take is reported."""

from __future__ import annotations

import random
import shutil
import sqlite3
from contextlib import closing
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.opening import open_recording
from pc2scan.errors import DamageError
from support import sampled
from support.sqlite3_files import Rows, build, hot_log, recovered, rosbag2_pages

if TYPE_CHECKING:
    from collections.abc import Iterator

_SUFFIXES = ("", "-wal", "-journal")


def interrupted(folder: Path, mode: str, seed: int, synchronous: str) -> Path:
    """A database and its log as a writer leaves them that dies at some point between two statements."""
    noise = random.Random(seed)
    folder.mkdir()
    live, dead = folder / "live.db3", folder / "dead.db3"
    build(live, 20)
    with closing(sqlite3.connect(live, isolation_level=None)) as database:
        database.execute(f"PRAGMA journal_mode = {mode}")
        database.execute(f"PRAGMA synchronous = {synchronous}")
        # What does not fit goes to the disk in the middle of a transaction.
        database.execute("PRAGMA cache_size = 10")
        for ending in [*noise.choices(["COMMIT", "ROLLBACK"], [3, 1], k=noise.randrange(6)), ""]:
            database.execute("BEGIN")
            for number in range(noise.randrange(200)):
                row = 5_000_000 + number, noise.randbytes(noise.choice([10, 100, 5000]))
                database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", row)
                database.execute("UPDATE messages SET data = ? WHERE id = ?", (row[1], noise.randrange(1, 50)))
            database.execute(ending)
        for suffix in _SUFFIXES:
            if Path(f"{live}{suffix}").exists():
                shutil.copyfile(f"{live}{suffix}", f"{dead}{suffix}")
    return dead


@pytest.mark.parametrize(
    ("mode", "synchronous"), sampled(product(["WAL", "DELETE", "PERSIST", "TRUNCATE"], ["OFF", "FULL"]), 4)
)
def test_logs_are_merged_as_sqlite_does(mode: str, synchronous: str, tmp_path: Path) -> None:
    for seed in range(5):
        path = interrupted(tmp_path / str(seed), mode, seed, synchronous)
        before = {entry.name: entry.read_bytes() for entry in path.parent.iterdir()}
        rows, damage = recovered(path)
        assert {entry.name: entry.read_bytes() for entry in path.parent.iterdir()} == before
        # The unfinished transaction is all that may be missing.
        assert all(place.path.suffix == ".db3-wal" for place in damage), damage
        with closing(sqlite3.connect(path)) as database:
            by_sqlite = database.execute("SELECT timestamp, data FROM messages ORDER BY timestamp, id").fetchall()
        assert [row[1:] for row in rows] == by_sqlite, seed


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


def test_the_first_page_of_a_database_may_be_in_its_log(hot: tuple[Path, Rows, list[int]], tmp_path: Path) -> None:
    path = changed(hot[0], tmp_path, Path(f"{hot[0]}-wal").read_bytes())
    path.write_bytes(b"\xff" + path.read_bytes()[1:])
    with closing(open_recording(path)) as reader:
        assert len(list(reader.messages())) == len(hot[1])


@pytest.mark.parametrize("length", [1, 512, 10_000])
def test_behind_damage_in_a_log_nothing_is_read_and_that_is_reported(
    length: int, hot: tuple[Path, Rows, list[int]], tmp_path: Path
) -> None:
    source, rows, ends = hot
    log = Path(f"{source}-wal").read_bytes()
    noise = random.Random(length)
    # The header of the log, of the first page, of the last one, and bytes anywhere.
    places = [8, 17, 25, 33, 41, 49, len(log) - 4111, len(log) - 4101, *noise.sample(range(len(log)), 15)]
    for place in places:
        changes = bytes(byte ^ noise.randrange(1, 256) for byte in log[place : place + length])
        path = changed(source, tmp_path, log[:place] + changes + log[place + length :])
        found, damage = recovered(path)
        committed = 6 * sum(end <= place for end in ends)
        # The first four bytes of the log have its byte order; a commit is a whole number of pages.
        assert sorted(found) == sorted(rows[: 20 + committed]), place
        assert damage[0].path.name == "a.db3-wal", place
        assert damage[0].bytes_lost, place
        with pytest.raises(DamageError, match="not used"):
            open_recording(path, strict=True)
