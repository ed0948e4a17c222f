"""A dry run says what would happen, and writes nothing at all; `tests/transcripts/dry_run.txt` has its words."""

from __future__ import annotations

import shutil
from itertools import product
from typing import TYPE_CHECKING

import pytest

from support import ROOT, sampled
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path


def state(folder: Path) -> dict[Path, tuple[int, int]]:
    """What is there: a lock that came and went has changed its folder's time."""
    return {path: (path.lstat().st_mtime_ns, path.lstat().st_ino) for path in (folder, *folder.rglob("*"))}


@pytest.mark.parametrize(
    ("source", "destination"), sampled(product(["hall.bag", "hall.mcap", "hall"], ["out.bag", "o.mcap", "o", "n/"]), 3)
)
def test_it_says_what_would_happen(source: str, destination: str, tmp_path: Path) -> None:
    (shutil.copy if "." in source else shutil.copytree)(ROOT / "fixtures" / source, tmp_path / source)
    words = ("convert", source, "-o", destination, "--min-height", "-0.3", "--max-height", "1", "--keep-clouds")
    before = state(tmp_path)
    dry = run(*words, "-n", cwd=tmp_path)
    assert (dry.status, dry.stderr) == (0, "")
    assert state(tmp_path) == before
    lines = dry.stdout.splitlines()
    assert lines[0] == f"dry run, nothing is written: {source}"
    rows = [line.split() for line in lines]
    assert ["min_height", "-0.3", "--min-height"] in rows
    assert ["/points", "/scan", "5", "5", "-", "converted", "(cloud", "kept)"] in rows
    assert ["/tf", "/tf", "5", "5"] in [row[:4] for row in rows]
    assert not any(line.startswith("next:") for line in lines)
    done = run(*words, cwd=tmp_path)
    assert done.status == 0
    assert {line for line in done.stdout.splitlines() if line.startswith("/t")} <= set(lines)
