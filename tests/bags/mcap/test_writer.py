"""What is written into MCAP files, as the mcap library and @mcap/core see it."""

from __future__ import annotations

import io
import itertools
import struct
from contextlib import closing
from typing import TYPE_CHECKING

import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, Message, MessageIndex
from mcap.stream_reader import StreamReader

from pc2scan.bags.mcap.read import McapReader
from pc2scan.bags.mcap.write import McapWriter
from pc2scan.model import Definition
from support.mcap_files import COMPRESSIONS, SAMPLE, connection, encoded, streamed, write

if TYPE_CHECKING:
    from pathlib import Path

    from mcap.summary import Summary

    from pc2scan.model import Connection


def summary_of(path: Path) -> Summary:
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    return summary


def declared(path: Path, *connections: Connection, profile: str = "ros2", keep: bool = False) -> list[Connection]:
    """Write connections, and read them again."""
    writer = McapWriter(path, profile=profile)
    if keep:
        writer.keep_ids(connections)
    for each in connections:
        writer.add_connection(each)
    writer.finish()
    with closing(McapReader(path, strict=True)) as reader:
        assert reader.summary.profile == profile
        return list(reader.connections)


@pytest.mark.parametrize(
    ("msgtype", "serialization", "definition", "written"),
    [
        ("foxglove.PointCloud", "protobuf", Definition("protobuf", b"\x00\xff"), "foxglove.PointCloud"),
        ("a/B", "json", Definition("jsonschema", b"{}"), "a/B"),
        ("a/B", "cdr", Definition("ros2msg", b""), "a/msg/B"),
        ("a/msg/B", "ros1", Definition("ros1msg", b""), "a/B"),
        ("", "json", Definition(), ""),
        # A type that is known by name only.
        ("a/msg/B", "cdr", Definition(), "a/msg/B"),
    ],
)
def test_types_are_spelled_as_their_serialization_does(
    msgtype: str, serialization: str, definition: Definition, written: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    given = connection(msgtype=msgtype, serialization=serialization, definition=definition)
    (only,) = declared(path, given, profile="")
    assert (only.msgtype, only.serialization, only.definition) == (written, serialization, definition)
    assert summary_of(path).channels[1].schema_id == (1 if written else 0)


def test_kept_ids_and_new_ones_do_not_collide(tmp_path: Path) -> None:
    """Ids are kept for chunks that are copied; what other files add has none, and 0 is none."""
    path = tmp_path / "a.mcap"
    connections = [
        connection("/one", id=1, schema_id=7),
        connection("/two", id=2, schema_id=8),
        connection("/three", id=3, schema_id=0, msgtype="std_msgs/msg/String"),
        connection("/four", id=4, schema_id=0, msgtype="", definition=Definition()),
    ]
    assert [c.ros_type for c in declared(path, *connections, keep=True)] == [c.ros_type for c in connections]
    summary = summary_of(path)
    assert summary.statistics is not None
    assert summary.statistics.schema_count == len(summary.schemas) == 3
    assert {c.topic: c.schema_id for c in summary.channels.values()} == {"/one": 7, "/two": 8, "/three": 1, "/four": 0}


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_indexes_and_statistics_agree_with_the_chunks(compression: str, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE, compression=compression, chunk_size=1000)
    summary, data = summary_of(path), path.read_bytes()
    statistics = summary.statistics
    assert statistics is not None
    times = [t for _, t, _ in SAMPLE]
    assert statistics.channel_message_counts == {1: 30, 2: 30}
    assert (statistics.message_start_time, statistics.message_end_time) == (min(times), max(times))
    assert statistics.chunk_count == len(summary.chunk_indexes) > 3
    assert (statistics.channel_count, statistics.schema_count, statistics.message_count) == (2, 1, 60)
    for index in summary.chunk_indexes:
        stream = StreamReader(io.BytesIO(data[index.chunk_start_offset :]), skip_magic=True, emit_chunks=True)
        chunk = next(iter(stream.records))
        assert isinstance(chunk, Chunk)
        assert chunk.message_start_time == index.message_start_time
        assert chunk.message_end_time == index.message_end_time
        assert (index.compressed_size, index.uncompressed_size) == (len(chunk.data), chunk.uncompressed_size)
        size = 0
        for channel_id, offset in index.message_index_offsets.items():
            (entry,) = itertools.islice(StreamReader(io.BytesIO(data[offset:]), skip_magic=True).records, 1)
            assert isinstance(entry, MessageIndex)
            assert entry.channel_id == channel_id
            size += len(encoded(entry))
            for log_time, at in entry.records if compression == "none" else ():
                opcode, _, channel, _, time = struct.unpack_from("<BQHIQ", chunk.data, at)
                assert (opcode, channel, time) == (5, channel_id, log_time)
        assert size == index.message_index_length
    # From end to end the messages are in the order of the calls.
    found = [(m.channel_id, m.sequence, m.data) for m in streamed(path) if isinstance(m, Message)]
    assert found == [(i + 1, n, each) for n, (i, _, each) in enumerate(SAMPLE)]


def test_a_large_message_has_a_chunk_of_its_own(tmp_path: Path) -> None:
    messages = [(0, 1, b"s"), (1, 2, b"L" * 5000), (0, 3, b"s"), (0, 4, b"s"), (1, 5, b"L" * 5000)]
    path = write(tmp_path / "a.mcap", messages, chunk_size=1000)
    chunks = [sorted(c.message_index_offsets) for c in summary_of(path).chunk_indexes]
    assert chunks == [[1], [2], [1], [2]]
