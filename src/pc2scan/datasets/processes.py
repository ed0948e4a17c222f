"""An executor: runs jobs in worker processes on this machine, and yields events.

A worker is a new interpreter that does not import the parent's program, so that a notebook, or a script without
``if __name__ == "__main__"``, can start it. It converts one recording after the other until its standard input ends,
which the parent closes, or which ends when the parent dies. Then the conversion is interrupted, its unfinished output
is removed, and the process ends. A message between the two is a pickled object.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, deque
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from pc2scan.errors import OutputError, Pc2ScanError
from pc2scan.files.staging import clean_up
from pc2scan.files.urls import path_or_url
from pc2scan.version import __version__

from .jobs import Event, Job, convert_one

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence
    from types import FrameType
    from typing import BinaryIO

#: Seconds that an interrupted worker has to remove its unfinished output, and after which it ends in any case.
_END_SECONDS = 12.0
_SURE_END_SECONDS = 10.0

#: The program of a worker.
_PROGRAM = f"import json, sys; sys.path[:] = json.loads(sys.argv[1]); from {__name__} import serve_jobs; serve_jobs()"

#: If more workers than this die before they begin, the batch fails.
_MAX_STILLBORN = 3

#: Seconds after which an event is yielded even if nothing happens; seconds between two messages about progress.
_IDLE_SECONDS = 0.5
_PROGRESS_SECONDS = 0.1

#: Characters of a dead worker's standard error that are read; the last line is reported.
_SAID = 2_000

#: Memory that is counted for a worker. A conversion with one thread takes less, unless chunks or clouds are very large.
_WORKER_BYTES = 300_000_000


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
class Pool:
    """The workers and their messages; None at the end of a worker."""

    lock: int | None = None
    workers: list[_Worker] = field(default_factory=list)
    inbox: SimpleQueue[tuple[_Worker, Any]] = field(default_factory=SimpleQueue)

    @property
    def is_ready(self) -> bool:
        """Whether there are workers, and all of them wait for a job."""
        return bool(self.workers) and all(
            worker.job is None and worker.ready and worker.process.poll() is None for worker in self.workers
        )

    @property
    def busy(self) -> int:
        """How many workers have a job."""
        return sum(worker.job is not None for worker in self.workers)

    def add(self) -> None:
        """Start a worker."""
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
        threading.Thread(target=self._read, args=(worker,), daemon=True).start()

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
    pool: Pool | None = None,
) -> Generator[Event]:
    """Run jobs in worker processes; see `pc2scan.datasets.jobs.Executor`.

    The last recordings get the threads of idle workers. A recording whose process died is tried ``retries`` times more,
    by a single thread. The workers of a ``pool`` that is given stay for the next jobs if all of these are done.
    """
    stays = pool is not None
    pending = deque(jobs)
    attempts: Counter[str] = Counter()
    pool = Pool(lock) if pool is None else pool
    stillborn = 0
    try:
        while pending or pool.busy:
            yield from _begin(pending, attempts, pool, workers, cores)
            try:
                worker, message = pool.inbox.get(timeout=_IDLE_SECONDS)
            except Empty:
                yield Event("idle")
                continue
            job = worker.job
            match message:
                case None:
                    why = worker.ended()
                    pool.workers.remove(worker)
                    stillborn += not worker.ready
                    if stillborn > _MAX_STILLBORN:
                        raise Pc2ScanError(f"no worker process can be started: {why}")
                    if job is None:
                        continue
                    if not worker.ready:
                        attempts[job.key] -= 1
                        pending.appendleft(job)
                        continue
                    with suppress(Pc2ScanError):
                        clean_up(path_or_url(job.destination))
                    tried = attempts[job.key]
                    if tried <= retries:
                        pending.append(job.retried())
                        yield Event("died", job.key, why)
                    else:
                        seconds = round(time.monotonic() - worker.began, 3)
                        yield Event("done", job.key, job.death(why, attempts=tried, seconds=seconds))
                case ("ready", str(version)):
                    worker.ready = True
                    if version != __version__:
                        raise Pc2ScanError(f"a worker process has pc2scan {version}, this is {__version__}")
                case ("progress", work) if job is not None:
                    yield Event("progress", job.key, work)
                case ("done", record):
                    worker.job = None
                    # Workers get their next jobs before the manifest is written, which waits for the disk.
                    yield from _begin(pending, attempts, pool, workers, cores)
                    yield Event("done", record.key, replace(record, attempts=attempts[record.key]))
                case ("unreadable", why):
                    raise _unsendable(why)
    finally:
        if not stays or not pool.is_ready:
            pool.close()


def _begin(pending: deque[Job], attempts: Counter[str], pool: Pool, workers: int, cores: int) -> Generator[Event]:
    """Give jobs to workers that have none; start workers if there are too few."""
    for _ in range(min(workers, pool.busy + len(pending)) - len(pool.workers)):
        pool.add()
    for worker in [worker for worker in pool.workers if worker.job is None][: len(pending)]:
        job = pending.popleft()
        attempts[job.key] += 1
        threads = 1 if attempts[job.key] > 1 else max(1, cores // min(workers, pool.busy + len(pending) + 1))
        worker.give(replace(job, threads=threads))
        yield Event("begun", job.key)


def _unsendable(why: object) -> Pc2ScanError:
    return Pc2ScanError(
        f"the options cannot be sent to another process: {why}",
        hint="your own filters must be classes of a module that can be imported",
    )


def _pipe(stream: Any) -> BinaryIO:
    assert stream is not None
    pipe: BinaryIO = stream
    return pipe


# --- In the worker ---


class _Server:
    """A worker: converts the jobs that the parent sends, and ends when its input ends."""

    def __init__(self, stream: BinaryIO, answers: BinaryIO) -> None:
        self._stream = stream
        self._answers = answers
        self._jobs: SimpleQueue[Any] = SimpleQueue()
        self._ends = False
        self._last = 0.0
        # A terminal sends Ctrl-C, and its end, to all of its processes. They are ignored here: the parent handles them.
        signal.signal(signal.SIGINT, self._interrupted)
        if hasattr(signal, "SIGHUP"):
            signal.signal(signal.SIGHUP, signal.SIG_IGN)
        if hasattr(signal, "pthread_sigmask"):
            # Workers of a Dask cluster on this machine block the signal.
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        threading.Thread(target=self._receive, daemon=True).start()

    def serve(self) -> None:
        """Convert one recording after the other."""
        send(self._answers, ("ready", __version__))
        while (job := self._jobs.get()) is not None:
            if isinstance(job, Exception):
                send(self._answers, ("unreadable", f"{type(job).__name__}: {job}"))
                return
            send(self._answers, ("done", convert_one(job, self._progress)))

    def _receive(self) -> None:
        """Receive jobs; at the end of the input, interrupt the conversion."""
        try:
            while True:
                self._jobs.put(receive(self._stream))
        except (EOFError, OSError):
            self._jobs.put(None)
        except Exception as err:  # noqa: BLE001  # a class that this process cannot import
            self._jobs.put(err)
            return
        self._ends = True
        watch = threading.Timer(_SURE_END_SECONDS, os._exit, (1,))
        watch.daemon = True
        watch.start()
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    def _interrupted(self, _number: int, _frame: FrameType | None) -> None:
        if self._ends:
            raise KeyboardInterrupt

    def _progress(self, done: int, total: int, _messages: int) -> None:
        """Send the progress of a conversion to the parent from time to time."""
        now = time.monotonic()
        if now - self._last >= _PROGRESS_SECONDS:
            self._last = now
            send(self._answers, ("progress", (done, total)))


def serve_jobs() -> None:
    """Convert the jobs that the parent sends, then end this process."""
    # Answers use a copy of standard output. What libraries print goes to standard error, so it cannot mix with them.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        server = _Server(sys.stdin.buffer, answers)
        server.serve()
    except (KeyboardInterrupt, BrokenPipeError):
        # The parent has ended, or has interrupted the conversion.
        pass
    # Does not wait for threads: their work is not needed any more, and all output is complete or removed.
    os._exit(0)


def send(stream: BinaryIO, message: object) -> None:
    """Write a message.

    Raises
    ------
    OSError
        If the other process has closed the pipe.
    """
    stream.write(pickle.dumps(message))
    stream.flush()


def receive(stream: BinaryIO) -> Any:
    """Read a message.

    Raises
    ------
    EOFError
        If the other process has ended, or died while it wrote a message.
    """
    try:
        # Safe: the data comes from a process that this program started, through a pipe that no other process has.
        return pickle.load(stream)  # noqa: S301
    except pickle.UnpicklingError as err:
        raise EOFError from err


# --- How many at a time ---


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
