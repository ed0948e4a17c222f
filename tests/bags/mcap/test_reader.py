"""Reading MCAP: every shape that the mcap library writes, and selection."""

from __future__ import annotations

import os
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.mcap.reader import McapReader
from pc2scan.bags.mcap.writer import McapWriter
from pc2scan.errors import RecordingError
from pc2scan.model import Attachment, Definition, Metadata
from support import RECORDINGS, needs_shared

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.chunked.segments import Segment
from support.mcap_files import (
    CLOUD,
    LIBRARY_OPTIONS,
    SAMPLE,
    connection,
    content,
    library,
    library_file,
    read,
    write,
)


@pytest.mark.parametrize("case", LIBRARY_OPTIONS)
def test_every_shape_that_the_library_writes(tmp_path: Path, case: str) -> None:
    path = tmp_path / "a.mcap"
    library_file(path, SAMPLE, extras=True, chunk_size=1000, **LIBRARY_OPTIONS[case])
    expected = sorted(
        ((i + 1, n, t, t + 5, data) for n, (i, t, data) in enumerate(SAMPLE)), key=lambda message: message[2]
    )
    with closing(McapReader(path)) as reader:
        assert content(reader) == expected
        assert [(c.id, c.topic, c.msgtype, c.serialization) for c in reader.connections] == [
            (1, "/topic0", CLOUD, "cdr"),
            (2, "/topic1", CLOUD, "cdr"),
        ]
        assert {c.definition for c in reader.connections} == {Definition("ros2msg", b"uint8[] data")}
        assert list(reader.attachments()) == [Attachment("calibration.yaml", "text/yaml", 8, 7, b"a: 1")]
        assert list(reader.metadata()) == [Metadata("robot", {"name": "r2"})]
        summary = reader.summary
        assert (summary.start_ns, summary.end_ns) == (expected[0][2], expected[-1][2])
        # Without statistics, only message indexes or a walk over the messages count them.
        uncounted = case in ("no statistics", "no summary")
        assert summary.message_count == (None if uncounted else 60)
        assert [c.message_count for c in reader.connections] == ([None, None] if uncounted else [30, 30])


@pytest.mark.parametrize("case", LIBRARY_OPTIONS)
def test_selection_in_every_shape(tmp_path: Path, case: str) -> None:
    path = tmp_path / "a.mcap"
    library_file(path, SAMPLE, chunk_size=1000, **LIBRARY_OPTIONS[case])
    everything = read(path)
    with closing(McapReader(path)) as reader:
        second = [reader.connections[1]]
        assert content(reader, connections=second) == [m for m in everything if m[0] == 2]
        assert content(reader, start_ns=1100, stop_ns=1200) == [m for m in everything if 1100 <= m[2] < 1200]
        assert content(reader, connections=[]) == []
        assert content(reader, connections=[connection(id=7)]) == []
        assert content(reader, start_ns=5000) == []


def test_only_chunks_with_wanted_messages_are_read(tmp_path: Path, loads: list[Segment]) -> None:
    messages = [(0, t, b"c" * 3000) if t % 10 == 0 else (1, t, b"s") for t in range(100)]
    path = write(tmp_path / "a.mcap", messages, chunk_size=1000)
    with closing(McapReader(path)) as reader:
        assert not loads
        assert reader.bytes_read == 0
        assert len(content(reader, connections=[reader.connections[0]])) == 10
        # The large messages have chunks of their own.
        assert len(loads) == 10
        assert reader.bytes_read == sum(segment.length for segment in loads)
        loads.clear()
        assert len(content(reader, start_ns=15, stop_ns=22)) == 7
        assert len(loads) == 3
        loads.clear()
        assert len(content(reader)) == 100
        assert len(loads) == 20


def test_truncated_while_reading(tmp_path: Path) -> None:
    messages = [(0, t, os.urandom(5000)) for t in range(20)]
    path = write(tmp_path / "a.mcap", messages, chunk_size=1000)
    with closing(McapReader(path)) as reader:
        found = reader.messages()
        next(found)
        os.truncate(path, 20_000)
        with pytest.raises(RecordingError, match="ended at byte 20000 while it was read"):
            list(found)


def test_reading_after_close(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", SAMPLE)
    reader = McapReader(path)
    reader.close()
    reader.close()
    with pytest.raises(RecordingError, match="Bad file descriptor"):
        content(reader)


@needs_shared
@pytest.mark.parametrize("name", ["ouster_os1_32.mcap", "d435_depth.mcap"])
def test_real_recordings(name: str, tmp_path: Path) -> None:
    path = RECORDINGS / name
    ours = read(path)
    assert ours == library(path)
    copy = tmp_path / "copy.mcap"
    with closing(McapReader(path)) as reader:
        writer = McapWriter(copy, profile=reader.summary.profile)
        handles = {c.id: writer.add_connection(c) for c in reader.connections}
        for message in reader.messages():
            writer.write(handles[message.connection.id], *message[1:5])
        writer.finish()
        with closing(McapReader(copy)) as again:
            assert again.connections == reader.connections
            assert again.summary.message_count == reader.summary.message_count
        assert [c.latching for c in reader.connections if c.topic == "/tf_static"] in ([], [True])
    assert read(copy) == ours
    assert library(copy) == ours
