"""Bags to the byte: the forms that recorders write, and the form that pc2scan writes."""

from __future__ import annotations

import itertools
import struct
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.rosbag1.read import Rosbag1Reader
from support.rosbag1_files import (
    COMPRESSIONS,
    SECOND,
    connection,
    connection_record,
    header,
    message,
    read_rows,
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
def test_fields_of_messages_may_stand_in_any_order(order: tuple[str, ...], tmp_path: Path) -> None:
    payload = b"".join(message(stamp, bytes([stamp]) * stamp, order=order) for stamp in range(1, 10))
    path = simple_bag(tmp_path / "a.bag", payload)
    assert read_rows(path) == [(0, stamp, bytes([stamp]) * stamp) for stamp in range(1, 10)]


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


# --- What is written ---


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
