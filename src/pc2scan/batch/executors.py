"""The executors of a batch, processes or a Dask cluster: how many recordings at a time, and how long all take."""

from __future__ import annotations

import tempfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.files.urls import is_url
from pc2scan.threads import cores

from .jobs import convert_one
from .processes import run_jobs

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence

    from .jobs import Job
    from .manifest import ManifestRecord
    from .processes import Event, Executor

#: Sizes of recordings that are converted as a sample: smaller ones say little, larger ones take too long.
_SAMPLE_BYTES = range(1_000_000, 300_000_000)

#: Memory that is counted for a worker. A conversion with one thread takes less, unless chunks or clouds are very large.
_WORKER_BYTES = 300_000_000


def local_executor(*, workers: int, retries: int, lock: int | None) -> Executor:
    """Return an executor with processes on this machine; ``lock`` is the lock that they inherit."""

    def executor(jobs: Sequence[Job]) -> Generator[Event]:
        yield from run_jobs(jobs, workers=workers, cores=cores(), retries=retries, lock=lock)

    return executor


def dask_executor(address: str) -> Callable[..., Executor]:
    """Return what makes an executor on the cluster at this address; empty: on one that is started on this machine."""
    from .cluster import check_dask, run_jobs_on_dask  # noqa: PLC0415  # most batches have no cluster

    check_dask()

    def make(*, workers: int, retries: int, lock: int | None) -> Executor:
        del lock  # It is for processes on this machine.

        def executor(jobs: Sequence[Job]) -> Generator[Event]:
            return run_jobs_on_dask(jobs, address, workers=workers, cores=cores(), retries=retries)

        return executor

    return make


def estimate_seconds(jobs: Sequence[Job], records: Sequence[ManifestRecord], workers: int) -> float | None:
    """Return how many seconds these jobs would take; None if that cannot be estimated.

    Parameters
    ----------
    jobs
        The recordings that would be converted.
    records
        The lines of the manifest.
    workers
        How many recordings are converted at a time.
    """
    size = sum(job.size_bytes for job in jobs)
    if not size:
        return 0.0
    done = [record for record in records if record.is_written and record.seconds > 0]
    pace = sum(record.identity.size_bytes for record in done) / max(sum(record.seconds for record in done), 1e-9)
    if not done:
        pace = _sample_pace(jobs)
    return size / pace / max(1, min(workers, len(jobs))) if pace else None


def _sample_pace(jobs: Sequence[Job]) -> float:
    """Return the bytes per second of a small recording, converted into a temporary folder; 0 if there is none."""
    local = (job for job in jobs if not any(map(is_url, job.sources)))
    fitting = sorted((job for job in local if job.size_bytes in _SAMPLE_BYTES), key=lambda job: job.size_bytes)
    for job in fitting[:3]:
        with tempfile.TemporaryDirectory(prefix="pc2scan-") as folder:
            destination = str(Path(folder) / Path(job.destination).name)
            result = convert_one(replace(job, destination=destination, dry_run=False))
            if result.report is not None and result.seconds:
                return job.size_bytes / result.seconds
    return 0.0


def workers_for(count: int, cores: int, available: int | None) -> int:
    """Return the number of worker processes for a number of recordings.

    Parameters
    ----------
    count
        Number of recordings.
    cores
        Number of processor cores.
    available
        Free memory in bytes; None if unknown.
    """
    room = cores if available is None else available // _WORKER_BYTES
    return max(1, min(count, cores, room))


def available_bytes() -> int | None:
    """Return how many bytes of memory are free on this machine, or in the container that this process runs in."""
    free: list[int] = []
    with suppress(OSError, ValueError, LookupError):
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
        free += [int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")]
    with suppress(OSError, ValueError):
        group = Path("/sys/fs/cgroup")
        limit, used = (int((group / f"memory.{name}").read_text("ascii")) for name in ("max", "current"))
        # The cgroup counts the page cache as used, but the kernel frees it when memory is needed.
        lines = (group / "memory.stat").read_text("ascii").splitlines()
        cached = sum(int(line.split()[1]) for line in lines if line.startswith(("active_file ", "inactive_file ")))
        free.append(max(0, limit - used + cached))
    return min(free, default=None)
