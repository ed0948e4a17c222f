"""MCAP files that contradict the specification are refused, with the place."""

from __future__ import annotations

import struct
from contextlib import closing
from typing import TYPE_CHECKING

import lz4.frame
import pytest
from mcap.records import Footer

from pc2scan.bags.mcap.read import McapReader
from pc2scan.bags.mcap.write import McapWriter
from pc2scan.errors import RecordingError
from pc2scan.model import Attachment
from support.mcap_files import (
    BODY,
    SAMPLE,
    encoded,
    failing,
    library_file,
    raw_channel,
    raw_chunk,
    raw_file,
    raw_message,
    record,
    write,
    zstd,
)

if TYPE_CHECKING:
    from pathlib import Path


def lz4_packed(data: bytes) -> bytes:
    return bytes(lz4.frame.compress(data))


DEEP = raw_channel() + raw_message(data=bytes(1 << 20))
UNSIZED = zstd(BODY, size=False)

#: What stands where a file has its records.
DAMAGED = [
    (raw_chunk(BODY, compression="bz2"), "compression 'bz2', known are none, lz4 and zstd"),
    (raw_chunk(BODY, uncompressed_size=len(BODY) + 1), "cannot be decompressed to|declares"),
    (raw_chunk(BODY, uncompressed_crc=1), "has CRC .*, recorded is 00000001"),
    (raw_chunk(BODY, compression="zstd", packed=b"nonsense"), "cannot be decompressed"),
    (raw_chunk(BODY, compression="lz4", packed=lz4_packed(BODY)[:-3]), "cannot be decompressed"),
    (raw_chunk(BODY, compression="lz4", packed=lz4_packed(DEEP)), "there is more"),
    (raw_chunk(BODY, compression="zstd", packed=UNSIZED, uncompressed_size=1 << 60), "at most [0-9]+ are possible"),
    (record(6, struct.pack("<QQQIIQ", 1, 1, 5, 0, 0, 6) + b"short"), "declares 6 bytes of records in 45 bytes"),
    (raw_chunk(BODY + raw_message(channel=7)), "channel 7 has messages"),
    (raw_chunk(BODY + record(15, b"")), "has a record with opcode 15 in it"),
    (raw_channel() + record(5, bytes(21)), "the message at byte .* has 30 bytes, at least 31 are needed"),
    (raw_channel()[:-1] + raw_message(), "record at byte"),
    (record(3, struct.pack("<HIII", 1, 0, 0, 4) + b"abc"), "the Schema record"),
    (record(7, bytes(6)), "the message index at byte .* follows no chunk"),
    (raw_chunk(BODY) + 2 * record(7, bytes(6)), "the message index at byte .* is of a chunk that is not there"),
    (record(0, b""), "has opcode 0, which no record may have"),
    (record(11, b""), "has opcode 11, which the data may not have"),
    (struct.pack("<BQ", 5, 1 << 62), "the record at byte"),
]


@pytest.mark.parametrize(("data", "told"), DAMAGED)
def test_damaged_records_are_refused(data: bytes, told: str, tmp_path: Path) -> None:
    failing(raw_file(tmp_path / "a.mcap", data), told)


def test_the_data_of_a_file_without_chunks_have_a_crc(tmp_path: Path) -> None:
    path = library_file(tmp_path / "a.mcap", SAMPLE, use_chunking=False, enable_data_crcs=True)
    data = bytearray(path.read_bytes())
    data[data.index(SAMPLE[40][2])] ^= 1
    path.write_bytes(data)
    failing(path, "the data section")


def test_a_damaged_attachment_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    writer.add_attachment(Attachment("a.bin", "", 0, 0, b"spotless"))
    writer.finish()
    path.write_bytes(path.read_bytes().replace(b"spotless", b"spottier"))
    with closing(McapReader(path, strict=True)) as reader, pytest.raises(RecordingError, match=r"'a\.bin' has CRC"):
        list(reader.attachments())
    with closing(McapReader(path)) as reader:
        assert [a.data for a in reader.attachments()] == [b"spottier"]
        assert ["has CRC" in damage.what for damage in reader.damage] == [True]


# --- Summaries ---


@pytest.mark.parametrize("start", [1, 1 << 60])
def test_a_summary_outside_of_the_file_is_refused(start: int, tmp_path: Path) -> None:
    path = raw_file(tmp_path / "a.mcap", BODY)
    path.write_bytes(path.read_bytes().replace(encoded(Footer(0, 0, 0)), encoded(Footer(start, 0, 0))))
    failing(path, f"the footer places the summary at byte {start}, allowed is up to")


def test_the_summary_has_a_crc(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE)
    data = bytearray(path.read_bytes())
    at = data.rindex(b"/topic1")
    data[at + 6] = ord("9")
    path.write_bytes(data)
    failing(path, "the summary's CRC is")
