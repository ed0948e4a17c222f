"""Work on several threads whose results come out in the order of the input."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable
    from concurrent.futures import Executor

Item = TypeVar("Item")
Result = TypeVar("Result")

#: Items that need no thread may queue behind one that does, up to here.
_MAX_QUEUED = 1024


def map_in_order(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    is_heavy: Callable[[Item], bool],
    pool: Executor | None,
    window: int,
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

    Yields
    ------
    Result
        In the order of ``items``, whatever the number of threads. An exception of ``work`` is raised
        when its turn comes.
    """
    if pool is None:
        yield from map(work, items)
        return
    queue: deque[Future[Result]] = deque()
    in_flight: deque[Future[Result]] = deque()
    try:
        for item in items:
            if is_heavy(item):
                while len(in_flight) >= window:
                    # The oldest heavy item has to be done before another one is read.
                    in_flight.popleft().exception()
                future = pool.submit(work, item)
                in_flight.append(future)
            else:
                future = Future()
                future.set_result(work(item))
            queue.append(future)
            while queue and (queue[0].done() or len(queue) > _MAX_QUEUED):
                yield queue.popleft().result()
        while queue:
            yield queue.popleft().result()
    finally:
        for future in queue:
            future.cancel()
