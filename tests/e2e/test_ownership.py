"""A run replaces what it writes, and removes what a record of an earlier run names; everything else stays."""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.errors import DestinationError, UsageError
from support import ROOT, sampled
from support.batches import batch, contents, manifest_of
from support.command import run

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"
HEIGHTS: dict[str, Any] = {"min_height": -0.3, "only_scans": True}
WORDS = ("--min-height", "-0.3", "--only-scans")
MINE = "three years of work"


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


ROLES = ("source", "second source", "tf_from")


@pytest.mark.parametrize(("how", "name"), sampled([(how, name) for how in ROLES for name in NAMES], 16))
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
    ended = run(*words.format(d=drive).split())
    assert ended.status == 2, ended.stderr
    assert contents(drive) == before


@pytest.mark.parametrize(
    ("url", "name"),
    [
        ("file://{d}/a b.bag", "a b.bag"),
        ("file://{d}/a%20b%25.bag", "a b%.bag"),
        ("file://localhost{d}/x.bag", "x.bag"),
        ("file:{d}/x.bag", "x.bag"),
        ("FILE://{d}/x.bag", "x.bag"),
        ("file:///{d}/x.bag", "x.bag"),
        ("file://{d}/%C3%A9.bag", "é.bag"),
        ("file:x.bag", "file:x.bag"),
    ],
)
def test_file_urls_are_read_as_their_standard_says(
    url: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert pc2scan.convert(HALL, url.format(d=tmp_path), **HEIGHTS).exit_status == 0
    assert [path.name for path in tmp_path.iterdir()] == [name]


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
    for name in (f"logs/mine.{suffix}", f"below/deep/mine.{suffix}"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text(MINE)
    before = contents(tmp_path)
    for folder in ("logs", "below"):
        with pytest.raises(DestinationError, match=f"mine.{suffix}|deep") as caught:
            pc2scan.export(source, f"{tmp_path}/{folder}/", format=form, overwrite=True)
        assert "rm -r" in (caught.value.hint or "")
    assert contents(tmp_path) == before


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


# --- Batches; `test_done_again` and `test_ownership_random` have their rules, `test_manifest` the note of a kill ---


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
    errors = errors_of(batch(drives, out, overwrite=overwrite, **words))
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
    assert errors_of(batch(drives, tmp_path / "out"))["loop.bag"]
    # Nor does it end other commands with a traceback.
    ended = run("convert", "--each", drives, "-o", f"{tmp_path}/each/", *WORDS)
    assert (ended.status, "loop.bag: cannot be read" in ended.stderr) == (1, True)


# --- Numbered files ---


@pytest.mark.parametrize("suffix", ["bag", "mcap"])
def test_numbered_files_of_rosbag_stay(suffix: str, tmp_path: Path) -> None:
    for number in (1, 7, 30):
        (tmp_path / f"drive_{number}.{suffix}").write_text(MINE)
    ended = run("convert", HALL, "-o", tmp_path / f"drive.{suffix}", *WORDS, "--split", "100s", "--overwrite")
    assert ended.status == 0, ended.stderr
    for number in (1, 7, 30):
        assert (tmp_path / f"drive_{number}.{suffix}").read_text() == MINE
        assert f"drive_{number}.{suffix}" in ended.stderr
    assert sorted(contents(tmp_path)) == [f"drive_{number}.{suffix}" for number in (0, 1, 30, 7)]
