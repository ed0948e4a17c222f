"""Reading rosbag2 directories: split, compressed, and rosbags' output."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from itertools import product
from pathlib import Path
from typing import Any, Literal

import pytest
import zstandard
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as TheirWriter

from pc2scan.bags.mcap.writer import McapWriter
from pc2scan.bags.rosbag2.metadata import storage_files
from pc2scan.bags.rosbag2.reader import Rosbag2Reader
from pc2scan.bags.rosbag2.sqlite3.writer import Sqlite3Writer
from pc2scan.errors import DamageError, RecordingError
from pc2scan.model import Attachment, Metadata
from support.rosbag2_files import (
    STORE,
    STRING,
    compress_file,
    names,
    read,
    text,
    topic,
    write_metadata,
    write_storage,
)


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
        read(bag, strict=True)


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
        read(bag, strict=True)


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


def test_a_damaged_part_closes_the_others(bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    (bag / "bag_1.db3").write_bytes(b"no database, but long enough to be looked at" * 10)
    with pytest.raises(RecordingError, match=r"bag_1\.db3: is no sqlite3 file: it begins with b'no database"):
        Rosbag2Reader(bag, strict=True)
    with closing(Rosbag2Reader(bag)) as reader:
        assert [m.log_time_ns for m in reader.messages()] == [3]
        assert [place.path.name for place in reader.damage] == ["bag_1.db3"]


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


def test_metadata_that_cannot_be_understood_is_done_without(bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3), ("/a", 4)])
    for content in (
        b"rosbag2_bagfile_information: [",
        b"\xff\xfe",
        b"rosbag2_bagfile_information:\n  version: 8\n  sto",
    ):
        (bag / "metadata.yaml").write_bytes(content)
        with closing(Rosbag2Reader(bag)) as reader:
            assert [m.log_time_ns for m in reader.messages()] == [3, 4]
            (damage,) = reader.damage
        assert damage.path == bag / "metadata.yaml"
        assert damage.bytes_lost == 0


def test_a_missing_part_is_told_with_its_times(bag: Path) -> None:
    write_storage(bag / "bag_1.mcap", [("/a", 30), ("/a", 40)])
    extents = [
        {
            "path": f"bag_{number}.mcap",
            "starting_time": {"nanoseconds_since_epoch": 10 + 20 * number},
            "duration": {"nanoseconds": 10},
            "message_count": count,
        }
        for number, count in enumerate((5, 2))
    ]
    write_metadata(bag, 8, ["bag_0.mcap", "bag_1.mcap"], "mcap", files=extents, message_count=7)
    with closing(Rosbag2Reader(bag)) as reader:
        assert [m.log_time_ns for m in reader.messages()] == [30, 40]
        (damage,) = reader.damage
    assert "names bag_0.mcap" in damage.what
    assert (damage.messages_lost, damage.first_ns, damage.last_ns) == (5, 10, 20)
    (bag / "bag_1.mcap").unlink()
    with pytest.raises(DamageError, match=r"names bag_1\.mcap"):
        Rosbag2Reader(bag)


@pytest.mark.parametrize(("declared", "lost"), [(3, None), (4, None), (9, 5)])
def test_counts_that_the_files_do_not_have(bag: Path, declared: int, lost: int | None) -> None:
    write_storage(bag / "bag_0.db3", [("/a", time_ns) for time_ns in range(4)])
    write_metadata(bag, 8, ["bag_0.db3"], message_count=declared)
    with closing(Rosbag2Reader(bag)) as reader:
        assert len(list(reader.messages())) == 4
        assert [damage.messages_lost for damage in reader.damage] == ([lost] if lost else [])
    if lost:
        with pytest.raises(DamageError, match=r"metadata\.yaml counts 9 messages, its files have 4"):
            Rosbag2Reader(bag, strict=True)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n"])
def test_an_empty_or_foreign_part_is_left_out(bag: Path, content: bytes) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    (bag / "bag_1.db3").write_bytes(content)
    write_metadata(bag, 8, ["bag_0.db3", "bag_1.db3"], message_count=1)
    with closing(Rosbag2Reader(bag)) as reader:
        assert [m.log_time_ns for m in reader.messages()] == [3]
        assert ["is no sqlite3 file" in damage.what for damage in reader.damage] == [True]


@pytest.mark.parametrize("suffix", ["db3", "mcap"])
def test_a_compressed_part_that_is_cut_off_gives_its_front(bag: Path, suffix: str) -> None:
    write_storage(bag / f"bag_0.{suffix}", [("/a", time_ns) for time_ns in range(5000)])
    compress_file(bag / f"bag_0.{suffix}")
    packed = bag / f"bag_0.{suffix}.zstd"
    packed.write_bytes(packed.read_bytes()[: packed.stat().st_size * 9 // 10])
    with closing(Rosbag2Reader(bag)) as reader:
        found = [m.log_time_ns for m in reader.messages()]
        # Named as the user knows the file, not as it was unpacked.
        assert {damage.path for damage in reader.damage} == {packed}
    assert len(found) > 1000
    assert found == sorted(found)


@pytest.mark.parametrize(("start", "duration", "outside"), [(0, 3, False), (-5, 20, False), (1, 2, True), (0, 2, True)])
def test_messages_outside_of_the_declared_times(bag: Path, start: int, duration: int, outside: bool) -> None:
    write_storage(bag / "bag_0.db3", [("/a", time_ns) for time_ns in range(4)])
    times = {"starting_time": {"nanoseconds_since_epoch": start}, "duration": {"nanoseconds": duration}}
    write_metadata(bag, 8, ["bag_0.db3"], message_count=4, **times)
    with closing(Rosbag2Reader(bag)) as reader:
        assert len(list(reader.messages())) == 4
        assert [(damage.messages_lost, "log times" in damage.what) for damage in reader.damage] == [(0, True)] * outside
    if outside:
        with pytest.raises(DamageError, match=r"its files 0\.000000000 to 0\.000000003"):
            Rosbag2Reader(bag, strict=True)


def test_declared_times_of_a_split_recording_are_not_relied_on(bag: Path) -> None:
    for number in range(2):
        write_storage(bag / f"bag_{number}.db3", [("/a", 10 * number + time_ns) for time_ns in range(4)])
    times = {"starting_time": {"nanoseconds_since_epoch": 10}, "duration": {"nanoseconds": 3}}
    write_metadata(bag, 8, ["bag_0.db3", "bag_1.db3"], message_count=8, **times)
    with closing(Rosbag2Reader(bag)) as reader:
        assert len(list(reader.messages())) == 8
        assert reader.damage == ()


def test_a_part_in_which_a_topic_has_no_serialization(bag: Path) -> None:
    for number in range(2):
        write_storage(bag / f"bag_{number}.db3", [("/a", 10 * number + time_ns) for time_ns in range(4)])
    write_metadata(bag, 8, ["bag_0.db3", "bag_1.db3"], message_count=8)
    with closing(sqlite3.connect(bag / "bag_1.db3")) as database, database:
        database.execute("UPDATE topics SET serialization_format = ''")
    with closing(Rosbag2Reader(bag)) as reader:
        assert len(list(reader.messages())) == 8
        # metadata.yaml has it.
        assert {connection.serialization for connection in reader.connections} == {"cdr"}
        (damage,) = reader.damage
    assert damage.what == f"metadata.yaml lists /a as {STRING!r} in 'cdr', its files have {STRING!r} in ''"
    assert (damage.path, damage.messages_lost) == (bag, 0)
