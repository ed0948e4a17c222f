"""Our records are those of the ``mcap`` library, byte for byte."""

from __future__ import annotations

import struct

import pytest
from mcap import records as library
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode as LibrarysOpcode

from pc2scan.bags.mcap import records as ours
from pc2scan.bags.mcap.records import RECORD, encode_record

RECORDS = (
    ours.Header("ros2", "näme"),
    ours.Footer(1 << 40, 2, 3),
    ours.Schema(7, "sensor_msgs/msg/LaserScan", "ros2msg", b"float32 x\n"),
    ours.Schema(8, "", "", b""),
    ours.Channel(1, 7, "/scan", "cdr", {"offered_qos_profiles": "- depth: 1", "": "é"}),
    ours.Channel(0xFFFF, 0, "", "", {}),
    ours.ChunkIndex(1, 2, 3, 4, {1: 5, 0xFFFF: 1 << 63}, 6, "zstd", 7, 8),
    ours.AttachmentRecord(1, 2, "a.txt", "text/plain", b"content"),
    ours.AttachmentRecord(1, 2, "", "", b""),
    ours.AttachmentIndex(1, 2, 3, 4, 5, "a.txt", "text/plain"),
    ours.Statistics(1 << 33, 2, 3, 4, 5, 6, 7, 8, {1: 9, 2: 10}),
    ours.MetadataRecord("rosbag2", {"key": "value"}),
    ours.MetadataIndex(1, 2, "rosbag2"),
    ours.SummaryOffset(ours.Opcode.CHANNEL, 1, 2),
    ours.DataEnd(0xFFFFFFFF),
)


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: type(record).__name__)
def test_a_record_is_the_librarys(record: ours.Record) -> None:
    fields = {name: value for name, value in record._asdict().items() if name != "crc"}
    builder = RecordBuilder()
    getattr(library, type(record).__name__.removesuffix("Record"))(**fields).write(builder)
    packed = encode_record(record)
    assert packed == builder.end()  # type: ignore[no-untyped-call]
    read = ours.unpack(type(record), packed[RECORD.size :])
    if isinstance(read, ours.AttachmentRecord):
        read = read._replace(crc=0)
    assert read == record


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: type(record).__name__)
def test_a_record_that_is_cut_off_is_none(record: ours.Record) -> None:
    content = encode_record(record)[RECORD.size :]
    for length in range(len(content)):
        with pytest.raises(struct.error):
            ours.unpack(type(record), content[:length])


def test_numbers_that_no_field_holds() -> None:
    for record in (
        ours.AttachmentRecord(-1, 0, "", "", b""),
        ours.DataEnd(1 << 32),
        ours.Channel(1 << 16, 0, "", "", {}),
    ):
        with pytest.raises(struct.error):
            encode_record(record)


def test_text_is_utf_8() -> None:
    content = encode_record(ours.Header("ab", ""))[RECORD.size :].replace(b"ab", b"\xff\xfe")
    with pytest.raises(UnicodeDecodeError):
        ours.unpack(ours.Header, content)


def test_opcodes_are_the_librarys() -> None:
    assert {each.name: int(each) for each in ours.Opcode} == {each.name: int(each) for each in LibrarysOpcode}
