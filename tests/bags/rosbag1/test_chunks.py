"""Chunks: messages of every layout, and damage."""

from __future__ import annotations

import bz2
import itertools
import tracemalloc
from contextlib import closing
from typing import TYPE_CHECKING, Any

import lz4.frame
import pytest

from pc2scan.bags.rosbag1 import chunks as rosbag1_chunks
from pc2scan.bags.rosbag1.reader import Rosbag1Reader

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

from support.rosbag1_files import (
    COMPRESSIONS,
    FIRST_CHUNK,
    chunk,
    connection_record,
    fails,
    message,
    read_rows,
    record,
    simple_bag,
    time,
    uint32,
)


@pytest.mark.parametrize("order", list(itertools.permutations(("op", "conn", "time"))), ids=" ".join)
def test_fields_of_messages_may_stand_in_any_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, order: tuple[str, ...]
) -> None:
    payload = b"".join(message(stamp, bytes([stamp]) * stamp, order=order) for stamp in range(1, 10))
    path = simple_bag(tmp_path / "a.bag", payload)
    general = 0
    real = rosbag1_chunks._record

    def counted(*arguments: Any) -> Any:
        nonlocal general
        general += 1
        return real(*arguments)

    monkeypatch.setattr(rosbag1_chunks, "_record", counted)
    assert read_rows(path) == [(0, stamp, bytes([stamp]) * stamp) for stamp in range(1, 10)]
    # The usual order is expected from the start, another one after its first message.
    assert general == (0 if order == ("conn", "op", "time") else 1)


def test_orders_of_fields_may_change_and_fields_may_be_added(tmp_path: Path) -> None:
    orders = list(itertools.permutations(("op", "conn", "time")))
    payload = connection_record() + message(1)
    payload += record(b"more", op=b"\x02", conn=uint32(0), time=time(2), added=b"field=")
    payload += b"".join(message(3, bytes([index]), order=order) for index, order in enumerate(orders * 2))
    payload += connection_record() + message(4, b"")
    path = simple_bag(tmp_path / "a.bag", payload)
    expected = [(0, 1, b"data"), (0, 2, b"more")]
    expected += [(0, 3, bytes([index])) for index in range(12)]
    assert read_rows(path) == [*expected, (0, 4, b"")]


@pytest.mark.parametrize("size", [0, 1, 3, 37, 38, 39, 45, 46, 47])
def test_a_message_may_hold_what_looks_like_a_record(tmp_path: Path, size: int) -> None:
    data = message(1, b"inside")[:size]
    path = simple_bag(tmp_path / "a.bag", message(1, data) + message(2, data, order=("conn", "op", "time")))
    assert read_rows(path) == [(0, 1, data), (0, 2, data)]


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("wrong", [-1, 1, 1000])
def test_a_chunk_of_another_size_than_declared_is_refused(tmp_path: Path, compression: str, wrong: int) -> None:
    payload = message(1)
    path = simple_bag(tmp_path / "a.bag", payload, compression=compression, size=len(payload) + wrong)
    observed = f"more than {len(payload) - 1}" if wrong < 0 else str(len(payload))
    assert f"holds {observed} bytes when decompressed, {len(payload) + wrong} are declared" in fails(path)


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_a_decompression_bomb_is_not_let_off(tmp_path: Path, compression: str) -> None:
    bomb = bytes(50_000_000)
    path = simple_bag(tmp_path / "a.bag", bomb, compression=compression, size=1000)
    tracemalloc.start()
    try:
        assert "holds more than 1000 bytes" in fails(path)
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
@pytest.mark.parametrize("size", [100, 2**32 - 1])
def test_compressed_data_that_is_none_is_refused(tmp_path: Path, compression: str, size: int) -> None:
    path = simple_bag(tmp_path / "a.bag", b"", compression=compression, size=size, stored=b"not compressed at all")
    expected = f"its {compression} data cannot be decompressed" if size == 100 else f"it declares {size} bytes"
    assert expected in fails(path)


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_compressed_data_without_its_end_is_refused(tmp_path: Path, compression: str) -> None:
    payload = message(1) * 100
    pack: Callable[[bytes], bytes] = bz2.compress if compression == "bz2" else lz4.frame.compress
    for stored in (pack(payload)[:-1], b""):
        path = simple_bag(tmp_path / "a.bag", payload, compression=compression, stored=stored)
        assert "data ends early" in fails(path)


@pytest.mark.parametrize(
    ("payload", "expected"),
    [
        (message(1, identity=7), "a message of connection 7, which is not in the index"),
        (message(1, order=("conn", "op", "time"))[:-1], "a message reaches to byte 50 of a chunk of 49"),
        (message(1)[:-1], "a record reaches to byte 50 of a chunk of 49"),
        (message(1)[:20], "a record reaches to byte 42 of a chunk of 20"),
        (message(1)[:2], "a record's length does not fit into the 2 bytes"),
        (message(1) + b"\0", "a record's length does not fit"),
        (record(op=b"\x04"), "a record of kind 4"),
        (record(conn=uint32(0)), "no field 'op'"),
        (record(op=b"\x02", time=time(1)), "no field 'conn'"),
        (record(op=b"\x02", conn=b"", time=time(1)), "'conn' has 0 bytes, 4 are needed"),
        (record(op=b"\x02", conn=uint32(0)), "no field 'time'"),
    ],
)
def test_a_damaged_chunk_is_refused(tmp_path: Path, payload: bytes, expected: str) -> None:
    message_text = fails(simple_bag(tmp_path / "a.bag", payload), hint="strict")
    assert expected in message_text
    assert f"the chunk with data at byte {FIRST_CHUNK + len(chunk(b''))} cannot be read" in message_text


def test_a_damaged_chunk_without_anything_wanted_does_no_harm(tmp_path: Path) -> None:
    path = simple_bag(tmp_path / "a.bag", b"rubbish", connections=[connection_record(), connection_record(1)])
    with closing(Rosbag1Reader(path)) as reader:
        assert list(reader.messages([reader.connections[1]])) == []
