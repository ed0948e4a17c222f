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
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib.util import find_spec
from typing import TYPE_CHECKING

import pytest

import pc2scan
from datasets.cluster import cluster
from pc2scan.errors import UsageError
from support.batches import HEIGHTS, batch, contents, manifest_of, place, run_batch
from support.builders import POINTS, T0, Recording, cloud, item, points_of, write_rosbag1
from support.command import COMMAND, INTERRUPTED, environment

if TYPE_CHECKING:
    from pathlib import Path

psutil = pytest.importorskip("psutil", reason="psutil, which distributed needs, is not installed")
# Not imported: that takes each worker of the tests a second.
if find_spec("distributed") is None:
    pytest.skip("distributed is not installed", allow_module_level=True)
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
slow = pytest.mark.slow


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    return place(tmp_path / "drives", "0.bag", "1.bag", "2.bag", "b.mcap")


def outcomes(folder: Path) -> dict[str, str]:
    return {key: line["outcome"] for key, line in manifest_of(folder).items()}


def test_a_cluster_converts_what_this_process_converts(drives: Path, tmp_path: Path) -> None:
    batch(drives / "0.bag", tmp_path / "here")
    assert batch(drives / "0.bag", tmp_path / "there", dask=True, jobs=1).exit_status == 0
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


def test_a_missing_package_and_a_wrong_address_are_named(
    drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match="needs distributed, which is not installed") as raised:
        pc2scan.batch(drives, tmp_path / "out", dask=True)
    assert 'pip install "pc2scan[dask]"' in (raised.value.hint or "")
    with pytest.raises(UsageError, match="the address of a scheduler is tcp://HOST:PORT"):
        pc2scan.batch(drives, tmp_path / "out", dask="scheduler")


def begun(*words: str | Path) -> subprocess.Popen[str]:
    """A batch with a cluster of its own, in a process group of its own."""
    command = [*COMMAND, "batch", "--dask", *map(str, words), "--jobs", "2", *HEIGHTS]
    return subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment(), start_new_session=True
    )


@slow
def test_a_worker_is_killed_and_everything_is_converted(drives: Path, tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    batch(drives, here)
    process = begun(drives, "-o", there)
    killed = None
    while killed is None and process.poll() is None:
        # A worker, while it has a conversion below it.
        for child in psutil.Process(process.pid).children():
            with suppress(psutil.Error):
                below = [word for grandchild in child.children() for word in grandchild.cmdline()]
                if any("pc2scan.datasets.processes" in word for word in below):
                    killed = child.pid
                    os.kill(killed, signal.SIGKILL)
                    break
        time.sleep(0.005)
    _, said = process.communicate(timeout=60)
    assert killed is not None
    assert process.returncode == 0, said
    assert "Dask's dashboard: http" in said
    assert "Traceback" not in said
    assert contents(there) == contents(here)
    assert set(outcomes(there).values()) == {"converted"}
    # The conversion was begun again, unless it was complete when its worker died; and once more if its process, which
    # ends after its worker, had completed the output by then.
    assert max(line["attempts"] for line in manifest_of(there).values()) in (1, 2, 3)


@slow
@pytest.mark.parametrize("seconds", [0.5, 1.2, 1.6, 2.5, None])
def test_an_interrupted_batch_goes_on(seconds: float | None, drives: Path, tmp_path: Path) -> None:
    """Interrupted at any time, or (None) when the first recording is converted."""
    out, many = tmp_path / "out", tmp_path / "many"
    # Enough that they take longer than the latest interruption, even on a fast machine.
    for number in range(50):
        shutil.copytree(drives, many / str(number))
    process = begun(many, "-o", out)
    time.sleep(seconds or 0)
    while seconds is None and process.poll() is None and not manifest_of(out):
        time.sleep(0.01)
    # To all processes, like a terminal.
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode in INTERRUPTED, said
    assert not [word for word in ("Traceback", "distributed") if word in said], said
    assert seconds is not None or manifest_of(out)
    assert len(manifest_of(out)) < 200
    # A conversion may have ended after its last event was read. The note has its output.
    assert not [path.name for path in out.glob("*pc2scan-*") if path.name != ".pc2scan-begun.json"]
    note = out / ".pc2scan-begun.json"
    outputs = json.loads(note.read_text())["outputs"] if note.exists() else []
    assert all((out / name).exists() for name in outputs)
    if seconds is None:
        assert batch(many, out).exit_status == 0
        assert len(manifest_of(out)) == 200


@slow
def test_a_scheduler_is_reached_by_its_address(drives: Path, tmp_path: Path) -> None:
    (drives / "bad.bag").write_bytes(b"no recording")
    out = tmp_path / "out"

    async def cell(address: str) -> None:
        pc2scan.batch(drives, tmp_path / "notebook", dask=address, min_height=-0.3)

    with cluster(tmp_path, {}) as (address, _):
        done = run_batch(drives, "-o", out, "--dask", address)
        assert done.status == 1, done.stderr
        again = run_batch(drives, "-o", out, "--dask", address)
        # A notebook runs its cells in an event loop. In a thread: the tests' browser runs one in the main thread.
        with ThreadPoolExecutor(1) as thread:
            thread.submit(asyncio.run, cell(address)).result()
    good = dict.fromkeys((path.name for path in drives.iterdir()), "converted")
    assert outcomes(out) == {**good, "bad.bag": "failed"}
    assert "4 unchanged" in again.stderr
    assert len(contents(out)) == len(contents(tmp_path / "notebook")) == 4


#: What is wrong with a worker, modules that make it so, and what is said.
UNUSABLE = {
    "another version": (
        {"pc2scan/__init__.py": "", "pc2scan/version.py": '__version__ = "0.0.1"\n'},
        ("has pc2scan 0.0.1, this is ", 'pip install "pc2scan[dask]=='),
    ),
    "no pc2scan": ({"pc2scan/__init__.py": "raise ModuleNotFoundError\n"}, ("has no pc2scan",)),
    # As on a machine where the disk is not mounted.
    **{
        f"does not see {hidden}": (
            {
                "sitecustomize.py": "import os\nlexists = os.path.lexists\n"
                f"os.path.lexists = lambda path: not str(path).startswith('{{folder}}/{hidden}') and lexists(path)\n"
            },
            (f"does not see {{folder}}/{hidden}", "must be on a disk that all workers share"),
        )
        for hidden in ("drives", "out")
    },
}


@slow
@pytest.mark.parametrize("wrong", UNUSABLE)
def test_a_worker_that_cannot_be_used_is_refused(wrong: str, drives: Path, tmp_path: Path) -> None:
    from distributed import Client

    modules, said = UNUSABLE[wrong]
    for name, text in modules.items():
        (tmp_path / "site" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "site" / name).write_text(text.format(folder=tmp_path))
    with cluster(tmp_path, {}, {"PYTHONPATH": str(tmp_path / "site")}) as (address, _):
        with Client(address, timeout=30) as client:
            client.wait_for_workers(2, timeout=60)
        done = run_batch(drives, "-o", tmp_path / "out", "--dask", address)
    assert done.status == 2, done.stderr
    # Long lines are broken between words.
    told = done.stderr.replace("\n  ", " ")
    assert [text for text in said if text.format(folder=tmp_path) not in told] == []
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("listens", [False, pytest.param(True, marks=slow)])
def test_a_scheduler_that_does_not_answer_is_an_error(listens: bool, drives: Path, tmp_path: Path) -> None:
    # No scheduler is there, or another program, which accepts connections and never answers.
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        if listens:
            server.listen()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        done = run_batch(drives, "-o", tmp_path / "out", "--dask", address)
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


@slow
def test_what_kills_every_worker_is_reported(drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "killing_filter.py").write_text(f"MARK = {str(tmp_path / 'mark')!r}\n{KILLER}")
    monkeypatch.syspath_prepend(str(tmp_path))
    import killing_filter  # type: ignore[import-not-found]

    # One recording kills every worker, the other one only the first.
    for name, count in (("killer", 13), ("once", 14)):
        made = [item(POINTS, T0, lambda g, s, count=count: cloud(points_of(s, count), g, seq=s))]  # type: ignore[misc]
        write_rosbag1(drives / f"{name}.bag", Recording((POINTS,), tuple(made)))
    out = tmp_path / "out"
    assert batch(drives, out, dask=True, jobs=2, filters=[killing_filter.Killer()]).exit_status == 1
    found = outcomes(out)
    assert found.pop("killer.bag") == "died"
    assert len(found) == 5
    assert set(found.values()) == {"converted"}
    line = manifest_of(out)["killer.bag"]
    assert "its Dask worker died" in line["error"]["message"]
    assert line["attempts"] == 2
    assert not list(out.glob("*.pc2scan-*"))


COUNTER = """
import os
from dataclasses import dataclass

import numpy as np

from pc2scan.pipeline.stages.filters import Frame


@dataclass(frozen=True)
class Counter:
    folder: str
    name = "counter"
    explanation = "counted"
    fields = ()
    frame = Frame.SOURCE

    def __call__(self, points):
        x, _, _ = points.xyz()
        open(os.path.join(self.folder, str(os.getpid())), "w").close()
        if x.size == 13:
            os._exit(5)
        return np.ones(x.shape, bool)
"""


def many(folder: Path, count: int) -> Path:
    for number in range(count):
        made = (item(POINTS, T0, lambda g, s: cloud(points_of(s), g, seq=s)),)
        folder.mkdir(exist_ok=True)
        write_rosbag1(folder / f"{number}.bag", Recording((POINTS,), made))
    return folder


@slow
def test_a_process_stays_for_all_recordings_and_not_longer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On two workers of a cluster that goes on; one recording ends its process, which is started again."""
    (tmp_path / "counting_filter.py").write_text(COUNTER)
    monkeypatch.syspath_prepend(str(tmp_path))
    import counting_filter  # type: ignore[import-not-found]
    from distributed import Client

    drives, seen, out = many(tmp_path / "drives", 40), tmp_path / "seen", tmp_path / "out"
    seen.mkdir()
    bad = item(POINTS, T0, lambda g, s: cloud(points_of(s, 13), g, seq=s))
    write_rosbag1(drives / "ends.bag", Recording((POINTS,), (bad,)))
    with cluster(tmp_path, {}, {}, PYTHONPATH=str(tmp_path)) as (address, _):
        with Client(address, timeout=30) as client:
            client.wait_for_workers(2, timeout=60)
        report = batch(drives, out, dask=address, filters=[counting_filter.Counter(str(seen))])
        assert report.workers == 2
        found = outcomes(out)
        assert found.pop("ends.bag") == "died"
        assert manifest_of(out)["ends.bag"]["attempts"] == 2
        assert (len(found), set(found.values())) == (40, {"converted"})
        # Both workers have one process, and another one after each attempt of the recording that ends it.
        processes = [int(path.name) for path in seen.iterdir()]
        assert len(processes) <= 4
        deadline = time.monotonic() + 30
        while any(map(psutil.pid_exists, processes)) and time.monotonic() < deadline:
            time.sleep(0.1)
        assert not any(map(psutil.pid_exists, processes))


@slow
def test_a_worker_that_dies_spoils_nothing_else_of_its_task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "killing_filter.py").write_text(f"MARK = {str(tmp_path / 'mark')!r}\n{KILLER}")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "killing_filter", raising=False)
    import killing_filter

    drives, out = many(tmp_path / "drives", 15), tmp_path / "out"
    for name, points in (("killer", 13), ("once", 14)):
        made = item(POINTS, T0, lambda g, s, points=points: cloud(points_of(s, points), g, seq=s))  # type: ignore[misc]
        write_rosbag1(drives / f"{name}.bag", Recording((POINTS,), (made,)))
    assert batch(drives, out, dask=True, jobs=2, filters=[killing_filter.Killer()]).exit_status == 1
    found = outcomes(out)
    assert found.pop("killer.bag") == "died"
    assert (len(found), set(found.values())) == (16, {"converted"})
    assert not list(out.glob("*.pc2scan-*"))
