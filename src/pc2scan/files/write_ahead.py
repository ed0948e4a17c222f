"""Compresses chunks on other threads, and writes them in order."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from pc2scan.threads import InOrder

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.threads import Threads

Prepared = TypeVar("Prepared")

#: Bytes that may wait for each thread.
_BYTES_A_THREAD = 4 << 20


class WriteAhead:
    """A queue between full chunks and the file.

    Until `use` is called, everything is done at once on the caller's thread. The written bytes are the same.
    """

    def __init__(self) -> None:
        self._queue: InOrder[Callable[[], None]] | None = None

    def use(self, pool: Threads) -> None:
        """Use these threads from now on."""
        self._queue = InOrder(pool, _BYTES_A_THREAD, 1)

    def put(self, prepare: Callable[[], Prepared], write: Callable[[Prepared], None], size: int) -> None:
        """Call ``prepare`` on any thread, then ``write`` with its result on the caller's, in order.

        Parameters
        ----------
        prepare, write
            Their errors are raised here or in `finish`, in order.
        size
            Bytes that are held until ``write`` is called.
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
        """Call ``write`` in order: at once if nothing waits."""
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
        """Drop everything that waits."""
        if self._queue is not None:
            self._queue.cancel()

    @staticmethod
    def _make_room(queue: InOrder[Callable[[], None]], size: int) -> None:
        """Write finished chunks, and wait for others until ``size`` more bytes may be queued."""
        while queue and (queue.is_ready() or not queue.has_room(size)):
            queue.take()()
