"""Folders, several sources, and where what is made of them goes."""

from __future__ import annotations

import json
import shutil
from collections import deque
from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

import pc2scan.files.staging
import pc2scan.pipeline.each
import pc2scan.pipeline.run
from pc2scan.cli.app import application
from support import ROOT
from support.builders import CONTENT, write_mcap, write_rosbag1
from support.command import run
from support.outputs import opened

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

FIXTURES = ROOT / "fixtures"
HEIGHTS = ("--min-height", "-0.3")


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    """A folder with a bag, an MCAP file and a rosbag2 directory."""
    folder = tmp_path / "my drives"
    folder.mkdir()
    shutil.copy(FIXTURES / "hall.bag", folder / "a.bag")
    shutil.copy(FIXTURES / "hall.mcap", folder / "b.mcap")
    shutil.copytree(FIXTURES / "hall", folder / "c")
    return folder


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


# --- Folders ---


@pytest.mark.parametrize("command", ["convert", "info", "tf", "repair", "check"])
def test_a_folder_with_several_recordings_is_refused(command: str, drives: Path) -> None:
    done = run(command, drives)
    assert done.status == 2
    assert "holds 3 recordings, not one: a.bag, b.mcap, c/" in done.stderr
    assert f"name one of them: '{drives / 'a.bag'}'" in done.stderr
    assert f"pc2scan convert --each '{drives}' -o DIR/" in done.stderr
    assert names(drives.parent) == {drives.name}


def test_two_unrelated_files_in_a_folder_are_two_recordings(tmp_path: Path) -> None:
    """They were merged into one."""
    folder = tmp_path / "drives"
    folder.mkdir()
    write_mcap(folder / "monday.mcap", CONTENT)
    write_mcap(folder / "tuesday.mcap", CONTENT)
    refused = run("convert", folder)
    assert refused.status == 2
    assert "holds 2 recordings, not one: monday.mcap, tuesday.mcap" in refused.stderr
    # Named as parts, but recorded at the same time.
    for number, name in enumerate(("monday", "tuesday")):
        (folder / f"{name}.mcap").rename(folder / f"drive_{number}.mcap")
    refused = run("info", folder)
    assert refused.status == 2
    assert "drive_1.mcap does not begin where drive_0.mcap ends" in refused.stderr


def test_parts_of_one_recording_are_one(tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    folder.mkdir()
    for number, part in enumerate(CONTENT.halves()):
        write_mcap(folder / f"drive_{number}.mcap", part)
    done = run("convert", folder, *HEIGHTS)
    assert done.status == 0, done.stderr
    assert len(opened(tmp_path / "drive_scan").messages) == len(CONTENT.items)


# --- Several sources ---


def test_sources_that_overlap_draw_a_warning(tmp_path: Path) -> None:
    write_rosbag1(tmp_path / "a.bag", CONTENT)
    write_rosbag1(tmp_path / "b.bag", CONTENT)
    done = run("convert", "a.bag", "b.bag", "-o", "out.bag", *HEIGHTS, cwd=tmp_path)
    assert done.status == 0
    assert "warning: a.bag and b.bag overlap in time, by up to 0.20" in done.stderr
    assert "/points" in done.stderr
    assert "--each converts each by itself" in done.stderr


def test_parts_of_a_split_bag_draw_no_warning(tmp_path: Path) -> None:
    for number, part in enumerate(CONTENT.halves()):
        write_rosbag1(tmp_path / f"drive_2020-11-04-18-39-5{number}_{number}.bag", part)
    done = run("convert", *sorted(tmp_path.glob("*.bag")), "-o", tmp_path / "out.bag", *HEIGHTS)
    assert done.status == 0
    assert "overlap" not in done.stderr


def test_a_last_source_that_does_not_exist_may_be_the_destination(drives: Path) -> None:
    done = run("convert", "a.bag", "new one.bag", cwd=drives)
    assert done.status == 2
    assert done.stderr.splitlines()[-1] == "hint: did you mean -o 'new one.bag'?"
    # With a destination it is a source that is missing.
    assert "-o" not in run("convert", "a.bag", "b.bag", "-o", "c.bag", cwd=drives).stderr


# --- Into a folder ---


@pytest.mark.parametrize("typed", ["out/", "out/.", "out//"])
def test_into_a_folder(typed: str, drives: Path) -> None:
    done = run("convert", "a.bag", "-o", typed, *HEIGHTS, cwd=drives)
    assert done.status == 0, done.stderr
    assert names(drives / "out") == {"a_scan.bag"}
    done = run("convert", "c", "-o", typed, *HEIGHTS, cwd=drives)
    assert names(drives / "out") == {"a_scan.bag", "c_scan"}
    assert run("repair", "b.mcap", "-o", typed, cwd=drives).status == 0
    assert names(drives / "out") == {"a_scan.bag", "c_scan", "b_repaired.mcap"}


def test_the_current_folder_is_one(drives: Path) -> None:
    assert run("convert", drives / "a.bag", "-o", ".", *HEIGHTS, cwd=drives.parent).status == 0
    assert names(drives.parent) == {drives.name, "a_scan.bag"}


def test_a_folder_is_made_only_for_what_is_written(drives: Path) -> None:
    failed = run("convert", "a.bag", "-o", "out/", "--topic", "/nothing", cwd=drives)
    assert failed.status == 2
    deep = run("convert", "a.bag", "-o", "out/out/", cwd=drives)
    assert (deep.status, "its directory does not exist" in deep.stderr) == (2, True)
    taken = run("convert", "a.bag", "-o", "b.mcap/", cwd=drives)
    assert (taken.status, "is not a folder" in taken.stderr) == (2, True)
    assert names(drives) == {"a.bag", "b.mcap", "c"}


@pytest.mark.parametrize(("to", "name"), [("bag", "b_scan.bag"), ("mcap", "b_scan.mcap"), ("rosbag2", "b_scan")])
def test_another_format(to: str, name: str, drives: Path) -> None:
    done = run("convert", "b.mcap", "-o", "out/", "--to", to, *HEIGHTS, cwd=drives)
    assert done.status == 0, done.stderr
    assert names(drives / "out") == {name}
    contradicted = run("convert", "b.mcap", "-o", "x.y", "--to", to, cwd=drives)
    if to != "rosbag2":
        assert (contradicted.status, f"--to {to} asks for another format" in contradicted.stderr) == (2, True)


# --- Each by itself ---


def test_each_by_itself(drives: Path) -> None:
    done = run("convert", "--each", drives, "-o", "scans/", "--report", "all.json", *HEIGHTS, cwd=drives.parent)
    assert done.status == 0, done.stderr
    assert names(drives.parent / "scans") == {"a_scan.bag", "b_scan.mcap", "c_scan"}
    assert "3 of 3 recordings converted" in done.stdout
    report = json.loads((drives.parent / "all.json").read_text())
    assert report["exit_status"] == 0
    assert [entry["destination"] for entry in report["conversions"]] == [
        "scans/a_scan.bag",
        "scans/b_scan.mcap",
        "scans/c_scan",
    ]
    alone = drives.parent / "alone.bag"
    assert run("convert", drives / "a.bag", "-o", alone, *HEIGHTS).status == 0
    assert alone.read_bytes() == (drives.parent / "scans" / "a_scan.bag").read_bytes()


def test_one_that_fails_does_not_keep_the_others_from_it(drives: Path) -> None:
    damaged = drives / "d.bag"
    damaged.write_bytes((drives / "a.bag").read_bytes()[:200_000])
    (drives / "e.bag").write_bytes(b"no bag")
    done = run("convert", "--each", drives, drives / "missing.bag", "-o", f"{drives.parent}/", *HEIGHTS)
    assert done.status == 1
    assert "missing.bag: does not exist" in done.stderr
    assert "e.bag: is not a recording" in done.stderr
    assert f"{damaged}:\n" in done.stderr
    assert "4 of 6 recordings converted, 2 failed" in done.stdout
    statuses = {line.split()[0]: line.split()[-1] for line in done.stdout.splitlines()[2:8]}
    assert statuses == {"a.bag": "0", "b.mcap": "0", "c": "0", "d.bag": "3", "e.bag": "1", "missing.bag": "2"}
    assert names(drives.parent) == {drives.name, "a_scan.bag", "b_scan.mcap", "c_scan", "d_scan.bag"}


def test_the_worst_status_counts(drives: Path) -> None:
    (drives / "d.bag").write_bytes((drives / "a.bag").read_bytes()[:200_000])
    done = run("convert", "--each", "a.bag", "d.bag", "--quiet", *HEIGHTS, cwd=drives)
    assert (done.status, done.stdout) == (3, "")
    assert {"a_scan.bag", "d_scan.bag"} < names(drives)


def test_names_that_collide_are_refused(drives: Path) -> None:
    (drives / "other").mkdir()
    shutil.copy(drives / "a.bag", drives / "other" / "a.bag")
    before = names(drives)
    collided = run("convert", "--each", "a.bag", "other/a.bag", "-o", "out/", cwd=drives)
    assert collided.status == 2
    assert "out/a_scan.bag: would be the output of both a.bag and other/a.bag" in collided.stderr
    twice = run("convert", "--each", "a.bag", "./a.bag", "-o", "out/", cwd=drives)
    assert (twice.status, "is given twice" in twice.stderr) == (2, True)
    named = run("convert", "--each", "a.bag", "b.mcap", "-o", "out", cwd=drives)
    assert (named.status, "did you mean -o out/?" in named.stderr) == (2, True)
    # Nor is one of them written over another.
    shutil.copy(drives / "a.bag", drives / "a_scan.bag")
    over = run("convert", "--each", "a.bag", "a_scan.bag", "--overwrite", cwd=drives)
    assert (over.status, "is a source" in over.stderr) == (2, True)
    assert names(drives) == before | {"a_scan.bag"}
    reported = run("convert", "--each", "a.bag", "b.mcap", "--report", "b_scan.mcap", "--overwrite", cwd=drives)
    assert reported.status == 2
    assert names(drives) == before | {"a_scan.bag"}


def test_an_interruption_says_what_was_written(drives: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It said that nothing was."""
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
    monkeypatch.chdir(drives)
    done = CliRunner().invoke(application(), ["convert", "--each", "a.bag", "b.mcap", *HEIGHTS])
    assert done.exit_code == 130
    last = done.stderr.splitlines()[-1]
    assert last.startswith("interrupted: ")
    assert "a_scan.bag" in last
    assert "b_scan.mcap" not in last
    assert names(drives) == {"a.bag", "b.mcap", "c", "a_scan.bag"}


def test_urls_are_refused_with_the_command_that_takes_them(tmp_path: Path) -> None:
    done = run("convert", "--each", "s3://bucket/a.bag", "s3://bucket/b.bag", "-o", f"{tmp_path}/out/")
    assert done.status == 2
    assert "--each takes local paths, not URLs" in done.stderr
    assert "pc2scan batch URL -o FOLDER/" in done.stderr
