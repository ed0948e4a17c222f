"""Converts the recordings of a batch: in processes of this machine, or on a Dask cluster, a task each.

A process is a new interpreter that does not import the caller's program, so that a notebook, or a script without ``if
__name__ == "__main__"``, can start it. A thread gives it one recording after the other. When its standard input ends,
because the batch ends or was killed, its conversion is interrupted, and removes what it has begun.
"""

from __future__ import annotations

import json
import logging
import os
import pickle
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack, suppress
from dataclasses import replace
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from pc2scan.errors import OutputError, Pc2ScanError, UsageError
from pc2scan.threads import cores
from pc2scan.version import __version__

from .jobs import convert_one

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from .jobs import Job
    from .manifest import ManifestRecord

#: Seconds that an interrupted process has to remove its unfinished output.
_END_SECONDS = 12.0

#: The program of a process.
_PROGRAM = f"import json, sys; sys.path[:] = json.loads(sys.argv[1]); from {__name__} import serve; serve()"

#: Seconds within which a scheduler must answer.
_CONNECT_SECONDS = 10

#: Above every level: what Dask logs when it is interrupted is no error.
_SILENT = logging.CRITICAL + 1


def run_jobs(jobs: Sequence[Job], *, workers: int, lock: int | None) -> Generator[ManifestRecord]:
    """Convert recordings, and yield their lines of the manifest as they end; closing it interrupts the conversions.

    A recording whose process died is tried once more at the end, when no other is converted.

    Parameters
    ----------
    jobs
        In the order in which they begin.
    workers
        How many recordings are converted at a time.
    lock
        The file descriptor of a lock that the processes hold until they end.
    """
    processes = [_start(lock) for _ in range(workers)]
    idle: SimpleQueue[subprocess.Popen[bytes] | None] = SimpleQueue()
    for process in processes:
        idle.put(process)

    def convert(job: Job) -> ManifestRecord:
        process = idle.get()
        if process is None:
            processes.append(process := _start(lock))
        record = _converted(job, process)
        idle.put(None if record.outcome == "died" else process)
        return record

    threads = ThreadPoolExecutor(workers)
    try:
        by_key = {job.key: replace(job, threads=max(1, cores() // workers)) for job in jobs}
        died = []
        for future in as_completed([threads.submit(convert, job) for job in by_key.values()]):
            if (record := future.result()).outcome == "died":
                died.append(by_key[record.key])
            else:
                yield record
        for job in died:
            yield replace(threads.submit(convert, job.retried()).result(), attempts=2)
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            with suppress(OSError):
                process.stdin.close()  # type: ignore[union-attr]
        for process in processes:
            with process:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(_END_SECONDS)
                process.kill()
        threads.shutdown()


def _start(lock: int | None) -> subprocess.Popen[bytes]:
    # The same import path as here.
    paths = json.dumps([path or os.getcwd() for path in sys.path])  # noqa: PTH109
    try:
        return subprocess.Popen(  # noqa: S603  # this interpreter, and text of our own
            [sys.executable, "-c", _PROGRAM, paths],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            # A terminal sends Ctrl-C, and its end, to a whole session: they are for the batch.
            start_new_session=True,
            # It inherits the lock, which is held until it has ended, even if the batch was killed.
            pass_fds=() if lock is None or os.name == "nt" else (lock,),
        )
    except OSError as err:
        raise OutputError(f"no worker process can be started: {err.strerror}") from err


def _converted(job: Job, process: subprocess.Popen[bytes]) -> ManifestRecord:
    """Convert a recording in a process."""
    try:
        _send(process.stdin, job)
        record: ManifestRecord | str = pickle.load(process.stdout)  # type: ignore[arg-type]  # noqa: S301  # our own
    except (EOFError, OSError, pickle.UnpicklingError):
        code = process.wait()
        ending = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with status {code}"
        return job.death(f"the process that converted it {ending}; perhaps memory ran out")
    except (pickle.PicklingError, AttributeError, TypeError) as err:
        record = str(err)
    if isinstance(record, str):
        raise Pc2ScanError(
            f"the options cannot be sent to another process: {record}",
            hint="your own filters must be classes of a module that can be imported",
        )
    return record


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
            jobs.put(pickle.load(sys.stdin.buffer))  # noqa: S301  # from a process of this program
        except EOFError:
            break
        except Exception as err:  # noqa: BLE001  # a class that this process cannot import
            jobs.put(f"{type(err).__name__}: {err}")
    jobs.put(None)
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def _send(stream: Any, message: object) -> None:
    stream.write(pickle.dumps(message))
    stream.flush()


def dask_setup(_worker: Any) -> None:
    """Ignore Ctrl-C in a Dask worker on this machine: the parent process handles it. Dask calls this as one starts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_jobs_on_dask(jobs: Sequence[Job], *, address: str, workers: int) -> Generator[ManifestRecord]:
    """Convert recordings on the cluster whose scheduler has this address; see `run_jobs`.

    With an empty address, a cluster is started on this machine, and closed at the end.
    """
    try:
        import distributed  # noqa: PLC0415  # an extra
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
        for task in distributed.as_completed(list(tasks), raise_errors=False):
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
        settings = {
            # Dask counts every task that a dead worker held as tried. So of many tasks, none waits at a worker.
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
