"""An executor: runs jobs as tasks on a Dask cluster, and yields their events. Dask handles lost workers.

A task converts in a child process of its Dask worker, as a batch on one machine does. So a conversion can be
interrupted, and it removes its unfinished output even if the Dask worker is killed. The process stays for the next
recordings of the batch, because starting one takes longer than converting a small recording.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
import threading
import time
from collections import Counter, deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from itertools import count
from multiprocessing import resource_tracker
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple
from uuid import uuid4

from pc2scan.errors import MissingError, OutputError, Pc2ScanError, UsageError
from pc2scan.files.staging import clean_up
from pc2scan.files.urls import is_url, path_or_url
from pc2scan.version import __version__

from .jobs import Event
from .manifest import Identity
from .processes import Pool, run_jobs

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator, Sequence
    from pathlib import Path

    from .jobs import Job
    from .manifest import ManifestRecord

#: Seconds between two checks whether a task was cancelled, and between two polls of the events.
_POLL_SECONDS = 0.5

#: Seconds that interrupted conversions, and those of lost workers, have to remove their unfinished output.
_CLEANUP_SECONDS = 15.0

#: Seconds after which a process that no recording needs is ended.
_KEEP_SECONDS = 10.0

#: Seconds without an event after which the workers of a cluster on this machine are counted.
_LONELY_SECONDS = 30.0

#: How many recordings a task has at most, and how many bytes if it has several.
_MOST_JOBS = 16
_TASK_BYTES = 20_000_000

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
            "`dask` needs distributed, which is not installed", hint='pip install "pc2scan[dask]"'
        ) from err


def dask_setup(_worker: Any) -> None:
    """Ignore Ctrl-C in a Dask worker on this machine: the parent process handles it. Dask calls this as one starts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_jobs_on_dask(
    jobs: Sequence[Job], *, address: str, workers: int, cores: int, lock: int | None = None
) -> Generator[Event]:
    """Run jobs on the Dask cluster whose scheduler has this address; see `pc2scan.datasets.jobs.Executor`.

    With an empty address, a cluster is started on this machine, and closed at the end.
    """
    del lock  # It is for processes on this machine.
    if not jobs:
        return
    with ExitStack() as stack:
        client = stack.enter_context(_connect(address, workers))
        yield Event("told", value=f"Dask's dashboard: {client.dashboard_link}")
        if not client.scheduler_info(n_workers=-1)["workers"]:
            yield Event("told", value=f"{address} has no worker yet; the batch begins when one joins")
            client.wait_for_workers(1)
        _check_workers(client, jobs)
        at_a_time = _tasks_at_a_time(client)
        yield Event("workers", value=at_a_time)
        # A cluster that was started here has a thread for each task: the cores are for the conversions.
        threads = 0 if address else max(1, cores // workers)
        yield from _run_jobs(client, tasks_of(jobs, at_a_time), threads)
        if client.status == "running":
            yield Event("workers", value=_tasks_at_a_time(client))


def _tasks_at_a_time(client: Any) -> int:
    """Return how many recordings the workers of a cluster convert at a time."""
    return sum(worker["nthreads"] for worker in client.scheduler_info(n_workers=-1)["workers"].values())


class _Task(NamedTuple):
    """Recordings that a worker converts one after the other, and how often the task is tried again if one kills it."""

    jobs: tuple[Job, ...]
    retries: int = 1

    def singly(self) -> list[_Task]:
        """Return a task for each recording, after an attempt that may have completed some of them."""
        return [_Task((job.retried(),), self.retries) for job in self.jobs]


def tasks_of(jobs: Sequence[Job], at_a_time: int) -> Iterator[_Task]:
    """Yield tasks of several small recordings: handing one over takes longer than converting it."""
    most = max(1, min(_MOST_JOBS, len(jobs) // (4 * max(1, at_a_time))))
    together: list[Job] = []
    size = 0
    for job in jobs:
        is_small = job.size_bytes * most <= _TASK_BYTES and not any(map(is_url, job.sources))
        if together and (not is_small or len(together) == most or size + job.size_bytes > _TASK_BYTES):
            yield _Task(tuple(together))
            together, size = [], 0
        together.append(job)
        size = size + job.size_bytes if is_small else _TASK_BYTES
    if together:
        yield _Task(tuple(together))


def _run_jobs(client: Any, tasks: Iterable[_Task], threads: int) -> Generator[Event]:
    """Submit all tasks, and yield what happens until all are done.

    A conversion has this number of threads; 0: its part of those of its Dask worker.
    """
    inbox: SimpleQueue[tuple[str, str, Any]] = SimpleQueue()
    topic = f"pc2scan-{uuid4().hex}"
    # How often each task has begun, and each recording in tasks that have ended.
    begun: Counter[str] = Counter()
    attempts: Counter[str] = Counter()

    def listen(event: tuple[Any, tuple[str, str, Any]]) -> None:
        # Counted here: a task may begin again, because its result was lost, while that is waited for below.
        what, name, _ = event[1]
        begun[name] += what == "began"
        inbox.put(event[1])

    client.subscribe_topic(topic, listen)
    pending = deque(tasks)
    left: dict[str, _Task] = {}
    futures: dict[str, Any] = {}
    running: dict[str, float] = {}
    numbers = count()
    quiet_since = time.monotonic()
    try:
        while pending or left:
            while pending:
                task, number = pending.popleft(), next(numbers)
                name = f"{topic}-{number}"
                left[name] = task
                futures[name] = client.submit(
                    _convert_on_worker,
                    task.jobs,
                    __version__,
                    topic,
                    threads,
                    key=name,
                    retries=task.retries,
                    priority=-number,
                )
                futures[name].add_done_callback(lambda future, name=name: inbox.put(("done", name, future)))
            happened = _next(inbox)
            if happened:
                quiet_since = time.monotonic()
            elif client.status == "closed":
                raise _loss_error()
            elif threads and time.monotonic() > quiet_since + _LONELY_SECONDS:
                # Dask does not replace a worker that dies while it starts. Elsewhere, another one may still join.
                quiet_since = time.monotonic()
                if not _tasks_at_a_time(client):
                    raise Pc2ScanError(
                        "no Dask worker is left on this machine", hint="run the same batch again to continue it"
                    )
            # All results that are there are fetched at once: a request takes as long as a small conversion.
            found = _results(client, [value for what, _, value in happened if what == "done"])
            for what, name, value in happened:
                if what == "gone":
                    running.pop(name, None)
                if name not in left:
                    continue
                match what:
                    case "began":
                        running[name] = time.monotonic()
                        for job in left[name].jobs:
                            yield Event("begun", job.key)
                    case "done":
                        task = left.pop(name)
                        del futures[name]
                        seconds = round(time.monotonic() - running.get(name, time.monotonic()), 3)
                        records = found.get(name) or _records(task, value, seconds)
                        if not records:
                            # One of them has killed the worker, or is not there: each is tried by itself.
                            pending += task.singly()
                        attempts.update({job.key: begun[name] for job in task.jobs})
                        for job, record in zip(task.jobs, records, strict=bool(records)):
                            if begun[name] > 1 and job != job.retried() and _says(record, "exists already"):
                                # The first attempt, whose worker was lost, has completed the output nevertheless.
                                pending.append(_Task((job.retried(),), task.retries))
                            elif record.outcome == "died" and len(task.jobs) > 1 and task.retries:
                                pending.append(_Task((job.retried(),), task.retries - 1))
                            else:
                                if record.outcome == "died":
                                    _clean_up_dead(job)
                                yield Event(
                                    "done", job.key, replace(record, attempts=max(record.attempts, attempts[job.key]))
                                )
    finally:
        connected = client.status == "running"
        if left:
            if connected:
                client.cancel(list(futures.values()), force=True)
                _wait_for_end(inbox, running)
            for job in (job for task in left.values() for job in task.jobs):
                with suppress(Pc2ScanError):
                    clean_up(path_or_url(job.destination))
        if connected:
            client.unsubscribe_topic(topic)


def _next(inbox: SimpleQueue[tuple[str, str, Any]]) -> list[tuple[str, str, Any]]:
    """Wait for what happens next, and return it with all that has happened since; empty if nothing happens."""
    happened: list[tuple[str, str, Any]] = []
    with suppress(Empty):
        happened.append(inbox.get(timeout=_POLL_SECONDS))
        while True:
            happened.append(inbox.get_nowait())
    return happened


def _results(client: Any, futures: Sequence[Any]) -> dict[str, list[ManifestRecord]]:
    """Return the results of the tasks that have one, by the tasks' keys."""
    finished = [future for future in futures if future.status == "finished"]
    if len(finished) < 2:
        return {}
    try:
        records = client.gather(finished)
    except Exception:  # noqa: BLE001  # a result is lost; each is asked for by itself, which says why
        return {}
    return {future.key: record for future, record in zip(finished, records, strict=True)}


def _clean_up_dead(job: Job) -> None:
    """Remove what a conversion left whose worker died; its process may hold the output until it has ended, too."""
    deadline = time.monotonic() + _CLEANUP_SECONDS
    with suppress(Pc2ScanError):
        while not clean_up(path_or_url(job.destination)) and time.monotonic() < deadline:
            time.sleep(_POLL_SECONDS)


def _wait_for_end(inbox: SimpleQueue[tuple[str, str, Any]], running: dict[str, float]) -> None:
    """Wait until cancelled conversions have removed their unfinished output."""
    deadline = time.monotonic() + _CLEANUP_SECONDS
    while running and time.monotonic() < deadline:
        with suppress(Empty):
            what, key, _ = inbox.get(timeout=_POLL_SECONDS)
            if what == "gone":
                running.pop(key, None)


def _records(task: _Task, future: Any, seconds: float) -> list[ManifestRecord]:
    """Return what a finished task has found; empty if its recordings must be tried one by one.

    Raises if the cluster cannot convert anything of this batch.
    """
    if future.status == "cancelled":
        raise _loss_error()
    try:
        # A result that was lost with its worker is waited for, and may become an error.
        records: list[ManifestRecord] = future.result()
    except Exception as err:  # noqa: BLE001  # any error of the task
        if len(task.jobs) > 1 and not isinstance(err, UsageError):
            return []
        return [_failure(task.jobs[0], err, seconds)]
    return records


def _failure(job: Job, error: Any, seconds: float) -> ManifestRecord:
    """Return the line of a recording whose task has failed; raises if the cluster cannot convert anything."""
    from distributed import KilledWorker  # noqa: PLC0415  # an extra

    match error:
        case KilledWorker() as err:
            attempts = err.allowed_failures + 1
            return job.death(f"its Dask worker died: {err}", attempts=attempts, seconds=seconds)
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


class _Processes:
    """The processes of a Dask worker that wait for the next recording of a batch, which is named by its topic."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[tuple[str, Pool, float]] = []

    @contextmanager
    def take(self, batch: str) -> Iterator[Pool]:
        """Yield a process that waits, or none yet; afterwards it waits again, unless it has ended meanwhile."""
        with self._lock:
            index = next((at for at, (topic, *_) in enumerate(self._waiting) if topic == batch), None)
            pool = Pool() if index is None else self._waiting.pop(index)[1]
        if pool.workers and not pool.is_ready:
            pool.close()
            pool = Pool()
        try:
            yield pool
        finally:
            if pool.is_ready:
                with self._lock:
                    self._waiting.append((batch, pool, time.monotonic()))
                timer = threading.Timer(_KEEP_SECONDS, self._end_idle)
                timer.daemon = True
                timer.start()

    def _end_idle(self) -> None:
        """End the processes that have waited for too long."""
        before = time.monotonic() - _KEEP_SECONDS + 0.1
        with self._lock:
            idle = [pool for _, pool, since in self._waiting if since <= before]
            self._waiting = [each for each in self._waiting if each[2] > before]
        for pool in idle:
            pool.close()


_PROCESSES = _Processes()


def _convert_on_worker(jobs: Sequence[Job], version: str, topic: str, threads: int) -> list[ManifestRecord]:
    """Convert recordings in a child process: runs on a worker, in one of its threads. Returns a line for each."""
    from distributed import get_worker  # noqa: PLC0415  # an extra

    host = socket.gethostname()
    if version != __version__:
        raise _version_error(host, __version__)
    folders = dict.fromkeys(path_or_url(job.destination).parent for job in jobs)
    unseen = [str(folder) for folder in folders if not is_url(folder) and not _is_there(folder)]
    unseen += [path for job in jobs for path in job.sources if not is_url(path) and not os.path.lexists(path)]
    if unseen:
        raise _UnseenError(host, unseen[0])
    worker = get_worker()
    task = worker.get_current_task()
    threads = threads or max(1, worker.state.nthreads // max(1, worker.state.executing_count))
    deadline = time.monotonic() + _CLEANUP_SECONDS
    worker.log_event(topic, ("began", task, None))
    try:
        found = _convert_in_process(jobs, threads, worker, topic)
        # The process of an earlier attempt may still hold an output. It ends soon after its worker was killed.
        while held := [job for job in jobs if _says(found[job.key], "being written by another run")]:
            if time.monotonic() > deadline:
                break
            time.sleep(_POLL_SECONDS)
            found |= _convert_in_process(held, threads, worker, topic)
    finally:
        worker.log_event(topic, ("gone", task, None))
    records = [found[job.key] for job in jobs]
    if len(records) == 1 and records[0].outcome == "died":
        raise _ProcessDeathError((records[0].error or {}).get("message", ""))
    return records


def _convert_in_process(jobs: Sequence[Job], threads: int, worker: Any, batch: str) -> dict[str, ManifestRecord]:
    """Convert recordings, and return their lines by key; raises if their task is cancelled meanwhile."""
    from distributed import Status  # noqa: PLC0415  # an extra

    key = worker.get_current_task()
    found: dict[str, ManifestRecord] = {}
    with (
        _PROCESSES.take(batch) as pool,
        closing(run_jobs(jobs, workers=1, cores=threads, retries=0, pool=pool)) as events,
    ):
        for event in events:
            if event.what == "done":
                found[event.key] = event.value
            if len(found) == len(jobs):
                return found
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
        f"the Dask worker on {host} {has}", hint=f'on every worker: pip install "pc2scan[dask]=={__version__}"'
    )


def _loss_error() -> Pc2ScanError:
    return Pc2ScanError("the connection to Dask's scheduler was lost", hint="run the same batch again to continue it")


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
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        if not address:
            # Dask counts every task that a dead worker held as tried. So no worker holds a second, waiting task.
            settings = {
                "distributed.scheduler.allowed-failures": 1,
                "distributed.scheduler.worker-saturation": 1.0,
            }
            stack.enter_context(dask.config.set(settings))
            # Started now, because starting it later would unblock the signal.
            resource_tracker.ensure_running()
            with _block_sigint():
                # Dask cannot stop a cluster while it starts: Ctrl-C takes effect after that.
                cluster = stack.enter_context(
                    LocalCluster(
                        n_workers=workers,
                        threads_per_worker=1,
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
