"""``pc2scan batch``: whole datasets, killed and continued, and what it may and may not touch."""

from __future__ import annotations

import csv
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from typer.testing import CliRunner

import pc2scan
from batch.datasets import HEIGHTS, contents, make_dataset
from pc2scan.cli.app import application
from support.builders import CONTENT, write_mcap, write_rosbag1, write_rosbag2
from support.command import COMMAND, environment, run
from support.terminal import shown

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and locks of POSIX")


def manifest_of(folder: Path) -> dict[str, dict[str, Any]]:
    """The last line of each recording; a line without its end is ignored, as the command does."""
    path = folder / "manifest.jsonl"
    data = path.read_bytes() if path.exists() else b""
    lines = [json.loads(line) for line in data.split(b"\n")[:-1]]
    return {line["key"]: line for line in lines}


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    """Three recordings."""
    folder = tmp_path / "drives"
    (folder / "robot1").mkdir(parents=True)
    write_rosbag1(folder / "a.bag", CONTENT)
    write_mcap(folder / "b.mcap", CONTENT)
    write_rosbag1(folder / "robot1" / "a.bag", CONTENT)
    return folder


# --- A whole dataset ---


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    folder = tmp_path_factory.mktemp("dataset") / "recordings"
    return folder, make_dataset(folder)


def test_200_recordings_killed_five_times(dataset: tuple[Path, dict[str, str]], tmp_path: Path) -> None:
    folder, expected = dataset
    before = contents(folder)
    clean = tmp_path / "clean"
    done = run("batch", folder, "-o", clean, *HEIGHTS, "--quiet")
    assert done.status == 1, done.stderr
    assert {key: line["outcome"] for key, line in manifest_of(clean).items()} == expected
    written = {line["output"]["path"] for line in manifest_of(clean).values() if line["report"]}
    assert len(written) == sum(outcome in ("converted", "incomplete") for outcome in expected.values())

    killed = tmp_path / "killed"
    choice = random.Random(16)
    command = [*COMMAND, "batch", str(folder), "-o", str(killed), *HEIGHTS, "--quiet"]
    kills = 0
    while kills < 5:
        goal = len(manifest_of(killed)) + choice.randrange(1, 30)
        process = subprocess.Popen(
            command, env=environment(), stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True
        )
        while process.poll() is None and len(manifest_of(killed)) < goal:
            time.sleep(0.003)
        time.sleep(choice.uniform(0, 0.05))
        assert process.poll() is None, "the run ended before it could be killed"
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        kills += 1
    assert 0 < len(manifest_of(killed)) < len(expected)
    done = run(*command[len(COMMAND) :])
    assert done.status == 1, done.stderr
    assert {key: line["outcome"] for key, line in manifest_of(killed).items()} == expected
    assert contents(killed) == contents(clean)
    # Empty folders neither.
    assert {str(path.relative_to(killed)) for path in killed.rglob("*")} == {
        str(path.relative_to(clean)) for path in clean.rglob("*")
    }
    assert contents(folder) == before

    # What failed is tried again; nothing else.
    again = run("batch", folder, "-o", killed, *HEIGHTS)
    failing = sum(outcome == "failed" for outcome in expected.values())
    assert f"{len(expected) - failing} unchanged" in again.stderr
    assert contents(killed) == contents(clean)


# --- What is done again, and why ---


def lines_of(stderr: str) -> list[str]:
    return [line for line in stderr.splitlines() if " -> " in line]


def plan_of(stderr: str) -> str:
    return stderr.splitlines()[0]


def test_a_second_run_does_what_is_missing_changed_or_failed(drives: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"

    def again(*more: str | Path) -> str:
        # In this process, which has everything loaded.
        done = CliRunner().invoke(
            application("batch"), ["batch", str(drives), "-o", str(out), *HEIGHTS, *map(str, more)]
        )
        assert done.exit_code == 0, done.stderr
        return plan_of(done.stderr)

    assert "3 to convert" in again()
    size = (out / "manifest.jsonl").stat().st_size
    assert again() == "3 recordings: 0 to convert (0 B), 3 unchanged"
    assert (out / "manifest.jsonl").stat().st_size == size
    (out / "a_scan.bag").unlink()
    assert "1 its output is missing" in again()
    with (out / "b_scan.mcap").open("ab") as file:
        file.write(b"x")
    assert "1 its output was changed" in again()
    os.utime(drives / "a.bag", ns=(1, 1))
    assert "1 the source was changed" in again()
    os.utime(drives / "a.bag", ns=(2, 2))
    assert "1 the source was changed" in again("--checksum")
    os.utime(drives / "a.bag", ns=(3, 3))
    assert "3 unchanged" in again("--checksum")
    assert "3 other options" in again("--range-max", "20")
    assert "3 unchanged" in again("--range-max", "20", "--jobs", "1")
    assert "3 forced" in again("--range-max", "20", "--force")
    write_mcap(drives / "new.mcap", CONTENT)
    assert "1 to convert" in again("--range-max", "20")


def test_a_dry_run_writes_nothing(drives: Path, tmp_path: Path) -> None:
    (drives / "c.bag").write_bytes(b"")
    done = run("batch", drives, "-o", tmp_path / "out", *HEIGHTS, "--dry-run")
    assert done.status == 1
    assert "3 to convert" in done.stderr
    assert "failed: c.bag: is empty" in done.stderr
    assert "would be converted: a.bag -> a_scan.bag" in done.stderr
    assert "written would be about" in done.stdout
    assert not (tmp_path / "out").exists()


def test_a_dry_run_does_not_count_what_has_no_index(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    write_rosbag1(tmp_path / "in" / "whole.bag", CONTENT)
    whole = (tmp_path / "in" / "whole.bag").read_bytes()
    (tmp_path / "in" / "cut.bag").write_bytes(whole[: len(whole) // 2])
    done = run("batch", tmp_path / "in", "-o", tmp_path / "out", *HEIGHTS, "--dry-run")
    lines = {line.split()[3]: line for line in done.stderr.splitlines() if " -> " in line}
    assert "scans not counted" in lines["cut.bag"]
    assert "scans not counted" not in lines["whole.bag"]


def test_nothing_is_opened_that_is_known(drives: Path, tmp_path: Path) -> None:
    """A run without anything to do takes a second for a thousand recordings: none of them is read."""
    write_rosbag2(drives / "c", CONTENT)
    for number, part in enumerate(CONTENT.halves()):
        write_mcap(drives / "robot1" / f"drive_{number}.mcap", part)
    out = tmp_path / "out"
    assert run("batch", drives, "-o", out, *HEIGHTS).status == 0
    code = (
        "import sys\n"
        "opened = []\n"
        "sys.addaudithook(lambda event, args: opened.append(str(args[0])) if event == 'open' else None)\n"
        "import pc2scan\n"
        f"report = pc2scan.batch({str(drives)!r}, {str(out)!r}, min_height=-2, max_height=2)\n"
        f"print([path for path in opened if path.startswith({str(drives)!r})])\n"
        "print(report.unchanged, [name for name in ('rosbags', 'mcap', 'zstandard', 'lz4') if name in sys.modules])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment(), timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["[]", "5 []"]


# --- Processes ---


def workers_of(process: subprocess.Popen[bytes]) -> list[int]:
    """The worker processes of a batch."""
    children = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True, check=False
    )
    return [int(pid) for pid in children.stdout.split()]


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording whose conversion takes seconds: of a great many beams."""
    folder = tmp_path_factory.mktemp("slow") / "drives"
    folder.mkdir()
    write_rosbag1(folder / "a.bag", CONTENT)
    write_rosbag1(folder / "b.bag", CONTENT)
    return folder


SLOW = (*HEIGHTS, "--angle-increment", "0.000002", "--compression", "bz2")


@pytest.fixture
def running(slow: Path, tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """A batch of long conversions, when both have begun to write."""
    out = tmp_path / "out"
    command = [*COMMAND, "batch", str(slow), "-o", str(out), *SLOW, "--jobs", "2"]
    process = subprocess.Popen(
        command,
        env=environment(),
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60
    while len(list(out.glob("*.pc2scan-partial"))) < 2:
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.01)
    with process:
        yield process, out
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)


def is_running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def assert_ended(pids: list[int], seconds: float = 15) -> None:
    deadline = time.monotonic() + seconds
    while any(map(is_running, pids)):
        assert time.monotonic() < deadline, "a worker is still there"
        time.sleep(0.02)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_leaves_nothing_half(running: tuple[subprocess.Popen[bytes], Path], number: int) -> None:
    process, out = running
    workers = workers_of(process)
    assert len(workers) == 2
    process.send_signal(number)
    _, stderr = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert b"Traceback" not in stderr
    assert (b"nothing was written" in stderr, b"the same command again" in stderr) == (True, number == signal.SIGINT)
    assert_ended(workers)
    assert not out.exists()


def test_workers_end_when_the_parent_is_killed(running: tuple[subprocess.Popen[bytes], Path], slow: Path) -> None:
    process, out = running
    workers = workers_of(process)
    assert len(workers) == 2
    process.kill()
    process.wait()
    # Another run waits for them, and finds everything in order.
    done = run("batch", slow, "-o", out, *HEIGHTS)
    assert done.status == 0, done.stderr
    assert_ended(workers, 1)
    assert sorted(path.name for path in out.iterdir()) == ["a_scan.bag", "b_scan.bag", "manifest.jsonl"]


def test_two_runs_on_one_folder_are_noticed(running: tuple[subprocess.Popen[bytes], Path], slow: Path) -> None:
    _, out = running
    began = time.monotonic()
    done = run("batch", slow, "-o", out, *HEIGHTS)
    assert done.status == 2
    assert "another batch is writing into this folder" in done.stderr
    assert time.monotonic() - began < 10


def test_a_worker_that_dies_is_replaced(running: tuple[subprocess.Popen[bytes], Path]) -> None:
    process, out = running
    # Both workers, so that each recording is tried again; then those that try again, so that it is given up.
    killed: set[int] = set()
    deadline = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < deadline:
        for pid in set(workers_of(process)) - killed:
            if any(out.glob("*.pc2scan-partial")):
                os.kill(pid, signal.SIGKILL)
                killed.add(pid)
        time.sleep(0.02)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 1, stderr
    assert b"was killed by SIGKILL, perhaps because memory ran out; it is tried again" in stderr
    lines = manifest_of(out)
    assert {line["outcome"] for line in lines.values()} == {"died"}
    assert {line["attempts"] for line in lines.values()} == {2}
    assert b"2 died" in stdout
    assert [path.name for path in out.iterdir()] == ["manifest.jsonl"]


# --- What it may not touch ---


def test_what_is_not_its_own_is_never_replaced(drives: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "a_scan.bag").write_bytes(b"precious")
    done = run("batch", drives, "-o", out, *HEIGHTS)
    assert done.status == 1
    assert (
        "failed: a.bag: exists already, and was not written by this batch (hint: --overwrite replaces it)"
        in done.stderr
    )
    assert (out / "a_scan.bag").read_bytes() == b"precious"
    # Again neither: what failed is not what is there.
    assert run("batch", drives, "-o", out, *HEIGHTS).status == 1
    assert (out / "a_scan.bag").read_bytes() == b"precious"
    assert run("batch", drives, "-o", out, *HEIGHTS, "--overwrite").status == 0
    (out / "other").mkdir()
    (out / "other" / "manifest.jsonl").write_text("{}\n")
    refused = run("batch", drives, "-o", out / "other", *HEIGHTS)
    assert (refused.status, "is not a manifest of pc2scan batch" in refused.stderr) == (2, True)
    assert (out / "other" / "manifest.jsonl").read_text() == "{}\n"


def test_scans_are_not_sources(drives: Path) -> None:
    into = run("batch", drives, "-o", drives / "scans", *HEIGHTS)
    assert into.status == 0, into.stderr
    again = run("batch", drives, "-o", drives / "scans", *HEIGHTS)
    assert plan_of(again.stderr) == "3 recordings: 0 to convert (0 B), 3 unchanged"
    for out in (drives, drives.parent):
        refused = run("batch", drives, "-o", out, *HEIGHTS)
        assert (refused.status, "they would be found as sources" in refused.stderr) == (2, True)
    named = run("batch", drives / "a.bag", "-o", drives, *HEIGHTS)
    assert named.status == 0, named.stderr
    by_glob = run("batch", f"{drives}/*.bag", "-o", drives, *HEIGHTS)
    assert "1 recording: 0 to convert (0 B), 1 unchanged" in by_glob.stderr


# --- Options and reports ---


def test_options_by_pattern(drives: Path, tmp_path: Path) -> None:
    (tmp_path / "dataset.yaml").write_text(
        "defaults:\n  min_height: -2\n  max_height: 2\nrecordings:\n"
        "  - match: robot1/**\n    topics: /points:=/front\n    only_scans: true\n    to: mcap\n"
        "  - match: b.mcap\n    skip: true\n"
    )
    done = run("batch", drives, "-o", tmp_path / "out", "--dataset", tmp_path / "dataset.yaml")
    assert done.status == 0, done.stderr
    assert set(contents(tmp_path / "out")) == {"a_scan.bag", "robot1/a_scan.mcap"}
    topics = {topic.topic for topic in pc2scan.info(tmp_path / "out" / "robot1" / "a_scan.mcap").topics}
    assert topics == {"/front"}
    lines = manifest_of(tmp_path / "out")
    assert lines["a.bag"]["report"]["param_origins"]["min_height"] == f"{tmp_path / 'dataset.yaml'}, line 2"
    # What is typed beats the file.
    typed = run("batch", drives, "-o", tmp_path / "out", "--dataset", tmp_path / "dataset.yaml", "--min-height", "-1")
    assert "2 other options" in typed.stderr


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "defaults:\n  min_hight: 1\n",
            "line 2: 'min_hight' is not allowed in defaults\nhint: did you mean min_height?",
        ),
        ("defaults:\n  preset: gmaping\n", "line 2: preset is 'gmaping', it must be one of"),
        ("recordings:\n- match: '*'\n  min_height: 3\n  max_height: 1\n", "line 4"),
        ("recordings:\n- match: '*'\n  static_tf: a b 0\n", "line 3"),
        ("recordings:\n- match: nothing\n  fixed_frame: odom\n", "matches no recording"),
    ],
)
def test_a_wrong_dataset_file_stops_everything(text: str, expected: str, drives: Path, tmp_path: Path) -> None:
    (tmp_path / "dataset.yaml").write_text(text)
    done = run("batch", drives, "-o", tmp_path / "out", "--dataset", tmp_path / "dataset.yaml")
    assert expected in done.stderr
    assert (tmp_path / "out").exists() == (expected == "matches no recording")


def test_reports(drives: Path, tmp_path: Path) -> None:
    (drives / "bad.bag").write_bytes(b"no")
    for name in ("all.json", "all.csv", "all.md"):
        done = run("batch", drives, "-o", tmp_path / "out", *HEIGHTS, "--report", tmp_path / name)
        assert done.status == 1, done.stderr
    report = json.loads((tmp_path / "all.json").read_text())
    assert report["counts"] == {"failed": 1, "converted": 3}
    assert report["recordings"][0]["recording"] == "bad.bag"
    with (tmp_path / "all.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["outcome"] for row in rows] == ["failed", "converted", "converted", "converted"]
    assert (tmp_path / "all.md").read_text().startswith("# Batch of pc2scan")
    wrong = run("batch", drives, "-o", tmp_path / "out", "--report", tmp_path / "all.txt")
    assert (wrong.status, "NAME.json, NAME.csv, NAME.md" in wrong.stderr) == (2, True)


def test_fail_fast_ends_at_the_first_failure(drives: Path, tmp_path: Path) -> None:
    shutil.copy(drives / "a.bag", drives / "z.bag")
    (drives / "z.bag").write_bytes((drives / "z.bag").read_bytes()[:13])
    done = run("batch", drives, "-o", tmp_path / "out", "--fail-fast", "--jobs", "1", "--topic", "/nothing")
    assert done.status == 1
    assert "not begun" in done.stdout
    assert len(manifest_of(tmp_path / "out")) == 1


def test_from_python(drives: Path, tmp_path: Path) -> None:
    seen: list[pc2scan.batch.watch.BatchProgress] = []  # type: ignore[name-defined, unused-ignore]
    report = pc2scan.batch(drives, tmp_path / "out", min_height=-2, max_height=2, jobs=1, progress=seen.append)
    assert report.exit_status == 0
    assert report.counts == {"converted": 3}
    assert [outcome.key for outcome in report.outcomes] == ["a.bag", "b.mcap", "robot1/a.bag"]
    assert seen[-1].recordings_done == seen[-1].recordings_total == 3
    assert seen[-1].bytes_done == seen[-1].bytes_total
    assert "3 converted" in str(report)
    with pytest.raises(TypeError, match="did you mean 'min_height'"):
        pc2scan.batch(drives, tmp_path / "out", min_hight=-2)


def test_exports(drives: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = (*HEIGHTS, "--export", "npz", "--pose-frame", "odom", "--base-frame", "base_link")
    done = run("batch", drives, "-o", out, *options)
    assert done.status == 0, done.stderr
    names = {f"{folder}/{name}" for folder in ("a", "b", "robot1/a") for name in ("scan.npz", ".pc2scan-files.json")}
    assert set(contents(out)) == names
    with np.load(out / "a" / "scan.npz") as archive:
        assert archive["ranges"].shape[0] == archive["stamps"].shape[0] == archive["poses"].shape[0] > 0
    alone = tmp_path / "alone"
    assert (
        run("export", drives / "a.bag", "-o", f"{alone}/", "--format", "npz", *options[-4:], *HEIGHTS).status
        == done.status
    )
    assert (alone / "scan.npz").read_bytes() == (out / "a" / "scan.npz").read_bytes()
    assert "3 unchanged" in plan_of(run("batch", drives, "-o", out, *options).stderr)
    (out / "a" / "scan.npz").unlink()
    assert "1 its output is missing" in plan_of(run("batch", drives, "-o", out, *options).stderr)
    clouds = tmp_path / "clouds"
    assert run("batch", drives, "-o", clouds, "--export", "pcd", "--dry-run").status == 0
    assert not clouds.exists()
    assert run("batch", drives, "-o", clouds, "--export", "pcd").status == 0
    assert len(list((clouds / "robot1" / "a").glob("*.pcd"))) == 3
    assert "3 unchanged" in plan_of(run("batch", drives, "-o", clouds, "--export", "pcd").stderr)


# --- What is shown ---


def test_a_terminal_has_a_bar_and_a_pipe_only_the_lines(drives: Path, tmp_path: Path) -> None:
    (drives / "bad.bag").write_bytes(b"")
    done = run("batch", drives, "-o", tmp_path / "piped", *HEIGHTS)
    first, *lines = done.stderr.splitlines()
    assert re.fullmatch(r"4 recordings: 3 to convert \(\d+\.\d kB; 3 new\)", first)
    assert sorted(line.split(" (")[0] for line in lines) == [
        "converted: a.bag -> a_scan.bag",
        "converted: b.mcap -> b_scan.mcap",
        "converted: robot1/a.bag -> robot1/a_scan.bag",
        "failed: bad.bag: is empty",
    ]
    on_terminal = shown("batch", drives, "-o", tmp_path / "terminal", *HEIGHTS, columns=120)
    assert "of 3 recordings" in on_terminal
    assert "converted: a.bag -> a_scan.bag" in on_terminal
    quiet = run("batch", drives, "-o", tmp_path / "piped", *HEIGHTS, "--quiet")
    assert (quiet.stdout, quiet.stderr.splitlines()) == ("", ["failed: bad.bag: is empty"])
    loud = run("batch", drives, "-o", tmp_path / "piped", *HEIGHTS, "--verbose", "--force")
    assert len(re.findall(r"/points +/scan", loud.stderr)) == 3
