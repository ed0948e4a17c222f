"""Bags to the byte: the forms that recorders write, and the form that pc2scan writes."""

from __future__ import annotations

import itertools
import struct
import tracemalloc
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING
from unittest.mock import Mock

import pytest

from pc2scan.bags.rosbag1 import read as rosbag1_reader
from pc2scan.bags.rosbag1 import write as rosbag1_writer
from pc2scan.bags.rosbag1.read import Rosbag1Reader
from pc2scan.bags.rosbag1.records import record_in
from pc2scan.bags.rosbag1.write import Rosbag1Writer
from pc2scan.errors import UnwritableError
from pc2scan.model import Connection, Definition
from support.rosbag1_files import (
    COMPRESSIONS,
    FIRST_CHUNK,
    SECOND,
    bag_header,
    connection,
    connection_record,
    given_bytes,
    header,
    message,
    read_rows,
    record,
    simple_bag,
    time,
    uint32,
    uint64,
    write,
)

if TYPE_CHECKING:
    from pathlib import Path

ORDERS = list(itertools.permutations(("op", "conn", "time")))


@pytest.mark.parametrize("order", ORDERS, ids=" ".join)
def test_fields_of_messages_may_stand_in_any_order(
    order: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    payload = b"".join(message(stamp, bytes([stamp]) * stamp, order=order) for stamp in range(1, 10))
    path = simple_bag(tmp_path / "a.bag", payload)
    slowly = Mock(wraps=record_in)
    monkeypatch.setattr(rosbag1_reader, "record_in", slowly)
    assert read_rows(path) == [(0, stamp, bytes([stamp]) * stamp) for stamp in range(1, 10)]
    # The usual order is expected from the start, another one after its first message.
    assert slowly.call_count == (order != ("conn", "op", "time"))


def test_orders_of_fields_may_change_within_a_chunk(tmp_path: Path) -> None:
    payload = connection_record() + message(1)
    payload += record(b"more", op=b"\x02", conn=uint32(0), time=time(2), added=b"field=")
    payload += b"".join(message(3, bytes([index]), order=order) for index, order in enumerate(ORDERS * 2))
    payload += connection_record() + message(4, b"")
    expected = [(0, 1, b"data"), (0, 2, b"more"), *((0, 3, bytes([index])) for index in range(12)), (0, 4, b"")]
    assert read_rows(simple_bag(tmp_path / "a.bag", payload)) == expected


@pytest.mark.parametrize("size", [0, 1, 3, 37, 38, 39, 45, 46, 47])
def test_a_message_may_hold_what_looks_like_a_record(size: int, tmp_path: Path) -> None:
    data = message(1, b"inside")[:size]
    path = simple_bag(tmp_path / "a.bag", message(1, data) + message(2, data, order=("conn", "op", "time")))
    assert read_rows(path) == [(0, 1, data), (0, 2, data)]


@pytest.mark.parametrize("times", [(0, 0), (9, 1), (2**32 * SECOND - 1, 0)])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_times_that_the_index_lacks_are_found(times: tuple[int, int], compression: str, tmp_path: Path) -> None:
    payload = connection_record() + message(30) + message(20) + message(25)
    path = simple_bag(tmp_path / "a.bag", payload, times=times, compression=compression, counts={0: 3})
    with closing(Rosbag1Reader(path)) as reader:
        assert (reader.summary.start_ns, reader.summary.end_ns) == (20, 30)
        assert [item.log_time_ns for item in reader.messages()] == [20, 25, 30]
        assert [item.log_time_ns for item in reader.messages(start_ns=30)] == [30]


def test_connections_that_only_a_chunk_describes_are_found(tmp_path: Path) -> None:
    payload = connection_record(5, callerid=b"/first") + message(2, identity=5) + message(3)
    path = simple_bag(tmp_path / "a.bag", payload, counts={0: 1, 5: 1})
    with closing(Rosbag1Reader(path)) as reader:
        found = [(item.id, item.callerid, item.message_count) for item in reader.connections]
        assert found == [(0, None, 1), (5, "/first", 1)]
        assert [item.connection.id for item in reader.messages()] == [5, 0]


@pytest.mark.parametrize("counts", [{}, {0: 1}])
def test_chunks_without_messages_are_passed_over(counts: dict[int, int], tmp_path: Path) -> None:
    path = simple_bag(tmp_path / "a.bag", connection_record(), counts=counts, times=(0, 0))
    with closing(Rosbag1Reader(path)) as reader:
        assert reader.summary.start_ns is None
        assert list(reader.messages()) == []


def test_a_chunk_may_have_very_many_index_records(tmp_path: Path) -> None:
    rows = [(number, number, b"x" * number) for number in range(400)]
    path = write(tmp_path / "a.bag", [connection(f"/{number}") for number in range(400)], rows, chunk_size=1 << 24)
    with closing(Rosbag1Reader(path, strict=True)) as reader:
        assert len(list(reader.messages())) == 400


def test_lying_lengths_of_index_records_do_no_harm(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bag", [connection()], [(0, 1, b"a"), (0, 2, b"b")], "none")
    raw = bytearray(path.read_bytes())
    # conn, count, op and ver make 47 bytes, followed by the length of two entries of 12 bytes.
    place = raw.index(header(conn=uint32(0), count=uint32(2), op=b"\x04", ver=uint32(1)))
    assert raw[place + 51 : place + 55] == uint32(24)
    raw[place + 51 : place + 55] = uint32(12)
    path.write_bytes(raw)
    assert read_rows(path) == [(0, 1, b"a"), (0, 2, b"b")]


def test_connections_may_lack_a_definition_and_be_repeated(tmp_path: Path) -> None:
    bare = record(header(type=b"std_msgs/String")[4:], op=b"\x07", conn=uint32(0), topic=b"/bare")
    again = connection_record(callerid=b"/second")
    path = simple_bag(tmp_path / "a.bag", message(1), connections=[bare, again])
    with closing(Rosbag1Reader(path)) as reader:
        # The first description counts.
        assert reader.connections == (Connection(0, "/bare", "std_msgs/String", "ros1", message_count=1),)


def test_an_empty_encryptor_is_none(tmp_path: Path) -> None:
    with closing(Rosbag1Reader(given_bytes(tmp_path, bag_header(FIRST_CHUNK + 14, 0, 0, encryptor=b"")))) as reader:
        assert reader.connections == ()


# --- What is written ---


def test_headers_of_connections_are_kept(tmp_path: Path) -> None:
    connections = [
        connection("/a", callerid="/node"),
        connection("no_slash//double", msgtype="std_msgs/msg/String", digest="", latching=True),
        connection("/ü", callerid="", metadata={"latching": "0", "tcp_nodelay": "1", "topic": "/remapped"}),
        connection("/silent", definition=Definition("ros1msg", b"\xff\xfe not text\r\n")),
    ]
    path = write(tmp_path / "a.bag", connections, [(0, 7, b"x")])
    with closing(Rosbag1Reader(path)) as reader:
        assert list(reader.connections) == [
            replace(each, id=index, msgtype="std_msgs/String", digest=each.digest or "*", message_count=index == 0)
            for index, each in enumerate(connections)
        ]
        (found,) = reader.messages()
        assert (found.log_time_ns, found.publish_time_ns) == (7, 7)


def records_of(raw: bytes) -> list[tuple[dict[str, bytes], bytes]]:
    """All records of a stretch of a bag, by a walk of its own."""
    found = []
    position = 0
    while position < len(raw):
        fields = {}
        (size,) = struct.unpack_from("<I", raw, position)
        place, stop = position + 4, position + 4 + size
        while place < stop:
            (length,) = struct.unpack_from("<I", raw, place)
            name, _, value = raw[place + 4 : place + 4 + length].partition(b"=")
            fields[name.decode()] = value
            place += 4 + length
        (size,) = struct.unpack_from("<I", raw, stop)
        position = stop + 4 + size
        found.append((fields, raw[stop + 4 : position]))
    return found


def test_records_are_laid_out_as_ros1_does(tmp_path: Path) -> None:
    rows = [(0, 5, b"1"), (1, 3, b"2"), (0, 4, b"3"), (0, 9, bytes(2000)), (0, 10, b"4"), (1, 11, b"5")]
    path = write(tmp_path / "a.bag", [connection("/a"), connection("/b")], rows, "none", 1500)
    raw = path.read_bytes()
    records = records_of(raw[len(b"#ROSBAG V2.0\n") :])
    # The large message has a chunk of its own.
    assert [item[0]["op"][0] for item in records] == [3, 5, 4, 4, 5, 4, 5, 4, 4, 7, 7, 6, 6, 6]
    assert all(list(fields) == sorted(fields) for fields, _ in records)
    chunk_pos = len(b"#ROSBAG V2.0\n") + 4096 + 8
    assert raw[chunk_pos:].startswith(header(compression=b"none", op=b"\5", size=uint32(len(records[1][1]))))
    inside = records_of(records[1][1])
    assert [item[0]["op"][0] for item in inside] == [7, 2, 7, 2, 2]
    assert [inside[0], inside[2]] == records[9:11]
    # Entries by time, each pointing at its message.
    entries = list(struct.iter_unpack("<III", records[2][1]))
    assert [entry[:2] for entry in entries] == [(0, 4), (0, 5)]
    assert [records_of(records[1][1][entry[2] :])[0][1] for entry in entries] == [b"3", b"1"]
    fields = {"chunk_pos": uint64(chunk_pos), "count": uint32(2), "end_time": time(5), "op": b"\6"}
    fields |= {"start_time": time(3), "ver": uint32(1)}
    assert records[11] == (fields, uint32(0) + uint32(2) + uint32(1) + uint32(1))
    assert [records_of(item[1])[-1][1] for item in records if item[0]["op"] == b"\5"] == [b"3", bytes(2000), b"5"]


def test_the_writer_holds_one_chunk(tmp_path: Path) -> None:
    writer = Rosbag1Writer(tmp_path / "a.bag", "none", 100_000)
    handle = writer.add_connection(connection())

    def chunks(count: int) -> None:
        for _ in range(count * 700):
            writer.write(handle, 1, bytes(100), 1)

    chunks(5)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        chunks(20)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    writer.finish()
    # 14,000 messages later: at most the open chunk, and 20 small records.
    assert grown < 700 * 500 + 20 * 400


def test_a_message_that_no_chunk_can_hold_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = Rosbag1Writer(tmp_path / "a.bag")
    handle = writer.add_connection(connection())
    monkeypatch.setattr(rosbag1_writer, "UINT32_MAX", 1000)
    with pytest.raises(UnwritableError, match="a message of 990 bytes does not fit into a ROS 1 bag"):
        writer.write(handle, 1, bytes(990), 1)
    writer.abort()
