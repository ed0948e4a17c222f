"""A dry run says what would happen, and writes nothing at all; `tests/transcripts/dry_run.txt` has its words."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest

from support import ROOT, sampled
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

HEIGHTS = ("--min-height", "-0.3", "--max-height", "1")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path / "drive.bag")
    shutil.copy(ROOT / "fixtures" / "hall.mcap", tmp_path / "drive.mcap")
    shutil.copytree(ROOT / "fixtures" / "hall", tmp_path / "drive")
    return tmp_path


def dry(folder: Path, *args: str, status: int = 0) -> str:
    """Run it, and see that nothing has changed: a lock that came and went has changed its folder's time."""

    def state() -> dict[Path, tuple[int, int]]:
        return {path: (path.lstat().st_mtime_ns, path.lstat().st_ino) for path in (folder, *folder.rglob("*"))}

    before = state()
    done = run("convert", *args, "-n", cwd=folder)
    assert done.status == status, done.stderr
    assert state() == before
    return done.stdout


@pytest.mark.parametrize(
    ("source", "destination"),
    sampled(
        (
            (source, made)
            for source in ("drive.bag", "drive.mcap", "drive")
            for made in ("out.bag", "o.mcap", "o", "n/")
        ),
        3,
    ),
)
def test_it_says_what_would_happen(source: str, destination: str, folder: Path) -> None:
    lines = dry(folder, source, "-o", destination, *HEIGHTS, "--keep-clouds").splitlines()
    assert lines[0] == f"dry run, nothing is written: {source}"
    rows = [line.split() for line in lines]
    assert ["min_height", "-0.3", "--min-height"] in rows
    assert ["/points", "/scan", "5", "5", "-", "converted", "(cloud", "kept)"] in rows
    assert ["/tf", "/tf", "5", "5"] in [row[:4] for row in rows]
    assert not any(line.startswith("next:") for line in lines)
    done = run("convert", source, "-o", destination, *HEIGHTS, "--keep-clouds", cwd=folder)
    assert done.status == 0
    assert {line for line in done.stdout.splitlines() if line.startswith("/t")} <= set(lines)
