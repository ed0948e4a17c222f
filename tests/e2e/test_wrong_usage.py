"""What people type by mistake, through the real command: an error that says what to type, and nothing on the disk."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import pc2scan
from support import ROOT
from support.command import environment, run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    """A recording of scans, in a folder of its own."""
    path = tmp_path / "source" / "scans.mcap"
    path.parent.mkdir()
    pc2scan.convert(HALL, path, min_height=-0.3)
    return path


def test_new_topics_have_a_leading_slash(tmp_path: Path) -> None:
    done = run("convert", HALL, "-o", tmp_path / "a.mcap", "--topic", "points:=front/scan", "--keep-used", "used")
    assert done.status == 0, done.stderr
    topics = {topic.topic for topic in pc2scan.info(tmp_path / "a.mcap").topics}
    assert {"/front/scan", "/used"} <= topics


@pytest.mark.parametrize("words", [("--keep-used", "my points"), ("--topic", "/points:=/my scan")])
def test_new_topics_have_names_that_ros_can_have(tmp_path: Path, words: tuple[str, str]) -> None:
    done = run("convert", HALL, "-o", tmp_path / "a.mcap", *words)
    assert done.status == 2
    assert f"error: {words[0]}" in done.stderr
    assert "is not a name that a topic can have" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_cell_of_5_m_was_meant_to_be_one_of_5_cm(scans: Path, tmp_path: Path) -> None:
    done = run("map", scans, "--png", tmp_path / "m.png", "--resolution", "5")
    assert done.status == 2
    assert done.stderr.splitlines() == [
        "error: --resolution is 5 m, it must be from 0.001 to 1",
        "hint: for 5 cm write --resolution 0.05",
    ]
    assert run("map", scans, "--png", tmp_path / "m.png", "--resolution", "5cm").status == 0


def test_a_picture_of_a_map_is_a_png(scans: Path, tmp_path: Path) -> None:
    done = run("map", scans, "--png", tmp_path / "m.jpg")
    assert done.status == 2
    assert done.stderr.splitlines()[-1] == "hint: --png m.png"
    assert not (tmp_path / "m.jpg").exists()


def test_one_is_not_several(tmp_path: Path) -> None:
    done = run("convert", HALL, "-o", tmp_path / "a.mcap", "--end", "0.05", "--min-height", "90", "--max-height", "91")
    assert "1 of 1 scan on /scan has no return at all" in " ".join(done.stderr.split())
    done = run("batch", HALL, "-o", tmp_path / "out", "--min-height", "-0.3")
    assert "1 recordings" not in done.stdout + done.stderr
    assert "1 recording" in done.stderr


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (("convert", "drive.bag", "--min-hieght", "0"), "did you mean --min-height or --max-height"),
        (("convert", "drive.bag", "--min_height", "0"), "did you mean --min-height?"),
        (("convert", "drive.bag", "--json"), "--report report.json writes a report as JSON"),
        (("drive.bag",), "the command comes first: pc2scan info drive.bag"),
        (("convert", "-drive.bag"), "for the file of this name, type ./-drive.bag"),
        (("convert", "gone.bag"), "it is a link to nowhere.bag, which does not exist"),
        (("convert", "-"), "recordings cannot be read from a pipe; save it as a file first"),
        (("convert", "drive.bag", "-o", "-"), "name a file: -o scans.mcap"),
        (("view", "drive.bag", "-o", "page.pdf"), "pages are HTML: page.html; pc2scan plot draws figures"),
        (("view", "drive.bag", "-o", "page.html", "--at", "99"), "--at 0 to --at 0.405 are in it"),
        (("diff", "drive.bag", "-drive.bag", "--view", "page"), "for the file of this name, type ./-drive.bag"),
        (("diff", "drive.bag", "./-drive.bag", "--view", "page"), "pages are HTML: page.html"),
        (("export", "drive.bag", "-o", "clouds.pcd"), "a file for each cloud, in a folder: -o clouds/, --format pcd"),
        (("batch",), "pc2scan batch --help shows what it takes"),
        (("convert", "drive.bag", "-o", "my scans/a.bag"), "create it: mkdir -p 'my scans'"),
    ],
)
def test_the_hint_is_what_to_type(tmp_path: Path, words: tuple[str, ...], hint: str) -> None:
    for name in ("drive.bag", "-drive.bag"):
        shutil.copy(HALL, tmp_path / name)
    (tmp_path / "gone.bag").symlink_to("nowhere.bag")
    before = sorted(tmp_path.iterdir())
    done = run(*words, cwd=tmp_path)
    assert done.status == 2
    assert f"hint: {hint}" in done.stderr
    assert sorted(tmp_path.iterdir()) == before


def test_a_fixed_frame_is_not_called_the_target_frame(tmp_path: Path) -> None:
    done = run("convert", HALL, "-o", tmp_path / "a.bag", "--deskew", "--fixed-frame", "map")
    assert done.status == 2
    assert "--fixed-frame is 'map', which is in no transform" in done.stderr


def test_a_server_that_is_not_there_is_not_a_file_that_is_not_there(tmp_path: Path) -> None:
    pytest.importorskip("aiohttp")
    done = run("convert", "https://127.0.0.1:1/drive.bag", "-o", tmp_path / "a.bag")
    assert done.status == 1
    assert "the host cannot be reached" in done.stderr


def test_a_failed_recording_of_a_batch_is_not_counted_as_converted(tmp_path: Path) -> None:
    broken = tmp_path / "broken.bag"
    broken.write_bytes(HALL.read_bytes()[:100])
    done = run("batch", HALL, broken, "-o", tmp_path / "out", "--min-height", "-0.3")
    assert done.status == 1
    assert "2 recordings: 1 failed, 1 converted" in done.stdout
    assert "1 converted now" in done.stdout


#: Root may read and write all files, whatever their permissions.
WITHOUT_RIGHTS = (
    "setpriv",
    "--bounding-set=-dac_override,-dac_read_search",
    "--inh-caps=-dac_override,-dac_read_search",
)


@pytest.mark.skipif(sys.platform != "linux" or shutil.which("setpriv") is None, reason="setpriv is not there")
def test_what_may_not_be_read_or_written(tmp_path: Path) -> None:
    folder, secret = tmp_path / "folder", tmp_path / "secret.bag"
    folder.mkdir()
    shutil.copy(HALL, folder / "hall.bag")
    shutil.copy(HALL, secret)
    folder.chmod(0o555)
    secret.chmod(0)
    user = WITHOUT_RIGHTS if os.getuid() == 0 else ()
    try:
        for words, error in (
            (("info", secret), f"error: {secret}: permission denied\nhint: ls -l shows who owns it"),
            (("convert", folder / "hall.bag"), f"error: {folder}/hall_scan.bag: its directory is not writable\nhint: "),
        ):
            command = [*user, sys.executable, "-m", "pc2scan", *map(str, words)]
            done = subprocess.run(command, capture_output=True, text=True, env=environment(), check=False)
            assert done.returncode in (1, 2)
            assert done.stderr.startswith(error)
    finally:
        folder.chmod(0o755)
