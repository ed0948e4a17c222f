"""Messages among the records of a chunk: views of it, and damage between them."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest
from mcap.records import MessageIndex

from pc2scan.bags.mcap.reader import McapReader
from pc2scan.errors import RecordingError
from pc2scan.model import RawMessage
from support.mcap_files import content, encoded, raw_channel, raw_chunk, raw_file, raw_message, record, write

if TYPE_CHECKING:
    from pathlib import Path


def test_data_are_views(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [(0, 1, b"abc"), (0, 2, b"def")])
    with closing(McapReader(path)) as reader:
        first, second = reader.messages()
    assert isinstance(first, RawMessage)
    assert isinstance(first.data, memoryview)
    assert isinstance(second.data, memoryview)
    assert first.data.obj is second.data.obj


@pytest.mark.parametrize(
    ("records", "match"),
    [
        (raw_message() + raw_message()[:-1], "are sound for 35 of 69 bytes"),
        (raw_message() + b"\x05" + bytes(8), "are sound for 35 of 44 bytes"),
        (raw_message() + record(5, bytes(21)) + raw_message(), "are sound for 35 of 100 bytes"),
        (raw_message() + b"\x03\xff" + bytes(7), "are sound for 35 of 44 bytes"),
        (raw_message() + raw_message(channel=2), "channel 2 has messages"),
    ],
)
def test_damage_among_the_messages_of_a_sound_chunk(tmp_path: Path, records: bytes, match: str) -> None:
    index = encoded(MessageIndex(channel_id=1, records=[(1, 0)]))
    path = raw_file(tmp_path / "a.mcap", raw_channel(), raw_chunk(records), index)
    with closing(McapReader(path, strict=True)) as reader:
        assert [c.topic for c in reader.connections] == ["/t"]
        with pytest.raises(RecordingError, match=match):
            content(reader)
