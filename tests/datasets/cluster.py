"""A Dask cluster as its own commands start it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from support.command import environment

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

__all__ = ["cluster"]


@contextmanager
def cluster(
    folder: Path, *workers: dict[str, str], **variables: str
) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler, and workers with environment variables of their own; ``variables`` are those of all.

    Yields the address and the processes of the workers.
    """
    file = folder / "scheduler.json"
    started: list[subprocess.Popen[bytes]] = []
    scheduler = "dask_scheduler", "--port", "0"
    worker = "dask_worker", "--nthreads", "1", "--no-nanny"
    try:
        for own, (program, *options) in zip(({}, *workers), (scheduler, *[worker] * len(workers)), strict=True):
            command = [sys.executable, "-m", f"distributed.cli.{program}", *options, "--host", "127.0.0.1"]
            started.append(
                subprocess.Popen(
                    [*command, "--no-dashboard", "--scheduler-file", str(file)],
                    env={**environment(), **variables, **own},
                    cwd=folder,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            )
            deadline = time.monotonic() + 30
            while not file.exists() and time.monotonic() < deadline:
                time.sleep(0.05)
        yield json.loads(file.read_text())["address"], started[1:]
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()
