"""A Dask cluster: real workers, one of which is killed, a scheduler by its address, and workers that cannot be used."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from threading import Thread
from typing import TYPE_CHECKING

import pytest

import pc2scan
from batch.datasets import HEIGHTS, contents
from batch.test_cutting import WORDS, drive
from pc2scan.batch.manifest import read_begun
from support.builders import CONTENT, POINTS, T0, Mcap, Recording, cloud, item, points_of, write_mcap, write_rosbag1
from support.command import COMMAND, INTERRUPTED, environment, run

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

psutil = pytest.importorskip("psutil", reason="psutil, which distributed needs, is not installed")
distributed = pytest.importorskip("distributed", reason="distributed is not installed")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    folder = tmp_path / "drives"
    folder.mkdir()
    for number in range(4):
        write_rosbag1(folder / f"{number}.bag", CONTENT)
    write_mcap(folder / "b.mcap", CONTENT)
    return folder


def outputs(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "manifest.jsonl"}


def outcomes(folder: Path) -> dict[str, str]:
    lines = [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()]
    return {line["key"]: line["outcome"] for line in lines}


@contextmanager
def cluster(folder: Path, **variables: str) -> Iterator[str]:
    """A scheduler and a worker, as their own commands start them; yields the address."""
    with cluster_of(folder, {}, variables=variables) as (address, _):
        yield address


@contextmanager
def cluster_of(
    folder: Path, *workers: dict[str, str], variables: dict[str, str] | None = None
) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler, and workers with variables of their own; yields the address and the processes of the workers.

    ``variables`` are those of all, the scheduler included.
    """
    file = folder / "scheduler.json"
    dask = [sys.executable, "-m", "distributed.cli"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    started: list[subprocess.Popen[bytes]] = []
    scheduler = "dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"
    worker = "dask_worker", "--host", "127.0.0.1", "--nthreads", "1", "--no-nanny", "--no-dashboard"
    try:
        for own, (program, *options) in zip(({}, *workers), (scheduler, *[worker] * len(workers)), strict=True):
            command = [*dask[:2], f"distributed.cli.{program}", *options, "--scheduler-file", str(file)]
            env = {**environment(), **(variables or {}), **own}
            started.append(subprocess.Popen(command, env=env, cwd=folder, **quiet))  # type: ignore[call-overload]
            deadline = time.monotonic() + 30
            while not file.exists() and time.monotonic() < deadline:
                time.sleep(0.05)
        yield json.loads(file.read_text())["address"], started[1:]
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()


def test_a_worker_is_killed_and_everything_is_converted(drives: Path, tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    assert run("batch", drives, "-o", here, *HEIGHTS, "--quiet").status == 0
    command = [*COMMAND, "batch", "--dask", str(drives), "-o", str(there), "--jobs", "2", *HEIGHTS]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment())
    killed = None
    while killed is None and process.poll() is None:
        # A worker, while it has a conversion below it.
        for child in psutil.Process(process.pid).children():
            with suppress(psutil.Error):
                below = [word for grandchild in child.children() for word in grandchild.cmdline()]
                if any("pc2scan.batch.worker" in word for word in below):
                    killed = child.pid
                    os.kill(killed, signal.SIGKILL)
                    break
        time.sleep(0.005)
    _, said = process.communicate(timeout=60)
    assert killed is not None
    assert process.returncode == 0, said
    assert "Dask's dashboard: http" in said
    assert "Traceback" not in said
    assert outputs(there) == outputs(here)
    assert set(outcomes(there).values()) == {"converted"}
    attempts = [json.loads(line)["attempts"] for line in (there / "manifest.jsonl").read_text().splitlines()]
    # The conversion was begun again, unless it was complete when its worker died.
    assert max(attempts) in (1, 2)


def test_an_interrupted_batch_leaves_complete_recordings_and_goes_on(drives: Path, tmp_path: Path) -> None:
    for number in range(4, 24):
        write_rosbag1(drives / f"{number}.bag", CONTENT)
    out = tmp_path / "out"
    command = [*COMMAND, "batch", "--dask", str(drives), "-o", str(out), "--jobs", "2", *HEIGHTS]
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment(), start_new_session=True
    )
    manifest = out / "manifest.jsonl"
    while process.poll() is None and not (manifest.exists() and manifest.read_bytes().count(b"\n")):
        time.sleep(0.01)
    # To all processes, like a terminal.
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode in INTERRUPTED, said
    assert "Traceback" not in said
    done = set(outcomes(out))
    assert 0 < len(done) < 25
    assert not list(out.glob("?*.pc2scan-*"))
    assert run("batch", drives, "-o", out, *HEIGHTS, "--quiet").status == 0
    assert len(outcomes(out)) == 25


def test_a_scheduler_is_reached_by_its_address(drives: Path, tmp_path: Path) -> None:
    (drives / "bad.bag").write_bytes(b"no recording")
    out = tmp_path / "out"
    with cluster(tmp_path) as address:
        done = run("batch", drives, "-o", out, *HEIGHTS, "--dask", address)
        assert done.status == 1, done.stderr
        again = run("batch", drives, "-o", out, *HEIGHTS, "--dask", address)
        # A notebook runs its cells in an event loop.
        asyncio.run(cell(drives, tmp_path / "notebook", address))
    assert outcomes(out) == {**{f"{n}.bag": "converted" for n in range(4)}, "b.mcap": "converted", "bad.bag": "failed"}
    assert "5 unchanged" in again.stderr
    assert len(outputs(out)) == 5
    assert len(outputs(tmp_path / "notebook")) == 5


async def cell(drives: Path, out: Path, address: str) -> None:
    """Convert from within an event loop."""
    pc2scan.batch(drives, out, dask=address, min_height=-0.3)


def wait_for_workers(address: str, count: int) -> None:
    with distributed.Client(address, timeout=30) as client:
        client.wait_for_workers(count, timeout=60)


def kill_one_that_converts(workers: list[subprocess.Popen[bytes]], out: Path, killed: list[int]) -> None:
    """Kill a worker as soon as it converts a piece."""
    deadline = time.monotonic() + 60
    while not killed and time.monotonic() < deadline:
        pieces = list(out.glob("*.pc2scan-partial/piece-*"))
        for worker in workers if pieces else ():
            if psutil.Process(worker.pid).children():
                worker.kill()
                killed.append(worker.pid)
                return
        time.sleep(0.005)


def test_a_long_recording_is_cut_and_a_worker_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from pc2scan.batch import cutting

    source = write_mcap(tmp_path / "drive.mcap", drive(), Mcap(chunk_size=4_000))
    pc2scan.batch(source, tmp_path / "here", **WORDS)
    monkeypatch.setattr(cutting, "PIECE_BYTES", source.stat().st_size // 6)
    out, killed = tmp_path / "there", list[int]()
    words = {name: value for name, value in WORDS.items() if name != "jobs"}
    with cluster_of(tmp_path, {}, {}) as (address, workers):
        killer = Thread(target=kill_one_that_converts, args=(workers, out, killed))
        killer.start()
        done = pc2scan.batch(source, out, dask=address, **words)
        killer.join()
    assert killed
    assert done.exit_status == 3  # the last cloud is behind the last transform
    assert contents(out) == contents(tmp_path / "here")
    (line,) = [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()]
    assert line["attempts"] == 2
    assert len(line["report"]["files"]) == 12


def test_a_worker_of_another_version_is_refused(drives: Path, tmp_path: Path) -> None:
    other = tmp_path / "other" / "pc2scan"
    other.mkdir(parents=True)
    (other / "__init__.py").touch()
    (other / "version.py").write_text('__version__ = "0.0.1"\n')
    with cluster(tmp_path, PYTHONPATH=str(other.parent)) as address:
        done = run("batch", drives, "-o", tmp_path / "out", *HEIGHTS, "--dask", address)
    assert done.status == 2, done.stderr
    assert "has pc2scan 0.0.1, this is " in done.stderr
    assert "pip install 'pc2scan[dask]==" in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_worker_without_pc2scan_is_refused(drives: Path, tmp_path: Path) -> None:
    other = tmp_path / "other" / "pc2scan"
    other.mkdir(parents=True)
    (other / "__init__.py").write_text("raise ModuleNotFoundError\n")
    with cluster_of(tmp_path, {}, {"PYTHONPATH": str(other.parent)}) as (address, _):
        wait_for_workers(address, 2)
        done = run("batch", drives, "-o", tmp_path / "out", *HEIGHTS, "--dask", address)
    assert done.status == 2, done.stderr
    assert "has no pc2scan" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("hidden", ["drives", "out"])
def test_a_worker_that_does_not_see_a_path_is_refused(hidden: str, drives: Path, tmp_path: Path) -> None:
    # As on a machine where the disk is not mounted.
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(
        "import os\n"
        "lexists = os.path.lexists\n"
        f"os.path.lexists = lambda path: not str(path).startswith({str(tmp_path / hidden)!r}) and lexists(path)\n"
    )
    with cluster_of(tmp_path, {}, {"PYTHONPATH": str(site)}) as (address, _):
        wait_for_workers(address, 2)
        done = run("batch", drives, "-o", tmp_path / "out", *HEIGHTS, "--dask", address)
    assert done.status == 2, done.stderr
    assert f"does not see {tmp_path / hidden}" in done.stderr
    assert "must be on a disk that all workers share" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("listens", [False, True])
def test_a_scheduler_that_does_not_answer_is_an_error_within_seconds(
    listens: bool, drives: Path, tmp_path: Path
) -> None:
    # No scheduler is there, or another program, which accepts connections and never answers.
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        if listens:
            server.listen()
        began = time.monotonic()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        done = run("batch", drives, "-o", tmp_path / "out", *HEIGHTS, "--dask", address)
        assert time.monotonic() - began < 60
    assert done.status == 2, done.stderr
    assert f"--dask {address} does not answer as a Dask scheduler" in done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) <= 3, done.stderr
    assert not (tmp_path / "out").exists()


KILLER = """
import os
import shutil
import signal
import time
from dataclasses import dataclass

import numpy as np

from pc2scan.pipeline.stages.filters import Frame


@dataclass(frozen=True)
class Killer:
    name = "killer"
    explanation = "killed"
    fields = ()
    frame = Frame.SOURCE

    def __call__(self, points):
        x, _, _ = points.xyz()
        if x.size == 13:
            os.kill(os.getppid(), signal.SIGKILL)
            time.sleep(30)
        if x.size == 14 and not os.path.exists(MARK):
            open(MARK, "w").close()
            os.kill(os.getppid(), signal.SIGKILL)
        return np.ones(x.shape, bool)
"""


def test_what_kills_every_worker_is_reported_and_the_rest_goes_on(
    drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    (tmp_path / "killing_filter.py").write_text(f"MARK = {str(tmp_path / 'mark')!r}\n{KILLER}")
    monkeypatch.syspath_prepend(str(tmp_path))
    import killing_filter  # type: ignore[import-not-found]

    # One recording kills every worker, the other one only the first.
    for name, count in (("killer", 13), ("once", 14)):
        made = [item(POINTS, T0, lambda g, s, count=count: cloud(points_of(s, count), g, seq=s))]  # type: ignore[misc]
        write_rosbag1(drives / f"{name}.bag", Recording((POINTS,), tuple(made)))
    out = tmp_path / "out"
    filters = [killing_filter.Killer()]
    done = pc2scan.batch(drives, out, dask=True, jobs=2, min_height=-2, max_height=2, filters=filters)
    assert done.exit_status == 1
    found = outcomes(out)
    assert found.pop("killer.bag") == "died"
    assert len(found) == 6
    assert set(found.values()) == {"converted"}
    lines = {line["key"]: line for line in map(json.loads, (out / "manifest.jsonl").read_text().splitlines())}
    assert "its Dask worker died" in lines["killer.bag"]["error"]["message"]
    assert lines["killer.bag"]["attempts"] == 2
    assert not list(out.glob("*.pc2scan-*"))


@pytest.mark.parametrize("seconds", [0.5, 1.2, 1.6, 2.5])
def test_an_early_interruption_says_nothing_of_dask(seconds: float, drives: Path, tmp_path: Path) -> None:
    out, many = tmp_path / "out", tmp_path / "many"
    # Enough that they take longer than the latest interruption, even on a fast machine.
    for number in range(40):
        shutil.copytree(drives, many / str(number))
    command = [*COMMAND, "batch", "--dask", str(many), "-o", str(out), "--jobs", "2", *HEIGHTS]
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment(), start_new_session=True
    )
    time.sleep(seconds)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    # Shells report both as 130. If the signal comes while Python starts, it ends the process itself.
    assert process.returncode in (130, -signal.SIGINT), said
    assert "Traceback" not in said
    assert "distributed" not in said
    # A conversion may have ended after its last event was read. The note has its output.
    assert not [path.name for path in out.glob("*pc2scan-*") if path.name != ".pc2scan-begun.json"]
    assert all((out / name).exists() for name in read_begun(out).outputs)


def test_errors_name_the_missing_package_and_the_wrong_address(
    drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pc2scan.errors import UsageError

    with pytest.raises(UsageError, match="the address of a scheduler is tcp://HOST:PORT"):
        pc2scan.batch(drives, tmp_path / "out", dask="scheduler")
    with pytest.raises(UsageError, match="has no effect"):
        pc2scan.batch(drives, tmp_path / "out", dask="tcp://127.0.0.1:1", jobs=2)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match="needs distributed, which is not installed") as raised:
        pc2scan.batch(drives, tmp_path / "out", dask=True)
    assert "pip install 'pc2scan[dask]'" in (raised.value.hint or "")
