"""A Dask cluster: one of this machine, one that is reached by its address, and workers that are killed."""

from __future__ import annotations

import asyncio
import socket
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from typing import TYPE_CHECKING

import pytest

import pc2scan
from support.batches import batch, contents, manifest_of, place, run_batch
from support.builders import POINTS, T0, Recording, cloud, item, points_of, write_rosbag1

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX"),
    # Not imported: that takes each worker of the tests a second.
    pytest.mark.skipif(find_spec("distributed") is None, reason="needs distributed"),
]


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    return place(tmp_path / "drives", "0.bag", "1.bag", "b.mcap")


def outcomes(folder: Path) -> dict[str, str]:
    return {key: line["outcome"] for key, line in manifest_of(folder).items()}


def test_a_cluster_converts_what_this_process_converts(drives: Path, tmp_path: Path) -> None:
    batch(drives / "0.bag", tmp_path / "here")
    assert batch(drives / "0.bag", tmp_path / "there", dask=True, jobs=1).exit_status == 0
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


def test_a_scheduler_that_does_not_answer_is_an_error(drives: Path, tmp_path: Path) -> None:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        done = run_batch(drives, "-o", tmp_path / "out", "--dask", address)
    assert (done.status, f"--dask {address} does not answer as a Dask scheduler" in done.stderr) == (2, True), done
    assert not (tmp_path / "out").exists()


def test_a_scheduler_is_reached_by_its_address(drives: Path, tmp_path: Path) -> None:
    (drives / "bad.bag").write_bytes(b"no recording")
    from distributed import LocalCluster

    out = tmp_path / "out"

    async def cell(address: str) -> None:
        pc2scan.batch(drives, tmp_path / "notebook", dask=address, min_height=-0.3)

    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0") as local:
        address = local.scheduler_address
        done = run_batch(drives, "-o", out, "--dask", address)
        assert done.status == 1, done.stderr
        again = run_batch(drives, "-o", out, "--dask", address)
        # A notebook runs its cells in an event loop. In a thread: the tests' browser runs one in the main thread.
        with ThreadPoolExecutor(1) as thread:
            thread.submit(asyncio.run, cell(address)).result()
    assert outcomes(out) == {**dict.fromkeys(("0.bag", "1.bag", "b.mcap"), "converted"), "bad.bag": "failed"}
    assert "3 unchanged" in again.stderr
    assert len(contents(out)) == len(contents(tmp_path / "notebook")) == 3


KILLER = """
import os
import signal
from dataclasses import dataclass

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
        return x == x
"""


def test_what_kills_every_worker_is_reported(drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "killing_filter.py").write_text(KILLER)
    monkeypatch.syspath_prepend(str(tmp_path))
    import dask
    import killing_filter  # type: ignore[import-not-found]

    made = item(POINTS, T0, lambda version, seq: cloud(points_of(seq, 13), version, seq=seq))
    write_rosbag1(drives / "killer.bag", Recording((POINTS,), (made,)))
    with dask.config.set({"distributed.scheduler.allowed-failures": 1}):
        report = batch(drives, tmp_path / "out", dask=True, jobs=2, filters=[killing_filter.Killer()])
    assert report.exit_status == 1
    good = dict.fromkeys(("0.bag", "1.bag", "b.mcap"), "converted")
    assert outcomes(tmp_path / "out") == {**good, "killer.bag": "died"}
    assert "its Dask worker died" in manifest_of(tmp_path / "out")["killer.bag"]["error"]["message"]
