"""The progress of a batch: the bytes that are read of all recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest

import pc2scan
from pc2scan.datasets.jobs import Event, convert_one
from support.batches import KEYWORDS, place

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


def test_a_recording_that_is_tried_again_begins_again(tmp_path: Path) -> None:
    drives = place(tmp_path / "drives", "a.bag", "b.bag")
    seen: list[Any] = []

    def execute(jobs: Any, **_: object) -> Iterator[Event]:
        first, second = jobs
        yield Event("begun", first.key)
        yield Event("progress", first.key, (60, 100))
        yield Event("died", first.key, "killed")
        yield Event("begun", first.key)
        yield Event("progress", first.key, (10, 100))
        for job in (first, second):
            yield Event("done", job.key, convert_one(job))

    with patch("pc2scan.datasets.run.run_jobs", execute):
        pc2scan.batch(drives, tmp_path / "out", jobs=1, progress=seen.append, **KEYWORDS)
    size = (drives / "a.bag").stat().st_size
    assert {step.bytes_total for step in seen} == {2 * size}
    shares = [step.bytes_done / size for step in seen]
    assert shares == pytest.approx([0, 0.6, 0, 0, 0.1, 1, 2], abs=1e-4)
    assert seen[-1][2:] == (2, 2)
