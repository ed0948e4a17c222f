"""Converts the recordings of a batch on a Dask cluster: a task each, in a thread of a worker."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any

from pc2scan.errors import Pc2ScanError, UsageError
from pc2scan.files.staging import clean_up
from pc2scan.files.urls import is_url, path_or_url
from pc2scan.threads import cores
from pc2scan.version import __version__

from .jobs import convert_one

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from .jobs import Job
    from .manifest import ManifestRecord

#: Seconds within which a scheduler must answer.
_CONNECT_SECONDS = 10

#: Above every level: what Dask logs when it is interrupted is no error.
_SILENT = logging.CRITICAL + 1


def check_dask() -> None:
    """Raise UsageError where Dask is not installed."""
    try:
        # Some of its modules catch every exception while they load, so Ctrl-C would be lost.
        with _block_sigint():
            import distributed  # noqa: F401, PLC0415  # an extra
    except ImportError as err:
        raise UsageError(
            "`dask` needs distributed, which is not installed", hint='pip install "pc2scan[dask]"'
        ) from err


def dask_setup(_worker: Any) -> None:
    """Ignore Ctrl-C in a Dask worker on this machine: the parent process handles it. Dask calls this as one starts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_jobs_on_dask(
    jobs: Sequence[Job], *, address: str, workers: int, lock: int | None = None
) -> Generator[ManifestRecord]:
    """Convert recordings on the cluster whose scheduler has this address; see `pc2scan.datasets.jobs.Executor`.

    With an empty address, a cluster is started on this machine, and closed at the end.
    """
    from distributed import as_completed  # noqa: PLC0415  # an extra

    del lock  # It is for processes on this machine.
    if not jobs:
        return
    threads = 1 if address else max(1, cores() // workers)
    left: dict[Any, Job] = {}
    try:
        with _connect(address, workers) as client:
            client.wait_for_workers(1)
            _check_workers(client, jobs)
            left.update((client.submit(convert_one, replace(job, threads=threads), pure=False), job) for job in jobs)
            ended = as_completed(list(left), raise_errors=False)
            try:
                for future in ended:
                    job = left[future]
                    record = _record_of(future, job)
                    if job.is_new and "exists already" in (record.error or {}).get("message", ""):
                        # The first attempt, whose worker was lost, has completed the output nevertheless.
                        again = client.submit(convert_one, replace(job.retried(), threads=threads), pure=False)
                        left[again] = job.retried()
                        ended.add(again)
                    else:
                        yield record
                    del left[future]
            finally:
                if left and client.status == "running":
                    client.cancel(list(left), force=True)
    finally:
        for job in left.values():
            with suppress(Pc2ScanError):
                clean_up(path_or_url(job.destination))


def _record_of(future: Any, job: Job) -> ManifestRecord:
    """Return the line of a task that has ended; raises if the cluster cannot convert anything of this batch."""
    from distributed import KilledWorker  # noqa: PLC0415  # an extra

    if future.status == "cancelled":
        raise Pc2ScanError(
            "the connection to Dask's scheduler was lost", hint="run the same batch again to continue it"
        )
    try:
        record: ManifestRecord = future.result()
    except KilledWorker as err:
        with suppress(Pc2ScanError):
            clean_up(path_or_url(job.destination))
        return job.death(f"its Dask worker died: {err}", attempts=err.allowed_failures + 1, seconds=0.0)
    except Exception as err:
        raise Pc2ScanError(
            f"a Dask worker cannot convert: {type(err).__name__}: {err}",
            hint="every worker needs the same version of pc2scan, and the modules of your own filters",
        ) from err
    return record


def _check_workers(client: Any, jobs: Sequence[Job]) -> None:
    """Raise unless all workers have this version of pc2scan, and see the sources and the destination."""
    named = {path for job in jobs for path in (*job.sources, os.path.dirname(job.destination))}  # noqa: PTH120
    paths = sorted(path for path in named if not is_url(path))

    # Dask sends a nested function by value, so a worker without pc2scan can run it, too.
    def look(paths: list[str]) -> tuple[str, str, list[str]]:
        try:
            from pc2scan.version import __version__ as version  # noqa: PLC0415
        except ImportError:
            version = ""
        return socket.gethostname(), version, [path for path in paths if not os.path.lexists(path)]

    for host, version, unseen in client.run(look, paths).values():
        if version != __version__:
            has = f"has pc2scan {version}, this is {__version__}" if version else "has no pc2scan"
            raise UsageError(
                f"the Dask worker on {host} {has}", hint=f'on every worker: pip install "pc2scan[dask]=={__version__}"'
            )
        if here := [path for path in unseen if os.path.lexists(path)]:
            raise UsageError(
                f"the Dask worker on {host} does not see {here[0]}",
                hint="sources and OUT must be on a disk that all workers share, under the same path",
            )


def _ask(address: str) -> None:
    """Raise unless a scheduler answers. A client would wait forever if it accepts connections and never answers."""
    from distributed.core import rpc  # noqa: PLC0415  # an extra

    async def ask() -> None:
        async with rpc(address) as scheduler:
            await asyncio.wait_for(scheduler.identity(), _CONNECT_SECONDS)

    # In another thread: that of a notebook already runs an event loop.
    with ThreadPoolExecutor(1) as thread:
        thread.submit(asyncio.run, ask()).result()


@contextmanager
def _block_sigint() -> Iterator[None]:
    """Block Ctrl-C in this thread, and in threads and processes that it starts within the context."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _connect(address: str, workers: int) -> Iterator[Any]:
    """Yield a client of the scheduler, or of a cluster on this machine."""
    import dask  # noqa: PLC0415  # an extra
    from distributed import Client, LocalCluster  # noqa: PLC0415

    # Dask sets the levels of these loggers itself, so the root logger's level has no effect on them.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(_SILENT)
    with ExitStack() as stack:
        if address:
            try:
                _ask(address)
                client = Client(address, timeout=_CONNECT_SECONDS)
            # Before Python 3.11 asyncio's TimeoutError was a class of its own.
            except (OSError, asyncio.TimeoutError, ValueError) as err:
                why = str(err) or f"no answer within {_CONNECT_SECONDS} seconds"
                raise UsageError(
                    f"`dask={address}` does not answer as a Dask scheduler: {why}",
                    hint="is it the scheduler's address?",
                ) from err
            yield stack.enter_context(client)
            return
        # Dask counts every task that a dead worker held as tried. So no worker holds a second, waiting task.
        settings = {"distributed.scheduler.allowed-failures": 1, "distributed.scheduler.worker-saturation": 1.0}
        stack.enter_context(dask.config.set(settings))
        # Started now, because starting it later would unblock the signal.
        resource_tracker.ensure_running()
        with _block_sigint():
            # Dask cannot stop a cluster while it starts: Ctrl-C takes effect after that.
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    dashboard_address="127.0.0.1:0",
                    memory_limit=0,
                    preload=[__name__],
                    silence_logs=_SILENT,
                )
            )
            client = stack.enter_context(Client(cluster))
        yield client
