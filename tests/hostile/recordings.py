"""Every kind of hostile recording in a folder: those of ``files/``, and those that are made."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from mcap.records import Channel, Schema
from mcap.writer import Writer

from hostile.test_side_files import journal
from support import mcap_files
from support.builders import CLOUD, CONTENT, write_db3, write_mcap, write_rosbag2

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["make_hostile"]

FILES = Path(__file__).with_name("files")


def make_hostile(folder: Path) -> dict[str, Path]:
    """Make all of them, each in a folder of its own; returns their paths by name.

    Whatever they lead to is the file ``victim``, in ``folder``.
    """
    victim = folder / "victim"
    victim.write_text("years of work")
    found = {}
    for file in sorted(FILES.iterdir()):
        if file.suffix != ".md":
            place = folder / file.name
            place.mkdir()
            found[file.name] = Path(shutil.copy(file, place))
    for name, make in _MADE.items():
        place = folder / name
        place.mkdir()
        found[name] = make(place, victim)
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


def _wal(folder: Path, _victim: Path) -> Path:
    """Rows that are only in the log."""
    live = write_db3(folder / "live.db3", CONTENT)
    source = folder / "drive.db3"
    with closing(sqlite3.connect(live)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute(
            "INSERT INTO messages(topic_id, timestamp, data) SELECT topic_id, timestamp, data FROM messages"
        )
        database.commit()
        shutil.copyfile(live, source)
        shutil.copyfile(f"{live}-wal", f"{source}-wal")
    return source


def _links_beside(folder: Path, victim: Path) -> Path:
    source = write_db3(folder / "drive.db3", CONTENT)
    for suffix in ("-wal", "-journal", "-shm"):
        source.with_name(f"drive.db3{suffix}").symlink_to(victim)
    return source


def _cut_database(folder: Path, _victim: Path) -> Path:
    """Its rows are put together from the pages, in a database of pc2scan's own."""
    source = write_db3(folder / "drive.db3", CONTENT)
    source.write_bytes(source.read_bytes()[:-3000])
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


def _long_array(folder: Path, _victim: Path) -> Path:
    """A definition of an array that would not fit in memory."""
    body = mcap_files.encoded(Schema(id=1, name="p/msg/A", encoding="ros2msg", data=b"int8[4000000000] x\n"))
    body += mcap_files.encoded(Channel(id=1, schema_id=1, topic="/t", message_encoding="cdr", metadata={}))
    body += mcap_files.raw_message(data=b"\0\1\0\0" + bytes(100))
    return mcap_files.raw_file(folder / "drive.mcap", body)


def _chunks_in_turn(folder: Path, _victim: Path) -> Path:
    """Two chunks whose messages alternate, the second of an impossible size."""
    body = mcap_files.encoded(Schema(id=1, name=CLOUD, encoding="ros2msg", data=b""))
    body += mcap_files.encoded(Channel(id=1, schema_id=1, topic="/t", message_encoding="cdr", metadata={}))
    chunks = []
    for first in (0, 1):
        messages = b"".join(mcap_files.raw_message(log_time=10 + 2 * n + first, data=bytes(100)) for n in range(50))
        size = 1 << 60 if first else len(body + messages)
        chunks.append(mcap_files.raw_chunk(body + messages, uncompressed_size=size))
    return mcap_files.raw_file(folder / "drive.mcap", b"".join(chunks))


def _many_topics(folder: Path, _victim: Path) -> Path:
    path = folder / "drive.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "x")
        schema = writer.register_schema(CLOUD, "ros2msg", b"string data")
        for number in range(200):
            channel = writer.register_channel(f"/t{number}", "cdr", schema)
            writer.add_message(channel, number + 1, bytes(8), number + 1)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _cut_mcap(folder: Path, _victim: Path) -> Path:
    path = write_mcap(folder / "drive.mcap", CONTENT)
    path.write_bytes(path.read_bytes()[:-500])
    return path


def _left_by_a_killed_run(folder: Path, _victim: Path) -> Path:
    return write_mcap(folder / "out.mcap.pc2scan-partial", CONTENT)


_MADE: dict[str, Callable[[Path, Path], Path]] = {
    "journal": _journal,
    "journal in a folder": _journal_in_a_folder,
    "wal": _wal,
    "links beside": _links_beside,
    "cut database": _cut_database,
    "trigger": _trigger,
    "metadata that leads out": _metadata_that_leads_out,
    "topics that are paths": _topics_that_are_paths,
    "long array": _long_array,
    "chunks in turn": _chunks_in_turn,
    "many topics": _many_topics,
    "cut mcap": _cut_mcap,
    "left by a killed run": _left_by_a_killed_run,
}
