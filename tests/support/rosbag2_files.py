"""rosbag2 directories for tests, with metadata.yaml of every version."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rosbags.typesys import Stores, get_typestore

from pc2scan.bags.mcap.write import McapWriter
from pc2scan.bags.rosbag2.read import Rosbag2Reader
from pc2scan.bags.rosbag2.sqlite3.write import Sqlite3Writer
from pc2scan.model import Connection, Definition
from support import builders
from support.builders import STRING, Stream, qos_text

if TYPE_CHECKING:
    from collections.abc import Sequence


STORE = get_typestore(Stores.ROS2_HUMBLE)


DEFINITION = Definition("ros2msg", b"string data\n")


_RECORDER = [Stream("", STRING, latched=True)]
QOS_NUMBERS, QOS_NAMES = qos_text(_RECORDER), qos_text(_RECORDER, by_name=True)


def names(folder: str | Path) -> list[str]:
    return sorted(entry.name for entry in Path(folder).iterdir())


def text(value: str) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types[STRING](data=value), STRING))


def topic(name: str, **changes: Any) -> Connection:
    made = Connection(1, name, STRING, "cdr", DEFINITION, STORE.hash_rihs01(STRING), qos=QOS_NUMBERS, latching=True)
    return replace(made, **changes)


def write_storage(path: Path, messages: Sequence[tuple[str, int]], **changes: Any) -> None:
    """One storage file with messages (topic, time), whose data is their time."""
    writer = Sqlite3Writer(path) if path.suffix == ".db3" else McapWriter(path, "none")
    handles: dict[str, int] = {}
    for name, time_ns in messages:
        if name not in handles:
            handles[name] = writer.add_connection(topic(name, **changes))
        writer.write(handles[name], time_ns, text(str(time_ns)), time_ns)
    writer.finish()


def listed(name: str, version: int, count: int = 1) -> dict[str, Any]:
    return builders.listed(name, version, count, _RECORDER, "RIHS01_listed")


def write_metadata(
    folder: Path, version: int, files: Sequence[str], storage: str = "sqlite3", /, **changes: Any
) -> None:
    """metadata.yaml that says other things than the files."""
    wrong: dict[str, Any] = {
        "duration": {"nanoseconds": 10**18},
        "starting_time": {"nanoseconds_since_epoch": 0},
        "message_count": 77,
        "topics_with_message_count": [listed("/a", version), listed("/silent", version, 0)],
    }
    builders.write_metadata(folder, version, files, storage, **(wrong | changes))


def read(path: Path, *, strict: bool = False) -> list[tuple[str, int, bytes]]:
    with closing(Rosbag2Reader(path, strict=strict)) as reader:
        return [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages()]
