"""The scheduler: all threads load units and work on their messages; results are returned in order.

A thread that loads a unit also works on its messages before it returns the unit. So a cloud of 4 MB is still in the
core's own cache, and the memory of a chunk is released as soon as its scans exist.
"""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from pc2scan.bags.units import Handle, LazyItems, load_when_due, merge_by_time
from pc2scan.model import StoredChunk, own_message
from pc2scan.threads import InOrder

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from pathlib import Path

    from pc2scan.bags.units import Loaded, TimedItem, Unit
    from pc2scan.model import RawMessage
    from pc2scan.threads import Threads

    Item = TypeVar("Item", bound=TimedItem)

#: How many bytes are loaded ahead for every thread. Of units up to the second size, always one more than threads is
#: loaded.
AHEAD_BYTES = 6 << 20
LARGEST_AHEAD = 20 << 20

#: How many bytes of messages are passed to another thread together. For fewer bytes, passing them takes longer than the
#: work.
_PIECE_BYTES = 1 << 20


def schedule(
    units: Iterable[Unit],
    callback: Callable[[RawMessage], Item],
    threads: Threads | None,
    *,
    window: int | None = None,
    path: Path | None = None,
) -> Generator[Item | StoredChunk]:
    """Work on the messages of a recording.

    Parameters
    ----------
    units
        The units to load, sorted by start.
    callback
        Makes an item of a message, on any thread; see `pc2scan.bags.units.Load`.
    threads
        All threads, or None for the caller's alone. The items do not depend on it.
    window
        How many units may be loaded ahead; None: as many as memory allows.
    path
        The recording, for error messages.

    Yields
    ------
    Item | StoredChunk
        Sorted by log time, whatever the number of threads. An exception of the callback is raised in the place of its
        item.
    """
    loading = load_when_due if threads is None else partial(_load_ahead, threads, window)
    return merge_by_time(units, callback, loading=loading, path=path)


def _load_ahead(
    threads: Threads, window: int | None, units: Iterable[Unit], callback: Callable[[RawMessage], Item]
) -> Generator[Handle]:
    """Load units ahead, on other threads."""
    waiting: deque[Unit] = deque()
    results: InOrder[Loaded[Any]] = InOrder(threads, AHEAD_BYTES, threads.jobs + 1, window)
    try:
        for unit in units:
            too_large = unit.size > LARGEST_AHEAD
            while waiting and (too_large or not _may_wait(unit, results, threads.jobs)):
                yield Handle(waiting.popleft(), results.take)
            if too_large:
                yield Handle(unit, partial(_load_together, threads, unit, callback))
            else:
                load = partial(unit.load, callback, whole=unit.may_be_whole)
                results.put(load, unit.size, at_its_turn=unit.is_quick)
                waiting.append(unit)
        while waiting:
            yield Handle(waiting.popleft(), results.take)
    finally:
        results.cancel()


def _may_wait(unit: Unit, results: InOrder[Loaded[Any]], jobs: int) -> bool:
    """Whether one more unit may be loaded ahead; of units that are already in memory, one per thread is enough."""
    return results.has_room(unit.size) and (len(results) < jobs or not unit.is_in_memory)


def _load_together(threads: Threads, unit: Unit, callback: Callable[[RawMessage], Item]) -> Loaded[Item]:
    """Load a unit on this thread, and work on its messages on all threads."""
    found = unit.load(own_message, whole=unit.may_be_whole)
    if isinstance(found, StoredChunk):
        return found
    if isinstance(found, LazyItems):
        return found.map(callback)
    tasks = [threads.submit(list[Any], map(callback, piece)) for piece in _pieces(found)]
    return [item for task in tasks for item in task.result()]


def _pieces(messages: Iterable[RawMessage]) -> Iterator[list[RawMessage]]:
    piece: list[RawMessage] = []
    size = 0
    for message in messages:
        piece.append(message)
        size += len(message.data)
        if size >= _PIECE_BYTES:
            yield piece
            piece, size = [], 0
    if piece:
        yield piece
