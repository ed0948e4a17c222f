"""What connections declare: topics, ROS versions, encodings."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer as LibraryWriter

from pc2scan.bags.mcap.reader import McapReader
from pc2scan.bags.mcap.writer import McapWriter
from support.mcap_files import connection

if TYPE_CHECKING:
    from pathlib import Path


def test_two_channels_of_one_topic_stay_two(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    one = writer.add_connection(connection(metadata={"publisher": "a"}))
    two = writer.add_connection(connection(metadata={"publisher": "b"}))
    writer.write(two, 1, b"2", 1)
    writer.write(one, 2, b"1", 2)
    writer.finish()
    with closing(McapReader(path)) as reader:
        assert [(c.topic, c.metadata["publisher"]) for c in reader.connections] == [
            ("/points", "a"),
            ("/points", "b"),
        ]
        assert [bytes(m.data) for m in reader.messages()] == [b"2", b"1"]
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    # One schema for both.
    assert len(summary.schemas) == 1
    assert len(summary.channels) == 2


@pytest.mark.parametrize(
    ("value", "expected"),
    [("1", True), ("true", True), ("True", True), ("0", False), ("false", False), (None, False)],
)
def test_ros1_latching(tmp_path: Path, value: str | None, *, expected: bool) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = LibraryWriter(file)
        writer.start("ros1", "test")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data")
        writer.register_channel("/a", "ros1", schema, {} if value is None else {"latching": value})
        writer.finish()  # type: ignore[no-untyped-call]
    with closing(McapReader(path)) as reader:
        assert reader.connections[0].latching is expected


@pytest.mark.parametrize(
    ("profile", "schema", "expected"),
    [
        ("", "ros1msg", "ros1"),
        ("", "ros2msg", "cdr"),
        ("", "ros2idl", "cdr"),
        ("ros1", "", "ros1"),
        ("ros2", "", "cdr"),
        ("ros1", "ros2msg", "cdr"),
        ("", "protobuf", ""),
    ],
)
def test_an_empty_message_encoding_is_deduced(tmp_path: Path, profile: str, schema: str, expected: str) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = LibraryWriter(file)
        writer.start(profile, "test")
        writer.register_channel("/a", "", writer.register_schema("a/B", schema, b""), {})
        writer.finish()  # type: ignore[no-untyped-call]
    with closing(McapReader(path)) as reader:
        assert reader.connections[0].serialization == expected
