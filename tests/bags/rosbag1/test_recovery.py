"""What is left of damaged ROS 1 bags: cut anywhere, bytes flipped anywhere, never closed."""

from __future__ import annotations

import random
import struct
from collections import Counter
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.bags.rosbag1 import chunks as rosbag1_chunks
from pc2scan.bags.rosbag1 import reader as rosbag1_reader
from pc2scan.bags.rosbag1.reader import Rosbag1Reader
from pc2scan.errors import DamageError
from support import sampled, stepped
from support.rosbag1_files import (
    COMPRESSIONS,
    FIRST_CHUNK,
    Row,
    bag_header,
    chunk,
    chunk_info,
    connection,
    connection_record,
    message,
    record,
    simple_bag,
    string,
    time,
    uint32,
    write,
)

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.bags.damage import Damage
    from pc2scan.bags.rosbag1.records import BagFile

CONNECTIONS = [connection("/a"), connection("/b")]
ROWS: list[Row] = [(i % 2, 1_000_000_000 + 10 * (i // 2) + (i * 7) % 13, string(f"{i:03}" * 6)) for i in range(9)]


def recovered(path: Path) -> tuple[list[tuple[str, int, bytes]], tuple[Damage, ...]]:
    with closing(Rosbag1Reader(path)) as reader:
        rows = [(item.connection.topic, item.log_time_ns, bytes(item.data)) for item in reader.messages()]
        return rows, reader.damage


def chunks_of(data: bytes) -> list[tuple[int, int]]:
    """Where the records of the chunks begin and end."""
    found = []
    position = 13
    while position < len(data):
        (header,) = struct.unpack_from("<I", data, position)
        (body,) = struct.unpack_from("<I", data, position + 4 + header)
        stop = position + 8 + header + body
        if b"op=\x05" in data[position : position + 4 + header]:
            found.append((position, stop))
        position = stop
    return found


def contents(path: Path, compression: str) -> tuple[bytes, list[tuple[int, int, set[bytes]]]]:
    """A bag's bytes, and for each of its chunks its place and the data of the messages in it."""
    write(path, CONNECTIONS, ROWS, compression, chunk_size=150)
    data = path.read_bytes()
    places = chunks_of(data)
    assert len(places) >= 3
    # By their order: a writer fills one chunk after the other.
    with closing(Rosbag1Reader(path)) as reader:
        segments = reader._index.segments
        loaded = [
            {
                bytes(m.data)
                for m in reader.messages(start_ns=s.start_ns, stop_ns=s.end_ns + 1)
                if bytes(m.data) in _stored(path, s.offset, s.length, compression)
            }
            for s in segments
        ]
    assert sum(map(len, loaded)) == len(ROWS)
    return data, [(*place, inner) for place, inner in zip(places, loaded, strict=True)]


def _stored(path: Path, offset: int, length: int, compression: str) -> bytes:
    from pc2scan.files.salvage import decompressed_prefix

    return decompressed_prefix(path.read_bytes()[offset : offset + length], compression, 0)


@pytest.mark.parametrize(("compression", "step"), stepped(COMPRESSIONS, 37))
def test_cut_at_every_byte(tmp_path: Path, compression: str, step: int) -> None:
    data, places = contents(tmp_path / "a.bag", compression)
    complete, damage = recovered(tmp_path / "a.bag")
    assert damage == ()
    path = tmp_path / "b.bag"
    most = 0
    # The header's padding is all alike.
    for size in (*range(13, 150, step), *range(4100, len(data) - 1, step), len(data) - 1):
        path.write_bytes(data[:size])
        rows, damage = recovered(path)
        assert damage, size
        assert Counter(rows) <= Counter(complete), size
        found = {row[2] for row in rows}
        assert {data for _, stop, inner in places if stop <= size for data in inner} <= found, size
        assert len(rows) >= most, size
        most = len(rows)
        if size % 10 == 0 or step > 1:
            with pytest.raises(DamageError), closing(Rosbag1Reader(path, strict=True)) as strict:
                list(strict.messages())
    assert most == len(ROWS)


@pytest.mark.parametrize("step", sampled([7, 1], 1))
def test_a_cut_loses_only_the_message_it_cuts(tmp_path: Path, step: int) -> None:
    data = write(tmp_path / "a.bag", CONNECTIONS, ROWS, "none").read_bytes()
    ends = sorted(data.index(body) + len(body) for _, _, body in ROWS)
    for size in {*range(ends[0], ends[-1] + 1, step), *ends, *(end - 1 for end in ends[1:])}:
        (tmp_path / "b.bag").write_bytes(data[:size])
        rows, _ = recovered(tmp_path / "b.bag")
        assert len(rows) == sum(end <= size for end in ends), size


@pytest.mark.parametrize(("compression", "step"), stepped(COMPRESSIONS, 37))
def test_any_byte_flipped(tmp_path: Path, compression: str, step: int) -> None:
    data, places = contents(tmp_path / "a.bag", compression)
    path = tmp_path / "b.bag"
    for position in (*range(13, 150, step), *range(4100, len(data), step)):
        flipped = bytearray(data)
        flipped[position] ^= 0xFF if position % 2 else 0x01
        path.write_bytes(flipped)
        try:
            rows, damage = recovered(path)
        except DamageError as err:
            pytest.fail(f"{position}: {err}")
        found = {row[2] for row in rows}
        for start, stop, inner in places:
            if not start <= position < stop:
                assert inner <= found, (position, start, stop)
        if len(rows) < len(ROWS):
            assert damage, position


def test_a_bag_that_was_never_closed(tmp_path: Path) -> None:
    data = write(tmp_path / "a.bag", CONNECTIONS, ROWS, "lz4", chunk_size=150).read_bytes()
    path = tmp_path / "b.bag.active"
    index_pos = chunks_of(data)[-1][1]
    header = bag_header(0, 0, 0)
    path.write_bytes(header + data[chunks_of(data)[0][0] : index_pos])
    rows, (damage,) = recovered(path)
    assert sorted(rows) == sorted((("/a", "/b")[i], t, d) for i, t, d in ROWS)
    assert "was never closed" in damage.what
    assert damage.bytes_lost == 0
    assert damage.first_ns == max(t for _, t, _ in ROWS)
    with pytest.raises(DamageError, match="was never closed"):
        Rosbag1Reader(path, strict=True)


@pytest.mark.parametrize("closed", [True, False])
def test_of_a_bag_never_closed_no_chunk_is_read_twice(
    closed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "a.bag", CONNECTIONS, ROWS, "lz4", chunk_size=150)
    data = bytearray((tmp_path / "a.bag").read_bytes())
    if not closed:
        at = data.index(b"index_pos=") + len(b"index_pos=")
        data[at : at + 8] = bytes(8)
        (tmp_path / "a.bag").write_bytes(data)
    read: list[int] = []
    original = rosbag1_chunks.with_payload

    def counting(file: BagFile, segment: Segment, use: Any) -> Any:
        read.append(segment.offset)
        return original(file, segment, use)

    for module in (rosbag1_chunks, rosbag1_reader):
        monkeypatch.setattr(module, "with_payload", counting)
    rows, damage = recovered(tmp_path / "a.bag")
    assert bool(damage) is not closed
    assert len(rows) == len(ROWS)
    assert len(set(read)) == len(chunks_of(bytes(data)))
    assert len(read) == len(set(read))


def index_data(entries: list[tuple[int, int]], *, width: int) -> bytes:
    body = b"".join(time(stamp) + uint32(place) for stamp, place in entries)
    return record(
        body.ljust(width * len(entries), b"\0"),
        op=b"\x04",
        ver=uint32(1),
        conn=uint32(0),
        count=uint32(len(entries)),
    )


@pytest.mark.parametrize("closed", [True, False])
def test_index_records_that_lie_about_their_length(tmp_path: Path, closed: bool) -> None:
    """A real recorder declares 20 bytes an entry where there are 12."""
    body = connection_record() + b"".join(message(t, bytes([t]) * 30) for t in range(1, 9))
    wrong = bytearray(index_data([(t, 0) for t in range(1, 9)], width=12))
    at = wrong.index(uint32(96))
    wrong[at : at + 4] = uint32(160)
    first = chunk(body, "lz4")
    second = chunk(b"".join(message(t, bytes([t]) * 30) for t in range(9, 12)), "lz4")
    records = first + bytes(wrong) + second
    infos = chunk_info(FIRST_CHUNK, 1, 8, {0: 8}) + chunk_info(FIRST_CHUNK + len(first) + len(wrong), 9, 11, {0: 3})
    path = tmp_path / "a.bag"
    header = bag_header(FIRST_CHUNK + len(records) if closed else 0, 1, 2)
    path.write_bytes(header + records + (connection_record() + infos if closed else b""))
    rows, damage = recovered(path)
    assert [row[1] for row in rows] == list(range(1, 12))
    assert bool(damage) is not closed


def test_an_index_that_counts_too_few_chunks(tmp_path: Path) -> None:
    data = bytearray(write(tmp_path / "a.bag", CONNECTIONS, ROWS, "none", chunk_size=150).read_bytes())
    at = data.index(b"chunk_count=") + len(b"chunk_count=")
    data[at] -= 1
    (tmp_path / "a.bag").write_bytes(data)
    rows, (damage,) = recovered(tmp_path / "a.bag")
    assert len(rows) == len(ROWS)
    assert "it continues at byte" in damage.what


@pytest.mark.parametrize("compression", ["lz4", "bz2"])
def test_of_a_chunk_that_breaks_midway_the_front_is_kept(tmp_path: Path, compression: str) -> None:
    noise = random.Random(3)
    words = ["alpha", "bravo", "charlie", "delta", "echo"]
    rows = [(0, 1_000_000_000 + i, string(" ".join(noise.choices(words, k=600)))) for i in range(600)]
    path = write(tmp_path / "a.bag", CONNECTIONS[:1], rows, compression, chunk_size=4 << 20)
    data = bytearray(path.read_bytes())
    ((start, stop),) = chunks_of(bytes(data))
    at = start + (stop - start) * 3 // 4
    data[at : at + 100] = bytes(100)
    path.write_bytes(data)
    found, (damage,) = recovered(path)
    assert 200 <= len(found) < 600
    assert len({row[2] for row in found} - {body for _, _, body in rows}) <= 1
    assert damage.bytes_lost > 0
    assert damage.messages_lost is None
    assert (damage.first_ns or 0) >= rows[0][1]


def test_a_wrong_length_inside_a_chunk_costs_that_message(tmp_path: Path) -> None:
    for wrong in (0, 10, 50, 200, 1 << 31):
        parts = [message(t, bytes([t]) * 40) for t in range(1, 9)]
        broken = parts[3].replace(uint32(40) + bytes([4]), uint32(wrong) + bytes([4]))
        payload = b"".join((*parts[:3], broken, *parts[4:]))
        path = simple_bag(tmp_path / "a.bag", payload, times=(1, 8), counts={0: 8})
        rows, (damage,) = recovered(path)
        assert {row[1] for row in rows} >= {1, 2, 3, 5, 6, 7, 8}, wrong
        assert damage.bytes_lost > 0


def test_messages_of_connections_that_nothing_describes(tmp_path: Path) -> None:
    path = simple_bag(tmp_path / "a.bag", message(1) + message(2, identity=7), counts={0: 2})
    rows, (damage,) = recovered(path)
    assert [row[1] for row in rows] == [1]
    assert damage.messages_lost == 1
    assert "connection 7" in damage.what


def test_garbage_between_chunks_is_stepped_over(tmp_path: Path) -> None:
    first = chunk(connection_record() + message(5), "bz2")
    second = chunk(message(9), "bz2")
    path = tmp_path / "a.bag"
    path.write_bytes(bag_header(0, 0, 0) + first + b"\xaa" * 333 + second)
    rows, damage = recovered(path)
    assert [row[1] for row in rows] == [5, 9]
    (gap,) = [place for place in damage if place.bytes_lost]
    assert (gap.offset, gap.bytes_lost, gap.first_ns, gap.last_ns) == (FIRST_CHUNK + len(first), 333, 5, 9)


def test_messages_of_a_chunk_without_a_header_are_found(tmp_path: Path) -> None:
    body = connection_record() + b"".join(message(t, bytes([t]) * 30) for t in range(1, 9))
    broken = bytearray(chunk(body))
    broken[0:4] = b"\xff\xff\xff\xff"
    path = tmp_path / "a.bag"
    path.write_bytes(bag_header(0, 0, 0) + bytes(broken))
    rows, _ = recovered(path)
    assert [row[1] for row in rows] == list(range(1, 9))


def test_a_bag_may_end_with_a_chunk(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(bag_header(0, 0, 0) + chunk(connection_record() + message(5)))
    rows, (damage,) = recovered(path)
    assert [row[1] for row in rows] == [5]
    assert "was never closed" in damage.what
