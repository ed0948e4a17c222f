"""Valid forms of MCAP files that few writers make, and what is read of each without reading the rest."""

from __future__ import annotations

import os
import struct
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from mcap.records import ChunkIndex, DataEnd, Footer
from mcap.writer import CompressionType
from mcap.writer import Writer as LibraryWriter

from pc2scan.bags.mcap import index as mcap_index
from pc2scan.bags.mcap.read import McapReader
from pc2scan.bags.mcap.records import MAGIC
from support.mcap_files import (
    LIBRARY_OPTIONS,
    SAMPLE,
    altered_index,
    connection,
    content,
    encoded,
    library_file,
    raw_channel,
    raw_chunk,
    raw_message,
    read,
    record,
    write,
)

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.chunks import Segment

EXPECTED = sorted(((i + 1, n, t, t + 5, data) for n, (i, t, data) in enumerate(SAMPLE)), key=lambda row: row[2])


def test_messages_beside_indexed_chunks_are_found(tmp_path: Path) -> None:
    """The specification advises against it, and readers that trust the index lose these messages."""
    data = MAGIC + record(1, bytes(8)) + raw_channel() + raw_message(1, 20, b"stray")
    indexes = b""
    for time_ns in (10, 30):
        records = raw_message(1, time_ns, b"chunked")
        chunk = raw_chunk(records, message_start_time=time_ns, message_end_time=time_ns)
        index = ChunkIndex(
            chunk_length=len(chunk), chunk_start_offset=len(data), compression="", compressed_size=len(records),
            message_end_time=time_ns, message_index_length=0, message_index_offsets={}, message_start_time=time_ns,
            uncompressed_size=len(records),
        )  # fmt: skip
        indexes += encoded(index)
        data += chunk
    data += encoded(DataEnd(0))
    path = tmp_path / "a.mcap"
    path.write_bytes(data + indexes + encoded(Footer(len(data), 0, 0)) + MAGIC)
    assert [row[2:3] + row[4:] for row in read(path)] == [(10, b"chunked"), (20, b"stray"), (30, b"chunked")]


def test_statistics_may_lack_the_counts_of_channels(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE)

    def change(statistics: Any) -> None:
        statistics.channel_message_counts.clear()

    with closing(McapReader(altered_index(path, "Statistics", change))) as reader:
        assert reader.summary.message_count == 60
        assert [c.message_count for c in reader.connections] == [None, None]


def declared(path: Path, profile: str, encoding: str, schema: str, metadata: dict[str, str]) -> McapReader:
    """Open a file with one channel, as the mcap library writes it."""
    with path.open("wb") as file:
        writer = LibraryWriter(file)
        writer.start(profile, "test")
        writer.register_channel("/a", encoding, writer.register_schema("a/B", schema, b""), metadata)
        writer.finish()  # type: ignore[no-untyped-call]
    return McapReader(path)


@pytest.mark.parametrize(
    ("profile", "schema", "expected"),
    [
        ("", "ros1msg", "ros1"),
        ("", "ros2msg", "cdr"),
        ("", "ros2idl", "cdr"),
        ("ros1", "", "ros1"),
        ("ros2", "", "cdr"),
        ("ros1", "ros2msg", "cdr"),
        ("", "protobuf", ""),
    ],
)
def test_an_empty_message_encoding_is_deduced(profile: str, schema: str, expected: str, tmp_path: Path) -> None:
    with closing(declared(tmp_path / "a.mcap", profile, "", schema, {})) as reader:
        assert reader.connections[0].serialization == expected


@pytest.mark.parametrize(
    ("value", "latching"),
    [("1", True), ("true", True), ("True", True), ("0", False), ("false", False), (None, False)],
)
def test_ros1_latching_is_recognised(value: str | None, *, latching: bool, tmp_path: Path) -> None:
    metadata = {} if value is None else {"latching": value}
    with closing(declared(tmp_path / "a.mcap", "ros1", "ros1", "ros1msg", metadata)) as reader:
        assert reader.connections[0].latching is latching


# --- What is not read ---


@pytest.mark.parametrize(
    ("case", "loaded"),
    [
        ("default", 0),
        ("no statistics", 0),
        ("only chunk indexes", 0),
        ("unchunked", 0),
        ("no summary but message indexes", 1),
    ],
)
def test_no_more_is_decompressed_to_open_than_needed(
    case: str, loaded: int, tmp_path: Path, loads: list[Segment]
) -> None:
    path = library_file(tmp_path / "a.mcap", SAMPLE, chunk_size=300, **LIBRARY_OPTIONS[case])
    McapReader(path).close()
    assert len(loads) == loaded


def test_contents_of_chunks_are_skipped_without_a_summary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = LIBRARY_OPTIONS["no summary but message indexes"] | {"compression": CompressionType.NONE}
    messages = [(0, time_ns, bytes(900_000)) for time_ns in range(10)]
    path = library_file(tmp_path / "a.mcap", messages, chunk_size=500_000, **options)
    sizes: list[int] = []
    real = os.pread

    def counted(fd: int, size: int, offset: int) -> bytes:
        sizes.append(size)
        return real(fd, size, offset)

    monkeypatch.setattr(os, "pread", counted)
    McapReader(path).close()
    # One chunk has the channels.
    assert sum(sizes) < 2_000_000


def test_only_chunks_with_wanted_messages_are_read(tmp_path: Path, loads: list[Segment]) -> None:
    messages = [(0, t, b"c" * 3000) if t % 10 == 0 else (1, t, b"s") for t in range(100)]
    path = write(tmp_path / "a.mcap", messages, chunk_size=1000)
    with closing(McapReader(path)) as reader:
        # The large messages have chunks of their own.
        for selection, found, loaded in (
            ({"connections": [reader.connections[0]]}, 10, 10),
            ({"start_ns": 15, "stop_ns": 22}, 7, 3),
            ({}, 100, 20),
            ({"connections": [connection(id=7)]}, 0, 0),
        ):
            loads.clear()
            assert len(content(reader, **selection)) == found
            assert len(loads) == loaded


def test_runs_outside_chunks_are_split(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, loads: list[Segment]) -> None:
    monkeypatch.setattr(mcap_index, "RUN_SIZE", 500)
    path = library_file(tmp_path / "a.mcap", SAMPLE, use_chunking=False)
    with closing(McapReader(path)) as reader:
        assert content(reader) == EXPECTED
        assert all(segment.length <= 500 for segment in loads)
        assert len(loads) > 10
        assert reader.summary.compression == ("none",)
        loads.clear()
        assert [m[2] for m in content(reader, start_ns=1000, stop_ns=1005)] == [m[2] for m in EXPECTED if m[2] < 1005]
        assert len(loads) < 5


def test_a_summary_may_place_its_parts_in_any_order(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE, chunk_size=500)
    data = path.read_bytes()
    start = struct.unpack_from("<Q", data, len(data) - 28)[0]
    records, position = [], start
    while position < len(data) - 37:
        following = position + 9 + struct.unpack_from("<Q", data, position + 1)[0]
        records.append(data[position:following])
        position = following
    path.write_bytes(data[:start] + b"".join(records[::-1]) + encoded(Footer(start, 0, 0)) + MAGIC)
    assert read(path) == EXPECTED
