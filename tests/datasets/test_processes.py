"""Batches in processes of their own: whole datasets, killed and continued, interrupted, and workers that die."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.errors import DestinationError, Pc2ScanError
from support.batches import HEIGHTS, KEYWORDS, batch, contents, manifest_of, place
from support.command import COMMAND, INTERRUPTED, environment, run

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and locks of POSIX")


def start(*words: str | Path, **pipes: Any) -> subprocess.Popen[bytes]:
    command = [*COMMAND, "batch", *map(str, words)]
    return subprocess.Popen(command, env=environment(), start_new_session=True, **pipes)


def test_processes_convert_as_this_process_does(tmp_path: Path) -> None:
    place(tmp_path / "in", "a.bag", "b.mcap", "r/cut.bag")
    cut = tmp_path / "in" / "r" / "cut.bag"
    cut.write_bytes(cut.read_bytes()[:-4000])
    seen: list[Any] = []
    report = pc2scan.batch(
        tmp_path / "in", tmp_path / "there", jobs=2, progress=lambda *numbers: seen.append(numbers), **KEYWORDS
    )
    here = batch(tmp_path / "in", tmp_path / "here")
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
    found = [{each.key: (each.outcome, each.output, each.scans) for each in made.outcomes} for made in (report, here)]
    assert found[0] == found[1]
    assert [each.key for each in report.outcomes] == ["a.bag", "b.mcap", "r/cut.bag"]
    assert (report.exit_status, report.counts) == (3, {"incomplete": 1, "converted": 2})
    assert "1 incomplete, 2 converted" in str(report)
    size = sum(path.stat().st_size for path in (tmp_path / "in").rglob("*.*"))
    assert seen[-1] == (size, size, 3, 3)
    assert seen == sorted(seen)


def test_a_dataset_is_continued_after_a_kill(tmp_path: Path) -> None:
    folder, clean, killed = tmp_path / "recordings", tmp_path / "clean", tmp_path / "killed"
    place(folder, *(f"robot{number % 3}/{number}{suffix}" for number in range(5) for suffix in (".bag", ".mcap", "")))
    (folder / "empty.bag").touch()
    before = contents(folder)
    assert batch(folder, clean).exit_status == 1
    process = start(folder, "-o", killed, *HEIGHTS, "--quiet", stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    while process.poll() is None and sum(line["outcome"] != "begun" for line in manifest_of(killed).values()) < 5:
        time.sleep(0.003)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    # What is converted is kept; what failed is tried again.
    assert batch(folder, killed).exit_status == 1
    assert contents(killed) == contents(clean)
    assert contents(folder) == before
    assert batch(folder, killed).unchanged == 15


# --- Interruptions ---


def workers_of(process: subprocess.Popen[bytes]) -> list[int]:
    children = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True, check=False
    )
    return [int(pid) for pid in children.stdout.split()]


@pytest.fixture
def running(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """A batch of two long conversions, of a great many beams, when both have begun to write."""
    drives, out = place(tmp_path / "drives", "a.bag", "b.bag"), tmp_path / "out"
    slow = (*HEIGHTS, "--angle-increment", "0.000002", "--compression", "bz2")
    process = start(drives, "-o", out, *slow, "--jobs", "2", stderr=subprocess.PIPE, stdout=subprocess.PIPE)
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


def wait_for_the_end(pids: Sequence[int]) -> None:
    assert len(pids) == 2
    deadline = time.monotonic() + 60
    while any(map(is_running, pids)):
        assert time.monotonic() < deadline, "a worker is still there"
        time.sleep(0.02)


def test_an_interruption_leaves_nothing_half(running: tuple[subprocess.Popen[bytes], Path]) -> None:
    process, out = running
    workers = workers_of(process)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode in INTERRUPTED
    assert (b"interrupted" in stderr, b"Traceback" in stderr) == (True, False)
    wait_for_the_end(workers)
    assert not out.exists()


def test_one_run_writes_at_a_time_until_its_workers_end(
    running: tuple[subprocess.Popen[bytes], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    process, out = running
    workers = workers_of(process)
    monkeypatch.setattr("pc2scan.datasets.manifest._WAIT_SECONDS", 0.2)
    with pytest.raises(DestinationError, match="another batch is writing into this folder"):
        batch(tmp_path / "drives", out)
    process.kill()
    process.wait()
    # Another run waits for the workers, which take their time on a busy machine, and finds everything in order.
    monkeypatch.setattr("pc2scan.datasets.manifest._WAIT_SECONDS", 60)
    assert batch(tmp_path / "drives", out).exit_status == 0
    wait_for_the_end(workers)
    assert sorted(path.name for path in out.iterdir()) == ["a_scan.bag", "b_scan.bag", "manifest.jsonl"]


#: A module that each worker loads: it is killed when its output is complete, just before the last renaming.
KILLED = """
import os
import signal
import sys

def kill(event, arguments):
    if event in ("os.link", "os.rename") and str(arguments[0]).endswith(".pc2scan-partial"):
        with open({deaths!r}, "a") as file:
            file.write(os.path.basename(arguments[0]) + "\\n")
        os.stat(arguments[0])
        os.kill(os.getpid(), signal.SIGKILL)

sys.addaudithook(kill)
"""


def test_a_worker_that_dies_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Both workers, so that each recording is tried again; then those that try again, so that it is given up.
    drives, out, deaths = place(tmp_path / "drives", "a.bag", "b.bag"), tmp_path / "out", tmp_path / "deaths"
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(KILLED.format(deaths=str(deaths)))
    paths = [str(site), environment().get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))
    done = run("batch", drives, "-o", out, *HEIGHTS, "--jobs", "2")
    assert done.status == 1, done.stderr
    assert sorted(deaths.read_text().split()) == [f"{name}_scan.bag.pc2scan-partial" for name in "aabb"]
    assert "was killed by SIGKILL; perhaps memory ran out" in done.stderr
    lines = manifest_of(out)
    assert {(line["outcome"], line["attempts"]) for line in lines.values()} == {("died", 2)}
    assert "2 died" in done.stdout


# --- Jobs and results ---


def test_filters_that_cannot_be_sent_are_refused(tmp_path: Path) -> None:
    parts = {"name": "local", "explanation": "nothing", "fields": (), "frame": "odom"}
    with pytest.raises(Pc2ScanError, match="cannot be sent to another process") as raised:
        pc2scan.batch(place(tmp_path / "in", "a.bag"), tmp_path / "out", jobs=1, filters=[type("Local", (), parts)()])
    assert "that can be imported" in (raised.value.hint or "")


def test_a_bug_is_the_result_of_its_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("pc2scan.datasets.jobs.run", fails)
    (outcome,) = batch(place(tmp_path / "in", "a.bag"), tmp_path / "out").outcomes
    assert (outcome.outcome, outcome.exit_status, outcome.error) == ("failed", 1, "ZeroDivisionError: oh")
    assert "in fails" in manifest_of(tmp_path / "out")["a.bag"]["error"]["traceback"]
