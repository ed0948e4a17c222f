"""A dry run says what would happen, and writes nothing at all."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest

import pc2scan
from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

FIXTURES = ROOT / "fixtures"
HEIGHTS = ("--min-height", "-0.3", "--max-height", "1")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(FIXTURES / "hall.bag", tmp_path / "drive.bag")
    shutil.copy(FIXTURES / "hall.mcap", tmp_path / "drive.mcap")
    shutil.copytree(FIXTURES / "hall", tmp_path / "drive")
    return tmp_path


def state_of(folder: Path) -> dict[str, tuple[int, int]]:
    """Each file and folder, the outermost included: a lock that came and went has changed its folder's time."""
    paths = [folder, *folder.rglob("*")]
    return {str(path): (path.lstat().st_mtime_ns, path.lstat().st_ino) for path in paths}


def dry(folder: Path, *args: str, status: int = 0) -> tuple[str, str]:
    before = state_of(folder)
    done = run("convert", *args, "-n", cwd=folder)
    assert "Traceback" not in done.stderr
    assert done.status == status, done.stderr
    assert state_of(folder) == before
    return done.stdout, done.stderr


@pytest.mark.parametrize("source", ["drive.bag", "drive.mcap", "drive"])
@pytest.mark.parametrize("destination", ["out.bag", "out.mcap", "out", "new/"])
def test_it_says_what_would_happen(source: str, destination: str, folder: Path) -> None:
    shown, _ = dry(folder, source, "-o", destination, *HEIGHTS, "--keep-clouds")
    lines = shown.splitlines()
    assert lines[0] == f"dry run, nothing is written: {source}"
    rows = [line.split() for line in lines]
    assert ["min_height", "-0.3", "--min-height"] in rows
    assert ["/points", "/scan", "5", "5", "-", "converted", "(cloud", "kept)"] in rows
    assert ["/tf", "/tf", "5", "5"] in [row[:4] for row in rows]
    assert "next:" not in shown
    done = run("convert", source, "-o", destination, *HEIGHTS, "--keep-clouds", cwd=folder)
    assert done.status == 0
    assert {line for line in done.stdout.splitlines() if line.startswith("/t")} <= set(lines)


@pytest.mark.parametrize(("options", "least", "most"), [((), 5_000, 60_000), (("--keep-clouds",), 250_000, 600_000)])
def test_the_size_is_about_right(options: tuple[str, ...], least: int, most: int, folder: Path) -> None:
    dry(folder, "drive.bag", "-o", "out.bag", *HEIGHTS, *options)
    keep = bool(options)
    report = pc2scan.convert(folder / "drive.bag", folder / "out.bag", min_height=-0.3, keep_clouds=keep, dry_run=True)
    written = pc2scan.convert(folder / "drive.bag", folder / "out.bag", min_height=-0.3, keep_clouds=keep)
    assert report.dry_run
    assert not written.dry_run
    assert least < report.bytes_written < most
    assert 0.3 < report.bytes_written / written.bytes_written < 3
    assert [(t.topic, t.messages_in, t.messages_out) for t in report.topics] == [
        (t.topic, t.messages_in, t.messages_out) for t in written.topics
    ]


@pytest.mark.parametrize(
    ("options", "status", "words"),
    [
        (("--topic", "/nothing"), 2, "/nothing"),
        (("--target-frame", "nowhere"), 1, "nothing can be converted"),
        (("--start", "100"), 2, "the cut is outside of the recording"),
        (("-o", "drive.bag"), 2, "is a source"),
        (("-o", "drive.mcap"), 2, "exists already"),
        (("-o", "missing/out.bag"), 2, "its directory does not exist"),
        (("-o", "missing/out/"), 2, "its directory does not exist"),
        (("-o", "out.zip"), 2, ".zip is not a destination"),
        (("--report", "drive.mcap"), 2, "exists already"),
        (("--report", "drive"), 2, "it is a directory"),
        (("--min-height", "2", "--max-height", "1"), 2, "height"),
    ],
)
def test_what_would_fail_fails(options: tuple[str, ...], status: int, words: str, folder: Path) -> None:
    shown, told = dry(folder, "drive.bag", *options, status=status)
    assert shown == ""
    assert words in told
    real = run("convert", "drive.bag", *options, cwd=folder)
    assert (real.status, real.stderr) == (status, told)


def test_the_report_is_not_written(folder: Path) -> None:
    dry(folder, "drive.bag", *HEIGHTS, "--report", "report.json")
    dry(folder, "drive.bag", "--topic", "/nothing", "--report", "report.json", status=2)
    dry(folder, "drive.bag", "--angle-min", "x", "--report", "report.json", status=2)


def test_empty_scans_and_damage_are_foreseen(folder: Path) -> None:
    _, told = dry(folder, "drive.bag", "--min-height", "50")
    assert "have no return" in told
    (folder / "cut.bag").write_bytes((folder / "drive.bag").read_bytes()[:300_000])
    _, told = dry(folder, "cut.bag", *HEIGHTS, status=3)
    assert "damaged: cut.bag" in told


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--min-height", "-1"), "the floor is within the heights"),
        (("--min-height", "0.1", "--target-frame", "odom"), "--target-frame is odom, in which base_link moves"),
        ((), "--min-height sets it below the sensor: --min-height -0.5 --max-height 0.9"),
        (("--min-height", "-1", "--every", "0.2", "--fixed-frame", "odom"), "the floor is within the heights"),
    ],
    ids=str,
)
def test_it_warns_as_the_conversion_does(options: tuple[str, ...], told: str, tmp_path: Path) -> None:
    shown, warned = dry(tmp_path, str(FIXTURES / "hall.bag"), "-o", "o.bag", *options)
    assert told in warned
    assert "dry run" in shown
    assert list(tmp_path.iterdir()) == []
