"""What is written into rosbag2 directories, as rosbags sees it."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosHistory
from rosbags.rosbag2 import Reader as TheirReader
from ruamel.yaml import YAML

from pc2scan.bags.mcap.read import McapReader
from pc2scan.bags.rosbag2.read import Rosbag2Reader
from pc2scan.bags.rosbag2.write import Rosbag2Writer
from support.builders import STRING
from support.rosbag2_files import QOS_NUMBERS, STORE, names, read, text, topic

if TYPE_CHECKING:
    from pathlib import Path

SUFFIXES = {"mcap": "mcap", "sqlite3": "db3"}
EXTENT = {"duration": {"nanoseconds": 5}, "starting_time": {"nanoseconds_since_epoch": 100}, "message_count": 6}


def info_of(folder: Path) -> dict[str, Any]:
    document = YAML(typ="safe").load((folder / "metadata.yaml").read_text())
    return dict(document["rosbag2_bagfile_information"])


def stored_info(path: Path) -> dict[str, Any]:
    """metadata.yaml's content, which the storage repeats."""
    if path.suffix == ".mcap":
        with closing(McapReader(path)) as reader:
            (record,) = reader.metadata()
            assert record.name == "rosbag2"
            assert reader.connections[0].qos == QOS_NUMBERS
            return dict(YAML(typ="safe").load(record.entries["serialized_metadata"]))
    with closing(sqlite3.connect(path)) as database:
        stored_version, stored = database.execute("SELECT metadata_version, metadata FROM metadata").fetchone()
        assert stored_version == 8
        return dict(YAML(typ="safe").load(stored))


@pytest.mark.parametrize(
    ("storage", "compression"),
    [("mcap", "none"), ("mcap", "lz4"), ("mcap", "zstd"), ("sqlite3", "none"), ("sqlite3", "zstd")],
)
def test_rosbags_reads_what_is_written(storage: str, compression: str, tmp_path: Path) -> None:
    path = tmp_path / "bag"
    writer = Rosbag2Writer(path, "drive", storage=storage, compression=compression)
    handles = [writer.add_connection(topic("/a")), writer.add_connection(topic("/b", qos="", latching=False))]
    for number in range(6):
        writer.write(handles[number % 2], 100 + number, text(f"message {number}"), 100 + number)
    writer.finish()
    file = f"drive_0.{SUFFIXES[storage]}"
    assert names(path) == [file, "metadata.yaml"]
    expected = [("/b" if n % 2 else "/a", 100 + n, text(f"message {n}")) for n in range(6)]
    with TheirReader(path) as theirs:
        assert [(c.topic, t, bytes(d)) for c, t, d in theirs.messages()] == expected
        assert (theirs.start_time, theirs.duration, theirs.message_count) == (100, 6, 6)
        metadata = theirs.storage.metadata
        assert (metadata.custom, metadata.ros_distro) == (None, "")
        a = next(c for c in theirs.connections if c.topic == "/a")
        assert (a.msgdef.data, a.digest) == ("string data\n", STORE.hash_rihs01(STRING))
        (qos,) = a.ext.offered_qos_profiles  # type: ignore[union-attr]
        assert (qos.depth, qos.durability, qos.history) == (10, QosDurability.TRANSIENT_LOCAL, QosHistory.KEEP_LAST)
    with AnyReader([path]) as any_reader:
        found = [any_reader.deserialize(d, c.msgtype).data for c, _, d in any_reader.messages()]  # type: ignore[attr-defined]
        assert found == [f"message {n}" for n in range(6)]
    assert read(path) == expected
    with closing(Rosbag2Reader(path)) as reader:
        assert reader.connections[0].latching
        assert reader.connections[0].qos == QOS_NUMBERS
    # metadata.yaml, to the key.
    assert "&id" not in (path / "metadata.yaml").read_text()
    info = info_of(path)
    by_message = storage == "sqlite3" and compression == "zstd"
    assert list(info) == [
        "version", "storage_identifier", "duration", "starting_time", "message_count", "topics_with_message_count",
        "compression_format", "compression_mode", "relative_file_paths", "files", "custom_data", "ros_distro",
    ]  # fmt: skip
    assert {key: info[key] for key in EXTENT} == EXTENT
    assert info["files"] == [{"path": file, **EXTENT}]
    assert (info["compression_format"], info["compression_mode"]) == (("zstd", "MESSAGE") if by_message else ("", ""))
    first, second = info["topics_with_message_count"]
    assert (first["message_count"], second["message_count"]) == (3, 3)
    assert [each["topic_metadata"]["offered_qos_profiles"] for each in (first, second)] == [QOS_NUMBERS, ""]
    assert stored_info(path / file) == info
