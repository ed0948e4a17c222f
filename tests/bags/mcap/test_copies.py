"""Chunks that are copied as a whole, and what makes that impossible."""

from __future__ import annotations

import zlib
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
import zstandard
from mcap.records import MessageIndex

from pc2scan.bags import chunks
from pc2scan.bags.loading import merge_by_time
from pc2scan.bags.mcap.chunks import whole_chunk
from pc2scan.bags.mcap.read import McapReader
from pc2scan.bags.mcap.records import RecordFile
from pc2scan.model import ChunkRule, StoredChunk
from support.mcap_files import encoded, raw_channel, raw_chunk, raw_file, raw_message, record, write

if TYPE_CHECKING:
    from pathlib import Path

ROWS = [(i % 2, 1000 + 10 * i, bytes([i]) * 40) for i in range(8)]
RULE = ChunkRule("mcap", frozenset({"zstd"}), frozenset({1, 2}))


class Chunk:
    """The one chunk of a file, and a copy of the file that can be changed."""

    def __init__(self, path: Path, rows: list[tuple[int, int, bytes]]) -> None:
        write(path, rows, compression="zstd")
        with closing(McapReader(path)) as reader:
            index: Any = reader._index
            (self.segment,) = index.segments
        self.path = path
        self.data = bytearray(path.read_bytes())

    @property
    def indexes(self) -> int:
        """Where the message indexes begin."""
        return int(self.segment.offset + self.segment.length)

    def whole(self, rule: ChunkRule = RULE) -> StoredChunk | memoryview:
        self.path.write_bytes(self.data)
        with closing(RecordFile(self.path)) as file:
            return whole_chunk(file, self.segment, rule)


@pytest.fixture
def chunk(tmp_path: Path) -> Chunk:
    return Chunk(tmp_path / "chunk.mcap", ROWS)


def test_the_messages_of_a_chunk_are_indexed(chunk: Chunk) -> None:
    found = chunk.whole()
    assert isinstance(found, StoredChunk)
    assert {channel: [time_ns for time_ns, _ in entries] for channel, entries in found.index.items()} == {
        1: [1000, 1020, 1040, 1060],
        2: [1010, 1030, 1050, 1070],
    }
    assert found.span_ns() == (1000, 1070)
    assert bytes(found.stored) == bytes(chunk.data[chunk.segment.offset : chunk.indexes])


def test_messages_packed_by_themselves_are_not_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "MIN_WHOLE_BYTES", 1)
    packed = [(channel, time_ns, zstandard.compress(data)) for channel, time_ns, data in ROWS]
    assert isinstance(Chunk(tmp_path / "packed.mcap", packed).whole(), memoryview)
    with closing(McapReader(tmp_path / "packed.mcap")) as reader:
        found: list[Any] = list(merge_by_time(reader.chunks(rule=RULE)))
    assert [bytes(message.data) for message in found] == [row[2] for row in ROWS]


def test_for_another_compression_a_chunk_is_decompressed(chunk: Chunk) -> None:
    rule = ChunkRule("mcap", frozenset({"none"}), frozenset({1, 2}))
    found = chunk.whole(rule)
    assert isinstance(found, StoredChunk)
    assert (found.compression, len(found.stored)) == ("", found.size)
    assert zlib.crc32(found.stored) == found.crc


def test_unsorted_messages_are_found(tmp_path: Path) -> None:
    found = Chunk(tmp_path / "chunk.mcap", [ROWS[0], ROWS[2], ROWS[1]]).whole()
    assert isinstance(found, StoredChunk)
    places = sorted((place, time_ns) for entries in found.index.values() for time_ns, place in entries)
    assert [time_ns for _, time_ns in places] == [ROWS[number][1] for number in (0, 2, 1)]


def test_a_chunk_with_a_channel_not_in_the_rule_is_not_copied(chunk: Chunk) -> None:
    assert isinstance(chunk.whole(ChunkRule("mcap", frozenset({"zstd"}), frozenset({1}))), memoryview)


def test_padding_is_not_copied(tmp_path: Path) -> None:
    """Fields of later specifications, after a chunk's records and after the entries of its message index."""
    first, second = raw_message(1, 5), raw_message(1, 6)
    index = encoded(MessageIndex(channel_id=1, records=[(5, 0), (6, len(first))]))
    chunk = raw_chunk(first + second, message_start_time=5, message_end_time=6)
    chunk, index = (record(data[0], data[9:] + b"later") for data in (chunk, index))
    path = raw_file(tmp_path / "a.mcap", raw_channel(), chunk, index)
    rule = ChunkRule("mcap", frozenset({"none"}), frozenset({1}))
    with closing(McapReader(path, strict=True)) as reader, closing(RecordFile(path)) as file:
        opened: Any = reader._index
        (segment,) = opened.segments
        copy = whole_chunk(file, segment, rule)
    assert isinstance(copy, StoredChunk)
    assert bytes(copy.stored) == first + second
    assert copy.index == {1: [(5, 0), (6, len(first))]}
