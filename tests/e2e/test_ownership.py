"""A run replaces what it writes, and removes what a record of an earlier run names; everything else stays."""

from __future__ import annotations

import json
import os
import shutil
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.arguments import local_path, path_of
from pc2scan.batch.options import BatchOptions
from pc2scan.batch.run import run_batch
from pc2scan.batch.work import convert_one
from pc2scan.batch.workers import Began, Ended
from pc2scan.cli.in_process import run_command
from pc2scan.errors import DestinationError, UsageError
from support import ROOT

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence
    from pathlib import Path

    from pc2scan.batch.summary import BatchReport
    from pc2scan.batch.work import Job
    from pc2scan.batch.workers import Event, Executor

HALL = ROOT / "fixtures" / "hall.bag"
HEIGHTS: dict[str, Any] = {"min_height": -0.3, "only_scans": True}
WORDS = ("--min-height", "-0.3", "--only-scans")
MINE = "three years of work"


def contents(folder: Path) -> dict[str, bytes | str]:
    """What is in a folder: the bytes of files, and where links lead."""
    return {
        path.relative_to(folder).as_posix(): str(path.readlink()) if path.is_symlink() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_symlink() or path.is_file()
    }


def batch(sources: Path, out: Path | str, **words: Any) -> BatchReport:
    """A batch whose jobs run in this process."""

    def executor(**_: object) -> Executor:
        def execute(jobs: Sequence[Job]) -> Generator[Event]:
            for job in jobs:
                yield Began(job.key)
                yield Ended(convert_one(job))

        return execute

    destination = path_of("destination", out)
    return run_batch([str(sources)], destination, {"min_height": -0.3, **words}, BatchOptions(), executor=executor)


# --- All names of a file are one ---


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A folder with a recording, links to it, and a link to the folder."""
    (tmp_path / "in").mkdir()
    shutil.copy(HALL, tmp_path / "in" / "drive.bag")
    shutil.copy(HALL, tmp_path / "in" / "other.bag")
    (tmp_path / "in" / "link.bag").symlink_to("drive.bag")
    os.link(tmp_path / "in" / "drive.bag", tmp_path / "in" / "hard.bag")
    (tmp_path / "there").symlink_to("in")
    return tmp_path / "in"


#: Names of ``drive.bag``, with the folder that it is in.
NAMES = (
    "{0}/drive.bag",
    "{0}/../in/drive.bag",
    "{0}/./drive.bag",
    "{0}/../there/drive.bag",
    "{0}/link.bag",
    "{0}/hard.bag",
    "file://{0}/drive.bag",
    "file:{0}/drive.bag",
    "FILE://{0}/drive.bag",
    "file://localhost{0}/drive.bag",
    "file://{0}/%64rive.bag",
    "file://{0}/../in/drive.bag",
    "file://{0}/../there/link.bag",
    "file://{0}//hard.bag",
)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("how", ["source", "second source", "tf_from"])
def test_a_source_is_never_replaced_by_any_name(how: str, name: str, drive: Path) -> None:
    before = contents(drive.parent)
    named, plain = name.format(drive), str(drive / "drive.bag")
    # The name as the source, and as the destination.
    for source, destination in ((named, plain), (plain, named)):
        sources = {"source": [source], "second source": [drive / "other.bag", source]}.get(how, [drive / "other.bag"])
        further = {"tf_from": source} if how == "tf_from" else {}
        with pytest.raises(DestinationError, match=r"is a (source|file of `tf_from`)"):
            pc2scan.convert(sources, destination, overwrite=True, **HEIGHTS, **further)  # type: ignore[arg-type]
        assert contents(drive.parent) == before


@pytest.mark.parametrize(
    "words",
    [
        "convert {d}/drive.bag -o file://{d}/drive.bag --overwrite",
        "convert file://{d}/drive.bag -o {d}/drive.bag --overwrite",
        "convert {d}/drive.bag --output=file:{d}/%64rive.bag --overwrite",
        "convert {d}/other.bag -o x.bag --report file://{d}/other.bag --overwrite",
        "convert {d}/other.bag -o {d}/x.bag --params-file {d}/params.yaml --report {d}/params.yaml --overwrite",
        "repair {d}/drive.bag -o file://localhost{d}/drive.bag --overwrite",
        "export {d}/drive.bag -f npz -o file://{d}/drive.bag --overwrite --preset slam_toolbox",
        "map {d}/drive.bag --params-file {d}/params.yaml -o {d}/params.yaml --overwrite",
        "map file:{d}/drive.bag --png {d}/shot.png --tf-from {d}/shot.png --overwrite",
        "view {d}/drive.bag -o {d}/page.html --params-file {d}/page.html --overwrite",
        "plot {d}/drive.bag -o {d}/shot.png --params-file {d}/shot.png --overwrite",
        "convert {d}/drive.bag -o {d}/x.bag --split 100ms --report {d}/x_1.bag --overwrite",
    ],
)
def test_commands_never_replace_what_they_read(words: str, drive: Path) -> None:
    for name in ("params.yaml", "page.html"):
        (drive / name).write_text("min_height: -0.3\n")
    shutil.copy(HALL, drive / "shot.png")
    before = contents(drive)
    ended = run_command(words.format(d=drive).split())
    assert ended.status == 2, ended.messages
    assert contents(drive) == before


@pytest.mark.parametrize(
    ("url", "path"),
    [
        ("file:///x/a b.bag", "/x/a b.bag"),
        ("file:///x/a%20b%25.bag", "/x/a b%.bag"),
        ("file://localhost/x.bag", "/x.bag"),
        ("file:/x.bag", "/x.bag"),
        ("FILE:///x.bag", "/x.bag"),
        ("file:////x.bag", "/x.bag"),
        ("file:///x/%C3%A9.bag", "/x/é.bag"),
        ("file:x.bag", "file:x.bag"),
        ("s3://x/a%20b.bag", "s3://x/a%20b.bag"),
    ],
)
def test_file_urls_are_read_as_their_standard_says(url: str, path: str) -> None:
    assert local_path(url) == path


@pytest.mark.parametrize(
    "url", ["file://other.host/x.bag", "file:///x?y.bag", "file:///x#1.bag", "file:///a%2Fb", "file://"]
)
def test_file_urls_that_name_no_file_here(url: str, tmp_path: Path) -> None:
    before = contents(tmp_path)
    for source, destination in ((url, tmp_path / "x.bag"), (HALL, url)):
        with pytest.raises(UsageError, match=r"is a (URL|file of another machine)"):
            pc2scan.convert(source, destination, **HEIGHTS)
    assert contents(tmp_path) == before


# --- Exported folders ---


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    """A recording with scans."""
    pc2scan.convert(HALL, tmp_path / "scans.bag", min_height=-0.3)
    return tmp_path / "scans.bag"


@pytest.mark.parametrize(("form", "suffix"), [("npz", "npz"), ("csv", "csv"), ("pcd", "pcd"), ("kitti", "txt")])
def test_an_export_leaves_files_that_no_record_names(form: str, suffix: str, scans: Path, tmp_path: Path) -> None:
    source = scans if form in ("npz", "csv") else HALL
    (tmp_path / "logs" / "deep").mkdir(parents=True)
    for name in (f"mine.{suffix}", f"deep/mine.{suffix}"):
        (tmp_path / "logs" / name).write_text(MINE)
    before = contents(tmp_path / "logs")
    with pytest.raises(DestinationError, match=f"mine.{suffix}") as caught:
        pc2scan.export(source, f"{tmp_path}/logs/", format=form, overwrite=True)
    assert "rm -r" in (caught.value.hint or "")
    assert contents(tmp_path / "logs") == before


def test_an_exported_folder_is_replaced_by_its_record(scans: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    pc2scan.export(scans, f"{out}/", format="npz")
    first = contents(out)
    assert sorted(first) == [".pc2scan-files.json", "scan.npz"]
    # Another format, and the same again: with the same bytes, the record included.
    pc2scan.export(scans, f"{out}/", format="csv", overwrite=True)
    assert sorted(contents(out)) == [".pc2scan-files.json", "scan.csv"]
    pc2scan.export(scans, f"{out}/", format="npz", overwrite=True)
    assert contents(out) == first
    # A copy is as good: the record has no times.
    shutil.copytree(out, tmp_path / "copy", copy_function=shutil.copyfile)
    pc2scan.export(scans, f"{tmp_path}/copy/", format="csv", overwrite=True)
    assert sorted(contents(tmp_path / "copy")) == [".pc2scan-files.json", "scan.csv"]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda out: (out / "labels.npz").write_text(MINE), "labels.npz"),
        (lambda out: (out / "deep").mkdir(), "deep"),
        (lambda out: (out / "link").symlink_to(out / "scan.npz"), "link"),
        # As long as before.
        (lambda out: (out / "scan.npz").write_bytes((out / "scan.npz").read_bytes()[::-1]), "scan.npz was changed"),
        (lambda out: (out / ".pc2scan-files.json").unlink(), "scan.npz"),
        (lambda out: (out / ".pc2scan-files.json").write_text("{}"), "scan.npz"),
    ],
)
def test_what_a_user_changes_in_an_exported_folder_stays(
    change: Callable[[Path], Any], named: str, scans: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    pc2scan.export(scans, f"{out}/", format="npz")
    change(out)
    before, folders = contents(out), sorted(out.rglob("*"))
    with pytest.raises(DestinationError, match=named):
        pc2scan.export(scans, f"{out}/", format="csv", overwrite=True)
    assert (contents(out), sorted(out.rglob("*"))) == (before, folders)


def test_a_changed_file_that_is_written_again_is_replaced(scans: Path, tmp_path: Path) -> None:
    pc2scan.export(scans, f"{tmp_path}/out/", format="npz")
    first = contents(tmp_path / "out")
    (tmp_path / "out" / "scan.npz").write_text("broken")
    pc2scan.export(scans, f"{tmp_path}/out/", format="npz", overwrite=True)
    assert contents(tmp_path / "out") == first


# --- Batches ---


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    (tmp_path / "in" / "sub").mkdir(parents=True)
    for name in ("a.bag", "sub/b.bag"):
        shutil.copy(HALL, tmp_path / "in" / name)
    return tmp_path / "in"


def test_results_of_two_recordings_share_no_folder(tmp_path: Path) -> None:
    (tmp_path / "in" / "drive").mkdir(parents=True)
    for name in ("drive.bag", "drive/x.bag"):
        shutil.copy(HALL, tmp_path / "in" / name)
    out = tmp_path / "out"
    found = []
    for beams in (90, 91, 92):
        assert batch(tmp_path / "in", out, export="npz", beams=beams).exit_status == 0
        found.append(sorted(contents(out)))
    assert found[0] == found[1] == found[2]
    assert {"drive_bag/scan.npz", "drive/x/scan.npz"} <= set(found[0])


def test_a_batch_leaves_files_in_its_exported_folders(drives: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert batch(drives, out, export="npz", beams=90).exit_status == 0
    (out / "a" / "deep").mkdir()
    for name in ("labels.npz", "deep/mine.npz"):
        (out / "a" / name).write_text(MINE)
    before = contents(out / "a")
    report = batch(drives, out, export="npz", beams=91)
    assert report.exit_status == 1
    errors = {outcome.key: outcome.error for outcome in report.outcomes}
    assert "deep/mine.npz" in errors["a.bag"]
    assert not errors["sub/b.bag"]
    assert contents(out / "a") == before
    # It is converted as soon as they are away.
    shutil.rmtree(out / "a" / "deep")
    (out / "a" / "labels.npz").unlink()
    assert batch(drives, out, export="npz", beams=91).exit_status == 0


def test_a_manifest_is_the_record_of_older_exports(drives: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert batch(drives, out, export="npz").exit_status == 0
    # As a version wrote them that put no record into folders.
    for record in out.rglob(".pc2scan-files.json"):
        record.unlink()
    os.utime(out / "sub" / "b" / "scan.npz", (1, 1))
    report = batch(drives, out, export="csv")
    assert {outcome.key: outcome.error for outcome in report.outcomes}["a.bag"] == ""
    assert sorted(contents(out / "a")) == [".pc2scan-files.json", "scan.csv"]
    assert sorted(contents(out / "sub")) == ["b/scan.npz"]


def test_a_split_batch_leaves_numbered_files_of_others(drives: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert batch(drives, out, split="100ms").exit_status == 0
    parts = sorted(path.name for path in out.glob("a_scan_*"))
    assert len(parts) == 5
    (out / "a_scan_5.bag").write_text(MINE)
    (out / "a_scan_4.bag").write_text("changed")
    report = batch(drives, out, split="200ms")
    assert report.exit_status == 0
    # Fewer are written: of the others those go that are as they were left.
    assert sorted(path.name for path in out.glob("a_scan_*")) == [f"a_scan_{n}.bag" for n in (0, 1, 2, 4, 5)]
    assert (out / "a_scan_5.bag").read_text() == MINE
    assert (out / "a_scan_4.bag").read_text() == "changed"
    assert sorted(path.name for path in (out / "sub").glob("*")) == [f"b_scan_{n}.bag" for n in range(3)]
    lines = [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()]
    warned = [line["report"]["warnings"] for line in lines if line["key"] == "a.bag"][-1]
    assert any("a_scan_4.bag, a_scan_5.bag" in text for text in warned)
    assert batch(drives, out, split="200ms").unchanged == 2
    # One that would be written over is an error.
    assert batch(drives, out, split="100ms").exit_status == 1
    assert (out / "a_scan_4.bag").read_text() == "changed"
    assert not list(tmp_path.rglob("*.pc2scan-*"))


def test_a_failed_run_forgets_no_numbered_file(drives: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert batch(drives, out, split="100ms").exit_status == 0
    (drives / "a.bag").write_bytes(b"")
    assert batch(drives, out, split="100ms").exit_status == 1
    shutil.copy(HALL, drives / "a.bag")
    assert batch(drives, out, split="200ms").exit_status == 0
    assert len(list(out.glob("a_scan_*"))) == 3


def test_a_batch_that_was_killed_knows_its_numbered_files(
    drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        # Between the renaming of the files and the line in the manifest.
        patch.setattr("pc2scan.batch.run.recorded", killed)
        with pytest.raises(KeyboardInterrupt):
            batch(drives, out, split="100ms")
    assert len(list(out.glob("a_scan_*.bag"))) == 5
    (out / "a_scan_5.bag").write_text(MINE)
    assert batch(drives, out, split="200ms").exit_status == 0
    assert sorted(path.name for path in out.glob("a_scan_*")) == [f"a_scan_{n}.bag" for n in (0, 1, 2, 5)]
    assert not list(tmp_path.rglob("*pc2scan-*"))


@pytest.mark.parametrize("words", [{}, {"split": "100ms"}, {"export": "npz"}, {"to": "rosbag2"}], ids=str)
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_batch_never_writes_through_a_link(
    words: dict[str, Any], overwrite: bool, drives: Path, tmp_path: Path
) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    for folder in (out, elsewhere):
        folder.mkdir()
    (elsewhere / "b_scan.bag").write_text(MINE)
    (out / "sub").symlink_to(elsewhere)
    before = contents(elsewhere)
    report = batch(drives, out, overwrite=overwrite, **words)
    errors = {outcome.key: outcome.error for outcome in report.outcomes}
    assert not errors["a.bag"]
    assert f"through the link {out}/sub" in errors["sub/b.bag"]
    assert contents(elsewhere) == before
    # Nor to a manifest that is one.
    (out / "manifest.jsonl").unlink()
    (elsewhere / "empty").touch()
    (out / "manifest.jsonl").symlink_to(elsewhere / "empty")
    with pytest.raises(DestinationError, match="is a link"):
        batch(drives, out, **words)
    assert (elsewhere / "empty").read_bytes() == b""


def test_results_behind_a_link_that_are_unchanged_are_kept(drives: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert batch(drives, out).exit_status == 0
    (out / "sub").rename(tmp_path / "disk")
    (out / "sub").symlink_to(tmp_path / "disk")
    assert batch(drives, out).unchanged == 2


def test_a_loop_of_links_is_no_recording(drives: Path, tmp_path: Path) -> None:
    (drives / "loop").symlink_to("loop")
    (drives / "sub" / "up").symlink_to("..")
    assert batch(drives, tmp_path / "out").counts == {"converted": 2}
    (drives / "loop.bag").symlink_to("loop.bag")
    report = batch(drives, tmp_path / "out")
    assert {outcome.key: outcome.outcome for outcome in report.outcomes}["loop.bag"] == "failed"


def test_the_note_of_a_killed_batch_goes_with_the_next_run(drives: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert batch(drives, out).exit_status == 0
    note = out / ".pc2scan-begun.json"
    note.write_text('{"pc2scan begun": "1.0", "outputs": ["a_scan.bag", "sub/b_scan.bag"]}\n')
    assert batch(drives, out).unchanged == 2
    assert not note.exists()


def test_a_killed_batch_leaves_empty_folders_of_the_user(drives: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "sub").mkdir(parents=True)
    (out / "made").mkdir()
    (out / ".pc2scan-begun.json").write_text(
        '{"pc2scan begun": "1.0", "outputs": ["sub/b_scan.bag", "made/x.bag"], "folders": ["made"]}\n'
    )
    (drives / "sub" / "b.bag").write_bytes(b"")
    batch(drives, out)
    assert (out / "sub").is_dir()
    assert not (out / "made").exists()


# --- Numbered files ---


@pytest.mark.parametrize("suffix", ["bag", "mcap"])
def test_numbered_files_of_rosbag_stay(suffix: str, tmp_path: Path) -> None:
    for number in (1, 7, 30):
        (tmp_path / f"drive_{number}.{suffix}").write_text(MINE)
    ended = run_command(
        ["convert", str(HALL), "-o", str(tmp_path / f"drive.{suffix}"), *WORDS, "--split", "100s", "--overwrite"]
    )
    assert ended.status == 0, ended.messages
    for number in (1, 7, 30):
        assert (tmp_path / f"drive_{number}.{suffix}").read_text() == MINE
        assert f"drive_{number}.{suffix}" in ended.messages
    assert sorted(contents(tmp_path)) == [f"drive_{number}.{suffix}" for number in (0, 1, 30, 7)]
