"""Valid forms of MCAP files that few writers make, and what is read of each without reading the rest."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest
from mcap.records import ChunkIndex, DataEnd, Footer
from mcap.writer import Writer as LibraryWriter

from pc2scan.bags.mcap.read import McapReader
from pc2scan.bags.mcap.records import MAGIC
from support.mcap_files import encoded, raw_channel, raw_chunk, raw_message, read, record

if TYPE_CHECKING:
    from pathlib import Path


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
