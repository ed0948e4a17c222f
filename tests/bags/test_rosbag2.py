"""rosbag2 directories: metadata.yaml of every version, rosbags' output, and rosbags as a reader of ours."""

from __future__ import annotations

from contextlib import closing
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import pytest
import zstandard
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Reader as TheirReader
from rosbags.rosbag2 import Writer as TheirWriter
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from pc2scan.bags.mcap import McapReader, McapWriter
from pc2scan.bags.model import Attachment, Connection, Definition, Metadata
from pc2scan.bags.rosbag2 import Rosbag2Reader, Rosbag2Writer, respelled_qos, storage_files
from pc2scan.bags.sqlite3 import Sqlite3Reader, Sqlite3Writer
from pc2scan.errors import OutputError, RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

STORE = get_typestore(Stores.ROS2_HUMBLE)
STRING = "std_msgs/msg/String"
DEFINITION = Definition("ros2msg", b"string data\n")
QOS_NUMBERS = """\
- history: 1
  depth: 5
  reliability: 1
  durability: 1
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false"""
QOS_NAMES = (
    QOS_NUMBERS.replace("history: 1", "history: keep_last")
    .replace("reliability: 1", "reliability: reliable")
    .replace("durability: 1", "durability: transient_local")
    .replace("liveliness: 1", "liveliness: automatic")
)


def names(folder: str | Path) -> list[str]:
    return sorted(entry.name for entry in Path(folder).iterdir())


def text(value: str) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types[STRING](data=value), STRING))


def topic(name: str, **changes: Any) -> Connection:
    known: dict[str, Any] = {
        "id": 1,
        "topic": name,
        "msgtype": STRING,
        "serialization": "cdr",
        "definition": DEFINITION,
        "digest": STORE.hash_rihs01(STRING),
        "qos": QOS_NUMBERS,
        "latching": True,
    }
    return Connection(**(known | changes))


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
    entry: dict[str, Any] = {"name": name, "type": STRING, "serialization_format": "cdr"}
    if version >= 4:
        entry["offered_qos_profiles"] = QOS_NUMBERS
    if version >= 7:
        entry["type_description_hash"] = "RIHS01_listed"
    if version >= 9:
        entry["offered_qos_profiles"] = YAML(typ="safe").load(QOS_NAMES)
    return {"topic_metadata": entry, "message_count": count}


def write_metadata(
    folder: Path, version: int, files: Sequence[str], storage: str = "sqlite3", /, **changes: Any
) -> None:
    info: dict[str, Any] = {
        "version": version,
        "storage_identifier": storage,
        "relative_file_paths": [f"{folder.name}/{file}" if version < 4 else file for file in files],
        "duration": {"nanoseconds": 7},
        "starting_time": {"nanoseconds_since_epoch": 3},
        "message_count": 77,
        "topics_with_message_count": [listed("/a", version), listed("/silent", version, 0)],
    }
    if version >= 3:
        info |= {"compression_format": "", "compression_mode": ""}
    if version >= 5:
        info["files"] = []
    if version >= 6:
        info["custom_data"] = None
    if version >= 8:
        info["ros_distro"] = "rolling"
    info = {key: value for key, value in (info | changes).items() if value is not ...}
    with (folder / "metadata.yaml").open("w") as stream:
        YAML(typ="safe").dump({"rosbag2_bagfile_information": info}, stream)


def read(path: Path) -> list[tuple[str, int, bytes]]:
    with closing(Rosbag2Reader(path)) as reader:
        return [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages()]


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    folder = tmp_path / "bag"
    folder.mkdir()
    return folder


# --- Reading ---


@pytest.mark.parametrize("version", range(1, 10))
def test_every_version_of_metadata(bag: Path, version: int) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3), ("/b", 4)], qos="", digest="", latching=False)
    write_metadata(bag, version, ["bag_0.db3"])
    with closing(Rosbag2Reader(bag)) as reader:
        a, b, silent = reader.connections
        assert [c.topic for c in (a, b, silent)] == ["/a", "/b", "/silent"]
        assert len({c.id for c in (a, b, silent)}) == 3
        expected = "" if version < 4 else QOS_NUMBERS if version < 9 else QOS_NAMES
        assert YAML(typ="safe").load(a.qos) == YAML(typ="safe").load(expected)
        assert version == 9 or a.qos == expected
        assert a.latching == (version >= 4)
        assert a.digest == ("RIHS01_listed" if version >= 7 else "")
        assert a.definition == DEFINITION
        assert (b.qos, b.digest) == ("", "")
        assert (silent.message_count, a.message_count) == (0, 1)
        messages = list(reader.messages())
        assert [(m.connection, m.log_time_ns) for m in messages] == [(a, 3), (b, 4)]
        assert [m.log_time_ns for m in reader.messages([b, silent])] == [4]
        assert list(reader.messages([silent])) == []
        summary = reader.summary
        assert (summary.container, summary.storage, summary.compression) == ("rosbag2", "sqlite3", ("none",))
        assert (summary.message_count, summary.start_ns, summary.end_ns) == (2, 3, 4)
        assert reader.path == bag


def test_the_storage_is_right_where_they_disagree(bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)], qos="- durability: 2", digest="RIHS01_own", latching=False)
    write_metadata(bag, 8, ["bag_0.db3"])
    with closing(Rosbag2Reader(bag)) as reader:
        a = reader.connections[0]
        assert (a.qos, a.digest, a.latching, a.message_count) == ("- durability: 2", "RIHS01_own", False, 1)


@pytest.mark.parametrize("suffix", ["db3", "mcap"])
@pytest.mark.parametrize("with_metadata", [True, False])
def test_split_recordings_are_merged_by_time(bag: Path, suffix: str, with_metadata: bool) -> None:
    write_storage(bag / f"bag_2.{suffix}", [("/a", 1), ("/b", 2), ("/a", 9)])
    write_storage(bag / f"bag_10.{suffix}", [("/b", 2), ("/a", 3)])
    if with_metadata:
        storage = {"db3": "sqlite3"}.get(suffix, suffix)
        write_metadata(bag, 5, [f"bag_2.{suffix}", f"bag_10.{suffix}"], storage, topics_with_message_count=[])
    with closing(Rosbag2Reader(bag)) as reader:
        assert [(c.id, c.topic, c.message_count) for c in reader.connections] == [(1, "/a", 3), (2, "/b", 2)]
        assert [(m.connection.topic, m.log_time_ns) for m in reader.messages()] == [
            ("/a", 1),
            ("/b", 2),
            ("/b", 2),
            ("/a", 3),
            ("/a", 9),
        ]
        assert reader.bytes_read > 0
        assert reader.summary.size_bytes == sum(f.stat().st_size for f in storage_files(bag))


def test_natural_order(bag: Path) -> None:
    for name in ("x_10.mcap", "x_9.mcap.zstd", "x_9b.mcap", "7.mcap", "notes.txt"):
        (bag / name).touch()
    assert [f.name for f in storage_files(bag)] == ["7.mcap", "x_9.mcap.zstd", "x_9b.mcap", "x_10.mcap"]


def compress_file(path: Path) -> None:
    path.with_name(path.name + ".zstd").write_bytes(zstandard.compress(path.read_bytes()))
    path.unlink()


@pytest.mark.parametrize("suffix", ["db3", "mcap"])
@pytest.mark.parametrize("mode", ["FILE", "file", "File", None])
def test_compressed_files(bag: Path, suffix: str, mode: str | None) -> None:
    for number in range(2):
        write_storage(bag / f"bag_{number}.{suffix}", [("/a", 10 * number), ("/a", 10 * number + 1)])
        compress_file(bag / f"bag_{number}.{suffix}")
    before = names(bag)
    if mode:
        storage = {"db3": "sqlite3"}.get(suffix, suffix)
        files = [f"bag_{number}.{suffix}.zstd" for number in range(2)]
        write_metadata(bag, 8, files, storage, compression_format="zstd", compression_mode=mode)
        before = sorted([*before, "metadata.yaml"])
    reader = Rosbag2Reader(bag)
    temporary = reader._temporary
    assert temporary is not None
    assert [m.log_time_ns for m in reader.messages()] == [0, 1, 10, 11]
    assert reader.summary.compression == ("zstd",)
    assert reader.summary.size_bytes == sum(f.stat().st_size for f in storage_files(bag))
    assert reader.bytes_read <= reader.summary.size_bytes
    reader.close()
    assert not Path(temporary.name).exists()
    assert names(bag) == before


def test_files_that_were_unpacked_by_hand_are_found(bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    write_metadata(bag, 8, ["bag_0.db3.zstd"], compression_format="zstd", compression_mode="file")
    assert [m[1] for m in read(bag)] == [3]


def test_compressed_file_of_several_frames(bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    content = (bag / "bag_0.db3").read_bytes()
    frames = (zstandard.compress(content[start : start + 5000]) for start in range(0, len(content), 5000))
    (bag / "bag_0.db3.zst").write_bytes(b"".join(frames))
    (bag / "bag_0.db3").unlink()
    assert [m[1] for m in read(bag)] == [3]


def test_compressed_file_that_is_cut_off(bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    compress_file(bag / "bag_0.db3")
    packed = bag / "bag_0.db3.zstd"
    packed.write_bytes(packed.read_bytes()[:-2])
    with pytest.raises(RecordingError, match="cut off"):
        read(bag)


def test_no_room_to_decompress(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    compress_file(bag / "bag_0.db3")
    unpatched = Path.open

    def refuse(self: Path, mode: str = "r", **options: Any) -> Any:
        if mode == "wb":
            raise OSError(28, "No space left on device")
        return unpatched(self, mode, **options)

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(RecordingError, match="No space left") as caught:
        read(bag)
    assert "TMPDIR" in (caught.value.hint or "")


def test_damaged_compressed_file(bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    compress_file(bag / "bag_0.db3")
    packed = bag / "bag_0.db3.zstd"
    content = bytearray(packed.read_bytes())
    content[8:40] = bytes(32)
    packed.write_bytes(content)
    with pytest.raises(RecordingError, match=r"bag_0\.db3\.zstd: cannot be decompressed"):
        read(bag)


@pytest.mark.parametrize("suffix", ["db3", "mcap"])
def test_compressed_messages(bag: Path, suffix: str) -> None:
    writer = Sqlite3Writer(bag / "b.db3") if suffix == "db3" else McapWriter(bag / "b.mcap", "none")
    handle = writer.add_connection(topic("/a"))
    for number in range(3):
        writer.write(handle, number, zstandard.compress(text(str(number))), number)
    writer.finish()
    storage = {"db3": "sqlite3"}.get(suffix, suffix)
    write_metadata(bag, 6, [f"b.{suffix}"], storage, compression_format="zstd", compression_mode="MESSAGE")
    assert read(bag) == [("/a", number, text(str(number))) for number in range(3)]
    with closing(Rosbag2Reader(bag)) as reader:
        assert reader.summary.compression == ("zstd",)


@pytest.mark.parametrize(
    "name", ["../outside.db3", "/etc/outside.db3", "C:\\x\\outside.db3", "sub/outside.db3"]
)
def test_only_files_in_the_directory_are_opened(bag: Path, name: str) -> None:
    write_storage(bag.parent / "outside.db3", [("/secret", 3)])
    write_metadata(bag, 5, [name])
    with pytest.raises(RecordingError, match=r"names outside\.db3, which is not in the directory"):
        Rosbag2Reader(bag)
    write_storage(bag / "outside.db3", [("/a", 4)])
    assert [m[0] for m in read(bag)] == ["/a"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 10}, "has version 10; 1 to 9 are known"),
        ({"version": 0}, "has version 0"),
        ({"version": "8"}, "version of rosbag2_bagfile_information is '8', expected an integer"),
        ({"version": True}, "is True, expected an integer"),
        ({"version": ...}, "version of rosbag2_bagfile_information is missing"),
        ({"storage_identifier": "rosbag_v2"}, "has storage 'rosbag_v2'; mcap and sqlite3 can be read"),
        ({"relative_file_paths": []}, "names no files"),
        ({"relative_file_paths": [3]}, "names 3, expected a file"),
        ({"relative_file_paths": [".."]}, "expected a file"),
        ({"relative_file_paths": "bag_0.db3"}, "expected a list"),
        ({"compression_mode": "file", "compression_format": "lz4"}, "compression_format 'lz4'; only zstd"),
        ({"compression_mode": "sideways"}, "compression_mode 'sideways'"),
        ({"topics_with_message_count": [3]}, "topic_metadata of topic 1 is missing, expected a mapping"),
        ({"topics_with_message_count": [{"topic_metadata": {"name": "/a"}}]}, "type of topic 1 is missing"),
    ],
)
def test_metadata_that_cannot_be_understood(bag: Path, changes: dict[str, Any], message: str) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    write_metadata(bag, 8, ["bag_0.db3"], **changes)
    with pytest.raises(RecordingError, match=message) as caught:
        Rosbag2Reader(bag)
    assert caught.value.path == bag / "metadata.yaml"
    assert caught.value.hint


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"rosbag2_bagfile_information: [", "is not valid YAML in line 1"),
        (b"", "rosbag2_bagfile_information of the file is missing"),
        (b"- 1", "is missing"),
        (b"\xff\xfe", "is not UTF-8"),
        (b"a: !!python/object:os.system x", "is not valid YAML"),
        (b"[" * 5000, "is not valid YAML"),
    ],
)
def test_malformed_yaml(bag: Path, content: bytes, message: str) -> None:
    (bag / "metadata.yaml").write_bytes(content)
    with pytest.raises(RecordingError, match=message):
        Rosbag2Reader(bag)


def test_a_missing_file_is_named(bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    write_metadata(bag, 8, ["bag_0.db3", "bag_1.db3"])
    with pytest.raises(RecordingError, match=r"names bag_1\.db3, which is not in the directory"):
        Rosbag2Reader(bag)


def test_a_damaged_part_closes_the_others(bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    (bag / "bag_1.db3").write_bytes(b"no database, but long enough to be looked at" * 10)
    with pytest.raises(RecordingError, match=r"bag_1\.db3: SQLite cannot read it"):
        Rosbag2Reader(bag)


def test_directories_without_metadata(bag: Path) -> None:
    with pytest.raises(RecordingError, match=r"neither metadata\.yaml nor"):
        Rosbag2Reader(bag)
    write_storage(bag / "x.db3", [("/a", 3)])
    write_storage(bag / "x.mcap", [("/a", 3)])
    with pytest.raises(RecordingError, match="has mcap and sqlite3 files"):
        Rosbag2Reader(bag)


def test_attachments_and_records_pass_but_rosbag2s_own_do_not(bag: Path) -> None:
    writer = McapWriter(bag / "b.mcap", "none")
    attachment = Attachment("calib.yaml", "text/yaml", 1, 2, b"x: 1")
    writer.add_attachment(attachment)
    writer.add_metadata(Metadata("rosbag2", {"serialized_metadata": "version: 8"}))
    writer.add_metadata(Metadata("site", {"city": "Graz"}))
    writer.finish()
    with closing(Rosbag2Reader(bag)) as reader:
        assert list(reader.attachments()) == [attachment]
        assert list(reader.metadata()) == [Metadata("site", {"city": "Graz"})]


# --- rosbags' output ---


THEIR_QOS = Qos(
    QosHistory.KEEP_LAST,
    5,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    QosTime(1, 2),
    QosTime(3, 4),
    QosLiveliness.AUTOMATIC,
    QosTime(5, 6),
    False,
)


@pytest.mark.parametrize(
    ("plugin", "mode"),
    # sqlite3 has no compression of its own.
    [
        pair
        for pair in product(StoragePlugin, CompressionMode)
        if pair != (StoragePlugin.SQLITE3, CompressionMode.STORAGE)
    ],
)
@pytest.mark.parametrize("version", [8, 9])
def test_what_rosbags_writes_is_read(
    tmp_path: Path, version: Literal[8, 9], plugin: StoragePlugin, mode: CompressionMode
) -> None:
    theirs = TheirWriter(tmp_path / "bag", version=version, storage_plugin=plugin)
    theirs.set_compression(mode, CompressionFormat.ZSTD)
    theirs.set_custom_data("robot", "r2")
    with theirs:
        connections = [
            theirs.add_connection("/a", STRING, typestore=STORE, offered_qos_profiles=[THEIR_QOS]),
            theirs.add_connection("/b", STRING, typestore=STORE),
        ]
        for number in range(6):
            theirs.write(connections[number % 2], 100 + number, text(f"message {number}"))
    with closing(Rosbag2Reader(tmp_path / "bag")) as reader:
        a, b = reader.connections
        assert (a.topic, a.msgtype, a.serialization, a.message_count) == ("/a", STRING, "cdr", 3)
        assert (a.latching, b.latching) == (True, False)
        assert a.definition.encoding == "ros2msg"
        assert a.digest == STORE.hash_rihs01(STRING)
        assert ("transient_local" in a.qos) == (version == 9)
        assert [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages()] == [
            ("/b" if number % 2 else "/a", 100 + number, text(f"message {number}")) for number in range(6)
        ]
        assert (reader.summary.start_ns, reader.summary.end_ns) == (100, 105)
        assert reader.summary.compression == (("none",) if mode == CompressionMode.NONE else ("zstd",))
        assert reader.custom_data == {"robot": "r2"}


# --- Writing ---


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
            stored_version, stored = database.execute(
                "SELECT metadata_version, metadata FROM metadata"
            ).fetchone()
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
def test_mutilated_profiles_are_kept(tmp_path: Path, storage: str, version: int, qos: str) -> None:
    path = tmp_path / "bag"
    connection = topic("/a", qos=qos, metadata={"offered_qos_profiles": qos, "other": "kept"})
    writer = Rosbag2Writer(path, "bag", storage=storage, metadata_version=version)
    writer.write(writer.add_connection(connection), 1, text("x"), 1)
    writer.finish()
    (expected,) = {qos} if version == 8 else {qos.replace("durability: 1", "durability: transient_local")}
    with closing(Rosbag2Reader(path)) as reader:
        (a,) = reader.connections
        assert a.qos == expected
        assert len(list(reader.messages())) == 1
    # metadata.yaml is well-formed whatever the profile is.
    assert YAML(typ="safe").load((path / "metadata.yaml").read_text())


def test_respelling_profiles() -> None:
    assert respelled_qos(QOS_NUMBERS, by_name=True) == QOS_NAMES
    assert respelled_qos(QOS_NAMES, by_name=False) == QOS_NUMBERS
    verbatim = "# as it was\n- {history: 1,   durability: 2}"
    assert respelled_qos(verbatim, by_name=False) == verbatim
    assert respelled_qos("", by_name=True) == ""
    odd = "- history: 99\n  reliability: sometimes\n  durability: true\n  liveliness: null"
    assert respelled_qos(odd, by_name=True) == odd
    assert respelled_qos(odd, by_name=False) == odd
    assert respelled_qos("- reliability: Best_Effort", by_name=False) == "- reliability: 2"


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
