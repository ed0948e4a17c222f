"""What is recovered of damaged ROS 1 bags, where no byte changed alone shows it (`fuzz.test_campaign` does those)."""

from __future__ import annotations

import random
import re
from contextlib import closing
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from fuzz.records import stretches
from pc2scan.bags.rosbag1.read import Rosbag1Reader
from pc2scan.errors import DamageError
from support.rosbag1_files import (
    FIRST_CHUNK,
    Row,
    bag_header,
    chunk,
    chunk_info,
    connection,
    connection_record,
    message,
    record,
    string,
    time,
    uint32,
    write,
)

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.damage import Damage

CONNECTIONS = [connection("/a"), connection("/b")]
ROWS: list[Row] = [(i % 2, 1_000_000_000 + 10 * (i // 2) + (i * 7) % 13, string(f"{i:03}" * 6)) for i in range(9)]


def recovered(path: Path) -> tuple[list[tuple[str, int, bytes]], tuple[Damage, ...]]:
    with closing(Rosbag1Reader(path)) as reader:
        rows = [(item.connection.topic, item.log_time_ns, bytes(item.data)) for item in reader.messages()]
        return rows, reader.damage


def messages(*times: int) -> bytes:
    return b"".join(message(t, bytes([t]) * 30) for t in times)


def closed(records: bytes, infos: bytes, chunks: int) -> bytes:
    return bag_header(FIRST_CHUNK + len(records), 1, chunks) + records + connection_record() + infos


def of_one_chunk(payload: bytes, *times: int) -> bytes:
    return closed(chunk(payload), chunk_info(FIRST_CHUNK, min(times), max(times), {0: len(times)}), 1)


class Kept(NamedTuple):
    """A bag, log times of messages that must be recovered, and fields of the only damage that costs anything."""

    data: bytes
    times: list[int]
    fields: dict[str, Any]
    what: str = ""


NEVER_CLOSED = bag_header(0, 0, 0)
FIRST = chunk(connection_record() + message(5), "bz2")

#: Those times are all that there is.
KEPT = {
    "a message of a connection that nothing describes": Kept(
        of_one_chunk(message(1) + message(2, identity=7), 1, 2), [1], {"messages_lost": 1}, "connection 7"
    ),
    "garbage between chunks": Kept(
        NEVER_CLOSED + FIRST + b"\xaa" * 333 + chunk(message(9), "bz2"),
        [5, 9],
        {"offset": FIRST_CHUNK + len(FIRST), "bytes_lost": 333, "first_ns": 5, "last_ns": 9},
    ),
}


@pytest.mark.parametrize("name", KEPT)
def test_what_is_sound_is_kept(name: str, tmp_path: Path) -> None:
    kept = KEPT[name]
    (tmp_path / "a.bag").write_bytes(kept.data)
    rows, damage = recovered(tmp_path / "a.bag")
    assert [row[1] for row in rows] == kept.times
    costs = [place for place in damage if place.bytes_lost or place.messages_lost]
    assert [{field: getattr(place, field) for field in kept.fields} for place in costs if kept.fields] == (
        [kept.fields] if kept.fields else []
    )
    assert all(kept.what in place.what for place in costs)


@pytest.mark.parametrize("wrong", [0, 10, 50, 200, 1 << 31])
def test_a_wrong_length_inside_a_chunk_is_made_good_by_its_index(wrong: int, tmp_path: Path) -> None:
    parts = [message(t, bytes([t]) * 40) for t in range(1, 9)]
    entries = b"".join(time(t) + uint32((t - 1) * len(parts[0])) for t in range(1, 9))
    parts[3] = parts[3].replace(uint32(40) + bytes([4]), uint32(wrong) + bytes([4]))
    index = record(entries, op=b"\x04", ver=uint32(1), conn=uint32(0), count=uint32(8))
    records = chunk(b"".join(parts)) + index
    (tmp_path / "a.bag").write_bytes(closed(records, chunk_info(FIRST_CHUNK, 1, 8, {0: 8}), 1))
    rows, (damage,) = recovered(tmp_path / "a.bag")
    assert [row[1] for row in rows] == list(range(1, 9))
    assert (damage.bytes_lost > 0) == (wrong < 40)


def test_a_bag_that_was_never_closed(tmp_path: Path) -> None:
    data = write(tmp_path / "a.bag", CONNECTIONS, ROWS, "lz4", chunk_size=150).read_bytes()
    places = stretches(data)
    path = tmp_path / "b.bag.active"
    # Behind the chunks is the index.
    path.write_bytes(NEVER_CLOSED + data[places[0].start : places[-1].stop])
    rows, (damage,) = recovered(path)
    assert sorted(rows) == sorted((("/a", "/b")[i], t, d) for i, t, d in ROWS)
    assert "was never closed" in damage.what
    assert (damage.bytes_lost, damage.first_ns) == (0, max(t for _, t, _ in ROWS))
    with pytest.raises(DamageError, match="was never closed"):
        Rosbag1Reader(path, strict=True)


@pytest.mark.parametrize("sound", [True, False])
def test_index_records_that_lie_about_their_length(sound: bool, tmp_path: Path) -> None:
    """A real recorder declares 20 bytes an entry where there are 12."""
    entries = b"".join(time(stamp) + uint32(0) for stamp in range(1, 9))
    index = record(entries, op=b"\x04", ver=uint32(1), conn=uint32(0), count=uint32(8))
    index = index.replace(uint32(len(entries)), uint32(20 * 8))
    first, second = chunk(connection_record() + messages(*range(1, 9)), "lz4"), chunk(messages(9, 10, 11), "lz4")
    records = first + index + second
    infos = chunk_info(FIRST_CHUNK, 1, 8, {0: 8}) + chunk_info(FIRST_CHUNK + len(first + index), 9, 11, {0: 3})
    (tmp_path / "a.bag").write_bytes(closed(records, infos, 2) if sound else NEVER_CLOSED + records)
    rows, damage = recovered(tmp_path / "a.bag")
    assert [row[1] for row in rows] == list(range(1, 12))
    assert bool(damage) is not sound


@pytest.mark.parametrize("number", [1, 2])
def test_a_topic_is_what_chunks_say(number: int, tmp_path: Path) -> None:
    """One bit of the index is another, in the record of a connection, or in the publisher's header."""
    path = write(tmp_path / "a.bag", CONNECTIONS, ROWS, "lz4")
    data = path.read_bytes()
    sound, _ = recovered(path)
    places = [match.start() for match in re.finditer(b"topic=/b", data)]
    at = places[-number] + 7
    path.write_bytes(data[:at] + b"c" + data[at + 1 :])
    rows, damage = recovered(path)
    assert rows == sound
    assert damage


@pytest.mark.parametrize("compression", ["lz4", "bz2"])
def test_of_a_chunk_that_breaks_midway_the_front_is_kept(compression: str, tmp_path: Path) -> None:
    noise = random.Random(3)
    words = ["alpha", "bravo", "charlie", "delta", "echo"]
    rows = [(0, 1_000_000_000 + i, string(" ".join(noise.choices(words, k=600)))) for i in range(600)]
    path = write(tmp_path / "a.bag", CONNECTIONS[:1], rows, compression, chunk_size=4 << 20)
    data = bytearray(path.read_bytes())
    ((start, stop, _),) = stretches(bytes(data))
    at = start + (stop - start) * 3 // 4
    data[at : at + 100] = bytes(100)
    path.write_bytes(data)
    found, (damage,) = recovered(path)
    assert 200 <= len(found) < 600
    assert len({row[2] for row in found} - {body for _, _, body in rows}) <= 1
    assert damage.bytes_lost > 0
    assert damage.messages_lost == 600 - len(found)
    assert (damage.first_ns or 0) >= rows[0][1]
