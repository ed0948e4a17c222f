"""What batches own: numbered files and exported folders; what commands own is in `transcripts/ownership.txt`.

`test_done_again` and `test_ownership_random` have the rules.
"""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING, Any

import pytest

from support import ROOT
from support.batches import batch, contents, manifest_of

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
    assert batch(drives, out, export="npz", beams=90).exit_status == 0
    (out / "a" / "deep").mkdir()
    for name in ("labels.npz", "deep/mine.npz"):
        (out / "a" / name).write_text(MINE)
    before = contents(out / "a")
    errors = errors_of(batch(drives, out, export="npz", beams=91))
    assert "deep/mine.npz" in errors["a.bag"]
    assert not errors["sub/b.bag"]
    assert contents(out / "a") == before
    # It is converted as soon as they are away.
    shutil.rmtree(out / "a" / "deep")
    (out / "a" / "labels.npz").unlink()
    assert batch(drives, out, export="npz", beams=91).exit_status == 0
    # As a version wrote them that put no record into folders: the manifest is the record.
    for record in out.rglob(".pc2scan-files.json"):
        record.unlink()
    os.utime(out / "sub" / "b" / "scan.npz", (1, 1))
    assert errors_of(batch(drives, out, export="csv"))["a.bag"] == ""
    assert sorted(contents(out / "a")) == [".pc2scan-files.json", "scan.csv"]
    assert sorted(contents(out / "sub")) == ["b/scan.npz"]


def test_a_split_batch_leaves_numbered_files_of_others(drives: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "a_scan_7.bag").write_text(MINE)
    assert "exists already, and was not written by this batch" in errors_of(batch(drives, out, split="100ms"))["a.bag"]
    assert sorted(path.name for path in out.glob("a_scan_*")) == ["a_scan_7.bag"]
    assert batch(drives, out, split="100ms", overwrite=True).exit_status == 0
    assert sorted(path.name for path in out.glob("a_scan_*")) == [f"a_scan_{n}.bag" for n in (0, 1, 2, 3, 4, 7)]
    (out / "a_scan_4.bag").write_text("changed")
    # Fewer are written: of the others those go that are as they were left, also after a run that failed.
    (drives / "a.bag").write_bytes(b"")
    assert batch(drives, out, split="200ms").exit_status == 1
    shutil.copy(HALL, drives / "a.bag")
    assert batch(drives, out, split="200ms").exit_status == 0
    assert sorted(path.name for path in out.glob("a_scan_*")) == [f"a_scan_{n}.bag" for n in (0, 1, 2, 4, 7)]
    assert ((out / "a_scan_4.bag").read_text(), (out / "a_scan_7.bag").read_text()) == ("changed", MINE)
    assert sorted(path.name for path in (out / "sub").glob("*")) == [f"b_scan_{n}.bag" for n in range(3)]
    warned = manifest_of(out)["a.bag"]["report"]["warnings"]
    assert any("a_scan_4.bag, a_scan_7.bag" in text for text in warned)
    assert batch(drives, out, split="200ms").unchanged == 2
    # One that would be written over is an error.
    assert batch(drives, out, split="100ms").exit_status == 1
    assert (out / "a_scan_4.bag").read_text() == "changed"
    assert not list(tmp_path.rglob("*.pc2scan-*"))


def test_a_batch_that_was_killed_knows_its_numbered_files(
    drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        # Between the renaming of the files and the line in the manifest.
        patch.setattr("pc2scan.batch.folder.BatchFolder.append", killed)
        with pytest.raises(KeyboardInterrupt):
            batch(drives, out, split="100ms")
    assert len(list(out.glob("a_scan_*.bag"))) == 5
    (out / "a_scan_5.bag").write_text(MINE)
    assert batch(drives, out, split="200ms").exit_status == 0
    assert sorted(path.name for path in out.glob("a_scan_*")) == [f"a_scan_{n}.bag" for n in (0, 1, 2, 5)]
    assert not list(tmp_path.rglob("*pc2scan-*"))
