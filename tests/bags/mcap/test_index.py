"""What is where in a file, with and without a summary, and when the summary lies."""

from __future__ import annotations

import io
import itertools
import struct
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, DataEnd, Footer
from mcap.stream_reader import StreamReader

from pc2scan.bags.damage import DamageLog
from pc2scan.bags.mcap import index as mcap_index
from pc2scan.bags.mcap.chunks import payload
from pc2scan.bags.mcap.index import McapIndex, RecordWalk, find_declarations, read_header
from pc2scan.bags.mcap.reader import McapReader
from pc2scan.bags.mcap.records import MAGIC, RecordFile, split
from pc2scan.errors import RecordingError

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.chunked.segments import Segment
from support.mcap_files import (
    LIBRARY_OPTIONS,
    SAMPLE,
    altered_index,
    content,
    encoded,
    failing,
    library_file,
    raw_message,
    read_all,
    record,
    write,
)


@pytest.mark.parametrize("case", ["default", "no statistics", "only chunk indexes", "unchunked"])
def test_nothing_is_decompressed_to_open(tmp_path: Path, loads: list[Segment], case: str) -> None:
    path = library_file(tmp_path / "a.mcap", SAMPLE, chunk_size=300, **LIBRARY_OPTIONS[case])
    McapReader(path).close()
    assert not loads


def test_no_more_is_decompressed_to_open_than_channels_need(tmp_path: Path, loads: list[Segment]) -> None:
    options = LIBRARY_OPTIONS["no summary but message indexes"]
    path = library_file(tmp_path / "a.mcap", SAMPLE, chunk_size=300, **options)
    McapReader(path).close()
    assert len(loads) == 1


def test_unindexed_messages_beside_indexed_chunks_are_found(tmp_path: Path) -> None:
    """The specification advises against it, and readers that trust the index lose these messages."""
    path = write(tmp_path / "a.mcap", [(0, 10, b"chunked"), (1, 30, b"chunked")], chunk_size=1)
    data = path.read_bytes()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    at = summary.chunk_indexes[0].chunk_start_offset
    # Put in front of the first chunk, it moves every chunk: rewrite the file behind it with the library.
    stray = raw_message(2, 20, b"stray")
    sections = streamed_chunks(data[at:])
    rebuilt = tmp_path / "b.mcap"
    rebuild_with_index(rebuilt, data[:at] + stray, sections)
    with closing(McapReader(rebuilt)) as reader:
        assert [(m.log_time_ns, bytes(m.data)) for m in reader.messages()] == [
            (10, b"chunked"),
            (20, b"stray"),
            (30, b"chunked"),
        ]


def streamed_chunks(data: bytes) -> list[Chunk]:
    """Chunks of a data section that begins without magic."""
    stream = StreamReader(io.BytesIO(data), skip_magic=True, emit_chunks=True)
    return [
        item
        for item in itertools.takewhile(lambda r: not isinstance(r, DataEnd), stream.records)
        if isinstance(item, Chunk)
    ]


def rebuild_with_index(path: Path, head: bytes, chunks: list[Chunk]) -> None:
    from mcap.records import ChunkIndex

    indexes = []
    data = head
    for chunk in chunks:
        body = encoded(chunk)
        indexes.append(
            ChunkIndex(
                chunk_length=len(body),
                chunk_start_offset=len(data),
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=0,
                message_index_offsets={},
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        data += body
    data += encoded(DataEnd(0))
    start = len(data)
    data += b"".join(map(encoded, indexes)) + encoded(Footer(start, 0, 0)) + MAGIC
    path.write_bytes(data)


def test_runs_outside_chunks_are_split(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, loads: list[Segment]) -> None:
    monkeypatch.setattr(mcap_index, "RUN_SIZE", 500)
    path = library_file(tmp_path / "a.mcap", SAMPLE, use_chunking=False)
    expected = sorted(
        ((i + 1, n, t, t + 5, data) for n, (i, t, data) in enumerate(SAMPLE)), key=lambda message: message[2]
    )
    with closing(McapReader(path)) as reader:
        assert content(reader) == expected
        assert all(segment.length <= 500 for segment in loads)
        assert len(loads) > 10
        assert reader.summary.compression == ("none",)
        loads.clear()
        assert [m[2] for m in content(reader, start_ns=1000, stop_ns=1005)] == [m[2] for m in expected if m[2] < 1005]
        assert len(loads) < 5


@pytest.mark.parametrize("case", ["default", "unchunked", "no summary"])
def test_every_truncation_is_an_error(tmp_path: Path, case: str) -> None:
    data = library_file(tmp_path / "a.mcap", SAMPLE[:8], extras=True, **LIBRARY_OPTIONS[case]).read_bytes()
    path = tmp_path / "b.mcap"
    for size in range(len(data)):
        path.write_bytes(data[:size])
        failing(path, r"cut off|begins with|the file has|declared")


@pytest.mark.parametrize("case", ["default", "unchunked", "no summary", "lz4", "uncompressed"])
def test_no_flipped_byte_escapes_as_another_error(tmp_path: Path, case: str) -> None:
    data = library_file(tmp_path / "a.mcap", SAMPLE[:3], extras=True, **LIBRARY_OPTIONS[case]).read_bytes()
    path = tmp_path / "b.mcap"
    failures = 0
    for position, value in itertools.product(range(len(data)), (0x00, 0x7F, 0xFF)):
        damaged = bytearray(data)
        damaged[position] = value
        path.write_bytes(damaged)
        try:
            read_all(path, strict=True)
        except RecordingError:
            failures += 1
    assert failures > len(data)


def test_the_summary_has_a_crc(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE)
    data = bytearray(path.read_bytes())
    at = data.rindex(b"/topic1")
    data[at + 6] = ord("9")
    path.write_bytes(data)
    failing(path, "the summary's CRC is")
    with closing(McapReader(path, verify=False)) as reader:
        assert reader.connections[1].topic == "/topic9"


@pytest.mark.parametrize("kind", ["AttachmentIndex", "MetadataIndex"])
def test_wrong_offsets_of_attachments_do_no_harm(tmp_path: Path, kind: str) -> None:
    """Files without chunks that @mcap/core 2.2.2 wrote have them."""
    path = library_file(tmp_path / "a.mcap", SAMPLE, extras=True, use_chunking=False)

    def change(index: Any) -> None:
        index.offset = 28

    with closing(McapReader(altered_index(path, kind, change))) as reader:
        assert len(content(reader)) == 60
        assert [each.name for each in reader.attachments()] == ["calibration.yaml"]
        assert [each.name for each in reader.metadata()] == ["robot"]


@pytest.mark.parametrize(
    ("attribute", "delta", "match"),
    [
        ("chunk_start_offset", 1, "no chunk begins|record at byte|data ends|places"),
        ("chunk_start_offset", 1 << 40, "the data ends at byte"),
        ("chunk_length", 1 << 40, "the data ends at byte"),
        ("compressed_size", 1, "the data ends|contradict"),
        ("compressed_size", -1, "contradict"),
        ("uncompressed_size", 1, "contradict"),
        ("message_index_length", 1 << 40, "the record at byte"),
    ],
)
def test_an_index_that_lies(tmp_path: Path, attribute: str, delta: int, match: str) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE, chunk_size=500)

    def change(index: Any) -> None:
        setattr(index, attribute, getattr(index, attribute) + delta)

    failing(altered_index(path, "ChunkIndex", change), match)


def test_a_chunk_that_is_indexed_twice(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE, chunk_size=500)
    failing(altered_index(path, "ChunkIndex", lambda _: None, times=2), "names a chunk twice")


def test_a_malformed_chunk_index(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE)
    data = path.read_bytes()
    start = struct.unpack_from("<Q", data, len(data) - 28)[0]
    summary = record(8, bytes(40))
    footer = struct.pack("<BQQQI", 2, 20, start, 0, 0)
    path.write_bytes(data[:start] + summary + footer + MAGIC)
    failing(path, "a ChunkIndex record in the summary at byte")


def test_statistics_without_counts_by_channel(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE)

    def change(statistics: Any) -> None:
        statistics.channel_message_counts.clear()

    with closing(McapReader(altered_index(path, "Statistics", change))) as reader:
        assert reader.summary.message_count == 60
        assert [c.message_count for c in reader.connections] == [None, None]


def test_what_precedes_damage_is_kept_for_recovery(tmp_path: Path) -> None:
    data = library_file(tmp_path / "a.mcap", SAMPLE, chunk_size=300, **LIBRARY_OPTIONS["no summary"]).read_bytes()
    path = tmp_path / "b.mcap"
    path.write_bytes(data[: len(data) // 2])
    file = RecordFile(path)
    index = McapIndex()
    with pytest.raises(RecordingError, match="the record at byte"):
        RecordWalk(file, index).run(read_header(file, index), file.size)
    find_declarations(
        file, index, lambda chunk: split(payload(file, chunk), chunk.offset, file), DamageLog(strict=True)
    )
    assert len(index.segments) > 3
    assert [channel.topic for channel in index.channels.values()] == ["/topic0", "/topic1"]
    assert all(len(payload(file, segment)) for segment in index.segments)
    file.close()


@pytest.mark.parametrize("kind", ["AttachmentIndex", "MetadataIndex"])
def test_a_summary_that_contradicts_attachments_and_metadata(kind: str, tmp_path: Path) -> None:
    path = library_file(tmp_path / "a.mcap", SAMPLE, extras=True, enable_crcs=False)
    data = path.read_bytes()
    name = {"AttachmentIndex": b"calibration.yaml", "MetadataIndex": b"robot"}[kind]
    at = data.rindex(name)
    path.write_bytes(data[:at] + b"X" + data[at + 1 :])
    with closing(McapReader(path)) as reader:
        assert [a.name for a in reader.attachments()] == ["calibration.yaml"]
        assert [m.name for m in reader.metadata()] == ["robot"]
        (damage,) = reader.damage
        assert "the summary contradicts the" in damage.what
        assert damage.messages_lost == 0
