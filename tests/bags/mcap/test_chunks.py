"""Chunks: damaged, empty, of every compression."""

from __future__ import annotations

import os
from contextlib import closing
from typing import TYPE_CHECKING, Any

import lz4.frame
import pytest

from pc2scan.bags.mcap.reader import McapReader
from support.mcap_files import (
    BODY,
    COMPRESSIONS,
    content,
    failing,
    raw_channel,
    raw_chunk,
    raw_file,
    raw_message,
    read,
    record,
    write,
    zstd,
)

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_flipped_bit_in_a_chunk(tmp_path: Path, compression: str) -> None:
    path = write(tmp_path / "a.mcap", [(0, 1, os.urandom(5000))], compression=compression)
    data = bytearray(path.read_bytes())
    data[3000] ^= 1
    path.write_bytes(data)
    failing(path, "has CRC|cannot be decompressed")
    if compression != "lz4":  # its frames have no checksum of their own, zstd's by default neither
        with closing(McapReader(path, verify=False)) as reader:
            assert len(content(reader)) == 1


DEEP = raw_channel() + raw_message(data=bytes(1 << 20))


@pytest.mark.parametrize(
    ("chunk", "match"),
    [
        (raw_chunk(BODY, compression="bz2"), "compression 'bz2', known are none, lz4 and zstd"),
        (raw_chunk(BODY, compression="z" * 1000), "malformed header: its compression has a name of 1000"),
        (raw_chunk(BODY, uncompressed_size=len(BODY) + 1), "decompresses to"),
        (raw_chunk(BODY, uncompressed_crc=1), "has CRC .*, recorded is 00000001"),
        (raw_chunk(BODY, compression="zstd", packed=b"nonsense"), "cannot be decompressed"),
        (raw_chunk(BODY, compression="lz4", packed=b"nonsense"), "cannot be decompressed"),
        (raw_chunk(BODY, compression="zstd", packed=zstd(BODY)[:-3]), "cannot be decompressed"),
        (raw_chunk(BODY, compression="lz4", packed=lz4.frame.compress(BODY)[:-3]), "cannot be decompressed"),
        (raw_chunk(BODY, compression="zstd", packed=zstd(BODY + b"x")), "the compressed data declare"),
        (raw_chunk(BODY, compression="lz4", packed=lz4.frame.compress(DEEP)), "there is more"),
        (raw_chunk(BODY, compression="zstd", packed=zstd(DEEP, size=False)), "cannot be decompressed"),
        (raw_chunk(DEEP, compression="zstd", packed=zstd(BODY, size=False)), "decompresses to"),
        (raw_chunk(DEEP, compression="lz4", packed=lz4.frame.compress(BODY)), "decompresses to"),
        (
            raw_chunk(BODY, compression="zstd", packed=zstd(BODY, size=False), uncompressed_size=1 << 60),
            "at most [0-9]+ may be",
        ),
        (
            raw_chunk(BODY, compression="lz4", packed=lz4.frame.compress(BODY), uncompressed_size=1 << 63),
            "at most [0-9]+ may be",
        ),
        (record(6, bytes(10)), "malformed header|declares"),
    ],
)
def test_damaged_chunks(tmp_path: Path, chunk: bytes, match: str) -> None:
    failing(raw_file(tmp_path / "a.mcap", chunk), match)


def test_a_zstd_frame_may_omit_its_size(tmp_path: Path) -> None:
    """Streaming compressors (Go's) do not know it beforehand."""
    path = raw_file(tmp_path / "a.mcap", raw_chunk(BODY, compression="zstd", packed=zstd(BODY, size=False)))
    assert [m[4] for m in read(path)] == [b"data"]


def test_chunks_without_messages(tmp_path: Path) -> None:
    empty: dict[str, Any] = {"message_start_time": 0, "message_end_time": 0}
    path = raw_file(
        tmp_path / "a.mcap",
        raw_chunk(raw_channel(), **empty),
        raw_chunk(b"", **empty),
        raw_chunk(b"", compression="zstd", **empty),
        raw_chunk(raw_message(log_time=9), message_start_time=9, message_end_time=9),
    )
    with closing(McapReader(path)) as reader:
        assert len(content(reader)) == 1
        assert (reader.summary.start_ns, reader.summary.end_ns) == (9, 9)
