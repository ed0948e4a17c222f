"""metadata.yaml of every version, damaged, or not there."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from ruamel.yaml import YAML

from pc2scan.bags.rosbag2.metadata import storage_files
from pc2scan.bags.rosbag2.reader import Rosbag2Reader
from pc2scan.errors import RecordingError
from support.rosbag2_files import DEFINITION, QOS_NAMES, QOS_NUMBERS, read, write_metadata, write_storage

if TYPE_CHECKING:
    from pathlib import Path


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


def test_natural_order(bag: Path) -> None:
    for name in ("x_10.mcap", "x_9.mcap.zstd", "x_9b.mcap", "7.mcap", "notes.txt"):
        (bag / name).touch()
    assert [f.name for f in storage_files(bag)] == ["7.mcap", "x_9.mcap.zstd", "x_9b.mcap", "x_10.mcap"]


def test_files_that_were_unpacked_by_hand_are_found(bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    write_metadata(bag, 8, ["bag_0.db3.zstd"], compression_format="zstd", compression_mode="file")
    assert [m[1] for m in read(bag)] == [3]


@pytest.mark.parametrize("name", ["../outside.db3", "/etc/outside.db3", "C:\\x\\outside.db3", "sub/outside.db3"])
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
        Rosbag2Reader(bag, strict=True)
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
        Rosbag2Reader(bag, strict=True)


def test_a_missing_file_is_named(bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    write_metadata(bag, 8, ["bag_0.db3", "bag_1.db3"])
    with pytest.raises(RecordingError, match=r"names bag_1\.db3, which is not in the directory"):
        Rosbag2Reader(bag, strict=True)


def test_directories_without_metadata(bag: Path) -> None:
    with pytest.raises(RecordingError, match=r"neither metadata\.yaml nor"):
        Rosbag2Reader(bag)
    write_storage(bag / "x.db3", [("/a", 3)])
    write_storage(bag / "x.mcap", [("/a", 3)])
    with pytest.raises(RecordingError, match="has mcap and sqlite3 files"):
        Rosbag2Reader(bag)
