"""Writing rosbag2 directories, and rosbags as a reader of them."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    QosDurability,
    QosHistory,
)
from rosbags.rosbag2 import Reader as TheirReader
from ruamel.yaml import YAML

from pc2scan.bags.mcap.reader import McapReader
from pc2scan.bags.qos import parsed_qos, respelled_qos
from pc2scan.bags.rosbag2.reader import Rosbag2Reader
from pc2scan.bags.rosbag2.sqlite3.reader import Sqlite3Reader
from pc2scan.bags.rosbag2.writer import Rosbag2Writer
from pc2scan.errors import OutputError
from pc2scan.model import Attachment, Metadata
from support.rosbag2_files import QOS_NAMES, QOS_NUMBERS, STORE, STRING, names, read, text, topic

if TYPE_CHECKING:
    from pathlib import Path


def write_bag(path: Path, **options: Any) -> None:
    writer = Rosbag2Writer(path, "drive", **options)
    a = writer.add_connection(topic("/a"))
    b = writer.add_connection(topic("/b", qos="", latching=False))
    for number in range(6):
        writer.write((a, b)[number % 2], 100 + number, text(f"message {number}"), 100 + number)
    writer.finish()


OPTIONS = [
    {"storage": "mcap", "compression": "none"},
    {"storage": "mcap", "compression": "lz4"},
    {"storage": "mcap", "compression": "zstd"},
    {"storage": "sqlite3", "compression": "none"},
    {"storage": "sqlite3", "compression": "zstd"},
]


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("options", OPTIONS, ids=lambda options: "-".join(options.values()))
def test_rosbags_reads_what_is_written(tmp_path: Path, options: dict[str, str], version: int) -> None:
    path = tmp_path / "drive"
    write_bag(path, metadata_version=version, custom_data={"robot": "yes: 1\n"}, **options)
    file = f"drive_0.{'db3' if options['storage'] == 'sqlite3' else 'mcap'}"
    assert names(path) == [file, "metadata.yaml"]
    expected = [("/b" if n % 2 else "/a", 100 + n, text(f"message {n}")) for n in range(6)]
    with TheirReader(path) as theirs:
        assert [(c.topic, t, bytes(d)) for c, t, d in theirs.messages()] == expected
        assert (theirs.start_time, theirs.duration, theirs.message_count) == (100, 6, 6)
        assert theirs.storage.metadata.custom == {"robot": "yes: 1\n"}
        assert theirs.storage.metadata.ros_distro == ""
        a = next(c for c in theirs.connections if c.topic == "/a")
        assert a.msgdef.data == "string data\n"
        assert a.digest == STORE.hash_rihs01(STRING)
        (qos,) = a.ext.offered_qos_profiles  # type: ignore[union-attr]
        assert (qos.depth, qos.durability, qos.history) == (
            5,
            QosDurability.TRANSIENT_LOCAL,
            QosHistory.KEEP_LAST,
        )
    with AnyReader([path]) as any_reader:
        assert [any_reader.deserialize(d, c.msgtype).data for c, _, d in any_reader.messages()] == [  # type: ignore[attr-defined]
            f"message {n}" for n in range(6)
        ]
    assert read(path) == expected
    with closing(Rosbag2Reader(path)) as reader:
        assert reader.connections[0].latching
        assert reader.connections[0].qos == (QOS_NAMES if version == 9 else QOS_NUMBERS)


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_metadata_file(tmp_path: Path, storage: str, version: int) -> None:
    path = tmp_path / "partial"
    write_bag(path, storage=storage, metadata_version=version)
    content = (path / "metadata.yaml").read_text()
    assert "&id" not in content
    info = YAML(typ="safe").load(content)["rosbag2_bagfile_information"]
    file = "drive_0.mcap" if storage == "mcap" else "drive_0.db3"
    assert list(info) == [
        "version",
        "storage_identifier",
        "duration",
        "starting_time",
        "message_count",
        "topics_with_message_count",
        "compression_format",
        "compression_mode",
        "relative_file_paths",
        "files",
        "custom_data",
        "ros_distro",
    ]
    extent = {
        "duration": {"nanoseconds": 5},
        "starting_time": {"nanoseconds_since_epoch": 100},
        "message_count": 6,
    }
    assert {key: info[key] for key in extent} == extent
    assert info["files"] == [{"path": file, **extent}]
    assert (info["compression_format"], info["compression_mode"]) == ("", "")
    first = info["topics_with_message_count"][0]
    assert first["message_count"] == 3
    qos = first["topic_metadata"]["offered_qos_profiles"]
    assert qos == (QOS_NUMBERS if version == 8 else YAML(typ="safe").load(QOS_NAMES))
    assert info["topics_with_message_count"][1]["topic_metadata"]["offered_qos_profiles"] == (
        "" if version == 8 else []
    )
    # The storage repeats it.
    if storage == "mcap":
        with closing(McapReader(path / file)) as reader:
            (record,) = reader.metadata()
            assert record.name == "rosbag2"
            stored = record.entries["serialized_metadata"]
            assert reader.connections[0].qos == (QOS_NUMBERS if version == 8 else QOS_NAMES)
    else:
        import sqlite3

        with closing(sqlite3.connect(path / file)) as database:
            stored_version, stored = database.execute("SELECT metadata_version, metadata FROM metadata").fetchone()
            assert stored_version == version
    assert YAML(typ="safe").load(stored) == info


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_an_empty_recording(tmp_path: Path, storage: str) -> None:
    path = tmp_path / "bag"
    writer = Rosbag2Writer(path, "bag", storage=storage)
    writer.add_connection(topic("/a"))
    writer.finish()
    info = YAML(typ="safe").load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert info["starting_time"] == {"nanoseconds_since_epoch": 9223372036854775807}
    assert info["duration"] == {"nanoseconds": 0}
    with TheirReader(path) as theirs:
        assert theirs.message_count == 0
        assert list(theirs.messages()) == []
    with closing(Rosbag2Reader(path)) as reader:
        assert list(reader.messages()) == []
        assert [c.topic for c in reader.connections] == ["/a"]
        assert (reader.summary.message_count, reader.summary.start_ns) == (0, None)


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize(
    "qos",
    [
        "- durability: 1",
        "- {}",
        "not: a list",
        "[unbalanced",
        "- durability: 77\n  speed: 3",
        "- - 1",
        "3",
        "- history: !!x",
    ],
)
def test_mutilated_profiles_are_completed_where_they_are_profiles(
    tmp_path: Path, storage: str, version: int, qos: str
) -> None:
    path = tmp_path / "bag"
    connection = topic("/a", qos=qos, metadata={"offered_qos_profiles": qos, "other": "kept"})
    writer = Rosbag2Writer(path, "bag", storage=storage, metadata_version=version)
    writer.write(writer.add_connection(connection), 1, text("x"), 1)
    writer.finish()
    with closing(Rosbag2Reader(path)) as reader:
        (a,) = reader.connections
        assert a.qos == respelled_qos(qos, by_name=version == 9)
        assert (a.qos == qos) == (parsed_qos(qos) is None)
        assert len(list(reader.messages())) == 1
    # metadata.yaml is well-formed whatever the profile is.
    assert YAML(typ="safe").load((path / "metadata.yaml").read_text())


def test_types_are_spelled_as_ros2_does(tmp_path: Path) -> None:
    writer = Rosbag2Writer(tmp_path / "bag", "bag", storage="sqlite3")
    writer.add_connection(topic("/a", msgtype="std_msgs/String"))
    writer.finish()
    with closing(Sqlite3Reader(tmp_path / "bag" / "bag_0.db3")) as reader:
        assert reader.connections[0].msgtype == STRING


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_attachments_and_records_are_written_where_they_can_be(tmp_path: Path, storage: str) -> None:
    writer = Rosbag2Writer(tmp_path / "bag", "bag", storage=storage)
    attachment = Attachment("calib.yaml", "text/yaml", 1, 2, b"x: 1")
    writer.add_attachment(attachment)
    writer.add_metadata(Metadata("site", {"city": "Graz"}))
    writer.add_metadata(Metadata("rosbag2", {"serialized_metadata": "of another file"}))
    writer.finish()
    with closing(Rosbag2Reader(tmp_path / "bag")) as reader:
        kept = storage == "mcap"
        assert list(reader.attachments()) == [attachment] * kept
        assert list(reader.metadata()) == [Metadata("site", {"city": "Graz"})] * kept


def test_the_same_messages_give_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, options in enumerate(OPTIONS):
        for name, distro in (("x", "humble"), ("y", "jazzy")):
            monkeypatch.setenv("ROS_DISTRO", distro)
            write_bag(tmp_path / f"{name}{number}", **options)
        for file in (tmp_path / f"x{number}").iterdir():
            assert file.read_bytes() == (tmp_path / f"y{number}" / file.name).read_bytes()


def test_what_cannot_be_written_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="File exists"):
        Rosbag2Writer(tmp_path, "x")
    with pytest.raises(OutputError, match="No such file"):
        Rosbag2Writer(tmp_path / "a" / "b", "x")
    writer = Rosbag2Writer(tmp_path / "bag", "x")
    (tmp_path / "bag" / "metadata.yaml").touch()
    with pytest.raises(OutputError, match="File exists"):
        writer.finish()
    writer.abort()


def test_abort_releases_the_files(tmp_path: Path) -> None:
    for storage in ("mcap", "sqlite3"):
        writer = Rosbag2Writer(tmp_path / storage, "x", storage=storage)
        writer.write(writer.add_connection(topic("/a")), 1, text("x"), 1)
        writer.abort()
        assert not (tmp_path / storage / "metadata.yaml").exists()
