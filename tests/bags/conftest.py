"""Fixtures that tests of several modules of a format need."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.mcap import chunks as mcap_chunks
from pc2scan.bags.mcap import read as mcap_reader

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.chunks import Segment
    from pc2scan.bags.mcap.records import RecordFile


@pytest.fixture
def loads(monkeypatch: pytest.MonkeyPatch) -> list[Segment]:
    """Every segment of an MCAP file whose payload is read."""
    seen: list[Segment] = []
    original = mcap_chunks.borrow_payload

    def counting(file: RecordFile, segment: Segment) -> memoryview:
        seen.append(segment)
        return original(file, segment)

    for module in (mcap_chunks, mcap_reader):
        monkeypatch.setattr(module, "borrow_payload", counting)
    return seen


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    folder = tmp_path / "bag"
    folder.mkdir()
    return folder
