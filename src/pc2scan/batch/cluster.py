"""An executor: runs jobs as tasks on a Dask cluster, and yields their events. Dask handles lost workers.

A task starts a child process of its Dask worker and converts there, as a batch on one machine does. So a conversion can
be interrupted, and it removes its unfinished output even if the Dask worker is killed.
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import time
from collections import Counter, deque
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from itertools import count
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from pc2scan.errors import MissingError, OutputError, Pc2ScanError, UsageError
from pc2scan.files.staging import clean_up
from pc2scan.files.urls import is_url, path_or_url
from pc2scan.version import __version__

from .jobs import Event
from .manifest import Identity
from .processes import run_jobs

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence
    from pathlib import Path

    from .jobs import Job
    from .manifest import ManifestRecord

#: Seconds between two checks whether a task was cancelled, and between two polls of the events.
_POLL_SECONDS = 0.5

#: Seconds that interrupted conversions, and those of lost workers, have to remove their unfinished output.
_CLEANUP_SECONDS = 15.0

#: Seconds within which a scheduler must answer.
_CONNECT_SECONDS = 10

_SHARED = "sources and OUT must be on a disk that all workers share, under the same path"


class _CancelledError(Exception):
    """The task was cancelled."""


class _ProcessDeathError(Exception):
    """The process of a conversion died; Dask tries the task again."""


class _UnseenError(Exception):
    """A worker does not see a path: the name of its machine, and the path."""


def check_dask() -> None:
    """Raise UsageError where Dask is not installed."""
    try:
        # Some of its modules catch every exception while they load, so Ctrl-C would be lost.
        with _block_sigint():
            import distributed  # noqa: F401, PLC0415  # an extra
    except ImportError as err:
        raise UsageError(
            "`dask` needs distributed, which is not installed", hint="pip install 'pc2scan[dask]'"
        ) from err


def dask_setup(_worker: Any) -> None:
    """Ignore Ctrl-C in a Dask worker on this machine: the parent process handles it. Dask calls this as one starts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_jobs_on_dask(
    jobs: Sequence[Job], *, address: str, workers: int, cores: int, retries: int, lock: int | None = None
) -> Generator[Event]:
    """Run jobs on the Dask cluster whose scheduler has this address; see `pc2scan.batch.jobs.Executor`.

    With an empty address, a cluster is started on this machine, and closed at the end.
    """
    del lock  # It is for processes on this machine.
    if not jobs:
        return
    with ExitStack() as stack:
        client = stack.enter_context(_connect(address, workers, cores, retries))
        yield Event("told", value=f"Dask's dashboard: {client.dashboard_link}")
        if not client.scheduler_info(n_workers=-1)["workers"]:
            yield Event("told", value=f"{address} has no worker yet; the batch begins when one joins")
            client.wait_for_workers(1)
        _check_workers(client, jobs)
        yield from _run_jobs(client, jobs, retries)


def _run_jobs(client: Any, jobs: Sequence[Job], retries: int) -> Generator[Event]:
    """Submit all jobs, and yield what happens until all are done."""
    inbox: SimpleQueue[tuple[str, str, Any]] = SimpleQueue()
    topic = f"pc2scan-{uuid4().hex}"
    client.subscribe_topic(topic, lambda event: inbox.put(event[1]))
    pending = deque(jobs)
    left: dict[str, Job] = {}
    futures: dict[str, Any] = {}
    attempts: Counter[str] = Counter()
    running: dict[str, float] = {}
    numbers = count()
    try:
        while pending or left:
            while pending:
                job = pending.popleft()
                left[job.key] = job
                number = next(numbers)
                future = client.submit(
                    _convert_on_worker,
                    job,
                    __version__,
                    topic,
                    key=f"{topic}-{number}",
                    retries=retries,
                    priority=-number,
                )
                futures[job.key] = future
                future.add_done_callback(lambda future, key=job.key: inbox.put(("done", key, future)))
            try:
                what, key, value = inbox.get(timeout=_POLL_SECONDS)
            except Empty:
                if client.status == "closed":
                    raise _loss_error() from None
                continue
            if what == "gone":
                running.pop(key, None)
            if key not in left:
                continue
            match what:
                case "began":
                    attempts[key] += 1
                    running[key] = time.monotonic()
                    yield Event("begun", key)
                case "done":
                    job = left.pop(key)
                    seconds = round(time.monotonic() - running.get(key, time.monotonic()), 3)
                    record = _record(job, value, seconds)
                    if attempts[key] > 1 and job != job.retried() and _says(record, "exists already"):
                        # The first attempt, whose worker was lost, has completed the output nevertheless.
                        pending.append(job.retried())
                        continue
                    yield Event("done", key, replace(record, attempts=max(1, attempts[key])))
    finally:
        connected = client.status == "running"
        if left:
            if connected:
                client.cancel(list(futures.values()), force=True)
                _wait_for_end(inbox, running)
            for job in left.values():
                with suppress(Pc2ScanError):
                    clean_up(path_or_url(job.destination))
        if connected:
            client.unsubscribe_topic(topic)


def _wait_for_end(inbox: SimpleQueue[tuple[str, str, Any]], running: dict[str, float]) -> None:
    """Wait until cancelled conversions have removed their unfinished output."""
    deadline = time.monotonic() + _CLEANUP_SECONDS
    while running and time.monotonic() < deadline:
        with suppress(Empty):
            what, key, _ = inbox.get(timeout=_POLL_SECONDS)
            if what == "gone":
                running.pop(key, None)


def _record(job: Job, future: Any, seconds: float) -> ManifestRecord:
    """Return what a finished task has found; raises if the cluster cannot convert anything of this batch."""
    from distributed import KilledWorker  # noqa: PLC0415  # an extra

    if future.status == "cancelled":
        raise _loss_error()
    if future.status != "error":
        record: ManifestRecord = future.result()
        return record
    match future.exception():
        case KilledWorker() as err:
            return job.death(f"its Dask worker died: {err}", attempts=1, seconds=seconds)
        case _ProcessDeathError() as err:
            return job.death(str(err), attempts=1, seconds=seconds)
        case _UnseenError(args=(host, path)):
            if os.path.lexists(path):
                raise _unseen_error(host, path)
            if path not in job.sources:
                raise OutputError(f"the Dask worker on {host} does not see {path}", hint=_SHARED)
            return job.failure(MissingError("does not exist", path=path_or_url(path)), identity=Identity())
        case UsageError() as err:
            raise err
        case err:
            raise Pc2ScanError(
                f"a Dask worker cannot convert: {type(err).__name__}: {err}",
                hint="every worker needs the same version of pc2scan, and the modules of your own filters",
            )


def _says(record: ManifestRecord, text: str) -> bool:
    """Return whether the error of a recording has this text."""
    return text in (record.error or {}).get("message", "")


def _convert_on_worker(job: Job, version: str, topic: str) -> ManifestRecord:
    """Convert a recording in a child process: runs on a worker, in one of its threads."""
    from distributed import get_worker  # noqa: PLC0415  # an extra

    host = socket.gethostname()
    if version != __version__:
        raise _version_error(host, __version__)
    folder = path_or_url(job.destination).parent
    unseen = [path for path in job.sources if not is_url(path) and not os.path.lexists(path)]
    if not is_url(folder) and not _is_there(folder):
        unseen.insert(0, str(folder))
    if unseen:
        raise _UnseenError(host, unseen[0])
    worker = get_worker()
    threads = max(1, worker.state.nthreads // max(1, worker.state.executing_count))
    deadline = time.monotonic() + _CLEANUP_SECONDS
    worker.log_event(topic, ("began", job.key, None))
    try:
        record = _convert_in_process(job, threads, worker)
        # The process of an earlier attempt may still hold the output. It ends soon after its worker was killed.
        while _says(record, "being written by another run") and time.monotonic() < deadline:
            time.sleep(_POLL_SECONDS)
            record = _convert_in_process(job, threads, worker)
    finally:
        worker.log_event(topic, ("gone", job.key, None))
    if record.outcome == "died":
        raise _ProcessDeathError((record.error or {}).get("message", ""))
    return record


def _convert_in_process(job: Job, threads: int, worker: Any) -> ManifestRecord:
    """Convert a recording; raises if its task is cancelled meanwhile."""
    from distributed import Status  # noqa: PLC0415  # an extra

    key = worker.get_current_task()
    with closing(run_jobs([job], workers=1, cores=threads, retries=0)) as events:
        for event in events:
            if event.what == "done":
                record: ManifestRecord = event.value
                return record
            task = worker.state.tasks.get(key)
            if task is None or task.state == "cancelled" or worker.status not in (Status.running, Status.paused):
                break
    raise _CancelledError


def _is_there(folder: Path) -> bool:
    """Whether a folder exists, which another machine may have just created."""
    if folder.is_dir():
        return True
    with suppress(OSError):
        # Listing a folder makes network file systems refresh what they have cached of it.
        list(folder.parent.iterdir())
    time.sleep(_POLL_SECONDS)
    return folder.is_dir()


def _check_workers(client: Any, jobs: Sequence[Job]) -> None:
    """Raise unless all workers have this version of pc2scan, and see the sources and the destination."""
    named = {path for job in jobs for path in (*job.sources, os.path.dirname(job.destination))}  # noqa: PTH120
    paths = sorted(path for path in named if not is_url(path))

    # Dask sends a nested function by value, so a worker without pc2scan can run it, too.
    def look(paths: list[str]) -> tuple[str, str, list[str]]:
        import os  # noqa: PLC0415
        import socket  # noqa: PLC0415

        try:
            from pc2scan.version import __version__ as version  # noqa: PLC0415
        except ImportError:
            version = ""
        return socket.gethostname(), version, [path for path in paths if not os.path.lexists(path)]

    for host, version, unseen in client.run(look, paths).values():
        if version != __version__:
            raise _version_error(host, version)
        if here := [path for path in unseen if os.path.lexists(path)]:
            raise _unseen_error(host, here[0])


def _unseen_error(host: str, path: str) -> Pc2ScanError:
    return UsageError(f"the Dask worker on {host} does not see {path}", hint=_SHARED)


def _version_error(host: str, version: str) -> Pc2ScanError:
    has = f"has pc2scan {version}, this is {__version__}" if version else "has no pc2scan"
    return UsageError(
        f"the Dask worker on {host} {has}", hint=f"on every worker: pip install 'pc2scan[dask]=={__version__}'"
    )


def _loss_error() -> Pc2ScanError:
    return Pc2ScanError("the connection to Dask's scheduler was lost", hint="run the same batch again to continue it")


def _ask(address: str) -> None:
    """Raise unless a scheduler answers. A client would wait forever if it accepts connections and never answers."""
    from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415

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
def _connect(address: str, workers: int, cores: int, retries: int) -> Iterator[Any]:
    """Yield a client of the scheduler, or of a cluster on this machine."""
    import logging  # noqa: PLC0415

    import dask  # noqa: PLC0415  # an extra
    from distributed import Client, LocalCluster  # noqa: PLC0415

    # Dask sets the levels of these loggers itself, so the root logger's level has no effect on them.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        if not address:
            # Dask counts every task that a dead worker held as tried. So no worker holds a second, waiting task.
            settings = {
                "distributed.scheduler.allowed-failures": retries,
                "distributed.scheduler.worker-saturation": 1.0,
            }
            stack.enter_context(dask.config.set(settings))
            from multiprocessing import resource_tracker  # noqa: PLC0415  # only clusters on this machine need it

            # Started now, because starting it later would unblock the signal.
            resource_tracker.ensure_running()
            with _block_sigint():
                # Dask cannot stop a cluster while it starts: Ctrl-C takes effect after that.
                cluster = stack.enter_context(
                    LocalCluster(
                        n_workers=workers,
                        threads_per_worker=max(1, cores // workers),
                        processes=True,
                        dashboard_address="127.0.0.1:0",
                        memory_limit=0,
                        preload=[__name__],
                        silence_logs=logging.CRITICAL,
                    )
                )
                client = stack.enter_context(Client(cluster))
            yield client
            return
        try:
            _ask(address)
            client = Client(address, timeout=_CONNECT_SECONDS)
        # Before Python 3.11 asyncio's TimeoutError was a class of its own.
        except (OSError, asyncio.TimeoutError, ValueError) as err:
            why = str(err) or f"no answer within {_CONNECT_SECONDS} seconds"
            raise UsageError(
                f"`dask={address}` does not answer as a Dask scheduler: {why}", hint="is it the scheduler's address?"
            ) from err
        yield stack.enter_context(client)
