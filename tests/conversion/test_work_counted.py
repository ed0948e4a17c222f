"""The thread that reads or decompresses a chunk converts the clouds in it, where they are: in its cache, not copied."""

from __future__ import annotations

import threading
from collections import defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from benchmarks.clouds import CLOUD_BYTES, FORMS, write_recording
from pc2scan.conversion import steps
from pc2scan.core.project import Projector
from pc2scan.files.source_file import lend

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("form", ["ROS 1, lz4", "MCAP, zstd", "MCAP, none"])
def test_the_thread_that_decompressed_clouds_projects_them(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = write_recording(tmp_path, FORMS[form], 6 * CLOUD_BYTES)
    chunks: dict[int, list[memoryview]] = defaultdict(list)
    borrowed: list[bool] = []

    def spying(*args: Any) -> memoryview:
        chunks[threading.get_ident()].append(lend(*args))
        return chunks[threading.get_ident()][-1]

    class Spy:
        def __init__(self, params: pc2scan.ProjectionParams) -> None:
            self._project = Projector(params)

        def __call__(self, x: Any, *more: Any) -> Any:
            own = (np.frombuffer(chunk, np.uint8) for chunk in chunks[threading.get_ident()])
            # A sample of the points of the first clouds is copied.
            borrowed.append(x.size < 1000 or any(np.may_share_memory(x, chunk) for chunk in own))
            return self._project(x, *more)

    how: dict[str, Any] = {"min_height": -2, "max_height": 2, "only_scans": True}
    alone = pc2scan.convert(source, tmp_path / "alone.mcap", jobs=1, **how)
    # What is not compressed is in the memory that it was read to.
    monkeypatch.setattr("pc2scan.files.source_file.lend", spying)
    monkeypatch.setattr("pc2scan.bags.chunks.lend", spying)
    monkeypatch.setattr(steps, "Projector", Spy)
    together = pc2scan.convert(source, tmp_path / "together.mcap", jobs=2, **how)
    # The first clouds are converted once more before, to be judged.
    assert len(borrowed) > together.converted[0].messages_out
    assert all(borrowed)
    assert together.topics == alone.topics
    assert (tmp_path / "together.mcap").read_bytes() == (tmp_path / "alone.mcap").read_bytes()
