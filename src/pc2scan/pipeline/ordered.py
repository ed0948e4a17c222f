"""Work on several threads whose results come out in the order of the input."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable

    from pc2scan.bags.threads import Threads

Item = TypeVar("Item")
Result = TypeVar("Result")

#: Items that need no thread may queue behind one that does, up to so many and so many bytes.
_MAX_QUEUED = 1024


def map_in_order(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    is_heavy: Callable[[Item], bool],
    pool: Threads | None,
    window: int,
    size: Callable[[Item], int] = lambda _: 0,
) -> Generator[Result, None, None]:
    """Apply ``work`` to every item, the heavy ones on other threads.

    Parameters
    ----------
    work
        Must not depend on the order of calls.
    is_heavy
        Which items are worth a thread; the others are worked on where they are read.
    pool
        The threads; None means none but the caller's.
    window
        Heavy items in flight at most: items are read no further than that, so memory stays bounded.
    size
        Bytes that an item keeps while it waits for its turn.

    Yields
    ------
    Result
        In the order of ``items``, whatever the number of threads. An exception of ``work`` is raised
        when its turn comes.
    """
    if pool is None:
        yield from map(work, items)
        return
    queue: deque[tuple[Future[Result], int]] = deque()
    queued_bytes = 0
    in_flight: deque[Future[Result]] = deque()
    try:
        for item in items:
            if is_heavy(item):
                while len(in_flight) >= window:
                    # The oldest heavy item has to be done before another one is read.
                    in_flight.popleft().exception()
                future = pool.submit(work, item)
                in_flight.append(future)
            elif not queue:
                yield work(item)
                del item
                continue
            else:
                future = Future()
                future.set_result(work(item))
            kept = size(item)
            queue.append((future, kept))
            queued_bytes += kept
            # What this frame still refers to would stay in memory while the consumer works.
            del item, future
            while queue and (queue[0][0].done() or len(queue) > _MAX_QUEUED or queued_bytes > pool.ahead_bytes):
                first, kept = queue.popleft()
                queued_bytes -= kept
                yield first.result()
                del first
        while queue:
            yield queue.popleft()[0].result()
    finally:
        for future, _ in queue:
            future.cancel()
