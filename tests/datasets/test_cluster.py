"""A Dask cluster: real workers, some of which are killed, a scheduler by its address, workers that cannot be used."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
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


@slow
def test_an_interrupted_batch_goes_on(drives: Path, tmp_path: Path) -> None:
    out, many = tmp_path / "out", tmp_path / "many"
    for number in range(50):
        shutil.copytree(drives, many / str(number))
    command = [*COMMAND, "batch", "--dask", str(many), "-o", str(out), "--jobs", "2", *HEIGHTS]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment(), start_new_session=True)
    while process.poll() is None and not manifest_of(out):
        time.sleep(0.01)
    # To all processes, like a terminal.
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode in INTERRUPTED, said
    assert not [word for word in ("Traceback", "distributed") if word in said], said
    assert 0 < len(manifest_of(out)) < 200
    assert batch(many, out).exit_status == 0
    assert set(outcomes(out).values()) == {"converted"}
    assert len(contents(out)) == 200


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
from dataclasses import dataclass

import numpy as np

from pc2scan.request.filters import Frame


@dataclass(frozen=True)
class Killer:
    name = "killer"
    explanation = "killed"
    fields = ()
    frame = Frame.SOURCE

    def __call__(self, points):
        x, _, _ = points.xyz()
        if x.size == 13:
            os.kill(os.getpid(), signal.SIGKILL)
        if x.size == 14 and not os.path.exists(MARK):
            open(MARK, "w").close()
            os.kill(os.getpid(), signal.SIGKILL)
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
