"""A command writes over nothing of the user's: not what it reads, and no file that it did not make."""

from __future__ import annotations

import json
import os
import resource
import shlex
import shutil
import stat
import subprocess
import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING

import pytest

import pc2scan
from pc2scan.errors import DestinationError
from pc2scan.tf.options import FrameOptions
from support import ROOT
from support.builders import CONTENT, POINTS, T0, Recording, cloud, item, points_of, write_rosbag1, write_rosbag2
from support.command import COMMAND, environment, run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"
HALL_MCAP = ROOT / "fixtures" / "hall.mcap"
HALL_FOLDER = ROOT / "fixtures" / "hall"
PARAMS = "pointcloud_to_laserscan:\n  ros__parameters:\n    min_height: -0.3\n"
TRANSFORMS = '- "map odom 0 0 0 0 0 0 1"\n'

#: What each path below a folder is: of a file inode, mode and content, of a link where it leads to.
State = dict[str, tuple[int, int, bytes | str]]


def state_of(folder: Path) -> State:
    found: State = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        content = str(path.readlink()) if path.is_symlink() else path.read_bytes() if path.is_file() else ""
        found[path.relative_to(folder).as_posix()] = (status.st_ino, status.st_mode, content)
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What a user has: recordings, parameters, transforms, a thesis, and links."""
    shutil.copy(HALL, tmp_path / "drive.bag")
    shutil.copy(HALL_MCAP, tmp_path / "tf.mcap")
    shutil.copytree(HALL_FOLDER, tmp_path / "drive")
    (tmp_path / "params").write_text(PARAMS)
    (tmp_path / "static").write_text(TRANSFORMS)
    (tmp_path / "thesis.tex").write_text("three years of work")
    (tmp_path / "link.bag").symlink_to("drive.bag")
    os.link(tmp_path / "drive.bag", tmp_path / "hard.bag")
    (tmp_path / "here").symlink_to(".")
    return tmp_path


# --- What is left of a run that was killed ---


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "out"])
def test_what_a_killed_run_left_may_be_read(name: str, tmp_path: Path) -> None:
    """The first thing that one tries; it was deleted."""
    left = tmp_path / f"{name}.pc2scan-partial"
    if name == "out":
        shutil.copytree(HALL_FOLDER, left)
    else:
        left.write_bytes((HALL if name == "out.bag" else HALL_MCAP).read_bytes()[:200_000])
    before = state_of(tmp_path)
    for command in ("repair", "convert"):
        refused = run(command, left, "-o", tmp_path / name, "--overwrite")
        assert refused.status == 2
        assert "is a source" in refused.stderr
        assert state_of(tmp_path) == before
    assert run("info", tmp_path / name).stderr.splitlines()[1].endswith(f"pc2scan repair {left}")
    assert run("info", left).status in (0, 3)
    # Without a destination it works, and so does what the error says is to be typed.
    assert run("repair", left).status in (0, 3)
    assert (tmp_path / name.replace("out", "out_repaired")).exists()
    rename = refused.stderr[refused.stderr.index("(mv ") + 1 : refused.stderr.rindex(")")]
    subprocess.run(shlex.split(rename), check=True)
    done = run("repair", tmp_path / f"interrupted_{name}", "-o", tmp_path / name)
    assert done.status in (0, 3), done.stderr
    assert (tmp_path / name).exists()


def test_what_a_killed_run_set_aside_may_be_read(tmp_path: Path) -> None:
    left = tmp_path / "out.pc2scan-old"
    shutil.copytree(HALL_FOLDER, left)
    before = state_of(tmp_path)
    refused = run("convert", left, "-o", tmp_path / "out", "--overwrite")
    assert refused.status == 2
    assert "needs the name out.pc2scan-old while it is written, which is a source" in refused.stderr
    told = run("info", tmp_path / "out")
    assert told.status == 2
    assert f"mv {left} {tmp_path / 'out'}" in told.stderr
    assert state_of(tmp_path) == before


def test_names_that_are_as_long_as_they_can_be(folder: Path) -> None:
    """With an ending they are too long, to be looked for and to be written."""
    longest = folder / f"{'x' * 251}.bag"
    missing = run("info", longest)
    assert (missing.status, missing.stderr.splitlines()[0]) == (2, f"error: {longest}: does not exist")
    before = state_of(folder)
    for options in (("-o", longest), ("-o", folder / "out.bag", "--report", longest)):
        done = run("convert", folder / "drive.bag", *options)
        assert done.status in (1, 2)
        assert done.stderr.startswith("error: ")
        assert "Traceback" not in done.stderr
        assert state_of(folder) == before


@pytest.mark.parametrize("kind", ["link", "hard link", "in it", "--tf-from"])
def test_an_input_that_leads_to_what_a_killed_run_left(kind: str, tmp_path: Path) -> None:
    left = tmp_path / "out.bag.pc2scan-partial"
    source = tmp_path / "source.bag"
    options: list[Path | str] = []
    if kind == "in it":
        left.mkdir()
        source = left / "drive.bag"
        shutil.copy(HALL, source)
    else:
        shutil.copy(HALL, left)
    if kind == "link":
        source.symlink_to(left)
    if kind == "hard link":
        source.hardlink_to(left)
    if kind == "--tf-from":
        shutil.copy(HALL, source)
        options = ["--tf-from", left]
    before = state_of(tmp_path)
    done = run("convert", source, "-o", tmp_path / "out.bag", *options)
    assert (done.status, done.stdout) == (2, "")
    assert "needs the name out.bag.pc2scan-partial while it is written" in done.stderr
    assert state_of(tmp_path) == before


# --- An output that is an input ---


@pytest.mark.parametrize("option", ["--tf-from", "--params-file", "--static-tf-file"])
@pytest.mark.parametrize("link", [False, True])
def test_the_destination_is_the_file_of_an_option(option: str, link: bool, folder: Path) -> None:
    name = {"--tf-from": "tf.mcap", "--params-file": "params", "--static-tf-file": "static"}[option]
    given = folder / ("here" if link else "") / name
    before = state_of(folder)
    done = run("convert", folder / "drive.bag", option, given, "-o", folder / name, "--overwrite")
    assert (done.status, done.stdout) == (2, "")
    assert f"is a file of {option}" in done.stderr
    assert state_of(folder) == before


def test_the_destination_is_one_of_several_sources(folder: Path) -> None:
    shutil.copy(HALL, folder / "second.bag")
    before = state_of(folder)
    done = run("convert", folder / "second.bag", folder / "drive.bag", "-o", folder / "hard.bag", "--overwrite")
    assert done.status == 2
    assert "is a source" in done.stderr
    assert state_of(folder) == before


def test_the_destination_is_a_log_of_the_source(folder: Path) -> None:
    """As a folder of that name it was no database's log any more, and its messages were lost."""
    (folder / "drive" / "hall_0.db3-wal").write_bytes(b"rows")
    (folder / "x").symlink_to(folder / "drive" / "hall_0.db3-wal")
    before = state_of(folder)
    for destination in (folder / "drive" / "hall_0.db3-wal", folder / "x"):
        done = run("convert", folder / "drive" / "hall_0.db3", "-o", destination, "--overwrite")
        assert done.status == 2, done.stderr
        assert "is a source" in done.stderr
    assert state_of(folder) == before


def test_a_folder_of_links_is_where_they_lead_to(folder: Path) -> None:
    recording = folder / "linked"
    recording.mkdir()
    (recording / "hall_0.mcap").symlink_to(folder / "tf.mcap")
    before = state_of(folder)
    done = run("convert", recording, "-o", folder / "tf.mcap", "--overwrite")
    assert done.status == 2
    assert "is a source" in done.stderr
    assert state_of(folder) == before


# --- Reports ---

REFUSED_REPORTS = {
    "the source": ("drive.bag", "is a source"),
    "a link to the source": ("link.bag", "is a source"),
    "a hard link to the source": ("hard.bag", "is a source"),
    "the source by another way": ("here/drive.bag", "is a source"),
    "the destination": ("out.bag", "is the destination"),
    "the destination by another way": ("here/out.bag", "is the destination"),
    "the destination's lock": ("out.bag.pc2scan-partial.lock", "is the destination"),
    "where the destination is written": ("out.bag.pc2scan-partial", "is the destination"),
    "a folder": ("drive", "it is a directory"),
    "no folder": ("missing/report.json", "its directory does not exist"),
    "a device": ("device", "it is not a file"),
    "a link to a device": ("link", "it is not a file"),
    "standard output": ("/proc/self/fd/1", "holds devices"),
    "a fifo": ("fifo", "it is not a file"),
}


def make_device(path: Path) -> None:
    """A device of its own: where a test fails for root, the system's must not suffer."""
    try:
        os.mknod(path, 0o600 | stat.S_IFCHR, os.makedev(1, 3))
    except PermissionError:
        pytest.skip("only root may make a device")


@pytest.mark.parametrize("kind", REFUSED_REPORTS)
@pytest.mark.parametrize("command", ["convert", "repair"])
def test_a_report_that_may_not_be_there(command: str, kind: str, folder: Path) -> None:
    """Not even with --overwrite; and it is known before anything is written."""
    name, told = REFUSED_REPORTS[kind]
    os.mkfifo(folder / "fifo")
    if "device" in kind:
        make_device(folder / "device")
    (folder / "link").symlink_to("device")
    before = state_of(folder)
    done = run(
        command, folder / "drive.bag", "-o", folder / "out.bag", "--report", folder / name, "--overwrite", "--quiet"
    )
    assert (done.status, done.stdout) == (2, ""), done.stderr
    assert told in done.stderr
    assert "report" in done.stderr
    assert state_of(folder) == before


@pytest.mark.parametrize("command", ["convert", "repair"])
def test_the_report_is_the_destination_that_nobody_named(command: str, folder: Path) -> None:
    name = {"convert": "drive_scan.bag", "repair": "drive_repaired.bag"}[command]
    before = state_of(folder)
    done = run(command, folder / "drive.bag", "--report", folder / name)
    assert done.status == 2
    assert "the file of --report is the destination" in done.stderr
    assert state_of(folder) == before


@pytest.mark.parametrize("option", ["--tf-from", "--params-file", "--static-tf-file"])
def test_a_report_over_the_file_of_an_option(option: str, folder: Path) -> None:
    name = {"--tf-from": "tf.mcap", "--params-file": "params", "--static-tf-file": "static"}[option]
    before = state_of(folder)
    output = ("-o", folder / "out.bag", "--overwrite")
    done = run("convert", folder / "drive.bag", option, folder / name, "--report", folder / name, *output)
    assert done.status == 2
    assert f"the file of --report is a file of {option}" in done.stderr
    assert state_of(folder) == before


@pytest.mark.parametrize("name", ["thesis.tex", "tf.mcap", "thesis"])
@pytest.mark.parametrize("command", ["convert", "repair"])
def test_a_report_replaces_other_files_only_if_asked(command: str, name: str, folder: Path) -> None:
    (folder / "thesis").symlink_to("thesis.tex")
    before = state_of(folder)
    call = (command, folder / "drive.bag", "-o", folder / "out.bag", "--report", folder / name)
    refused = run(*call)
    assert (refused.status, refused.stdout) == (2, "")
    assert "the report cannot be written there: exists already, and was not written by pc2scan" in refused.stderr
    assert "--overwrite" in refused.stderr
    assert state_of(folder) == before
    done = run(*call, "--overwrite")
    assert done.status == 0, done.stderr
    assert json.loads((folder / name).read_text())["exit_status"] == 0
    after = state_of(folder)
    # Of a link the link is replaced, and what it leads to stays.
    assert {path for path in after if before.get(path) != after[path]} == {name, "out.bag"}


@pytest.mark.parametrize("command", ["convert", "repair"])
def test_a_report_replaces_a_report_and_an_empty_file(command: str, folder: Path) -> None:
    report = folder / "report.json"
    report.touch()
    for name in ("a.bag", "b.bag"):
        done = run(command, folder / "drive.bag", "-o", folder / name, "--report", report)
        assert done.status == 0, done.stderr
        assert json.loads(report.read_text())["destination"] == str(folder / name)


@pytest.mark.parametrize("target", ["thesis.tex", "missing"])
@pytest.mark.parametrize("planted", [".pc2scan-partial", ".pc2scan-partial.lock", ".pc2scan-old"])
@pytest.mark.parametrize("output", ["out.bag", "report.json"])
def test_links_that_somebody_planted_are_not_followed(output: str, planted: str, target: str, folder: Path) -> None:
    (folder / (output + planted)).symlink_to(target)
    before = state_of(folder)
    done = run("convert", folder / "drive.bag", "-o", folder / "out.bag", "--report", folder / "report.json")
    assert done.status in (0, 2), done.stderr
    after = state_of(folder)
    ours = {output + planted, "out.bag", "report.json"}
    assert {path for path in {*after, *before} if before.get(path) != after.get(path)} <= ours
    if planted.endswith(".lock"):
        assert "move it away" in done.stderr


def test_a_lock_that_is_something_else(folder: Path) -> None:
    (folder / "out.bag.pc2scan-partial.lock").write_text("diary")
    before = state_of(folder)
    done = run("convert", folder / "drive.bag", "-o", folder / "out.bag")
    assert done.status == 2
    assert "move it away" in done.stderr
    assert state_of(folder) == before


def test_a_report_for_which_there_is_no_room_undoes_nothing(tmp_path: Path) -> None:
    """The recording is there, so the exit status is not 1; the report is not, so it is not 0 either."""
    items = [item(POINTS, T0, lambda g, s: cloud(points_of(s), g, seq=s), 0)]
    # Too many messages to be skipped, each with its reason: a report that is longer than the recording.
    items += [item(POINTS, T0 + n, lambda g, s: cloud(points_of(s), g, seq=s)[:40], n) for n in range(1, 100)]
    source = write_rosbag1(tmp_path / "drive.bag", Recording((POINTS,), tuple(items)))
    output = tmp_path / "out.mcap"
    call = ["convert", str(source), "-o", str(output), "--only-scans", "--report", str(tmp_path / "report.json")]
    limit = 12_000
    # Python would keep compiled modules that the limit cuts off.
    env = environment() | {"PYTHONDONTWRITEBYTECODE": "1"}
    with subprocess.Popen(
        [*COMMAND, *call], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env
    ) as process:
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (limit, limit))
        stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 3, stderr
    assert (
        f"warning: {tmp_path / 'report.json'}: the report is not written: cannot be written: File too large" in stderr
    )
    assert f"{output} is" in stderr
    assert "Traceback" not in stderr
    assert "/scan" in stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.bag", "out.mcap"]
    assert run("info", output).status == 0
    # It is for want of room, and of nothing else, that it was not written.
    assert run(*call, "--overwrite").status == 3
    assert (tmp_path / "report.json").stat().st_size > limit


def test_a_conversion_that_fails_replaces_the_report_and_nothing_else(folder: Path) -> None:
    report = folder / "report.json"
    assert run("convert", folder / "drive.bag", "-o", folder / "a.bag", "--report", report).status == 0
    before = state_of(folder)
    del before["report.json"]
    for status, *options in ((2, "--topic", "/missing"), (1, "--on-error", "fail", "--target-frame", "nowhere")):
        done = run("convert", folder / "drive.bag", "-o", folder / "b.bag", "--report", report, *map(str, options))
        assert done.status == status
        after = state_of(folder)
        del after["report.json"]
        assert after == before
        assert json.loads(report.read_text())["exit_status"] == done.status


# --- Golden cases ---


@pytest.fixture
def cases(folder: Path) -> Path:
    """Two cases, the second with an input elsewhere."""
    for name in ("one", "two"):
        (folder / "golden" / name).mkdir(parents=True)
    shutil.copy(HALL, folder / "golden" / "one" / "input.bag")
    long = f"/points:={'/scan' * 99}"
    settings = f"input: ../../drive.bag\narguments: [--tf-from, {folder / 'tf.mcap'}, --topic, {long}]\n"
    (folder / "golden" / "two" / "case.yaml").write_text(settings)
    assert run("golden", folder / "golden", "--update").status == 0
    return folder / "golden"


JUNIT = {
    "an input": ("golden/one/input.bag", "is a file of a case"),
    "a link to an input": ("link.bag", "is a file of a case"),
    "an input elsewhere": ("drive.bag", "is a file of a case"),
    "settings": ("golden/two/case.yaml", "is a file of a case"),
    "the expected output": ("golden/one/expected.txt", "is a file of a case"),
    "the file of an argument": ("tf.mcap", "is a file of a case"),
    "a folder": ("drive", "it is a directory"),
    "no folder": ("missing/junit.xml", "its directory does not exist"),
    "a device": ("device", "it is not a file"),
}


@pytest.mark.parametrize("kind", JUNIT)
def test_junit_xml_that_may_not_be_there(kind: str, cases: Path) -> None:
    name, told = JUNIT[kind]
    folder = cases.parent
    if "device" in kind:
        make_device(folder / "device")
    before = state_of(folder)
    done = run("golden", cases, "--junit", folder / name, "--overwrite")
    assert (done.status, done.stdout) == (2, "")
    assert told in done.stderr
    assert state_of(folder) == before


def test_junit_xml_replaces_other_files_only_if_asked(cases: Path) -> None:
    folder = cases.parent
    before = state_of(folder)
    refused = run("golden", cases, "--junit", folder / "thesis.tex")
    assert (refused.status, refused.stdout) == (2, "")
    assert "--overwrite" in refused.stderr
    assert state_of(folder) == before
    assert run("golden", cases, "--junit", folder / "thesis.tex", "--overwrite").status == 0
    # Now it is one of ours.
    assert run("golden", cases, "--junit", folder / "thesis.tex").status == 0
    (suite,) = ET.parse(folder / "thesis.tex").getroot()
    assert len(suite) == 2


def test_links_in_a_golden_folder_are_not_followed(cases: Path) -> None:
    """A folder of cases may be untrusted: it may come with a pull request."""
    folder = cases.parent
    (cases / "one" / "params.yaml").write_text(PARAMS)
    (cases / "one" / "expected.txt.pc2scan-partial").symlink_to(folder / "thesis.tex")
    (cases / "junit.xml.pc2scan-partial").symlink_to(folder / "thesis.tex")
    (cases / "two" / "expected.txt").unlink()
    (cases / "two" / "expected.txt").symlink_to(folder / "drive.bag")
    before = state_of(folder)
    done = run("golden", cases, "--update", "--junit", cases / "junit.xml")
    assert done.status == 2
    assert "updated one" in done.stdout
    assert "is a file of a case" in done.stdout
    after = state_of(folder)
    changed = {path for path in {*after, *before} if before.get(path) != after.get(path)}
    assert changed == {
        "golden/one/expected.txt",
        "golden/one/expected.txt.pc2scan-partial",
        "golden/junit.xml",
        "golden/junit.xml.pc2scan-partial",
    }


def test_results_are_shown_though_their_file_cannot_be_written(cases: Path) -> None:
    change = f"import shutil; shutil.rmtree({str(cases.parent / 'results')!r})"
    (cases.parent / "results").mkdir()
    program = f"from pc2scan.files import junit; junit.junit_xml = lambda *_: exec({change!r}) or ''\n"
    program += "from pc2scan.cli import main; main()"
    junit = cases.parent / "results" / "junit.xml"
    command = [COMMAND[0], "-c", program, "golden", str(cases), "--junit", str(junit)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment(), check=False)
    assert done.returncode == 2
    assert "2 passed" in done.stdout
    assert f"error: {junit}: cannot be" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_library_compares_too(tmp_path: Path) -> None:
    source = write_rosbag2(tmp_path / "drive", CONTENT)
    tf = write_rosbag2(tmp_path / "tf", CONTENT)
    with pytest.raises(DestinationError, match="is a file of `tf_from`"):
        pc2scan.convert(source, tf, frames=FrameOptions(tf_from=(tf,)), overwrite=True)
