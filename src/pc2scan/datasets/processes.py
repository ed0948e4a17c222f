"""Converts the recordings of a batch in processes of this machine.

A process is a new interpreter that does not import the caller's program, so that a notebook, or a script without ``if
__name__ == "__main__"``, can start it. A thread gives it one recording after the other. When its standard input ends,
because the batch ends or was killed, its conversion is interrupted, and removes what it has begun.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, BinaryIO

from pc2scan.errors import OutputError, Pc2ScanError
from pc2scan.files.staging import clean_up
from pc2scan.files.urls import path_or_url
from pc2scan.threads import cores

from .jobs import convert_one

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from .jobs import Job
    from .manifest import ManifestRecord

#: Seconds that an interrupted process has to remove its unfinished output.
_END_SECONDS = 12.0

#: The program of a process.
_PROGRAM = f"import json, sys; sys.path[:] = json.loads(sys.argv[1]); from {__name__} import serve; serve()"

#: Memory that is counted for a process. A conversion with one thread takes less, unless clouds are very large.
_PROCESS_BYTES = 300_000_000


def run_jobs(jobs: Sequence[Job], *, workers: int, lock: int | None = None) -> Generator[ManifestRecord]:
    """Convert recordings, and yield their lines of the manifest as they end; see `pc2scan.datasets.jobs.Executor`.

    A recording whose process died is tried once more at the end, when no other is converted.
    """
    processes = _Processes(workers, len(jobs), lock)
    threads = ThreadPoolExecutor(workers)
    died = []
    try:
        by_key = {job.key: job for job in jobs}
        for future in as_completed([threads.submit(processes.convert, job) for job in jobs]):
            record = future.result()
            if record.outcome == "died":
                died.append(by_key[record.key])
            else:
                yield record
        for job in died:
            yield replace(threads.submit(processes.convert, job.retried(), 1).result(), attempts=2)
    finally:
        processes.close()
        threads.shutdown(cancel_futures=True)


class _Processes:
    """The processes, one for each thread that asks; one that died is replaced."""

    def __init__(self, count: int, jobs: int, lock: int | None) -> None:
        self._count, self._left, self._lock = count, jobs, lock
        self._own = threading.local()
        self._guard = threading.Lock()
        self._started: list[subprocess.Popen[bytes]] = []
        self._busy: dict[str, Job] = {}
        self._is_closed = False

    def convert(self, job: Job, threads: int = 0) -> ManifestRecord:
        """Convert a recording in the process of this thread, with the threads that the other processes leave."""
        began = time.monotonic()
        with self._guard:
            threads = threads or max(1, cores() // max(1, min(self._count, self._left)))
            process = self._process()
            self._busy[job.key] = job
        try:
            _send(process.stdin, replace(job, threads=threads))
            record = _receive(process.stdout)
        except (EOFError, OSError):
            self._own.process = None
            with suppress(Pc2ScanError):
                clean_up(path_or_url(job.destination))
            return job.death(_end_of(process), attempts=1, seconds=round(time.monotonic() - began, 3))
        except (pickle.PicklingError, AttributeError, TypeError) as err:
            raise _unsendable(err) from err
        finally:
            with self._guard:
                self._left -= 1
        del self._busy[job.key]
        if isinstance(record, str):
            raise _unsendable(record)
        done: ManifestRecord = record
        return done

    def _process(self) -> subprocess.Popen[bytes]:
        """Return the process of this thread; start one if there is none."""
        process: subprocess.Popen[bytes] | None = getattr(self._own, "process", None)
        if self._is_closed:
            raise KeyboardInterrupt
        if process is None:
            # The same import path as here.
            paths = json.dumps([path or os.getcwd() for path in sys.path])  # noqa: PTH109
            try:
                process = self._own.process = subprocess.Popen(  # noqa: S603  # this interpreter, and text of our own
                    [sys.executable, "-c", _PROGRAM, paths],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                    # A terminal sends Ctrl-C, and its end, to a whole session: they are for the batch.
                    start_new_session=True,
                    # It inherits the lock, which is held until it has ended, even if the batch was killed.
                    pass_fds=() if self._lock is None or os.name == "nt" else (self._lock,),
                )
            except OSError as err:
                raise OutputError(f"no worker process can be started: {err.strerror}") from err
            self._started.append(process)
        return process

    def close(self) -> None:
        """Interrupt all processes, wait for their end, and remove what is left of unfinished outputs."""
        with self._guard:
            self._is_closed = True
        for process in self._started:
            with suppress(OSError):
                process.stdin.close()  # type: ignore[union-attr]
        deadline = time.monotonic() + _END_SECONDS
        for process in self._started:
            try:
                process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            process.stdout.close()  # type: ignore[union-attr]
        for job in list(self._busy.values()):
            with suppress(Pc2ScanError):
                clean_up(path_or_url(job.destination))


def _end_of(process: subprocess.Popen[bytes]) -> str:
    """Return how a process ended that has closed its pipe, as text."""
    code = process.wait()
    how = f"ended with status {code}"
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        how = f"was killed by {name}" + (", perhaps because memory ran out" if name == "SIGKILL" else "")
    return f"the process that converted it {how}"


def _unsendable(why: object) -> Pc2ScanError:
    return Pc2ScanError(
        f"the options cannot be sent to another process: {why}",
        hint="your own filters must be classes of a module that can be imported",
    )


def serve() -> None:
    """Convert the recordings that standard input names, one after the other; then end this process."""
    # Answers use a copy of standard output, so that nothing which libraries print mixes with them.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    jobs: SimpleQueue[Any] = SimpleQueue()
    threading.Thread(target=_listen, args=(jobs,), daemon=True).start()
    with suppress(KeyboardInterrupt, BrokenPipeError):
        while (job := jobs.get()) is not None:
            _send(answers, job if isinstance(job, str) else convert_one(job))
    # Does not wait for threads: all output is complete or removed.
    os._exit(0)


def _listen(jobs: SimpleQueue[Any]) -> None:
    """Receive jobs; when there are no more, interrupt the conversion."""
    while True:
        try:
            jobs.put(_receive(sys.stdin.buffer))
        except EOFError:
            break
        except Exception as err:  # noqa: BLE001  # a class that this process cannot import
            jobs.put(f"{type(err).__name__}: {err}")
    jobs.put(None)
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def _send(stream: Any, message: object) -> None:
    data = pickle.dumps(message)
    stream.write(len(data).to_bytes(8, "little") + data)
    stream.flush()


def _receive(stream: BinaryIO | Any) -> Any:
    """Read a message; raises EOFError if the other process has ended."""
    size = int.from_bytes(stream.read(8), "little")
    data = stream.read(size)
    if not size or len(data) < size:
        raise EOFError
    # Safe: it comes from a process of this program, through a pipe that no other process has.
    return pickle.loads(data)  # noqa: S301


def workers_for(count: int, cores: int, available: int | None) -> int:
    """Return the number of processes for a number of recordings, given the free memory in bytes, if it is known."""
    room = cores if available is None else available // _PROCESS_BYTES
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
