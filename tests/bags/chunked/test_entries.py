"""Index entries compared with the messages that they are about."""

from __future__ import annotations

import random
import struct
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.chunked.index_checks import EntryForm, count_wrong_entries
from pc2scan.bags.opening import open_recording
from pc2scan.errors import DamageError
from support import rosbag1_files as bag
from support.mcap_files import SAMPLE, library_file

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

FORM = EntryForm(struct.Struct("<8sI"), struct.Struct("<H"), 3, 11)
ENTRY = struct.Struct("<QI")

Row = tuple[int, int, int]


def chunk(count: int, seed: int) -> tuple[bytes, list[Row]]:
    """Messages of different sizes, with the id at 3 and the time at 11; and owner, time and place of each."""
    rng = random.Random(seed)
    records, rows = b"", []
    for _ in range(count):
        owner, time = rng.randrange(3), rng.randrange(1 << 63)
        rows.append((owner, time, len(records)))
        records += rng.randbytes(3) + struct.pack("<H", owner) + rng.randbytes(6) + struct.pack("<Q", time)
        records += rng.randbytes(rng.randrange(9))
    return records, rows


def groups(rows: Sequence[Row]) -> list[tuple[int, bytes]]:
    owners = dict.fromkeys(owner for owner, _, _ in rows)
    return [(o, b"".join(ENTRY.pack(time, place) for own, time, place in rows if own == o)) for o in owners]


@pytest.mark.parametrize("count", [0, 1, 24, 25, 300])
def test_entries_of_messages(count: int) -> None:
    records, rows = chunk(count, count)
    assert count_wrong_entries(memoryview(records), groups(rows), FORM) == 0


@pytest.mark.parametrize("count", [1, 24, 25, 300])
def test_entries_of_others(count: int) -> None:
    for seed in range(20):
        rng = random.Random(seed)
        records, rows = chunk(count, seed)
        number = rng.randrange(count)
        owner, time, place = rows[number]
        further = max(place for _, _, place in rows) + 1
        for changed in (
            (owner + 1, time, place),
            (owner, time ^ 1 << rng.randrange(63), place),
            (owner, time, place + 1),
            (owner, time, len(records)),
            (owner, time, (1 << 32) - 1),
            (owner, time, further),
        ):
            assert count_wrong_entries(records, groups([*rows[:number], changed, *rows[number + 1 :]]), FORM) == 1
        assert count_wrong_entries(records, groups([*rows, rows[number]]), FORM) == 1
    assert count_wrong_entries(b"", groups(rows), FORM) == count


# --- Readers ---


def bag_of(
    path: Path, entries: dict[int, list[tuple[int, int]]], order: tuple[str, ...] = ("op", "conn", "time")
) -> Path:
    """Write three messages of two connections, each of 50 bytes, and an index with these entries."""
    described = bag.connection_record(0) + bag.connection_record(1, topic=b"/other")
    messages = [bag.message(time, b"data", time % 2, order) for time in (1, 2, 3)]
    first = bag.chunk(b"".join(messages), "lz4")
    index = b"".join(
        bag.record(
            b"".join(bag.time(time) + bag.uint32(place) for time, place in rows),
            op=b"\x04",
            ver=bag.uint32(1),
            conn=bag.uint32(connection),
            count=bag.uint32(len(rows)),
        )
        for connection, rows in entries.items()
    )
    info = bag.chunk_info(bag.FIRST_CHUNK, 1, 3, {0: 1, 1: 2})
    body = first + index
    path.write_bytes(bag.bag_header(bag.FIRST_CHUNK + len(body), 2, 1) + body + described + info)
    return path


@pytest.mark.parametrize("order", [("op", "conn", "time"), ("time", "op", "conn"), ("conn", "op", "time")])
@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({0: [(2, 50)], 1: [(1, 0), (3, 100)]}, ""),
        ({}, ""),
        ({0: [(2, 50)], 1: [(1, 0), (4, 100)]}, "1 of 3 entries match no message by their connection and time"),
        ({0: [(2, 50)], 1: [(1, 0), (3, 101)]}, "1 of 3 entries"),
        ({0: [(2, 50)], 1: [(1, 0)]}, "it has entries for 2 messages, the chunk has 3"),
        ({1: [(1, 0), (3, 100)]}, "it has entries for 2 messages, the chunk has 3"),
        ({1: [(2, 50)], 0: [(1, 0), (3, 100)]}, "3 of 3 entries"),
    ],
)
def test_index_records_of_a_bag(
    entries: dict[int, list[tuple[int, int]]], words: str, order: tuple[str, ...], tmp_path: Path
) -> None:
    path = bag_of(tmp_path / "a.bag", entries, order)
    with closing(open_recording(path)) as reader:
        assert [message.log_time_ns for message in reader.messages()] == [1, 2, 3]
        assert [words in place.what for place in reader.damage] == ([True] if words else [])
        # If no entry matches, the chunk may be another.
        assert all(place.messages_lost == (None if "3 of 3" in words else 0) for place in reader.damage)
    if words:
        with closing(open_recording(path, strict=True)) as reader, pytest.raises(DamageError, match="contradicts it"):
            list(reader.messages())


def test_of_a_cut_only_what_is_read_is_compared(tmp_path: Path) -> None:
    path = bag_of(tmp_path / "a.bag", {0: [(2, 50)], 1: [(1, 0), (4, 100)]})
    with closing(open_recording(path)) as reader:
        (even,) = [connection for connection in reader.connections if connection.id == 0]
        assert len(list(reader.messages([even]))) == 1
        assert reader.damage == ()
        assert len(list(reader.messages(None, 2))) == 2
        assert len(reader.damage) == 1


@pytest.mark.parametrize(("place", "words"), [(15, "match no message"), (23, "match no message"), (11, "")])
@pytest.mark.parametrize("chunk_size", [300, 1 << 20])
def test_message_indexes_that_contradict(place: int, words: str, chunk_size: int, tmp_path: Path) -> None:
    """A bit of an entry's time, of its place, and of the length of all."""
    path = library_file(tmp_path / "a.mcap", SAMPLE, chunk_size=chunk_size)
    data = bytearray(path.read_bytes())
    at = data.index(b"\x07", 8 + 9)
    while int.from_bytes(data[at + 1 : at + 9], "little") != 6 + int.from_bytes(data[at + 11 : at + 15], "little"):
        at = data.index(b"\x07", at + 1)
    data[at + place] ^= 1
    path.write_bytes(data)
    with closing(open_recording(path)) as reader:
        assert len(list(reader.messages())) == len(SAMPLE)
        assert reader.damage
        assert words in reader.damage[0].what
    with closing(open_recording(path, verify=False)) as reader:
        assert len(list(reader.messages())) == len(SAMPLE)
        assert reader.damage == ()
