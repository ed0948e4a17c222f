"""Several recordings, one after the other; `tests/transcripts/folders.txt` has the rest."""

from __future__ import annotations

import shutil
from collections import deque
from typing import TYPE_CHECKING, Any

import pc2scan.files.staging
import pc2scan.pipeline.each
import pc2scan.pipeline.run
from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_an_interruption_says_what_was_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("hall.bag", "hall.mcap"):
        shutil.copy(ROOT / "fixtures" / name, tmp_path)
    real = pc2scan.pipeline.run.run
    calls = []

    def second_is_interrupted(*args: Any, **keywords: Any) -> Any:
        calls.append(args)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(*args, **keywords)

    monkeypatch.setattr(pc2scan.pipeline.each, "run", second_is_interrupted)
    # A process of the command's own has written nothing yet.
    monkeypatch.setattr(pc2scan.files.staging, "_renamed", deque())
    done = run("convert", "--each", "hall.bag", "hall.mcap", "--min-height", "-0.3", cwd=tmp_path)
    assert done.status == 130
    last = done.stderr.splitlines()[-1]
    assert last.startswith("interrupted: ")
    assert "hall_scan.bag" in last
    assert "hall_scan.mcap" not in last
    assert {path.name for path in tmp_path.iterdir()} == {"hall.bag", "hall.mcap", "hall_scan.bag"}
