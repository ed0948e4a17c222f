"""Records that describe connections."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

from pc2scan.bags.rosbag1.reader import Rosbag1Reader
from pc2scan.model import Connection
from support.rosbag1_files import connection_record, fails, header, message, record, simple_bag, uint32

if TYPE_CHECKING:
    from pathlib import Path


def test_a_connection_without_a_definition_has_none(tmp_path: Path) -> None:
    inner = header(type=b"std_msgs/String")[4:]
    bare = record(inner, op=b"\x07", conn=uint32(0), topic=b"/bare")
    path = simple_bag(tmp_path / "a.bag", message(1), connections=[bare])
    with closing(Rosbag1Reader(path)) as reader:
        assert reader.connections == (Connection(0, "/bare", "std_msgs/String", "ros1", message_count=1),)


def test_a_connection_without_a_type_is_refused(tmp_path: Path) -> None:
    bare = record(header(topic=b"/a")[4:], op=b"\x07", conn=uint32(0), topic=b"/a")
    assert "no field 'type'" in fails(simple_bag(tmp_path / "a.bag", message(1), connections=[bare]))


def test_the_first_of_two_connections_with_one_id_counts(tmp_path: Path) -> None:
    both = [connection_record(callerid=b"/first"), connection_record(callerid=b"/second")]
    path = simple_bag(tmp_path / "a.bag", message(2), connections=both)
    with closing(Rosbag1Reader(path)) as reader:
        assert [item.callerid for item in reader.connections] == ["/first"]
