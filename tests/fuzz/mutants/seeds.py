"""Sound recordings to be damaged: every container, small, with all that can be wrong in it."""

from __future__ import annotations

import sqlite3
import tempfile
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from support import mcap_files, rosbag1_files
from support.builders import (
    CONTENT,
    POINTS,
    SECOND,
    Item,
    Mcap,
    Recording,
    cloud,
    write_db3,
    write_mcap,
    write_rosbag1,
    write_rosbag2,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

__all__ = ["Seed", "make_seeds", "make_small_seeds", "place"]

_SPAN = 3 * SECOND // 10
_EXTRAS = {
    "attachments": [("map.pgm", "image/x-portable-graymap", 7, 8, b"P5 1 1 255 x" * 5)],
    "metadata": [("robot", {"serial": "7"})],
}


@dataclass(frozen=True, slots=True)
class Seed:
    """A sound recording: its files by name, and the name of what is opened (a file, or the folder of all)."""

    name: str
    files: dict[str, bytes]
    opened: str


def place(files: dict[str, bytes], opened: str, folder: Path) -> Path:
    """Write the files, over those that are there; returns what to open."""
    for name, data in files.items():
        path = folder / name
        try:
            # Not emptied first: the next mutant of a file takes a sixth of the time.
            with path.open("r+b") as file:
                file.write(data)
                file.truncate()
        except FileNotFoundError:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
    return folder / opened


def _recording(times: int = 4) -> Recording:
    items = (
        replace(item, log_time_ns=item.log_time_ns + number * _SPAN)
        for number in range(times)
        for item in CONTENT.items
    )
    return replace(CONTENT, items=tuple(items))


def _large() -> Recording:
    """Chunks large enough to be copied whole, of clouds that compress well."""
    recording = _recording(2)
    points = np.zeros((25_000, 3), np.float32)
    points[:, 0] = 3.0
    content = {ros_version: cloud(points, ros_version) for ros_version in (1, 2)}
    items = (Item(POINTS, item.log_time_ns, content) if item.stream == POINTS else item for item in recording.items)
    return replace(recording, items=tuple(items))


def _with_log(path: Path, recording: Recording) -> None:
    """The second half of the rows is in the write-ahead log, in several transactions."""
    first, second = recording.halves()
    building = path.with_name("building.db3")
    write_db3(building, first)
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
        for suffix in ("", "-wal"):
            path.with_name(path.name + suffix).write_bytes(building.with_name(building.name + suffix).read_bytes())


def _with_journal(path: Path, recording: Recording) -> None:
    """A transaction that was not committed: its journal has the pages as they were."""
    building = path.with_name("building.db3")
    write_db3(building, recording)
    with closing(sqlite3.connect(building)) as database:
        database.execute("PRAGMA cache_size=2")
        database.execute("UPDATE messages SET data = data || x'00', timestamp = timestamp + 1")
        database.execute("INSERT INTO messages SELECT id + 1000, topic_id, timestamp, data FROM messages")
        for suffix in ("", "-journal"):
            path.with_name(path.name + suffix).write_bytes(building.with_name(building.name + suffix).read_bytes())
        database.rollback()


def _bag(**form: Any) -> Callable[[Path], Path]:
    large = form.pop("large", False)
    return lambda folder: write_rosbag1(
        folder / "drive.bag", _large() if large else _recording(), chunk_size=300_000 if large else 3_000, **form
    )


def _mcap(**form: Any) -> Callable[[Path], Path]:
    if form.pop("large", False):
        return lambda folder: write_mcap(folder / "drive.mcap", _large(), Mcap(chunk_size=300_000, **form))
    return lambda folder: write_mcap(folder / "drive.mcap", _recording(), Mcap(**form))


def _rosbag2(**form: Any) -> Callable[[Path], Path]:
    return lambda folder: write_rosbag2(folder / "drive", _recording(2), **form)


def _db3(write: Callable[[Path, Recording], object]) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        write(folder / "drive.db3", _recording(2))
        for path in folder.glob("building*"):
            path.unlink()
        return folder / "drive.db3"

    return build


_BUILDS: dict[str, Callable[[Path], Path]] = {
    **{f"bag-{name}": _bag(compression=name) for name in ("none", "lz4", "bz2")},
    **{f"bag-{name}-large": _bag(compression=name, large=True) for name in ("none", "lz4")},
    **{f"mcap-{name}": _mcap(compression=name, **_EXTRAS) for name in ("none", "lz4", "zstd")},
    **{f"mcap-{name}-large": _mcap(compression=name, large=True) for name in ("none", "zstd")},
    "mcap-none-without-crc": _mcap(compression="none", crcs=False),
    "mcap-lz4-without-summary": _mcap(compression="lz4", summary=False),
    "mcap-unchunked-without-summary": _mcap(chunked=False, summary=False, **_EXTRAS),
    "mcap-unchunked-data-crc-without-summary": _mcap(chunked=False, summary=False, data_crc=True),
    "mcap-unchunked": _mcap(chunked=False, **_EXTRAS),
    "mcap-unchunked-data-crc": _mcap(chunked=False, data_crc=True),
    "mcap-ros1": _mcap(ros_version=1, profile="ros1"),
    **{f"rosbag2-{storage}": _rosbag2(storage=storage) for storage in ("sqlite3", "mcap")},
    **{f"rosbag2-{storage}-split": _rosbag2(storage=storage, parts=2) for storage in ("sqlite3", "mcap")},
    **{
        f"rosbag2-{storage}-zstd-{mode}": _rosbag2(storage=storage, mode=mode)
        for storage in ("sqlite3", "mcap")
        for mode in ("file", "message")
    },
    "db3": _db3(write_db3),
    "db3-wal": _db3(_with_log),
    "db3-journal": _db3(_with_journal),
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
    **{f"small-bag-{name}": _small_bag(name) for name in rosbag1_files.COMPRESSIONS},
    **{
        f"small-mcap-{name}": _small_mcap(name)
        for name in ("default", "lz4", "uncompressed", "unchunked", "no summary", "no crc")
    },
}


def make_seeds(builds: Mapping[str, Callable[[Path], Path]] = _BUILDS) -> list[Seed]:
    """One seed of every kind."""
    seeds = []
    for name, build in builds.items():
        with tempfile.TemporaryDirectory(prefix="pc2scan-seed-") as folder:
            top = Path(folder)
            opened = build(top)
            files = {str(path.relative_to(top)): path.read_bytes() for path in sorted(top.rglob("*")) if path.is_file()}
            seeds.append(Seed(name, files, opened.name))
    return seeds


def make_small_seeds() -> list[Seed]:
    """Files of a few chunks of a few messages, so short that each of their bytes can be damaged."""
    return make_seeds(_SMALL)
