"""``pc2scan batch``: its reports, what it exports, and its bar; what it says is in `transcripts/batches.txt`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from support.batches import HEIGHTS, contents, in_this_process, place, run_batch
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    return place(tmp_path / "drives", "a.bag", "b.mcap", "robot1/a.bag")


def test_each_recording_is_exported_as_by_export(drives: Path, tmp_path: Path) -> None:
    out, alone = tmp_path / "out", tmp_path / "alone"
    poses = ("--pose-frame", "odom", "--base-frame", "base_link")
    assert run_batch(drives, "-o", out, "--format", "npz", *poses).status == 0
    names = {f"{folder}/{name}" for folder in ("a", "b", "robot1/a") for name in ("scan.npz", ".pc2scan-files.json")}
    assert set(contents(out)) == names
    with np.load(out / "a" / "scan.npz") as archive:
        assert archive["ranges"].shape[0] == archive["stamps"].shape[0] == archive["poses"].shape[0] > 0
    assert run("export", drives / "a.bag", "-o", f"{alone}/", "--format", "npz", *poses, *HEIGHTS).status == 0
    assert (alone / "scan.npz").read_bytes() == (out / "a" / "scan.npz").read_bytes()
    assert "3 unchanged" in run_batch(drives, "-o", out, "--format", "npz", *poses).stderr
    (out / "a" / "scan.npz").unlink()
    assert "1 its output is missing" in run_batch(drives, "-o", out, "--format", "npz", *poses).stderr
    # Clouds have no heights.
    clouds = ("batch", drives, "-o", tmp_path / "clouds", "--format", "pcd")
    with in_this_process():
        assert run(*clouds, "--dry-run").status == 0
        assert not (tmp_path / "clouds").exists()
        assert run(*clouds).status == 0
        assert len(list((tmp_path / "clouds" / "robot1" / "a").glob("*.pcd"))) == 3
        assert "3 unchanged" in run(*clouds).stderr
