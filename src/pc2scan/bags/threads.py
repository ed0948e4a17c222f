"""The threads of a conversion, and how much may be held for them ahead of its turn."""

from __future__ import annotations

from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType
    from typing import Self

__all__ = ["Task", "Threads"]

_Result = TypeVar("_Result")
_Arguments = ParamSpec("_Arguments")


class Task(Future[_Result], Generic[_Result]):
    """A piece of work that threads were given. Who waits for its result works on others meanwhile."""

    def __init__(self, work: Callable[[], _Result], threads: Threads) -> None:
        super().__init__()
        self._work: Callable[[], _Result] | None = work
        self._threads = threads

    def run(self) -> None:
        """Do it, unless it was given up; an interruption is raised at once."""
        work, self._work = self._work, None
        if work is None or not self.set_running_or_notify_cancel():
            return
        try:
            result = work()
        except Exception as err:  # noqa: BLE001  # it is raised where the result is asked for
            self.set_exception(err)
        except BaseException as err:
            self.set_exception(err)
            raise
        else:
            self.set_result(result)

    def result(self, timeout: float | None = None) -> _Result:
        """Return its result, or raise its error."""
        self._threads.help(self)
        return super().result(timeout)

    def exception(self, timeout: float | None = None) -> BaseException | None:
        """Return its error."""
        self._threads.help(self)
        return super().exception(timeout)


class Threads:
    """Some threads, one of which is that of the caller: it works while it waits for a result.

    Parameters
    ----------
    jobs
        How many threads.

    Attributes
    ----------
    jobs
        How many threads.
    ahead
        Pieces of work that may wait, or have a result that waits for its turn.
    ahead_bytes
        Bytes that these may take; one larger piece may always.

    Notes
    -----
    An executor of the standard library's leaves the caller's thread idle or in the way: it would be one more than there
    are cores, and what takes a fraction of a millisecond waits as long for the interpreter's lock.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self.ahead = 4 * jobs
        self.ahead_bytes = jobs << 23
        self._tasks: SimpleQueue[Task[Any] | None] = SimpleQueue()
        self._threads: list[Thread] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for _ in self._threads:
            self._tasks.put(None)
        for thread in self._threads:
            thread.join()

    def submit(
        self, work: Callable[_Arguments, _Result], /, *args: _Arguments.args, **kwargs: _Arguments.kwargs
    ) -> Future[_Result]:
        """Let one of the threads call ``work``."""
        task = Task(partial(work, *args, **kwargs), self)
        self._tasks.put(task)
        if len(self._threads) < self.jobs - 1:
            thread = Thread(target=self._serve, name=f"pc2scan_{len(self._threads)}")
            # Where there may be no more threads, those that there are do the work.
            with suppress(RuntimeError):
                thread.start()
                self._threads.append(thread)
        return task

    def help(self, task: Task[_Result]) -> None:
        """Work until a task is done, or as long as there is something to do."""
        while not task.done():
            try:
                other = self._tasks.get_nowait()
            except Empty:
                return
            if other is not None:
                other.run()

    def _serve(self) -> None:
        while (task := self._tasks.get()) is not None:
            # An interruption of this thread alone is told by the task.
            with suppress(BaseException):
                task.run()
            # Its result must not be kept while the thread waits for the next one.
            del task
