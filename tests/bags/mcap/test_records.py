"""Records: damaged, unknown, extended."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.mcap.records import MAGIC
from support.mcap_files import BODY, failing, raw_channel, raw_chunk, raw_file, raw_message, read, record

if TYPE_CHECKING:
    from pathlib import Path


def test_files_that_are_not_mcap(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"")
    failing(path, "begins with nothing")
    path.write_bytes(b"#ROSBAG V2.0\n")
    failing(path, "begins with 23 52 4f 53")
    path.write_bytes(MAGIC + record(3, b"ab"))
    failing(path, "HEADER")
    failing(tmp_path / "none.mcap", "No such file")
    failing(tmp_path, "directory")


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (raw_chunk(BODY + raw_message(channel=7)), "channel 7 has messages"),
        (raw_chunk(BODY + b"\x05"), "do not end|sound for"),
        (raw_chunk(BODY[:-1]), "do not end|sound for"),
        (raw_chunk(raw_channel(schema=3)), "channel 1 has schema 3"),
        (raw_channel() + record(5, bytes(21)), "the message at byte"),
        (raw_channel() + record(5, bytes(22)), "channel 0 has messages"),
        (raw_channel()[:-1] + raw_message(), "record at byte"),
        (record(4, b"\x01\x00"), "the Channel record"),
        (record(4, struct.pack("<HHI", 1, 0, 1 << 30)), "the Channel record"),
        (record(4, struct.pack("<HHI", 1, 0, 2) + b"\xff\xff"), "the Channel record"),
        (record(7, b""), "message index"),
    ],
)
def test_damaged_records(tmp_path: Path, data: bytes, match: str) -> None:
    failing(raw_file(tmp_path / "a.mcap", data), match)


def test_a_length_beyond_the_file(tmp_path: Path) -> None:
    failing(raw_file(tmp_path / "a.mcap", struct.pack("<BQ", 5, 1 << 62)), "the record at byte")


def test_unknown_records_are_stepped_over(tmp_path: Path) -> None:
    odd = record(0x80, b"application") + record(0x7F, b"")
    path = raw_file(
        tmp_path / "a.mcap",
        odd,
        raw_channel(),
        raw_message(log_time=1),
        odd,
        raw_chunk(odd + raw_message() + odd),
    )
    assert len(read(path)) == 2


def test_records_with_more_fields_than_today(tmp_path: Path) -> None:
    """ "Records may be extended by adding new fields at the end of existing fields."""
    extended = bytearray(raw_channel())
    extended += b"new"
    struct.pack_into("<Q", extended, 1, len(extended) - 9)
    path = raw_file(tmp_path / "a.mcap", bytes(extended), raw_message())
    assert len(read(path)) == 1
