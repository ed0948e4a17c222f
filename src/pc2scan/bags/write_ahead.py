"""Chunks that are compressed on other threads, and written in the order in which they were put in."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    from .threads import Threads

__all__ = ["WriteAhead"]

Prepared = TypeVar("Prepared")


class WriteAhead:
    """A queue between chunks that are full and the file.

    Without threads, which is how it begins, everything is done at once by the caller. What is written, and in which
    order, is the same.
    """

    def __init__(self) -> None:
        self._pool: Threads | None = None
        # The work (None: there is none), what writes its result, and the bytes held meanwhile.
        self._waiting: deque[tuple[Future[Any] | None, Callable[[], None], int]] = deque()
        self._held = 0

    def use(self, pool: Threads) -> None:
        """Work on what is put in from now on on these threads."""
        self._pool = pool

    def put(self, prepare: Callable[[], Prepared], write: Callable[[Prepared], None], size: int) -> None:
        """Call ``prepare`` on any thread, then ``write`` with its result on the caller's, in its turn.

        Parameters
        ----------
        prepare, write
            What they raise is raised here or in `finish`, when it is their turn.
        size
            Bytes that are held until it is written.
        """
        if self._pool is None:
            write(prepare())
            return
        self._make_room(size)
        future = self._pool.submit(prepare)
        self._waiting.append((future, lambda: write(future.result()), size))
        self._held += size

    def put_ready(self, write: Callable[[], None], size: int) -> None:
        """Call ``write`` in its turn: at once if nothing waits."""
        self._make_room(size)
        if self._waiting:
            self._waiting.append((None, write, size))
            self._held += size
        else:
            write()

    def finish(self) -> None:
        """Write everything that waits."""
        while self._waiting:
            self._write_first()

    def cancel(self) -> None:
        """Give up everything that waits."""
        for future, _, _ in self._waiting:
            if future is not None:
                future.cancel()
        self._waiting.clear()

    def _make_room(self, size: int) -> None:
        """Write what is ready, and of the rest as much as there is too much with ``size`` bytes more."""
        pool = self._pool
        while self._waiting and pool is not None:
            future = self._waiting[0][0]
            room = len(self._waiting) < pool.ahead and self._held + size <= pool.ahead_bytes
            if room and future is not None and not future.done():
                return
            self._write_first()

    def _write_first(self) -> None:
        _, write, size = self._waiting.popleft()
        self._held -= size
        write()
