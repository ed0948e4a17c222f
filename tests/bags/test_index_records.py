"""Index records after chunks that are wrong: the chunks are read, and only a wrong number of messages is damage."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.opening import open_recording
from pc2scan.errors import DamageError
from support import rosbag1_files as bag

if TYPE_CHECKING:
    from pathlib import Path


def bag_of(
    path: Path,
    entries: dict[int, list[tuple[int, int]]],
    order: tuple[str, ...] = ("op", "conn", "time"),
    counts: dict[int, int] | None = None,
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
    info = bag.chunk_info(bag.FIRST_CHUNK, 1, 3, counts or {0: 1, 1: 2})
    body = first + index
    path.write_bytes(bag.bag_header(bag.FIRST_CHUNK + len(body), 2, 1) + body + described + info)
    return path


@pytest.mark.parametrize("order", [("op", "conn", "time"), ("time", "op", "conn"), ("conn", "op", "time")])
@pytest.mark.parametrize(
    "entries",
    [
        {0: [(2, 50)], 1: [(1, 0), (3, 100)]},
        {},
        {0: [(2, 50)], 1: [(1, 0), (4, 101)]},
        {1: [(1, 0), (3, 100)]},
        {1: [(2, 50)], 0: [(1, 0), (3, 100)]},
    ],
)
@pytest.mark.parametrize("cut", [(None, None), (2, None)])
def test_entries_of_a_bag_decide_nothing(
    entries: dict[int, list[tuple[int, int]]],
    order: tuple[str, ...],
    cut: tuple[int | None, int | None],
    tmp_path: Path,
) -> None:
    path = bag_of(tmp_path / "a.bag", entries, order)
    with closing(open_recording(path)) as reader:
        assert [message.log_time_ns for message in reader.messages(None, *cut)] == [1, 2, 3][(cut[0] or 1) - 1 :]
        assert reader.damage == ()


@pytest.mark.parametrize("counts", [{0: 1, 1: 3}, {0: 1, 1: 1}])
@pytest.mark.parametrize("cut", [(None, None), (2, None), (3, 4)])
def test_a_wrong_number_of_messages_in_a_chunk_is_damage(
    counts: dict[int, int], cut: tuple[int | None, int | None], tmp_path: Path
) -> None:
    path = bag_of(tmp_path / "a.bag", {0: [(2, 50)], 1: [(1, 0), (3, 100)]}, counts=counts)
    fewer = sum(counts.values()) < 3
    words = "has 3 messages, counted are 2" if fewer else "it has 3 messages, the index counts 4"
    with closing(open_recording(path)) as reader:
        assert [m.log_time_ns for m in reader.messages(None, *cut)] == [1, 2, 3][(cut[0] or 1) - 1 :]
        assert [words in place.what for place in reader.damage] == [True]
        # Of one topic alone, too.
        assert len(list(reader.messages([reader.connections[0]]))) == 1
        assert len(reader.damage) == 1
    with closing(open_recording(path, strict=True)) as reader, pytest.raises(DamageError, match=words):
        list(reader.messages(None, *cut))
