"""Units: the parts of a recording that can be loaded by themselves, and their messages merged by log time.

A unit is a chunk, a run of records outside chunks, or some rows of a database. A reader lists the units of its
recording. Here they are loaded when their first message is due, and their messages are merged: chunks overlap in time
where the recorder had several buffers, and sorting a whole index would need memory that grows with the recording.
"""

from __future__ import annotations

import heapq
from collections import deque
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeVar

from pc2scan.errors import RecordingError
from pc2scan.model import RawMessage, StoredChunk, owned

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from pathlib import Path

    from pc2scan.files.source import SourceFile

__all__ = [
    "MAX_OPEN_BYTES",
    "UNKNOWN_START_NS",
    "Handle",
    "Load",
    "Stretch",
    "Timed",
    "Unit",
    "by_start",
    "in_time_order",
    "loaded",
    "when_due",
]

#: Loaded units may take this much before the ones needed last are dropped and later loaded again.
MAX_OPEN_BYTES = 64 << 20

#: The start of a unit whose first log time is not known: it is due at once.
UNKNOWN_START_NS = -1 << 63

#: Units may be loaded again until that comes to so many times the whole, and a gigabyte.
_MAX_AGAIN = 16

#: So many bytes are announced to the system before they are read: it reads them while others are decompressed.
_ANNOUNCED_BYTES = 32 << 20

#: Chunks follow each other at no larger distance: an index may lie between them.
_GAP_BYTES = 64 << 10


class Timed(Protocol):
    """Anything with a log time and a size: a message, or what a callback makes of one."""

    @property
    def log_time_ns(self) -> int:
        """When the message was recorded."""
        ...

    @property
    def size(self) -> int:
        """Bytes that it takes."""
        ...


Item = TypeVar("Item", bound=Timed)


class Load(Protocol):
    """Loads a unit; may be called on any thread, and again."""

    def __call__(self, callback: Callable[[RawMessage], Item], *, whole: bool) -> list[Item] | StoredChunk:
        """Return what the callback makes of each message, in the order of the file, or the chunk as a whole.

        Parameters
        ----------
        callback
            Called with each wanted message where it was read or decompressed, while it is still in that core's cache.
            The message's data may be borrowed: what is kept of them must be `pc2scan.model.owned`.
        whole
            Whether the chunk may be returned as a whole. It is only if its messages are sorted by log time.
        """
        ...


class Stretch(NamedTuple):
    """Where a unit lies: the file, and the bytes in it."""

    file: SourceFile
    offset: int
    length: int


@dataclass(frozen=True, slots=True)
class Unit:
    """A part of a recording that can be loaded by itself.

    Attributes
    ----------
    start_ns
        Log time of its first message, or earlier.
    place
        Where it stands among units: messages of one log time are in this order.
    size
        Bytes that it takes once it is loaded.
    load
        See `Load`.
    is_quick
        Whether loading it takes less time than handing it to another thread.
    may_be_whole
        Whether a chunk may be handed on as a whole: all of it is wanted, and no other unit has messages between its
        first and its last one.
    stretch
        Where it lies in a file; None for what does not lie in one piece.
    """

    start_ns: int
    place: tuple[int, ...]
    size: int
    load: Load
    is_quick: bool = False
    may_be_whole: bool = False
    stretch: Stretch | None = None


class Handle(NamedTuple):
    """A unit, and the call that returns what it was loaded as."""

    unit: Unit
    result: Callable[[], list[Any] | StoredChunk]


def by_start(units: Iterable[Unit]) -> list[Unit]:
    """Sort units in the order in which they are due."""
    return sorted(units, key=attrgetter("start_ns", "place"))


def loaded(unit: Unit, callback: Callable[[RawMessage], Item], *, whole: bool) -> list[Item] | StoredChunk:
    """Load a unit, its messages sorted by log time."""
    found = unit.load(callback, whole=whole)
    if not isinstance(found, StoredChunk):
        # A stable sort, and next to free where the recorder kept the order.
        found.sort(key=attrgetter("log_time_ns"))
    return found


def when_due(units: Iterable[Unit], callback: Callable[[RawMessage], Item]) -> Generator[Handle]:
    """Load each unit when its result is asked for."""
    for unit in units:
        yield Handle(unit, partial(loaded, unit, callback, whole=unit.may_be_whole))


def in_time_order(
    units: Iterable[Unit],
    callback: Callable[[RawMessage], Item] = owned,  # type: ignore[assignment]  # the default makes messages of messages
    *,
    loading: Callable[[Iterable[Unit], Callable[[RawMessage], Item]], Generator[Handle]] = when_due,
    max_open_bytes: int = MAX_OPEN_BYTES,
    path: Path | None = None,
) -> Generator[Item | StoredChunk]:
    """Merge the messages of units that overlap in time.

    Parameters
    ----------
    units
        By start; see `by_start`. They may be made one after the other, as they are needed.
    callback
        Makes the items of messages; see `Load`. Called once a message, except that a unit is loaded again if more than
        ``max_open_bytes`` of units overlap at one time, or if one that may be whole does not stand alone after all.
    loading
        When and where units are loaded. It yields a handle for each unit, in order, and its results are asked for in
        order, each once.
    max_open_bytes
        Bound on the units held at one time (one is always held).
    path
        The recording, for the error.

    Yields
    ------
    Item | StoredChunk
        By log time; equal log times in the order of places. Whole chunks only of units that may be whole.

    Raises
    ------
    RecordingError
        If units that overlap would have to be loaded again and again.
    """
    handles = loading(_announced(units), callback)
    try:
        yield from _merged(handles, callback, max_open_bytes, path)
    finally:
        handles.close()


def _announced(units: Iterable[Unit]) -> Iterator[Unit]:
    """The units, the stretches of each announced to the system some way ahead of its turn.

    Announcements are rare, and several units that follow each other are announced as one: every call lets other
    threads take the interpreter's lock.
    """
    source = iter(units)
    coming: deque[Unit] = deque()
    announced = 0
    while True:
        if announced <= _ANNOUNCED_BYTES // 2:
            stretches: list[Stretch] = []
            while announced < _ANNOUNCED_BYTES and (unit := next(source, None)) is not None:
                coming.append(unit)
                if unit.stretch is None:
                    break
                announced += unit.stretch.length
                _append(stretches, unit.stretch)
            for file, offset, length in stretches:
                file.expect(offset, length)
        if not coming:
            return
        due = coming.popleft()
        announced -= due.stretch.length if due.stretch else 0
        yield due
        # Rows of a database lie in the unit itself: they must not stay in memory while the next one is made.
        unit = None
        del due


def _append(stretches: list[Stretch], following: Stretch) -> None:
    """Append a stretch, or extend the last one if it follows that."""
    if stretches:
        file, offset, length = stretches[-1]
        if file is following.file and 0 <= following.offset - offset - length <= _GAP_BYTES:
            stretches[-1] = Stretch(file, offset, following.offset + following.length - offset)
            return
    stretches.append(following)


class _Open:
    """A loaded unit on the heap, keyed by its next item's log time, then by its place."""

    __slots__ = ("items", "key", "position", "size", "unit", "whole")

    def __init__(self, unit: Unit, found: list[Any] | StoredChunk, max_open_bytes: int) -> None:
        self.unit = unit
        self.size = unit.size
        if unit.size > max_open_bytes and not isinstance(found, StoredChunk):
            # A damaged chunk may declare any size: what it really holds must not drive all others out.
            self.size = min(unit.size, sum(item.size for item in found))
        self.position = 0
        #: None once they were dropped, and of a whole chunk.
        self.items: list[Any] | None = None
        self.whole: StoredChunk | None = None
        if isinstance(found, StoredChunk):
            self.whole = found
            self.key = (found.span_ns()[0], unit.place)
        else:
            self.items = found
            self.key = (found[0].log_time_ns, unit.place)

    def __lt__(self, other: _Open) -> bool:
        return self.key < other.key


def _merged(
    handles: Iterator[Handle], callback: Callable[[RawMessage], Any], max_open_bytes: int, path: Path | None
) -> Generator[Any]:
    """Merge units that are loaded in the order in which they are due."""
    heap: list[_Open] = []
    coming = next(handles, None)
    total = again = 0
    while heap or coming is not None:
        while coming is not None and (not heap or coming.unit.start_ns <= heap[0].key[0]):
            unit = coming.unit
            total += unit.size
            # Room is made before it is needed.
            _evict(heap, max_open_bytes - unit.size)
            found = coming.result()
            if found:
                heapq.heappush(heap, _Open(unit, found, max_open_bytes))
                _evict(heap, max_open_bytes)
            del found, unit
            coming = next(handles, None)
        if not heap:
            continue
        current = heapq.heappop(heap)
        place = current.unit.place
        # Everything up to the next unit's turn comes from this one: no heap operation an item.
        limit = heap[0].key if heap else None
        if coming is not None:
            arrival: tuple[int, tuple[int, ...]] = (coming.unit.start_ns, ())
            limit = arrival if limit is None or arrival < limit else limit
        if current.whole is not None and (limit is None or (current.whole.span_ns()[1], place) < limit):
            yield current.whole
            del current
            continue
        if current.items is None:
            again += current.unit.size
            if again > _MAX_AGAIN * total + (1 << 30):
                raise RecordingError(
                    f"its chunks overlap in time so much that each would have to be read {_MAX_AGAIN} times", path=path
                )
            _evict(heap, max_open_bytes - current.unit.size)
            split = loaded(current.unit, callback, whole=False)
            assert not isinstance(split, StoredChunk)
            current.items, current.whole = split, None
            del split
        items, position = current.items, current.position
        while position < len(items) and (limit is None or (items[position].log_time_ns, place) < limit):
            yield items[position]
            position += 1
        if position < len(items):
            current.position = position
            current.key = (items[position].log_time_ns, place)
            heapq.heappush(heap, current)
            _evict(heap, max_open_bytes)
        # The generator's frame must not keep a spent or dropped unit alive while the next one is loaded.
        del items, current


def _evict(heap: list[_Open], max_open_bytes: int) -> None:
    """Drop the items of the units that are needed last, until the rest fits."""
    if len(heap) <= 1:
        return
    held = sorted((entry for entry in heap if entry.items is not None), reverse=True)
    total = sum(entry.size for entry in held)
    for entry in held[:-1]:
        if total <= max_open_bytes:
            return
        entry.items = None
        total -= entry.size
