"""The scheduler: units are loaded and their messages worked on by all threads; the results come in order.

A thread that loads a unit also works on its messages, before the unit is handed on: a cloud of 4 MB is in no core's own
cache by the time another thread has it, and a chunk is free again as soon as its scans are there.
"""

from __future__ import annotations

import os
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from pc2scan.bags.many import Many
from pc2scan.bags.units import Handle, in_time_order, loaded, when_due
from pc2scan.model import RawMessage, StoredChunk, owned
from pc2scan.threads import InOrder

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from pathlib import Path

    from pc2scan.bags.units import Loaded, Timed, Unit
    from pc2scan.threads import Threads

    Item = TypeVar("Item", bound=Timed)

__all__ = ["Later", "cores", "schedule"]

#: So much is loaded ahead of its turn for every thread, and one unit more than threads of those up to the second size.
AHEAD_BYTES = 12 << 20
LARGEST_AHEAD = 20 << 20

#: Messages that are handed to another thread together have so many bytes: fewer take less time than handing them over.
_PIECE_BYTES = 1 << 20


class Later(NamedTuple):
    """A message that a callback leaves as it is until its turn, because its result takes more memory."""

    message: RawMessage
    work: Callable[[RawMessage], Any]

    @property
    def log_time_ns(self) -> int:
        """When the message was recorded."""
        return self.message.log_time_ns

    @property
    def size(self) -> int:
        """Bytes of the message."""
        return self.message.size


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def schedule(
    units: Iterable[Unit],
    callback: Callable[[RawMessage], Item | Later],
    threads: Threads | None,
    *,
    window: int | None = None,
    path: Path | None = None,
) -> Generator[Item | StoredChunk]:
    """Work on the messages of a recording.

    Parameters
    ----------
    units
        What is loaded, by start.
    callback
        Makes the items of messages, each for itself and on any thread; see `pc2scan.bags.units.Load`.
    threads
        All of them, or None for none but the caller's. The items are the same.
    window
        How many units may be loaded ahead of their turn; None: as many as memory allows.
    path
        The recording, for errors.

    Yields
    ------
    Item | StoredChunk
        By log time, whatever the number of threads. An exception of the callback is raised when its turn comes.
    """
    loading = when_due if threads is None else partial(_ahead, threads, window)
    items = in_time_order(units, callback, loading=loading, path=path)
    try:
        for item in items:
            yield item.work(item.message) if isinstance(item, Later) else item
            # This frame must not keep an item in memory while the next one is made.
            del item
    finally:
        items.close()


def _ahead(
    threads: Threads, window: int | None, units: Iterable[Unit], callback: Callable[[RawMessage], Item]
) -> Generator[Handle]:
    """Load units on other threads ahead of their turn."""
    waiting: deque[Unit] = deque()
    results: InOrder[Loaded[Any]] = InOrder(threads, AHEAD_BYTES, threads.jobs + 1, window)
    try:
        for unit in units:
            too_large = unit.size > LARGEST_AHEAD
            while waiting and (too_large or not results.has_room(unit.size)):
                yield Handle(waiting.popleft(), results.take)
            if too_large:
                yield Handle(unit, partial(_together, threads, unit, callback))
            else:
                load = partial(loaded, unit, callback, whole=unit.may_be_whole)
                results.put(load, unit.size, at_its_turn=unit.is_quick)
                waiting.append(unit)
        while waiting:
            yield Handle(waiting.popleft(), results.take)
    finally:
        results.cancel()


def _together(threads: Threads, unit: Unit, callback: Callable[[RawMessage], Item]) -> Loaded[Item]:
    """Load a unit on this thread, and work on its messages on all of them."""
    found = loaded(unit, owned, whole=unit.may_be_whole)
    if isinstance(found, StoredChunk):
        return found
    if isinstance(found, Many):
        return found.mapped(callback)
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
