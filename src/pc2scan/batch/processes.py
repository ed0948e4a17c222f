"""Runs jobs in worker processes on this machine, and yields their events.

An executor is a function from jobs to events, such as `execute`. It only runs jobs; what the events mean for the batch
is decided by its caller.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field, replace
from queue import Empty, SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from pc2scan.errors import OutputError, Pc2ScanError
from pc2scan.files.staging import clean_up
from pc2scan.files.urls import path_or_url
from pc2scan.version import __version__

from .jobs import Job, JobResult, death_of
from .worker import receive, send

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence
    from typing import BinaryIO

#: Seconds that an interrupted worker has to remove its unfinished output.
_END_SECONDS = 12.0

#: The program of a worker.
_PROGRAM = f"import json, sys; sys.path[:] = json.loads(sys.argv[1]); from {__package__}.worker import main; main()"

#: If more workers than this die before they begin, the batch fails.
_MAX_STILLBORN = 3

#: Seconds between two calls of ``check``.
_CHECK_SECONDS = 0.5

#: Characters of a dead worker's standard error that are read; the last line is reported.
_SAID = 2_000


class JobStart(NamedTuple):
    """The conversion of a job begins."""

    key: str


class JobProgress(NamedTuple):
    """Bytes of a recording that were read, and bytes in total."""

    key: str
    done: int
    total: int


class ProcessDeath(NamedTuple):
    """The process that converted a recording died; the recording is tried again."""

    key: str
    why: str


class JobEnd(NamedTuple):
    """A job is done."""

    result: JobResult


class Information(NamedTuple):
    """Information for the user, such as the address of a dashboard."""

    text: str


Event = JobStart | JobProgress | ProcessDeath | JobEnd | Information


class Executor(Protocol):
    """Runs jobs, and yields events. Closing the generator interrupts the jobs and removes their unfinished outputs."""

    def __call__(self, jobs: Sequence[Job]) -> Generator[Event]:
        """Run jobs."""
        ...


@dataclass(slots=True)
class _Worker:
    """A worker process and its current job."""

    process: subprocess.Popen[bytes]
    said: Any
    job: Job | None = None
    began: float = 0.0
    ready: bool = False

    def give(self, job: Job) -> None:
        """Send a job. If the process is dead, the thread that reads its answers reports it."""
        self.job, self.began = job, time.monotonic()
        try:
            send(_pipe(self.process.stdin), job)
        except OSError:
            pass
        except (pickle.PicklingError, AttributeError, TypeError) as err:
            raise _unsendable(err) from err

    def ended(self) -> str:
        """Wait for the end of a process that has closed its pipe; return how it ended, as text."""
        code = self.process.wait()
        self.said.seek(0, os.SEEK_END)
        self.said.seek(max(0, self.said.tell() - _SAID))
        said = self.said.read().decode("utf-8", "replace").strip()
        self.close()
        how = f"ended with status {code}"
        if code < 0:
            name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
            how = f"was killed by {name}" + (", perhaps because memory ran out" if name == "SIGKILL" else "")
        return f"the process that converted it {how}{f': {said.splitlines()[-1]}' if said else ''}"

    def close(self) -> None:
        """Release its pipes."""
        for stream in (self.process.stdin, self.process.stdout, self.said):
            with suppress(OSError):
                _pipe(stream).close()


@dataclass(slots=True)
class _Pool:
    """The workers and their messages."""

    lock: int | None
    stillborn: int = 0
    workers: list[_Worker] = field(default_factory=list)
    inbox: SimpleQueue[tuple[_Worker, Any]] = field(default_factory=SimpleQueue)

    def add(self) -> _Worker:
        said = tempfile.TemporaryFile()  # noqa: SIM115  # closed with the worker
        # The worker gets the same import path as this process.
        paths = json.dumps([path or os.getcwd() for path in sys.path])  # noqa: PTH109
        try:
            process = subprocess.Popen(  # noqa: S603  # this interpreter, and text of our own
                [sys.executable, "-c", _PROGRAM, paths],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=said,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                # Workers inherit the lock: it is held until the last of them has ended, even if the parent was killed.
                pass_fds=() if self.lock is None or os.name == "nt" else (self.lock,),
            )
        except OSError as err:
            said.close()
            raise OutputError(f"no worker process can be started: {err.strerror}") from err
        worker = _Worker(process, said)
        self.workers.append(worker)
        Thread(target=self._read, args=(worker,), daemon=True).start()
        return worker

    def _read(self, worker: _Worker) -> None:
        stream = _pipe(worker.process.stdout)
        try:
            while True:
                self.inbox.put((worker, receive(stream)))
        except (EOFError, OSError, ValueError):
            self.inbox.put((worker, None))
        except Exception as err:  # noqa: BLE001  # a result that this process cannot read must not be waited for
            self.inbox.put((worker, ("unreadable", f"{type(err).__name__}: {err}")))

    def close(self) -> None:
        """Interrupt all workers and wait for their end; their unfinished outputs are removed."""
        for worker in self.workers:
            with suppress(OSError):
                _pipe(worker.process.stdin).close()
        deadline = time.monotonic() + _END_SECONDS
        for worker in self.workers:
            try:
                worker.process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                worker.process.kill()
                worker.process.wait()
            worker.close()
            if worker.job is not None:
                with suppress(Pc2ScanError):
                    clean_up(path_or_url(worker.job.destination))


def run_jobs(
    jobs: Sequence[Job],
    *,
    workers: int,
    cores: int,
    retries: int = 1,
    lock: int | None = None,
    check: Callable[[], None] | None = None,
) -> Generator[Event]:
    """Run jobs in worker processes.

    Parameters
    ----------
    jobs
        In the order in which they begin.
    workers
        The maximum number of processes.
    cores
        The number of threads of all workers together. The last recordings get the threads of idle workers.
    retries
        How often a recording is tried again if its worker died. The last attempt uses a single thread.
    lock
        The file descriptor of the lock that workers inherit.
    check
        Called from time to time. If it raises, the jobs are interrupted.

    Yields
    ------
    Event
        `JobEnd` once for every job.
    """
    pending = deque(jobs)
    attempts: dict[str, int] = {}
    pool = _Pool(lock)
    idle: deque[_Worker] = deque()

    def begin() -> Generator[Event]:
        """Give jobs to workers that have none."""
        busy = sum(worker.job is not None for worker in pool.workers)
        for _ in range(min(workers, busy + len(pending)) - len(pool.workers)):
            idle.append(pool.add())
        while idle and pending:
            job = pending.popleft()
            tried = attempts[job.key] = attempts.get(job.key, 0) + 1
            busy = sum(worker.job is not None for worker in pool.workers)
            threads = 1 if tried > 1 else max(1, cores // min(workers, busy + len(pending) + 1))
            idle.popleft().give(replace(job, threads=threads))
            yield JobStart(job.key)

    try:
        while pending or any(worker.job for worker in pool.workers) or not pool.inbox.empty():
            yield from begin()
            try:
                worker, message = pool.inbox.get(timeout=None if check is None else _CHECK_SECONDS)
            except Empty:
                assert check is not None
                check()
                continue
            if message is None:
                pool.workers.remove(worker)
                if worker in idle:
                    idle.remove(worker)
                yield from _after_death(worker, pool, pending, attempts, retries)
                continue
            match message:
                case ("ready", str(version)):
                    worker.ready = True
                    if version != __version__:
                        raise Pc2ScanError(f"a worker process has pc2scan {version}, this is {__version__}")
                case ("progress", key, done, total):
                    yield JobProgress(key, done, total)
                case ("result", result):
                    worker.job = None
                    idle.append(worker)
                    # Workers get their next jobs before the manifest is written, which waits for the disk.
                    yield from begin()
                    yield JobEnd(replace(result, attempts=attempts[result.key]))
                case ("unreadable", why):
                    raise _unsendable(why)
    finally:
        pool.close()


def _after_death(
    worker: _Worker, pool: _Pool, pending: deque[Job], attempts: dict[str, int], retries: int
) -> Generator[Event]:
    """Put the job of a dead worker back into the queue, or report its recording as died."""
    why = worker.ended()
    job = worker.job
    if not worker.ready:
        pool.stillborn += 1
        if pool.stillborn > _MAX_STILLBORN:
            raise Pc2ScanError(f"no worker process can be started: {why}")
        if job is not None:
            attempts[job.key] -= 1
            pending.appendleft(job)
        return
    if job is None:
        return
    with suppress(Pc2ScanError):
        clean_up(path_or_url(job.destination))
    if attempts[job.key] <= retries:
        pending.append(job.retried())
        yield ProcessDeath(job.key, why)
    else:
        seconds = round(time.monotonic() - worker.began, 3)
        yield JobEnd(death_of(job, why, attempts=attempts[job.key], seconds=seconds))


def _unsendable(why: object) -> Pc2ScanError:
    return Pc2ScanError(
        f"the options cannot be sent to another process: {why}",
        hint="your own filters must be classes of a module that can be imported",
    )


def _pipe(stream: Any) -> BinaryIO:
    assert stream is not None
    pipe: BinaryIO = stream
    return pipe
