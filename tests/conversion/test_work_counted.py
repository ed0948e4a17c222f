"""The thread that decompresses a chunk converts the clouds in it, while they are in its cache."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from benchmarks.clouds import CLOUD_BYTES, FORMS, write_recording
from pc2scan.conversion import conversions
from pc2scan.core.project import Projector
from pc2scan.files.compression import decompress

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("form", ["ROS 1, lz4", "MCAP, zstd"])
def test_the_thread_that_decompressed_clouds_projects_them(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = write_recording(tmp_path, FORMS[form], 6 * CLOUD_BYTES)
    chunks: dict[int, Any] = {}
    borrowed: list[bool] = []

    def spying(compression: str, stored: Any, records: Any) -> None:
        decompress(compression, stored, records)
        chunks[threading.get_ident()] = records

    class Spy:
        def __init__(self, params: pc2scan.ProjectionParams) -> None:
            self._project = Projector(params)

        def __call__(self, x: Any, *more: Any) -> Any:
            chunk = np.frombuffer(chunks[threading.get_ident()], np.uint8)
            borrowed.append(np.may_share_memory(x, chunk))
            return self._project(x, *more)

    how: dict[str, Any] = {"min_height": -2, "max_height": 2, "only_scans": True}
    alone = pc2scan.convert(source, tmp_path / "alone.mcap", jobs=1, **how)
    monkeypatch.setattr("pc2scan.bags.chunks.decompress", spying)
    monkeypatch.setattr(conversions, "Projector", Spy)
    together = pc2scan.convert(source, tmp_path / "together.mcap", jobs=2, **how)
    # The first clouds are converted once more before, to be judged.
    assert len(borrowed) > together.converted[0].messages_out
    assert all(borrowed)
    assert together.topics == alone.topics
    assert (tmp_path / "together.mcap").read_bytes() == (tmp_path / "alone.mcap").read_bytes()
