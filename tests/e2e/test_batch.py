"""``pc2scan batch``: what it says, its reports, and what it exports."""

from __future__ import annotations

import csv
import json
import re
import shutil
from typing import TYPE_CHECKING

import numpy as np
import pytest

from e2e.test_screen import shown
from support.batches import HEIGHTS, contents, in_this_process, place, run_batch
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    return place(tmp_path / "drives", "a.bag", "b.mcap", "robot1/a.bag")


def plan_of(stderr: str) -> str:
    return stderr.splitlines()[0]


def test_a_second_run_says_what_it_does(drives: Path, tmp_path: Path) -> None:
    def again(*more: str) -> str:
        done = run_batch(drives, "-o", tmp_path / "out", *more)
        assert done.status == 0, done.stderr
        return plan_of(done.stderr)

    first = run_batch(drives, "-o", tmp_path / "out")
    assert re.fullmatch(r"3 recordings: 3 to convert \(\d+\.\d kB; 3 new\)", plan_of(first.stderr))
    assert again() == "3 recordings: 0 to convert (0 B), 3 unchanged"
    (tmp_path / "out" / "a_scan.bag").unlink()
    assert "1 to convert" in again()
    assert "3 unchanged" in again("--checksum")
    assert "3 other options" in again("--range-max", "20")
    assert "3 unchanged" in again("--range-max", "20", "--jobs", "1")
    assert "3 forced" in again("--range-max", "20", "--force")


def test_a_dry_run_writes_nothing(drives: Path, tmp_path: Path) -> None:
    (drives / "c.bag").write_bytes(b"")
    whole = (drives / "a.bag").read_bytes()
    (drives / "cut.bag").write_bytes(whole[: len(whole) // 2])
    done = run_batch(drives, "-o", tmp_path / "out", "--dry-run")
    assert done.status == 1
    assert "4 to convert" in done.stderr
    assert "failed: c.bag: is empty" in done.stderr
    assert "would be converted: a.bag -> a_scan.bag" in done.stderr
    assert "written would be about" in done.stdout
    # What has no index is not counted.
    lines = {line.split()[3]: "scans not counted" in line for line in done.stderr.splitlines() if " -> " in line}
    assert lines == {"a.bag": False, "b.mcap": False, "cut.bag": True, "robot1/a.bag": False}
    assert not (tmp_path / "out").exists()


def test_reports_have_a_row_for_each_recording(drives: Path, tmp_path: Path) -> None:
    (drives / "bad.bag").write_bytes(b"no")
    for name in ("all.json", "all.csv", "all.md"):
        done = run_batch(drives, "-o", tmp_path / "out", "--report", tmp_path / name)
        assert done.status == 1, done.stderr
    report = json.loads((tmp_path / "all.json").read_text())
    assert report["counts"] == {"failed": 1, "converted": 3}
    assert report["recordings"][0]["recording"] == "bad.bag"
    with (tmp_path / "all.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["outcome"] for row in rows] == ["failed", "converted", "converted", "converted"]
    assert (tmp_path / "all.md").read_text().startswith("# Batch of pc2scan")
    wrong = run_batch(drives, "-o", tmp_path / "out", "--report", tmp_path / "all.txt")
    assert (wrong.status, "NAME.json, NAME.csv, NAME.md" in wrong.stderr) == (2, True)
    # Nor where the batch writes itself.
    for name in ("manifest.jsonl", "a_scan.bag"):
        with_report = run_batch(drives, "-o", tmp_path / "out", "--report", tmp_path / "out" / name)
        assert (with_report.status, (tmp_path / "out" / name).exists()) == (2, True)


def test_fail_fast_ends_at_the_first_failure(drives: Path, tmp_path: Path) -> None:
    done = run_batch(drives, "-o", tmp_path / "out", "--fail-fast", "--jobs", "1", "--topic", "/nothing")
    assert done.status == 1
    assert "not begun" in done.stdout
    assert (tmp_path / "out" / "manifest.jsonl").read_bytes().count(b"\n") == 1
    # Also if that is known before anything is converted.
    (drives / "c.bag").write_bytes(b"")
    assert "3 not begun" in run_batch(drives, "-o", tmp_path / "none", "--fail-fast").stdout
    assert contents(tmp_path / "none") == {}


def test_each_recording_is_exported_as_by_export(drives: Path, tmp_path: Path) -> None:
    out, alone = tmp_path / "out", tmp_path / "alone"
    poses = ("--pose-frame", "odom", "--base-frame", "base_link")
    assert run_batch(drives, "-o", out, "--export", "npz", *poses).status == 0
    names = {f"{folder}/{name}" for folder in ("a", "b", "robot1/a") for name in ("scan.npz", ".pc2scan-files.json")}
    assert set(contents(out)) == names
    with np.load(out / "a" / "scan.npz") as archive:
        assert archive["ranges"].shape[0] == archive["stamps"].shape[0] == archive["poses"].shape[0] > 0
    assert run("export", drives / "a.bag", "-o", f"{alone}/", "--format", "npz", *poses, *HEIGHTS).status == 0
    assert (alone / "scan.npz").read_bytes() == (out / "a" / "scan.npz").read_bytes()
    assert "3 unchanged" in run_batch(drives, "-o", out, "--export", "npz", *poses).stderr
    (out / "a" / "scan.npz").unlink()
    assert "1 its output is missing" in run_batch(drives, "-o", out, "--export", "npz", *poses).stderr
    # Clouds have no heights.
    clouds = ("batch", drives, "-o", tmp_path / "clouds", "--export", "pcd")
    with in_this_process():
        assert run(*clouds, "--dry-run").status == 0
        assert not (tmp_path / "clouds").exists()
        assert run(*clouds).status == 0
        assert len(list((tmp_path / "clouds" / "robot1" / "a").glob("*.pcd"))) == 3
        assert "3 unchanged" in run(*clouds).stderr


def test_a_terminal_has_a_bar_and_a_pipe_only_the_lines(drives: Path, tmp_path: Path) -> None:
    (drives / "bad.bag").write_bytes(b"")
    piped = tmp_path / "piped"
    (piped / "robot1").mkdir(parents=True)
    (piped / "robot1" / "a_scan.bag").write_text("precious")
    done = run_batch(drives, "-o", piped)
    first, *lines = done.stderr.splitlines()
    assert re.fullmatch(r"4 recordings: 2 to convert \(\d+\.\d kB; 2 new\)", first)
    assert sorted(line.split(" (")[0] for line in lines) == [
        "converted: a.bag -> a_scan.bag",
        "converted: b.mcap -> b_scan.mcap",
        "failed: bad.bag: is empty",
        "failed: robot1/a.bag: exists already, and was not written by this batch",
    ]
    assert "(hint: --overwrite replaces it)" in done.stderr
    on_terminal = shown("batch", drives, "-o", tmp_path / "terminal", *HEIGHTS, columns=120)
    assert "of 3 recordings" in on_terminal
    assert "converted: a.bag -> a_scan.bag" in on_terminal
    shutil.rmtree(piped / "robot1")
    quiet = run_batch(drives, "-o", piped, "--quiet")
    assert (quiet.stdout, quiet.stderr.splitlines()) == ("", ["failed: bad.bag: is empty"])
    loud = run_batch(drives, "-o", piped, "--verbose", "--force")
    assert len(re.findall(r"/points +/scan", loud.stderr)) == 3
