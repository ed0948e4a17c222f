"""A Dask cluster: jobs become its tasks, and events come back; lost workers and retries are Dask's business.

A task converts in a process of its own below its worker, as a batch on one machine does. So a conversion can be
interrupted, and it removes what it has written where its worker is killed.
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import time
from collections import Counter, deque
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from pc2scan.errors import OutputError, Pc2ScanError, UsageError
from pc2scan.files.staging import clean_up
from pc2scan.remote.urls import is_url
from pc2scan.version import __version__

from .cutting import is_given_up
from .staged import jobs_here
from .work import Result, died
from .workers import Began, Ended, Progressed, Told, execute

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from .work import Job
    from .workers import Event

__all__ = ["check_dask", "dask_setup", "execute_on_dask"]

#: Seconds between two looks at whether a task is still wanted, and between two messages about progress.
_LOOK_SECONDS = 0.5

#: Seconds that interrupted conversions have to remove what they have written, and that a lost one has.
_PATIENCE = 15.0

#: Seconds in which a scheduler answers.
_CONNECT_SECONDS = 10

_SHARED = "sources and OUT must be on a disk that all workers share, under the same path"


class _CancelledError(Exception):
    """Nobody wants the result."""


class _ConversionDiedError(Exception):
    """The process of a conversion died; Dask tries the task again."""


@dataclass(frozen=True, slots=True)
class _Answer:
    """What a task returns: a result, or what kept it from beginning."""

    host: str
    result: Result | None = None
    version: str = __version__
    unseen: tuple[str, ...] = ()


def check_dask() -> None:
    """Raise UsageError where Dask is not installed."""
    try:
        # Some of its modules catch whatever happens while they are loaded.
        with _sigint_blocked():
            import distributed  # noqa: F401, PLC0415  # an extra
    except ImportError as err:
        raise UsageError(
            "`dask` needs distributed, which is not installed", hint="pip install 'pc2scan[dask]'"
        ) from err


def dask_setup(_worker: Any) -> None:
    """Ignore Ctrl-C in a worker of this machine, as Dask calls it: the parent decides what it means."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def execute_on_dask(jobs: Sequence[Job], address: str, *, workers: int, cores: int, retries: int) -> Generator[Event]:
    """Do jobs on a Dask cluster.

    Parameters
    ----------
    jobs
        In the order in which they begin. A deque is emptied, and may get more while events are taken.
    address
        Of the scheduler; empty for a cluster on this machine, which is closed at the end.
    workers, cores
        How many workers, and threads of all of them, a cluster on this machine has.
    retries
        How often a recording is tried again whose process died.

    Yields
    ------
    Event
        `Ended` once for every job.
    """
    if not jobs:
        return
    with ExitStack() as stack:
        client = stack.enter_context(_connected(address, workers, cores, retries))
        yield Told(f"Dask's dashboard: {client.dashboard_link}")
        if not client.scheduler_info(n_workers=-1)["workers"]:
            yield Told(f"{address} has no worker yet; the batch begins when one joins")
            client.wait_for_workers(1)
        _check_workers(client, jobs)
        yield from _run(client, jobs, retries)


def _run(client: Any, jobs: Sequence[Job], retries: int) -> Generator[Event]:
    """Submit all jobs, and yield what happens until all are done."""
    inbox: SimpleQueue[tuple[str, str, Any]] = SimpleQueue()
    topic = f"pc2scan-{uuid4().hex}"
    client.subscribe_topic(topic, lambda event: inbox.put(event[1]))
    pending = jobs if isinstance(jobs, deque) else deque(jobs)
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
                    _convert, job, __version__, topic, key=f"{topic}-{number}", retries=retries, priority=-number
                )
                futures[job.key] = future
                future.add_done_callback(lambda future, key=job.key: inbox.put(("done", key, future)))
            try:
                what, key, value = inbox.get(timeout=_LOOK_SECONDS)
            except Empty:
                if client.status == "closed":
                    raise _lost() from None
                continue
            if what == "gone":
                running.pop(key, None)
            if key not in left:
                continue
            match what:
                case "began":
                    attempts[key] += 1
                    running[key] = time.monotonic()
                    yield Began(key)
                case "progress":
                    yield Progressed(key, *value)
                case "done":
                    job = left.pop(key)
                    seconds = time.monotonic() - running.get(key, time.monotonic())
                    result = _result(job, value, seconds)
                    if (
                        attempts[key] > 1
                        and not job.replaces
                        and "exists already" in (result.error or {}).get("message", "")
                    ):
                        # The conversion of a worker that was lost has completed it nevertheless.
                        pending.append(replace(job, replaces=True))
                        continue
                    yield Ended(replace(result, attempts=max(1, attempts[key])))
    finally:
        connected = client.status == "running"
        if left:
            if connected:
                client.cancel(list(futures.values()), force=True)
                _wait_for_end(inbox, running)
            for job in left.values():
                with suppress(Pc2ScanError):
                    clean_up(Path(job.destination))
        if connected:
            client.unsubscribe_topic(topic)


def _wait_for_end(inbox: SimpleQueue[tuple[str, str, Any]], running: dict[str, float]) -> None:
    """Wait until cancelled conversions have removed what they have written."""
    deadline = time.monotonic() + _PATIENCE
    while running and time.monotonic() < deadline:
        with suppress(Empty):
            what, key, _ = inbox.get(timeout=_LOOK_SECONDS)
            if what == "gone":
                running.pop(key, None)


def _result(job: Job, future: Any, seconds: float) -> Result:
    """Return what a finished task says about its recording; raises where the cluster cannot do the batch at all."""
    from distributed import KilledWorker  # noqa: PLC0415  # an extra

    if future.status == "cancelled":
        raise _lost()
    if future.status == "error":
        err = future.exception()
        if isinstance(err, KilledWorker):
            return died(job, f"its Dask worker died: {err}", attempts=1, seconds=seconds)
        if isinstance(err, _ConversionDiedError):
            return died(job, str(err), attempts=1, seconds=seconds)
        raise Pc2ScanError(
            f"a Dask worker cannot convert: {type(err).__name__}: {err}",
            hint="every worker needs the same version of pc2scan, and the module of a filter of your own",
        )
    answer: _Answer = future.result()
    if answer.version != __version__:
        raise _other_version(answer.host, answer.version)
    _check_seen(answer.host, answer.unseen)
    if answer.result is None:
        raise OutputError(f"the Dask worker on {answer.host} does not see {answer.unseen[0]}", hint=_SHARED)
    return answer.result


def _convert(job: Job, version: str, topic: str) -> _Answer:
    """Convert a recording: runs on a worker, in one of its threads."""
    from distributed import Status, get_worker  # noqa: PLC0415  # an extra

    host = socket.gethostname()
    if version != __version__:
        return _Answer(host, version=__version__)
    unseen = tuple(path for path in job.sources if not is_url(Path(path)) and not os.path.lexists(path))
    folder = Path(job.destination).parent
    if job.step is not None and is_given_up(job):
        return _Answer(host, died(job, "the recording was given up", attempts=1, seconds=0.0))
    if not is_url(folder) and not _is_there(folder):
        return _Answer(host, unseen=(str(folder), *unseen))
    worker = get_worker()
    key = worker.get_current_task()

    def check() -> None:
        task = worker.state.tasks.get(key)
        if task is None or task.state == "cancelled" or worker.status not in (Status.running, Status.paused):
            raise _CancelledError

    threads = max(1, worker.state.nthreads // max(1, worker.state.executing_count))
    deadline = time.monotonic() + _PATIENCE
    worker.log_event(topic, ("began", job.key, None))
    try:
        while True:
            result = _converted(job, threads, check, lambda what: worker.log_event(topic, ("progress", job.key, what)))
            error = result.error or {}
            # The process of a worker that was killed is about to end.
            if "being written by another run" not in error.get("message", "") or time.monotonic() > deadline:
                break
            time.sleep(_LOOK_SECONDS)
    finally:
        worker.log_event(topic, ("gone", job.key, None))
    if result.outcome == "died":
        raise _ConversionDiedError((result.error or {}).get("message", ""))
    return _Answer(host, result, unseen=unseen)


def _is_there(folder: Path) -> bool:
    """Whether a folder is there that may have been made this moment, on another machine."""
    if folder.is_dir():
        return True
    with suppress(OSError):
        # Network file systems look again at folders that are read.
        list(folder.parent.iterdir())
    time.sleep(_LOOK_SECONDS)
    return folder.is_dir()


def _converted(job: Job, threads: int, check: Any, tell: Any) -> Result:
    last = 0.0
    with (
        jobs_here([job], workers=1) as queue,
        closing(execute(queue, workers=1, cores=threads, retries=0, check=check)) as events,
    ):
        for event in events:
            if isinstance(event, Ended):
                return event.result
            if isinstance(event, Progressed) and time.monotonic() - last >= _LOOK_SECONDS:
                last = time.monotonic()
                check()
                tell((event.done, event.total))
    raise _CancelledError


def _check_workers(client: Any, jobs: Sequence[Job]) -> None:
    """Make sure that the workers have this version of pc2scan, and see what is read and written."""
    named = {path for job in jobs for path in (*job.sources, os.path.dirname(job.destination))}  # noqa: PTH120
    paths = sorted(path for path in named if not is_url(Path(path)))

    # A function in a function is sent as it is: a worker without pc2scan can run it, too.
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
            raise _other_version(host, version)
        _check_seen(host, unseen)


def _check_seen(host: str, unseen: Sequence[str]) -> None:
    """Raise if a worker does not see what is there on this machine."""
    here = [path for path in unseen if os.path.lexists(path)]
    if here:
        raise UsageError(f"the Dask worker on {host} does not see {here[0]}", hint=_SHARED)


def _other_version(host: str, version: str) -> Pc2ScanError:
    has = f"has pc2scan {version}, this is {__version__}" if version else "has no pc2scan"
    return UsageError(
        f"the Dask worker on {host} {has}", hint=f"on every worker: pip install 'pc2scan[dask]=={__version__}'"
    )


def _lost() -> Pc2ScanError:
    return Pc2ScanError(
        "the connection to Dask's scheduler was lost", hint="the same batch again goes on where this one ended"
    )


def _ask(address: str) -> None:
    """Ask a scheduler who it is; a client would wait for ever for one that accepts connections and says nothing."""
    from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415

    from distributed.core import rpc  # noqa: PLC0415  # an extra

    async def ask() -> None:
        async with rpc(address) as scheduler:
            await asyncio.wait_for(scheduler.identity(), _CONNECT_SECONDS)

    # A notebook's own thread runs an event loop already.
    with ThreadPoolExecutor(1) as thread:
        thread.submit(asyncio.run, ask()).result()


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """Block Ctrl-C in this thread, and in the threads and processes that it starts meanwhile."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _connected(address: str, workers: int, cores: int, retries: int) -> Iterator[Any]:
    """Yield a client of the scheduler, or of a cluster on this machine."""
    import logging  # noqa: PLC0415

    import dask  # noqa: PLC0415  # an extra
    from distributed import Client, LocalCluster  # noqa: PLC0415

    # Dask gives some of its loggers levels of their own.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        if not address:
            # What a worker had when it died counts as tried; no second task waits at a worker, and counts with it.
            settings = {
                "distributed.scheduler.allowed-failures": retries,
                "distributed.scheduler.worker-saturation": 1.0,
            }
            stack.enter_context(dask.config.set(settings))
            from multiprocessing import resource_tracker  # noqa: PLC0415  # only clusters on this machine need it

            # If it is started later, it unblocks the signal.
            resource_tracker.ensure_running()
            with _sigint_blocked():
                # Dask cannot end a cluster that is half started: Ctrl-C counts when it has started.
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
