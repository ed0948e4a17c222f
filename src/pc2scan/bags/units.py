"""Loads the units of a recording, and merges their messages by log time.

A unit is a part of a recording that can be loaded by itself: a chunk, consecutive records outside chunks, or some rows
of a database. A reader lists the units of its recording. They are loaded when their first message is due, and merged,
because chunks overlap in time if the recorder had several buffers. Sorting a whole index would need memory that grows
with the recording.

A message without data takes 31 bytes in a chunk, next to none where it is compressed, and ten times as much as an
object. So of a chunk with very many messages only the log times and the places are kept (`LazyItems`).
"""

from __future__ import annotations

import heapq
from array import array
from bisect import bisect_left
from collections import deque
from contextlib import closing
from functools import partial
from itertools import compress, islice
from operator import attrgetter, le
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol, TypeAlias, TypeVar, overload

from pc2scan.errors import RecordingError
from pc2scan.model import RawMessage, StoredChunk, own_message

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from pathlib import Path

    from pc2scan.files.source import SourceFile

#: Limit of loaded units; beyond it, those needed last are dropped and later loaded again.
MAX_OPEN_BYTES = 96 << 20

#: The start of a unit with an unknown first log time: it is due at once.
UNKNOWN_START_NS = -1 << 63

#: Limit for loading units again, as a multiple of the size of all units; a gigabyte is always allowed.
_MAX_AGAIN = 4

#: Maximum number of messages in a recording, whatever its size; one more is allowed for each stored byte.
_MAX_FREE_MESSAGES = 1_000_000

#: Bytes that are announced to the system before they are read: it reads them while others are decompressed.
_ANNOUNCED_BYTES = 32 << 20

#: How many units are announced at most: each takes half a kilobyte.
_ANNOUNCED_UNITS = 1_000

#: Chunks with at most this distance are announced together: an index may be between them.
_GAP_BYTES = 64 << 10

#: Up to this number, the messages of a chunk are all created at once. Usual chunks have fewer.
MAX_LISTED_ITEMS = 1 << 15

#: Bytes that an item takes besides its data.
ITEM_BYTES = 400

_Value = TypeVar("_Value")
_Other = TypeVar("_Other")


class TimedItem(Protocol):
    """Anything with a log time and a size: a message, or a callback's result."""

    @property
    def log_time_ns(self) -> int:
        """When the message was recorded."""
        ...

    @property
    def size(self) -> int:
        """Bytes that it takes."""
        ...


Item = TypeVar("Item", bound=TimedItem)


class LazyItems(Generic[_Value]):
    """Items that are created from messages one by one; only the last one is kept.

    Parameters
    ----------
    times
        Log times, ns.
    places
        The messages' positions, in the same order.
    make
        Creates the item at a position. Each call for a position gives an equal item.
    kept_bytes
        Bytes that ``make`` keeps in memory.
    """

    __slots__ = ("_kept_bytes", "_last", "_make", "_places", "_times")

    def __init__(self, times: array[int], places: array[int], make: Callable[[int], _Value], kept_bytes: int) -> None:
        self._kept_bytes = kept_bytes
        self._times = times
        self._places = places
        self._make = make
        self._last: tuple[int, _Value] | None = None

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, number: int) -> _Value:
        if self._last is None or self._last[0] != number:
            # Not two at the same time.
            self._last = None
            self._last = (number, self._make(self._places[number]))
        return self._last[1]

    def __iter__(self) -> Iterator[_Value]:
        return map(self._make, self._places)

    @property
    def times(self) -> array[int]:
        """Log times, ns."""
        return self._times

    @property
    def size(self) -> int:
        """Bytes of memory that it takes."""
        return self._kept_bytes + sum(len(values) * values.itemsize for values in (self._times, self._places))

    def map(self, callback: Callable[[_Value], _Other], times: array[int] | None = None) -> LazyItems[_Other]:
        """Return the callback's results for the items, with their log times or the given ones."""
        make = self._make
        times = self._times if times is None else times
        return LazyItems(times, self._places, lambda place: callback(make(place)), self._kept_bytes)

    def filter(self, test: Callable[[_Value], bool]) -> LazyItems[_Value]:
        """Return the items for which ``test`` is true."""
        chosen = bytearray(map(test, self))
        times, places = (array("Q", compress(values, chosen)) for values in (self._times, self._places))
        return LazyItems(times, places, self._make, self._kept_bytes)

    def as_list(self) -> list[_Value] | LazyItems[_Value]:
        """Return a list of all items if they are few enough; else itself."""
        return self if len(self) > MAX_LISTED_ITEMS else list(self)

    def sort_by_time(self) -> LazyItems[_Value]:
        """Return the items sorted by log time; items with equal times keep their order."""
        times = self._times
        if all(map(le, times, islice(times, 1, None))):
            return self
        order = array("Q", sorted(range(len(times)), key=times.__getitem__))
        times, places = (array("Q", map(values.__getitem__, order)) for values in (times, self._places))
        return LazyItems(times, places, self._make, self._kept_bytes)


@overload
def map_items(callback: Callable[[_Value], _Other], items: list[_Value]) -> list[_Other]: ...
@overload
def map_items(
    callback: Callable[[_Value], _Other], items: list[_Value] | LazyItems[_Value]
) -> list[_Other] | LazyItems[_Other]: ...
def map_items(
    callback: Callable[[_Value], _Other], items: list[_Value] | LazyItems[_Value]
) -> list[_Other] | LazyItems[_Other]:
    """Return the callback's results for items."""
    return items.map(callback) if isinstance(items, LazyItems) else list(map(callback, items))


def filter_items(
    test: Callable[[_Value], bool], items: list[_Value] | LazyItems[_Value]
) -> list[_Value] | LazyItems[_Value]:
    """Return the items for which ``test`` is true."""
    return items.filter(test) if isinstance(items, LazyItems) else list(filter(test, items))


#: The result of loading a unit: items in the order of the file, or the chunk as a whole.
Loaded: TypeAlias = list[Item] | LazyItems[Item] | StoredChunk


class Load(Protocol):
    """Loads a unit; may be called on any thread, and again."""

    def __call__(self, callback: Callable[[RawMessage], Item], *, whole: bool) -> Loaded[Item]:
        """Return the callback's result for each message, in the order of the file, or the chunk as a whole.

        Parameters
        ----------
        callback
            Called with each wanted message on the thread that read it, while it is still in that core's cache.
            The message's data may be borrowed: a message that is kept must be copied by `pc2scan.model.own_message`.
        whole
            Whether the chunk may be returned as a whole, which its reader does unless its content is not as declared.
        """
        ...


class Extent(NamedTuple):
    """The place of a unit: the file, and its bytes there."""

    file: SourceFile
    offset: int
    length: int


class Unit(NamedTuple):
    """A part of a recording that can be loaded by itself.

    Attributes
    ----------
    start_ns
        Log time of its first message, or earlier. Of a chunk that may be whole: when it is due.
    place
        Order among units: messages of one log time are in this order.
    size
        Bytes of memory when it is loaded.
    load
        See `Load`.
    is_quick
        Whether loading it takes less time than handing it to another thread.
    may_be_whole
        Whether a chunk may be copied as a whole; see `pc2scan.bags.chunks.whole_chunks`.
    extent
        Its place in a file; None if it is not in one piece.
    is_in_memory
        Whether it takes its memory as soon as it is listed, as the rows of a database do.
    end_ns
        Log time of its last message, or later; None if that is unknown.
    connection_ids
        The connections with messages in it; None if they are unknown, or those that were asked for.
    """

    start_ns: int
    place: tuple[int, ...]
    size: int
    load: Load
    is_quick: bool = False
    may_be_whole: bool = False
    extent: Extent | None = None
    is_in_memory: bool = False
    end_ns: int | None = None
    connection_ids: frozenset[int] | None = None

    @property
    def stored(self) -> int:
        """Its bytes in the file, or those of its messages if it is not in one piece."""
        return self.size if self.extent is None else self.extent.length

    @property
    def due(self) -> tuple[int, tuple[int, ...]]:
        """When it is loaded: at its start; units that start together, in the order of their places."""
        return self.start_ns, self.place


class Handle(NamedTuple):
    """A unit, and the function that returns its items or its chunk."""

    unit: Unit
    result: Callable[[], Loaded[Any]]


def _sort(found: Loaded[Item]) -> Loaded[Item]:
    """Return the items of a unit sorted by log time."""
    if isinstance(found, LazyItems):
        return found.sort_by_time()
    if not isinstance(found, StoredChunk):
        # A stable sort, which takes almost no time if the messages are in order.
        found.sort(key=attrgetter("log_time_ns"))
    return found


def load_when_due(units: Iterable[Unit], callback: Callable[[RawMessage], Item]) -> Generator[Handle]:
    """Load each unit when its result is needed."""
    for unit in units:
        yield Handle(unit, partial(unit.load, callback, whole=unit.may_be_whole))


def merge_by_time(
    units: Iterable[Unit],
    callback: Callable[[RawMessage], Item] = own_message,  # type: ignore[assignment]  # the default makes messages of messages
    *,
    loading: Callable[[Iterable[Unit], Callable[[RawMessage], Item]], Generator[Handle]] = load_when_due,
    max_open_bytes: int = MAX_OPEN_BYTES,
    holds_units: bool = True,
    path: Path | None = None,
) -> Generator[Item | StoredChunk]:
    """Merge the messages of units that overlap in time.

    Parameters
    ----------
    units
        In the order in which they are due. They may come from a generator.
    callback
        Makes the items of messages; see `Load`. Called once a message, except that a unit is loaded again if more than
        ``max_open_bytes`` of units overlap at one time.
    loading
        Decides when and where units are loaded. It yields a handle for each unit, in order; each result is used once,
        in order.
    max_open_bytes
        Bound on the units held at one time (one is always held).
    holds_units
        Whether items may keep the memory of their unit. Otherwise it counts as much as its items.
    path
        The recording, for the error.

    Yields
    ------
    Item | StoredChunk
        By log time; equal log times in the order of places. Whole chunks, only for units that may be whole, when they
        are due.

    Raises
    ------
    RecordingError
        If units that overlap would have to be loaded again and again.
    """
    with closing(loading(_announce(units), callback)) as handles:
        heap: list[_OpenUnit] = []
        coming = next(handles, None)
        total = again = 0
        most = _MAX_FREE_MESSAGES
        while heap or coming is not None:
            while coming is not None and (not heap or coming.unit.due < heap[0].key):
                unit = coming.unit
                total += unit.size
                # Makes room before loading.
                _evict(heap, max_open_bytes - unit.size)
                found = _sort(coming.result())
                if unit.extent and not isinstance(found, StoredChunk):
                    most += unit.extent.length - len(found)
                    if most < 0:
                        raise RecordingError("has more messages than bytes, which no recording does", path=path)
                if found:
                    heapq.heappush(heap, _OpenUnit(unit, found, max_open_bytes if holds_units else 0))
                    _evict(heap, max_open_bytes)
                del found, unit
                coming = next(handles, None)
            if not heap:
                continue
            current = heapq.heappop(heap)
            if current.whole is not None:
                yield current.whole
                del current
                continue
            place = current.unit.place
            # All items up to the next unit's turn are from this one, without a heap operation for each.
            limit = heap[0].key if heap else None
            if coming is not None:
                arrival = coming.unit.due
                limit = arrival if limit is None or arrival < limit else limit
            if current.items is None:
                again += current.unit.size
                if again > _MAX_AGAIN * total + (1 << 30):
                    raise RecordingError(
                        f"its chunks overlap in time so much that each would have to be read {_MAX_AGAIN} times",
                        path=path,
                    )
                _evict(heap, max_open_bytes - current.unit.size)
                split = _sort(current.unit.load(callback, whole=False))
                assert not isinstance(split, StoredChunk)
                current.items = split
                del split
            items, position = current.items, current.position
            if isinstance(items, list) and (limit is None or (items[-1].log_time_ns, place) < limit):
                yield from islice(items, position, None)
                position = len(items)
            while position < len(items) and (limit is None or (items[position].log_time_ns, place) < limit):
                yield items[position]
                position += 1
            if position < len(items):
                current.position = position
                current.key = (items[position].log_time_ns, place)
                heapq.heappush(heap, current)
                _evict(heap, max_open_bytes)
            # The generator's frame must not keep a used unit in memory while the next one is loaded.
            del items, current


def _announce(units: Iterable[Unit]) -> Iterator[Unit]:
    """Yield the units, and announce their extents to the system ahead of their turn.

    Units that follow each other are announced by one call, because every call lets other threads take the
    interpreter's lock.
    """
    source = iter(units)
    coming: deque[Unit] = deque()
    announced = 0
    while True:
        if announced <= _ANNOUNCED_BYTES // 2 and len(coming) <= _ANNOUNCED_UNITS // 2:
            extents: list[Extent] = []
            while (
                announced < _ANNOUNCED_BYTES
                and len(coming) < _ANNOUNCED_UNITS
                and (unit := next(source, None)) is not None
            ):
                coming.append(unit)
                if unit.extent is None:
                    break
                file, offset, length = unit.extent
                announced += length
                last = extents[-1] if extents else None
                if last and last.file is file and 0 <= offset - last.offset - last.length <= _GAP_BYTES:
                    extents[-1] = Extent(file, last.offset, offset + length - last.offset)
                else:
                    extents.append(unit.extent)
            for file, offset, length in extents:
                file.expect(offset, length)
        if not coming:
            return
        due = coming.popleft()
        announced -= due.extent.length if due.extent else 0
        yield due
        # The unit may hold rows of a database, which must not stay in memory while the next one is made.
        unit = None
        del due


class _OpenUnit:
    """A loaded unit on the heap, keyed by its next item's log time, then by its place."""

    __slots__ = ("items", "key", "position", "size", "unit", "whole")

    def __init__(self, unit: Unit, found: Loaded[Any], max_open_bytes: int) -> None:
        self.unit = unit
        self.size = unit.size
        if isinstance(found, LazyItems):
            self.size = found.size
        elif not isinstance(found, StoredChunk):
            if unit.size > max_open_bytes:
                # A damaged chunk may declare any size: its actual size counts, so that others are not dropped for it.
                # So does what is left of a chunk that is not held.
                self.size = min(unit.size, sum(item.size for item in found))
            self.size += ITEM_BYTES * len(found)
        self.position = 0
        #: None if they were dropped, and for a whole chunk.
        self.items: list[Any] | LazyItems[Any] | None = None
        self.whole: StoredChunk | None = None
        if isinstance(found, StoredChunk):
            self.whole = found
            self.key = unit.due
        else:
            self.items = found
            self.key = (found[0].log_time_ns, unit.place)

    def __lt__(self, other: _OpenUnit) -> bool:
        return self.key < other.key


def _evict(heap: list[_OpenUnit], max_open_bytes: int) -> None:
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


class FirstTimes:
    """The earliest log times of the messages so far: a chunk may have later messages before earlier ones.

    Parameters
    ----------
    most
        How many messages are wanted.
    """

    __slots__ = ("_most", "_times")

    def __init__(self, most: int) -> None:
        self._most = most
        self._times: list[int] = []

    def may_have(self, log_time_ns: int) -> bool:
        """Add a message; return whether it may be among the first ones. False is certain. On any thread.

        Equal log times count once, because a chunk may be loaded again. If two threads add messages at once, one is not
        added, and more messages may be among the first.
        """
        times = self._times
        number = bisect_left(times, log_time_ns)
        if number == self._most:
            return False
        if number == len(times) or times[number] != log_time_ns:
            self._times = [*times[:number], log_time_ns, *times[number:]][: self._most]
        return True
