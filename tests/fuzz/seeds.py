"""Sound recordings to be damaged: every container, small, with all that can be wrong in it."""

from __future__ import annotations

import sqlite3
import tempfile
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from support import mcap_files, rosbag1_files
from support.builders import CONTENT, SECOND, Mcap, Recording, write_db3, write_mcap, write_rosbag1, write_rosbag2

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


@dataclass(frozen=True, slots=True, eq=False)
class Seed:
    """A sound recording: its files by name, and the name of what is opened (a file, or the folder of all)."""

    name: str
    files: dict[str, bytes]
    opened: str


def place(files: Mapping[str, bytes], opened: str, folder: Path) -> Path:
    """Write the files, over those that are there; returns what to open."""
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return folder / opened


def _recording(times: int) -> Recording:
    span = 3 * SECOND // 10
    items = (
        replace(item, log_time_ns=item.log_time_ns + number * span) for number in range(times) for item in CONTENT.items
    )
    return replace(CONTENT, items=tuple(items))


def _db3(folder: Path) -> Path:
    return write_db3(folder / "drive.db3", _recording(2))


def _with_log(folder: Path) -> Path:
    """The second half of the rows is in the write-ahead log, in several transactions."""
    first, second = _recording(2).halves()
    building = write_db3(folder / "building.db3", first)
    with closing(sqlite3.connect(building)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("PRAGMA wal_autocheckpoint=0")
        ids = dict(database.execute("SELECT name, id FROM topics"))
        for number, item in enumerate(second.items):
            row = (ids[item.stream.topic], item.log_time_ns, item.data[2])
            database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", row)
            if number % 8 == 7:
                database.commit()
        database.commit()
        return _taken(folder, "-wal")


def _with_journal(folder: Path) -> Path:
    """A transaction that was not committed: its journal has the pages as they were."""
    building = write_db3(folder / "building.db3", _recording(2))
    with closing(sqlite3.connect(building)) as database:
        database.execute("PRAGMA cache_size=2")
        database.execute("UPDATE messages SET data = data || x'00', timestamp = timestamp + 1")
        taken = _taken(folder, "-journal")
        database.rollback()
    return taken


def _taken(folder: Path, suffix: str) -> Path:
    """The database that is being written, as it is, with the file beside it."""
    for end in ("", suffix):
        (folder / f"drive.db3{end}").write_bytes((folder / f"building.db3{end}").read_bytes())
    return folder / "drive.db3"


def _bag(compression: str) -> Callable[[Path], Path]:
    return lambda folder: write_rosbag1(folder / "drive.bag", _recording(4), compression, chunk_size=3_000)


def _mcap(form: Mcap) -> Callable[[Path], Path]:
    return lambda folder: write_mcap(folder / "drive.mcap", _recording(4), form)


_EXTRAS = Mcap(
    attachments=[("map.pgm", "image/x-portable-graymap", 7, 8, b"P5 1 1 255 x" * 5)],
    metadata=[("robot", {"serial": "7"})],
)
_BUILDS: dict[str, Callable[[Path], Path]] = {
    **{f"bag-{name}": _bag(name) for name in ("none", "lz4", "bz2")},
    **{f"mcap-{name}": _mcap(replace(_EXTRAS, compression=name)) for name in ("none", "lz4", "zstd")},
    "mcap-without-crc": _mcap(Mcap(compression="none", crcs=False)),
    "mcap-without-summary": _mcap(Mcap(compression="lz4", summary=False)),
    "mcap-unchunked": _mcap(replace(_EXTRAS, chunked=False)),
    "rosbag2-mcap": lambda folder: write_rosbag2(folder / "drive", _recording(2), storage="mcap"),
    "rosbag2-split": lambda folder: write_rosbag2(folder / "drive", _recording(2), parts=2),
    "rosbag2-zstd": lambda folder: write_rosbag2(folder / "drive", _recording(2), mode="file"),
    "db3": _db3,
    "db3-wal": _with_log,
    "db3-journal": _with_journal,
}

#: Messages whose data are told from each other, and whose chunks overlap in time: topic, log time, data.
_ROWS = [(i % 2, 1_000_000 + 10 * (i // 2) + (i * 7) % 13, b"\0\1\0\0" + bytes([i]) * (20 + i)) for i in range(9)]


def _small_mcap(case: str) -> Callable[[Path], Path]:
    options = mcap_files.LIBRARY_OPTIONS[case]
    return lambda folder: mcap_files.library_file(folder / "a.mcap", _ROWS, extras=True, chunk_size=300, **options)


def _small_bag(compression: str) -> Callable[[Path], Path]:
    connections = [rosbag1_files.connection("/a"), rosbag1_files.connection("/b")]
    return lambda folder: rosbag1_files.write(folder / "a.bag", connections, _ROWS, compression, chunk_size=150)


_SMALL = {
    **{f"bag-{name}": _small_bag(name) for name in rosbag1_files.COMPRESSIONS},
    **{f"mcap-{name}": _small_mcap(name) for name in ("default", "lz4", "uncompressed", "no crc")},
    "mcap-without-summary": _small_mcap("no summary"),
}


def make_seeds(builds: Mapping[str, Callable[[Path], Path]] = _BUILDS) -> list[Seed]:
    """One seed of every kind."""
    seeds = []
    for name, build in builds.items():
        with tempfile.TemporaryDirectory(prefix="pc2scan-seed-") as folder:
            top = Path(folder)
            opened = build(top)
            paths = [path for path in sorted(top.rglob("*")) if path.is_file() and "building" not in path.name]
            seeds.append(Seed(name, {str(path.relative_to(top)): path.read_bytes() for path in paths}, opened.name))
    return seeds


def make_small_seeds() -> list[Seed]:
    """Files of a few chunks of a few messages, so short that each of their bytes can be damaged."""
    return make_seeds(_SMALL)
