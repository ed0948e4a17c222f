"""Every kind of hostile recording in a folder: those of ``files/``, and those that are made."""

from __future__ import annotations

import random
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from mcap.writer import Writer

from fuzz.mutants import damaged
from fuzz.seeds import make_seeds, place
from hostile.test_side_files import journal
from support.builders import CONTENT, write_db3, write_mcap, write_rosbag2

if TYPE_CHECKING:
    from collections.abc import Callable

FILES = Path(__file__).with_name("files")

#: Seeds of which there is a mutant.
_DAMAGED = ("bag-lz4", "mcap-zstd", "mcap-unchunked", "rosbag2-split", "rosbag2-zstd", "db3", "db3-wal")


def make_hostile(folder: Path) -> dict[str, Path]:
    """Make all of them, each in a folder of its own; returns their paths by name.

    Whatever they lead to is the file ``victim``, in ``folder``.
    """
    victim = folder / "victim"
    victim.write_text("years of work")
    found = {}
    for file in sorted(FILES.iterdir()):
        if file.suffix != ".md":
            (folder / file.name).mkdir()
            found[file.name] = Path(shutil.copy(file, folder / file.name))
    for name, make in _MADE.items():
        (folder / name).mkdir()
        found[name] = make(folder / name, victim)
    seeds = {seed.name: seed for seed in make_seeds()}
    for number, name in enumerate(_DAMAGED):
        made = damaged(seeds[name], random.Random(number))
        found[f"mutant of {name}"] = place(made.files, made.seed.opened, folder / f"mutant of {name}")
    return found


def _journal(folder: Path, victim: Path) -> Path:
    """A rollback journal that names another file: SQLite deletes that."""
    source = write_db3(folder / "drive.db3", CONTENT)
    source.with_name("drive.db3-journal").write_bytes(journal(source, names=victim))
    return source


def _journal_in_a_folder(folder: Path, victim: Path) -> Path:
    recording = write_rosbag2(folder / "drive", CONTENT)
    source = recording / "drive_0.db3"
    source.with_name("drive_0.db3-journal").write_bytes(journal(source, names=victim))
    return recording


def _links_beside(folder: Path, victim: Path) -> Path:
    source = write_db3(folder / "drive.db3", CONTENT)
    for suffix in ("-wal", "-journal", "-shm"):
        source.with_name(f"drive.db3{suffix}").symlink_to(victim)
    return source


def _trigger(folder: Path, victim: Path) -> Path:
    """A schema with a view, a trigger, and a command that would write elsewhere."""
    source = write_db3(folder / "drive.db3", CONTENT)
    with closing(sqlite3.connect(source)) as database:
        database.execute("ALTER TABLE messages RENAME TO rows")
        database.execute(f"CREATE VIEW messages AS SELECT *, '{victim}' AS place FROM rows")
        database.execute("CREATE TRIGGER gone INSTEAD OF INSERT ON messages BEGIN DELETE FROM rows; END")
        database.commit()
    return source


def _metadata_that_leads_out(folder: Path, victim: Path) -> Path:
    recording = write_rosbag2(folder / "drive", CONTENT)
    metadata = recording / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("drive_0.db3", str(victim)))
    (recording / "link.db3").symlink_to(victim)
    return recording


def _topics_that_are_paths(folder: Path, victim: Path) -> Path:
    """Names of topics, types and attachments that are paths."""
    path = folder / "drive.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", str(victim))
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel(f"/..{victim}", "cdr", schema)
        writer.add_message(channel, 1, b"\0\1\0\0\1\0\0\0\0", 1)
        writer.add_attachment(1, 1, str(victim), "text/plain", b"x")
        writer.add_metadata(str(victim), {"path": str(victim)})
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _left_by_a_killed_run(folder: Path, _victim: Path) -> Path:
    return write_mcap(folder / "out.mcap.pc2scan-partial", CONTENT)


_MADE: dict[str, Callable[[Path, Path], Path]] = {
    "journal": _journal,
    "journal in a folder": _journal_in_a_folder,
    "links beside": _links_beside,
    "trigger": _trigger,
    "metadata that leads out": _metadata_that_leads_out,
    "topics that are paths": _topics_that_are_paths,
    "left by a killed run": _left_by_a_killed_run,
}
