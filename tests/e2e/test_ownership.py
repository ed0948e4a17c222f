"""What batches own: exported folders; what commands own is in `transcripts/ownership.txt`.

`test_done_again` has the rules.
"""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING, Any

import pytest

from support import ROOT
from support.batches import batch, contents

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"
MINE = "three years of work"


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    (tmp_path / "in" / "sub").mkdir(parents=True)
    for name in ("a.bag", "sub/b.bag"):
        shutil.copy(HALL, tmp_path / "in" / name)
    return tmp_path / "in"


def errors_of(report: Any) -> dict[str, str]:
    return {outcome.key: outcome.error for outcome in report.outcomes}


def test_a_batch_leaves_files_in_its_exported_folders(drives: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert batch(drives, out, format="npz", beams=90).exit_status == 0
    (out / "a" / "deep").mkdir()
    for name in ("labels.npz", "deep/mine.npz"):
        (out / "a" / name).write_text(MINE)
    before = contents(out / "a")
    errors = errors_of(batch(drives, out, format="npz", beams=91))
    assert "deep/mine.npz" in errors["a.bag"]
    assert not errors["sub/b.bag"]
    assert contents(out / "a") == before
    # It is converted as soon as they are away.
    shutil.rmtree(out / "a" / "deep")
    (out / "a" / "labels.npz").unlink()
    assert batch(drives, out, format="npz", beams=91).exit_status == 0
    os.utime(out / "sub" / "b" / "scan.npz", (1, 1))
    assert errors_of(batch(drives, out, format="csv"))["a.bag"] == ""
    assert sorted(contents(out / "a")) == [".pc2scan-files.json", "scan.csv"]
    assert sorted(contents(out / "sub")) == ["b/.pc2scan-files.json", "b/scan.npz"]
