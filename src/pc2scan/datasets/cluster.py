"""Converts the recordings of a batch on a Dask cluster: a task each, in a thread of a worker."""

from __future__ import annotations

import logging
import signal
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pc2scan.errors import Pc2ScanError, UsageError
from pc2scan.threads import cores
from pc2scan.version import __version__

from .jobs import convert_one

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from .jobs import Job
    from .manifest import ManifestRecord

#: Seconds within which a scheduler must answer.
_CONNECT_SECONDS = 10

#: Above every level: what Dask logs when it is interrupted is no error.
_SILENT = logging.CRITICAL + 1


def dask_setup(_worker: Any) -> None:
    """Ignore Ctrl-C in a Dask worker on this machine: the parent process handles it. Dask calls this as one starts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_jobs_on_dask(jobs: Sequence[Job], *, address: str, workers: int) -> Generator[ManifestRecord]:
    """Convert recordings on the cluster whose scheduler has this address; see `pc2scan.datasets.processes.run_jobs`.

    With an empty address, a cluster is started on this machine, and closed at the end.
    """
    try:
        from distributed import as_completed  # noqa: PLC0415  # an extra
    except ImportError as err:
        raise UsageError(
            "`dask` needs distributed, which is not installed", hint='pip install "pc2scan[dask]"'
        ) from err
    threads = 1 if address else max(1, cores() // workers)
    with ExitStack() as stack:
        client = _connect(address, workers, stack)
        client.wait_for_workers(1)
        _check_versions(client)
        # Dask does again what a lost worker had done; its output may be there, and is replaced.
        again = [replace(job.retried(), threads=threads) for job in jobs]
        # One message to the scheduler for all of them.
        tasks = dict(zip(client.map(convert_one, again, pure=False), again, strict=True))
        for task in as_completed(list(tasks), raise_errors=False):
            yield _record_of(task, tasks.pop(task))


def _record_of(task: Any, job: Job) -> ManifestRecord:
    """Return the line of a task that has ended; raises if the cluster cannot convert anything of this batch."""
    from distributed import KilledWorker  # noqa: PLC0415  # an extra

    if task.status == "cancelled":
        raise Pc2ScanError(
            "the connection to Dask's scheduler was lost", hint="run the same batch again to continue it"
        )
    try:
        record: ManifestRecord = task.result()
    except KilledWorker as err:
        return job.death(f"its Dask worker died: {err}")
    except Exception as err:
        raise Pc2ScanError(
            f"a Dask worker cannot convert: {type(err).__name__}: {err}",
            hint="every worker needs the same version of pc2scan, and the modules of your own filters",
        ) from err
    return record


def _check_versions(client: Any) -> None:
    """Raise unless all workers have this version of pc2scan: another one may give other bits."""

    # Dask sends a nested function by value, so a worker without pc2scan can run it, too.
    def version() -> str:
        from pc2scan.version import __version__ as worker_version  # noqa: PLC0415

        return worker_version

    for worker, installed in client.run(version, on_error="return").items():
        if installed != __version__:
            raise UsageError(
                f"the Dask worker at {worker} has another pc2scan ({installed}), this is {__version__}",
                hint=f'on every worker: pip install "pc2scan[dask]=={__version__}"',
            )


def _connect(address: str, workers: int, stack: ExitStack) -> Any:
    """Return a client of the scheduler, or of a cluster on this machine, until the stack is closed."""
    import dask  # noqa: PLC0415  # an extra
    from distributed import Client, LocalCluster  # noqa: PLC0415

    # Dask sets the levels of these loggers itself, so the root logger's level has no effect on them.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(_SILENT)
    if not address:
        # Dask counts every task that a dead worker held as tried. So no worker holds a second, waiting task.
        settings = {
            "distributed.scheduler.allowed-failures": 1,
            "distributed.scheduler.worker-saturation": 1.0,
            # It looks at each worker's stack a hundred times a second.
            "distributed.worker.profile.enabled": False,
        }
        stack.enter_context(dask.config.set(settings))
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",
            memory_limit=0,
            preload=[__name__],
            silence_logs=_SILENT,
        )
        return stack.enter_context(Client(stack.enter_context(cluster)))
    try:
        return stack.enter_context(Client(address, timeout=_CONNECT_SECONDS))
    # Before Python 3.11 asyncio's TimeoutError was a class of its own.
    except (OSError, TimeoutError, ValueError) as err:
        raise UsageError(
            f"`dask={address}` does not answer as a Dask scheduler: {err}", hint="is it the scheduler's address?"
        ) from err
