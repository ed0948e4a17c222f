"""The executors of a batch: processes on this machine, or a Dask cluster; around both, long recordings in pieces."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pc2scan.pipeline.scheduler import cores

from .staged import jobs_here
from .workers import execute as execute_here

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence

    from .work import Job
    from .workers import Event, Executor


def count_of(jobs: Sequence[Job]) -> int:
    """Return how many processes could work on these jobs at the same time."""
    if not any(job.request.output.cut for job in jobs):
        return len(jobs)
    from .cutting import count_of as count_of_pieces  # noqa: PLC0415  # most outputs are one file

    return count_of_pieces(jobs)


def _cutting(executor: Executor) -> Executor:
    """Return an executor that converts long recordings in pieces, where their output is split."""

    def execute(jobs: Sequence[Job]) -> Generator[Event]:
        if not any(job.request.output.cut for job in jobs):
            return executor(jobs)
        from .cutting import in_pieces  # noqa: PLC0415  # most outputs are one file

        return in_pieces(executor)(jobs)

    return execute


def local(*, workers: int, retries: int, lock: int | None) -> Executor:
    """Return an executor with processes on this machine; ``lock`` is the lock that they inherit."""

    def executor(jobs: Sequence[Job]) -> Generator[Event]:
        with jobs_here(jobs, workers) as queue:
            yield from execute_here(queue, workers=workers, cores=cores(), retries=retries, lock=lock)

    return _cutting(executor)


def on_dask(address: str) -> Callable[..., Executor]:
    """Return what makes an executor on the cluster at this address; empty: on one that is started on this machine."""
    from .cluster import check_dask, execute_on_dask  # noqa: PLC0415  # most batches have no cluster

    check_dask()

    def make(*, workers: int, retries: int, lock: int | None) -> Executor:
        del lock  # It is for processes on this machine.

        def executor(jobs: Sequence[Job]) -> Generator[Event]:
            if not address and isinstance(jobs, list):
                # The workers are on this machine and share its disk, so each gets a part of the space for copies.
                jobs = [
                    job if job.scratch_size is None else replace(job, scratch_size=job.scratch_size // workers)
                    for job in jobs
                ]
            return execute_on_dask(jobs, address, workers=workers, cores=cores(), retries=retries)

        return _cutting(executor)

    return make
