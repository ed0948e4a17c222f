"""What a bag holds by its index, what the index does not know, and bags that are refused."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.rosbag1.reader import Rosbag1Reader
from support.rosbag1_files import (
    COMPRESSIONS,
    FIRST_CHUNK,
    SECOND,
    bag_header,
    chunk,
    chunk_info,
    connection,
    connection_record,
    fails,
    given_bytes,
    header,
    message,
    read_rows,
    record,
    simple_bag,
    uint32,
    write,
)

if TYPE_CHECKING:
    from pathlib import Path


def test_lying_index_records_are_not_looked_at(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bag", [connection()], [(0, 1, b"a"), (0, 2, b"b")], "none")
    raw = bytearray(path.read_bytes())
    # conn, count, op and ver make 47 bytes, followed by the length of two entries of 12 bytes.
    place = raw.index(header(conn=uint32(0), count=uint32(2), op=b"\x04", ver=uint32(1)))
    assert raw[place + 51 : place + 55] == uint32(24)
    raw[place + 51 : place + 55] = uint32(12)
    path.write_bytes(raw)
    assert read_rows(path) == [(0, 1, b"a"), (0, 2, b"b")]


@pytest.mark.parametrize("times", [(0, 0), (9, 1), (2**32 * SECOND - 1, 0)])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_times_that_the_index_does_not_know_are_found_out(
    tmp_path: Path, times: tuple[int, int], compression: str
) -> None:
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
        assert [(item.id, item.callerid, item.message_count) for item in reader.connections] == [
            (0, None, 1),
            (5, "/first", 1),
        ]
        assert [item.connection.id for item in reader.messages()] == [5, 0]


def test_chunks_without_messages_are_passed_over(tmp_path: Path) -> None:
    path = simple_bag(tmp_path / "a.bag", connection_record(), counts={}, times=(0, 0))
    with closing(Rosbag1Reader(path)) as reader:
        assert reader.summary.start_ns is None
        assert list(reader.messages()) == []
    path = simple_bag(tmp_path / "b.bag", connection_record(), times=(0, 0))
    with closing(Rosbag1Reader(path)) as reader:
        assert list(reader.messages()) == []


@pytest.mark.parametrize("first", [b"", b"#ROS", b"#ROSBAG V3.0\n", b"SQLite format 3\0", b"#ROSBAG V2.0 "])
def test_a_file_that_is_no_bag_is_refused(tmp_path: Path, first: bytes) -> None:
    assert "a ROS 1 bag begins with b'#ROSBAG V2.0\\n'" in fails(given_bytes(tmp_path, first))


@pytest.mark.parametrize("first", [b"#ROSBAG V1.2\n", b"#ROSRECORD V1.1\n", b"#ROSBAG V1.1\n"])
def test_old_formats_are_refused(tmp_path: Path, first: bytes) -> None:
    assert "only bags of format 2.0" in fails(given_bytes(tmp_path, first + bytes(99)), hint="rosbag fix")


def test_what_cannot_be_opened_is_refused(tmp_path: Path) -> None:
    assert "No such file" in fails(tmp_path / "missing.bag")
    assert "Is a directory" in fails(tmp_path)


def test_an_encrypted_bag_is_refused(tmp_path: Path) -> None:
    raw = bag_header(9999, 1, 1, encryptor=b"rosbag/AesCbcEncryptor")
    assert "encrypted (rosbag/AesCbcEncryptor)" in fails(given_bytes(tmp_path, raw), hint="rosbag decrypt")
    plain = given_bytes(tmp_path, bag_header(FIRST_CHUNK + 14, 0, 0, encryptor=b""))
    with closing(Rosbag1Reader(plain)) as reader:
        assert reader.connections == ()


def test_a_bag_that_was_never_closed_is_refused(tmp_path: Path) -> None:
    message_text = fails(given_bytes(tmp_path, bag_header(0, 0, 0) + chunk(b"")), hint="`strict`")
    assert "index_pos is 0" in message_text


def test_a_cut_bag_is_refused_wherever_it_is_cut(tmp_path: Path) -> None:
    rows = [(index % 2, index, b"x" * 300) for index in range(40)]
    path = write(tmp_path / "a.bag", [connection("/a"), connection("/b")], rows, "bz2", 4000)
    whole = path.read_bytes()
    for length in [*range(0, len(whole), 53), *range(len(whole) - 60, len(whole))]:
        message_text = fails(given_bytes(tmp_path, whole[:length]))
        if length > 5000:
            assert f"the file has {length} bytes" in message_text


def test_an_index_that_is_somewhere_else_is_refused(tmp_path: Path) -> None:
    body = chunk(message(1))
    raw = bag_header(FIRST_CHUNK, 1, 1) + body
    assert "is a chunk, a connection should be there" in fails(given_bytes(tmp_path, raw), hint="`strict`")
    raw = bag_header(FIRST_CHUNK, 0, 0)
    at = raw.index(b"op=\x03")
    assert "is a 9, a bag header should be there" in fails(
        given_bytes(tmp_path, raw[: at + 3] + b"\x09" + raw[at + 4 :])
    )
    raw = bag_header(10**12, 1, 1)
    assert "should be at byte 1000000000000, the file has" in fails(given_bytes(tmp_path, raw), hint="`strict`")


@pytest.mark.parametrize(
    ("info", "expected"),
    [
        (chunk_info(FIRST_CHUNK, 1, 1, {0: 1}, version=2), "version 2, only 1"),
        (chunk_info(FIRST_CHUNK, 1, 1, {0: 1}, count=3), "of 8 bytes declares 3 counts"),
        (chunk_info(FIRST_CHUNK, 1, 1, {3: 1}), "connection 3 has messages but is not described"),
        (chunk_info(2**50, 1, 1, {0: 1}), "4 bytes are declared from byte 1125899906842624"),
        (chunk_info(len(b"#ROSBAG V2.0\n"), 1, 1, {0: 1}), "is a bag header, a chunk should be there"),
        (record(op=b"\x06", ver=b"\1"), "'ver' has 1 bytes, 4 are needed"),
        (record(op=b"\x06"), "no field 'ver'"),
        (record(b"x" * 9, op=b"\x06")[:-1], "the chunk info at byte"),
        (uint32(8) + uint32(2) + b"op" + uint32(0)[:2], "has no '='"),
        (uint32(6) + uint32(9) + b"op" + uint32(0), "does not fit into its header of 6 bytes"),
        (uint32(2) + b"op" + uint32(0), "ends inside a field's length"),
    ],
)
def test_a_damaged_index_is_refused(tmp_path: Path, info: bytes, expected: str) -> None:
    body = chunk(message(1))
    raw = bag_header(FIRST_CHUNK + len(body), 1, 1) + body + connection_record() + info
    assert expected in fails(given_bytes(tmp_path, raw), hint="`strict`")


def test_an_unknown_compression_is_refused(tmp_path: Path) -> None:
    path = simple_bag(tmp_path / "a.bag", message(1), compression="zstd")
    assert "compressed with 'zstd', allowed are none, bz2, lz4" in fails(path, hint="`strict`")
