"""Bags that contradict the format are refused, with the place and what to do."""

from __future__ import annotations

import tracemalloc
from typing import TYPE_CHECKING

import pytest

from support.rosbag1_files import (
    COMPRESSIONS,
    FIRST_CHUNK,
    bag_header,
    chunk,
    chunk_info,
    connection_record,
    fails,
    given_bytes,
    message,
    record,
    simple_bag,
    uint32,
)

if TYPE_CHECKING:
    from pathlib import Path


HEADS = [
    (bag_header(9999, 1, 1, encryptor=b"rosbag/AesCbcEncryptor"), "encrypted (rosbag/AesCbcEncryptor)",
     "rosbag decrypt"),
    (bag_header(0, 0, 0) + chunk(b""), "index_pos is 0", "`strict`"),
    (bag_header(FIRST_CHUNK, 1, 1) + chunk(message(1)), "is a chunk, a connection should be there", "`strict`"),
    (bag_header(FIRST_CHUNK, 0, 0).replace(b"op=\x03", b"op=\x09"), "is a 9, a bag header should be there", ""),
    (bag_header(10**12, 1, 1), "should be at byte 1000000000000, the file has", "`strict`"),
    # A header may have very many fields, which cost memory.
    (b"#ROSBAG V2.0\n" + record(b"", **{f"f{number}": b"" for number in range(4097)}), "more than 4096 fields", ""),
]  # fmt: skip


@pytest.mark.parametrize(("data", "told", "hint"), HEADS)
def test_what_does_not_begin_as_a_bag_is_refused(data: bytes, told: str, hint: str, tmp_path: Path) -> None:
    assert told in fails(given_bytes(tmp_path, data), hint=hint)


@pytest.mark.parametrize(
    ("info", "told"),
    [
        (chunk_info(FIRST_CHUNK, 1, 1, {0: 1}, count=3), "of 8 bytes declares 3 counts"),
        (chunk_info(2**50, 1, 1, {0: 1}), "does not fit"),
        (uint32(6) + uint32(2) + b"op" + uint32(0), "has no '='"),
        (chunk_info(FIRST_CHUNK, 1, 1, {0: 1}) + chunk(message(1)), "after the records that the bag header counts"),
    ],
)
def test_a_damaged_index_is_refused(info: bytes, told: str, tmp_path: Path) -> None:
    body = chunk(message(1))
    raw = bag_header(FIRST_CHUNK + len(body), 1, 1) + body + connection_record() + info
    assert told in fails(given_bytes(tmp_path, raw), hint="`strict`")


# --- Chunks ---


@pytest.mark.parametrize(
    ("payload", "told"),
    [
        (message(1, identity=7), "a message of connection 7, which is not in the index"),
        (message(1, order=("conn", "op", "time"))[:-1], "a message reaches to byte 50 of a chunk of 49"),
        (message(1) + b"\0", "a record's length does not fit"),
        (record(op=b"\x04"), "a record with op 4"),
        (message(10), "a message of log time 0.000000010, and declares 0.000000001 to 0.000000009"),
    ],
)
def test_a_damaged_chunk_is_refused(payload: bytes, told: str, tmp_path: Path) -> None:
    message_text = fails(simple_bag(tmp_path / "a.bag", payload), hint="strict")
    assert told in message_text
    assert f"the chunk with data at byte {FIRST_CHUNK + len(chunk(b''))} cannot be read" in message_text


PAYLOAD = message(1)
LONG = PAYLOAD * 100


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("wrong", [-1, 1, 1000])
def test_a_chunk_of_another_size_is_refused(compression: str, wrong: int, tmp_path: Path) -> None:
    path = simple_bag(tmp_path / "a.bag", PAYLOAD, compression=compression, size=len(PAYLOAD) + wrong)
    observed = "there is more" if wrong < 0 else f"it ends after {len(PAYLOAD)} bytes"
    said = f"its {compression} data cannot be decompressed to the declared {len(PAYLOAD) + wrong} bytes: {observed}"
    assert (said if compression != "none" else f"declares {len(PAYLOAD) + wrong}") in fails(path)


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_a_decompression_bomb_is_not_let_off(compression: str, tmp_path: Path) -> None:
    path = simple_bag(tmp_path / "a.bag", bytes(50_000_000), compression=compression, size=1000)
    tracemalloc.start()
    try:
        assert "declared 1000 bytes: there is more" in fails(path)
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()
