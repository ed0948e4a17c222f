"""Runs the work of a conversion on threads, returns results in order within bounds of memory."""

from __future__ import annotations

import os
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from queue import Empty, SimpleQueue
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

_Result = TypeVar("_Result")
_Arguments = ParamSpec("_Arguments")


def cores() -> int:
    """Return how many processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(eq=False)
class Task(Generic[_Result]):
    """A piece of work for threads. A thread that waits for its result runs other tasks meanwhile.

    It is not a `concurrent.futures.Future`, because importing that module takes 2 % of a short conversion.
    """

    _work: Callable[[], _Result] | None
    _queue: SimpleQueue[Task[Any] | None]
    #: Acquired once, by the thread that runs or cancels the task, and never released.
    _taken: Lock = field(default_factory=Lock)
    _done: Event = field(default_factory=Event)
    _result: _Result = field(init=False)
    _error: BaseException | None = None

    def run(self) -> None:
        """Run the work unless it was cancelled. An interruption is raised at once."""
        if not self._taken.acquire(blocking=False):
            return
        work, self._work = self._work, None
        assert work is not None  # only the thread that has acquired `_taken` gets here
        try:
            self._result = work()
        except Exception as err:  # noqa: BLE001  # `result` raises it
            self._error = err
        except BaseException as err:
            self._error = err
            raise
        finally:
            self._done.set()

    def cancel(self) -> bool:
        """Cancel the work, and return True; False if it has begun."""
        if not self._taken.acquire(blocking=False):
            return False
        self._work, self._error = None, RuntimeError("the work was cancelled")
        self._done.set()
        return True

    def done(self) -> bool:
        """Return whether there is a result or an error."""
        return self._done.is_set()

    def result(self) -> _Result:
        """Return its result, or raise its error."""
        # Until it is done, or no work is queued.
        with suppress(Empty):
            while not self._done.is_set():
                other = self._queue.get_nowait()
                if other is not None:
                    other.run()
                # Frees its result now, if nobody waits for it.
                del other
        self._done.wait()
        error = self._error
        if error is None:
            return self._result
        try:
            raise error
        finally:
            # The error's traceback refers to this frame. Deleting both names breaks the reference cycle.
            del self, error


class Threads:
    """A pool of threads that includes the caller's thread: it works while it waits for a result.

    Parameters
    ----------
    jobs
        Number of threads.

    Attributes
    ----------
    jobs
        Number of threads.
    ahead
        Number of tasks that may be queued or finished before their results are needed.

    Notes
    -----
    With an executor of the standard library there would be one more thread than cores, the caller's. Short tasks would
    then wait for the interpreter's lock as long as they run.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self.ahead = 4 * jobs
        self._tasks: SimpleQueue[Task[Any] | None] = SimpleQueue()
        self._threads: list[Thread] = []

    def close(self) -> None:
        """End the threads, after all queued work."""
        for _ in self._threads:
            self._tasks.put(None)
        for thread in self._threads:
            thread.join()

    def submit(
        self, work: Callable[_Arguments, _Result], /, *args: _Arguments.args, **kwargs: _Arguments.kwargs
    ) -> Task[_Result]:
        """Queue a call of ``work`` for one of the threads."""
        task = Task(partial(work, *args, **kwargs), self._tasks)
        self._tasks.put(task)
        if len(self._threads) < self.jobs - 1:
            # A process may end while a loop over scans is open, which the threads of this loop must not delay.
            thread = Thread(target=self._serve, name=f"pc2scan_{len(self._threads)}", daemon=True)
            # If the system allows no more threads, the existing ones run the task.
            with suppress(RuntimeError):
                thread.start()
                self._threads.append(thread)
        return task

    def _serve(self) -> None:
        while (task := self._tasks.get()) is not None:
            # The task keeps the error, also an interruption of this thread.
            with suppress(BaseException):
                task.run()
            # Frees the result now: the thread may wait long for its next task.
            del task


class InOrder(Generic[_Result]):
    """A queue of work on threads; results are taken in the order of the queue, within bounds of memory.

    Parameters
    ----------
    threads
        The threads.
    bytes_a_thread
        Bytes that may wait, for each thread.
    least
        Number of tasks that may wait, whatever their size.
    most
        Maximum number of tasks that wait; None: `Threads.ahead`.
    """

    def __init__(self, threads: Threads, bytes_a_thread: int, least: int, most: int | None = None) -> None:
        self._threads = threads
        self._bytes = threads.jobs * bytes_a_thread
        self._most = max(1, threads.ahead if most is None else min(most, threads.ahead))
        self._least = min(least, self._most)
        self._held = 0
        #: A function that returns the result, the task (None for work that `take` runs itself), and the size in bytes.
        self._waiting: deque[tuple[Callable[[], _Result], Task[_Result] | None, int]] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def has_room(self, size: int) -> bool:
        """Return whether one more task of this size may be queued."""
        return len(self._waiting) < (self._most if self._held + size <= self._bytes else self._least)

    def put(self, work: Callable[[], _Result], size: int, *, at_its_turn: bool = False) -> None:
        """Queue ``work`` for a thread; with ``at_its_turn``, the thread that calls `take` runs it."""
        task = None if at_its_turn else self._threads.submit(work)
        self._waiting.append((work if task is None else task.result, task, size))
        self._held += size

    def is_ready(self) -> bool:
        """Whether the first result can be taken without waiting."""
        return bool(self._waiting) and ((task := self._waiting[0][1]) is None or task.done())

    def take(self) -> _Result:
        """Return the first result, or raise its error."""
        result, _, size = self._waiting.popleft()
        self._held -= size
        return result()

    def cancel(self) -> None:
        """Cancel work that has not begun."""
        for _, task, _ in self._waiting:
            if task is not None:
                task.cancel()
        self._waiting.clear()
