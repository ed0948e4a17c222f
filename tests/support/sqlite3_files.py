"""Databases of rosbag2 that a test damages, and what is read of them."""

from __future__ import annotations

import random
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.bags.rosbag2.sqlite3.read import Sqlite3Reader
from pc2scan.bags.rosbag2.sqlite3.write import Sqlite3Writer
from support.rosbag2_files import topic

if TYPE_CHECKING:
    import pytest

    from pc2scan.bags.damage import Damage

#: Topic, log time and data of messages.
Rows = list[tuple[str, int, bytes]]


def rosbag2_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write databases with pages of the size that rosbag2 gives them."""
    monkeypatch.setattr("pc2scan.bags.rosbag2.sqlite3.write._PAGE_BYTES", 4096)


def build(path: Path, count: int = 120) -> Rows:
    """Write messages that fit into a page, and such that go on in several."""
    noise = random.Random(11)
    writer = Sqlite3Writer(path)
    handles = [writer.add_connection(topic(name)) for name in ("/a", "/b")]
    rows = []
    for number in range(count):
        data = _data(noise, number)
        time_ns = 1_000_000 + 10 * number + (number * 7) % 25
        writer.write(handles[number % 2], time_ns, data, time_ns)
        rows.append((("/a", "/b")[number % 2], time_ns, data))
    writer.finish()
    return rows


def _data(noise: random.Random, number: int) -> bytes:
    return b"\0\1\0\0" + noise.randbytes(9000 if number % 10 == 3 else noise.randrange(20, 700))


def hot_log(folder: Path) -> tuple[Path, Rows, list[int]]:
    """Leave a recording as a recorder that died: most of its messages are in its log, in twenty transactions.

    Returns
    -------
    tuple[Path, Rows, list[int]]
        The database, its messages, and where in the log each transaction ends.
    """
    live, path = folder / "live.db3", folder / "a.db3"
    rows = build(live, 20)
    noise = random.Random(1)
    ends = []
    with closing(sqlite3.connect(live, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA wal_autocheckpoint = 0")
        for number in range(120):
            if number % 6 == 0:
                database.execute("BEGIN")
            row = ("/a", 2_000_000 + number, _data(noise, number))
            database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", row[1:])
            rows.append(row)
            if number % 6 == 5:
                database.execute("COMMIT")
                ends.append(Path(f"{live}-wal").stat().st_size)
        shutil.copyfile(live, path)
        shutil.copyfile(f"{live}-wal", f"{path}-wal")
    return path, rows, ends


def recovered(path: Path) -> tuple[Rows, tuple[Damage, ...]]:
    """Read what is left of a database, and what is wrong with it."""
    with closing(Sqlite3Reader(path)) as reader:
        rows = [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages()]
        return rows, reader.damage
