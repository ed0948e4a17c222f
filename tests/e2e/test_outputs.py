"""A command writes over nothing of the user's; what is typed and said is in ``tests/transcripts/outputs.txt``."""

from __future__ import annotations

import json
import os
import resource
import shutil
import stat
import subprocess
from itertools import product
from typing import TYPE_CHECKING

import pytest

import pc2scan
from pc2scan.errors import DestinationError
from support import ROOT, sampled
from support.builders import CONTENT, POINTS, T0, Recording, cloud, item, points_of, write_rosbag1, write_rosbag2
from support.command import COMMAND, environment, run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"

#: What each path below a folder is: of a file inode, mode and content, of a link where it leads to.
State = dict[str, tuple[int, int, bytes | str]]


def state_of(folder: Path) -> State:
    found: State = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        content = str(path.readlink()) if path.is_symlink() else path.read_bytes() if path.is_file() else ""
        found[path.relative_to(folder).as_posix()] = (status.st_ino, status.st_mode, content)
    return found


def changed(before: State, folder: Path) -> set[str]:
    after = state_of(folder)
    return {path for path in {*after, *before} if before.get(path) != after.get(path)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What a user has."""
    shutil.copy(HALL, tmp_path / "drive.bag")
    (tmp_path / "thesis.tex").write_text("three years of work")
    return tmp_path


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
        assert not changed(before, folder)


def test_devices_are_not_written_to(folder: Path) -> None:
    """One of its own: where a test fails for root, the system's must not suffer."""
    try:
        os.mknod(folder / "device", 0o600 | stat.S_IFCHR, os.makedev(1, 3))
    except PermissionError:
        pytest.skip("only root may make a device")
    (folder / "link").symlink_to("device")
    before = state_of(folder)
    for name in ("device", "link"):
        for command in ("convert", "repair"):
            done = run(
                command, folder / "drive.bag", "-o", folder / "out.bag", "--report", folder / name, "--overwrite"
            )
            assert (done.status, done.stdout) == (2, "")
            assert "is neither a file nor a directory" in done.stderr
            assert not changed(before, folder)


@pytest.mark.parametrize(
    ("output", "planted", "target"),
    sampled(
        product(
            ("out.bag", "report.json"),
            (".pc2scan-partial", ".pc2scan-partial.lock", ".pc2scan-old"),
            ("thesis.tex", "missing"),
        ),
        7,
    ),
)
def test_links_that_somebody_planted_are_not_followed(output: str, planted: str, target: str, folder: Path) -> None:
    (folder / (output + planted)).symlink_to(target)
    before = state_of(folder)
    done = run("convert", folder / "drive.bag", "-o", folder / "out.bag", "--report", folder / "report.json")
    assert done.status in (0, 2), done.stderr
    assert changed(before, folder) <= {output + planted, "out.bag", "report.json"}
    if planted.endswith(".lock"):
        assert "move it away" in done.stderr


def test_a_report_for_which_there_is_no_room_undoes_nothing(tmp_path: Path) -> None:
    """The recording is there, so the exit status is not 1; the report is not, so it is not 0 either."""
    items = [item(POINTS, T0, lambda g, s: cloud(points_of(s), g, seq=s), 0)]
    # Too many messages to be skipped, each with its reason: a report that is longer than the recording.
    items += [item(POINTS, T0 + n, lambda g, s: cloud(points_of(s), g, seq=s)[:40], n) for n in range(1, 100)]
    source = write_rosbag1(tmp_path / "drive.bag", Recording((POINTS,), tuple(items)))
    output, report = tmp_path / "out.mcap", tmp_path / "report.json"
    call = ["convert", str(source), "-o", str(output), "--only-scans", "--report", str(report)]
    limit = 12_000
    # Python 3.11 cuts the files of compiled modules off at the limit, too, and cannot read them later.
    command = [COMMAND[0], "-B", *COMMAND[1:], *call]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment()
    ) as process:
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (limit, limit))
        stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 3, stderr
    assert f"warning: {report}: the report is not written: cannot be written: File too large" in stderr
    assert f"{output} is" in stderr
    assert "Traceback" not in stderr
    assert "/scan" in stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.bag", "out.mcap"]
    assert run("info", output).status == 0
    # It is for want of room, and of nothing else, that it was not written.
    assert run(*call, "--overwrite").status == 3
    assert report.stat().st_size > limit


def test_a_conversion_that_fails_replaces_only_the_report(folder: Path) -> None:
    report = folder / "report.json"
    assert run("convert", folder / "drive.bag", "-o", folder / "a.bag", "--report", report).status == 0
    before = state_of(folder)
    for status, *options in ((2, "--topic", "/missing"), (1, "--strict", "--target-frame", "nowhere")):
        done = run("convert", folder / "drive.bag", "-o", folder / "b.bag", "--report", report, *map(str, options))
        assert done.status == status
        assert changed(before, folder) == {"report.json"}
        assert json.loads(report.read_text())["exit_status"] == done.status


@pytest.fixture
def cases(folder: Path) -> Path:
    """Two golden cases, the second with an input elsewhere."""
    for name in ("one", "two"):
        (folder / "golden" / name).mkdir(parents=True)
    shutil.copy(HALL, folder / "golden" / "one" / "input.bag")
    (folder / "golden" / "two" / "case.yaml").write_text("input: ../../drive.bag\n")
    assert run("golden", folder / "golden", "--update").status == 0
    return folder / "golden"


def test_links_in_a_golden_folder_are_not_followed(cases: Path) -> None:
    """A folder of cases may be untrusted: it may come with a pull request."""
    folder = cases.parent
    (cases / "one" / "params.yaml").write_text("pointcloud_to_laserscan:\n  ros__parameters:\n    min_height: -0.3\n")
    (cases / "one" / "expected.txt.pc2scan-partial").symlink_to(folder / "thesis.tex")
    (cases / "two" / "expected.txt").unlink()
    (cases / "two" / "expected.txt").symlink_to(folder / "drive.bag")
    before = state_of(folder)
    done = run("golden", cases, "--update")
    assert done.status == 2
    assert "updated one" in done.stdout
    assert "is a file of a case" in done.stdout
    written = "golden/one/expected.txt"
    assert changed(before, folder) == {written, f"{written}.pc2scan-partial"}


def test_the_library_compares_too(tmp_path: Path) -> None:
    source = write_rosbag2(tmp_path / "drive", CONTENT)
    tf = write_rosbag2(tmp_path / "tf", CONTENT)
    with pytest.raises(DestinationError, match="is a file of `tf_from`"):
        pc2scan.convert(source, tf, tf_from=tf, overwrite=True)
