"""A worker process of a batch: converts one recording after the other until its standard input ends.

It is a new interpreter that does not import the parent's program, so that a notebook, or a script without
``if __name__ == "__main__"``, can start it. Its input ends when the parent closes it or dies. Then the conversion is
interrupted, its unfinished output is removed, and the process ends.

A message between the two is the length of a pickled object, then the object.
"""

from __future__ import annotations

import os
import pickle
import signal
import struct
import sys
import threading
import time
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from pc2scan.threads import keep_freed_memory
from pc2scan.version import __version__

from .jobs import convert_one

if TYPE_CHECKING:
    from types import FrameType
    from typing import BinaryIO

#: Seconds between two messages about progress.
_PROGRESS_SECONDS = 0.1

#: Seconds after which the process is ended even if its conversion does not react to the interrupt.
_END_SECONDS = 10.0

_LENGTH = struct.Struct(">Q")


class _Shutdown:
    """Ends this process when its input ends: the parent has closed it or died."""

    def __init__(self) -> None:
        self.begun = False
        # A terminal sends Ctrl-C to all of its processes. It is ignored here: the parent handles it.
        signal.signal(signal.SIGINT, self._interrupted)
        if hasattr(signal, "pthread_sigmask"):
            # Workers of a Dask cluster on this machine block the signal.
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})

    def begin(self) -> None:
        """Interrupt the conversion; called by the thread that reads the input."""
        self.begun = True
        watch = threading.Timer(_END_SECONDS, os._exit, (1,))
        watch.daemon = True
        watch.start()
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    def _interrupted(self, _number: int, _frame: FrameType | None) -> None:
        if self.begun:
            raise KeyboardInterrupt


def _receive_jobs(stream: BinaryIO, jobs: SimpleQueue[Any], ending: _Shutdown) -> None:
    try:
        while True:
            jobs.put(receive(stream))
    except (EOFError, OSError):
        jobs.put(None)
        ending.begin()
    except Exception as err:  # noqa: BLE001  # a class that this process cannot import
        jobs.put(err)


class _ProgressSender:
    """Sends the progress of a conversion to the parent from time to time."""

    def __init__(self, stream: BinaryIO, key: str) -> None:
        self._stream = stream
        self._key = key
        self._last = 0.0

    def __call__(self, done: int, total: int, _messages: int) -> None:
        now = time.monotonic()
        if now - self._last >= _PROGRESS_SECONDS:
            self._last = now
            send(self._stream, ("progress", self._key, done, total))


def _serve(jobs: SimpleQueue[Any], answers: BinaryIO) -> None:
    send(answers, ("ready", __version__))
    while (job := jobs.get()) is not None:
        if isinstance(job, Exception):
            send(answers, ("unreadable", f"{type(job).__name__}: {job}"))
            return
        send(answers, ("result", convert_one(job, _ProgressSender(answers, job.key))))


def main() -> None:
    """Convert the jobs that the parent sends."""
    ending = _Shutdown()
    # Answers use a copy of standard output. What libraries print goes to standard error, so it cannot mix with them.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    jobs: SimpleQueue[Any] = SimpleQueue()
    try:
        threading.Thread(target=_receive_jobs, args=(sys.stdin.buffer, jobs, ending), daemon=True).start()
        keep_freed_memory()
        _serve(jobs, answers)
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
    data = pickle.dumps(message)
    stream.write(_LENGTH.pack(len(data)))
    stream.write(data)
    stream.flush()


def receive(stream: BinaryIO) -> Any:
    """Read a message.

    Raises
    ------
    EOFError
        If the other process has ended, or died while it wrote a message.
    """
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise EOFError
    (length,) = _LENGTH.unpack(head)
    data = stream.read(length)
    if len(data) < length:
        raise EOFError
    # Safe: the data comes from a process that this program started, through a pipe that no other process has.
    return pickle.loads(data)  # noqa: S301
