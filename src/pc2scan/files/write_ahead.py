"""Chunks that are compressed on other threads, and written in the order in which they were put in."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from pc2scan.threads import InOrder

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.threads import Threads

__all__ = ["WriteAhead"]

Prepared = TypeVar("Prepared")

#: So many bytes wait for each thread.
_BYTES_A_THREAD = 8 << 20


class WriteAhead:
    """A queue between chunks that are full and the file.

    Without threads, which is how it begins, everything is done at once by the caller. What is written, and in which
    order, is the same.
    """

    def __init__(self) -> None:
        self._queue: InOrder[Callable[[], None]] | None = None

    def use(self, pool: Threads) -> None:
        """Work on what is put in from now on on these threads."""
        self._queue = InOrder(pool, _BYTES_A_THREAD, 1)

    def put(self, prepare: Callable[[], Prepared], write: Callable[[Prepared], None], size: int) -> None:
        """Call ``prepare`` on any thread, then ``write`` with its result on the caller's, in its turn.

        Parameters
        ----------
        prepare, write
            What they raise is raised here or in `finish`, when it is their turn.
        size
            Bytes that are held until it is written.
        """

        def prepared() -> Callable[[], None]:
            result = prepare()
            return lambda: write(result)

        if self._queue is None:
            prepared()()
            return
        self._make_room(self._queue, size)
        self._queue.put(prepared, size)

    def put_ready(self, write: Callable[[], None], size: int) -> None:
        """Call ``write`` in its turn: at once if nothing waits."""
        if self._queue is not None:
            self._make_room(self._queue, size)
        if self._queue:
            self._queue.put(lambda: write, size, at_its_turn=True)
        else:
            write()

    def finish(self) -> None:
        """Write everything that waits."""
        while self._queue:
            self._queue.take()()

    def cancel(self) -> None:
        """Give up everything that waits."""
        if self._queue is not None:
            self._queue.cancel()

    @staticmethod
    def _make_room(queue: InOrder[Callable[[], None]], size: int) -> None:
        """Write what is ready, and of the rest as much as there is too much with ``size`` bytes more."""
        while queue and (queue.is_ready() or not queue.has_room(size)):
            queue.take()()
