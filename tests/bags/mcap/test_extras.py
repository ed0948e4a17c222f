"""Attachments and metadata records."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.mcap.reader import McapReader
from pc2scan.bags.mcap.writer import McapWriter
from pc2scan.errors import RecordingError
from pc2scan.model import Attachment

if TYPE_CHECKING:
    from pathlib import Path


def test_a_damaged_attachment(tmp_path: Path) -> None:
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
    with closing(McapReader(path, verify=False)) as reader:
        assert [a.data for a in reader.attachments()] == [b"spottier"]
