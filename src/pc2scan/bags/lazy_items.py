"""The messages of a chunk with very many, each created when it is needed.

A message without data takes 31 bytes in a chunk, next to none where it is compressed, and ten times as much as an
object. So only the log times and the places of very many are kept.
"""

from __future__ import annotations

from array import array
from itertools import compress, islice
from operator import le
from typing import TYPE_CHECKING, Generic, TypeVar, overload

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_Item = TypeVar("_Item")
_Other = TypeVar("_Other")

#: Up to this number, the messages of a chunk are all created at once. Usual chunks have fewer.
MAX_LISTED_ITEMS = 1 << 15

#: Bytes that an item takes besides its data.
ITEM_BYTES = 400


class LazyItems(Generic[_Item]):
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

    def __init__(self, times: array[int], places: array[int], make: Callable[[int], _Item], kept_bytes: int) -> None:
        self._kept_bytes = kept_bytes
        self._times = times
        self._places = places
        self._make = make
        self._last: tuple[int, _Item] | None = None

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, number: int) -> _Item:
        if self._last is None or self._last[0] != number:
            # Not two at the same time.
            self._last = None
            self._last = (number, self._make(self._places[number]))
        return self._last[1]

    def __iter__(self) -> Iterator[_Item]:
        return map(self._make, self._places)

    @property
    def times(self) -> array[int]:
        """Log times, ns."""
        return self._times

    @property
    def size(self) -> int:
        """Bytes of memory that it takes."""
        return self._kept_bytes + sum(len(values) * values.itemsize for values in (self._times, self._places))

    def map(self, callback: Callable[[_Item], _Other], times: array[int] | None = None) -> LazyItems[_Other]:
        """Return the callback's results for the items, with their log times or the given ones."""
        make = self._make
        times = self._times if times is None else times
        return LazyItems(times, self._places, lambda place: callback(make(place)), self._kept_bytes)

    def filter(self, test: Callable[[_Item], bool]) -> LazyItems[_Item]:
        """Return the items for which ``test`` is true."""
        chosen = bytearray(map(test, self))
        times, places = (array("Q", compress(values, chosen)) for values in (self._times, self._places))
        return LazyItems(times, places, self._make, self._kept_bytes)

    def as_list(self) -> list[_Item] | LazyItems[_Item]:
        """Return a list of all items if they are few enough; else itself."""
        return self if len(self) > MAX_LISTED_ITEMS else list(self)

    def sort_by_time(self) -> LazyItems[_Item]:
        """Return the items sorted by log time; items with equal times keep their order."""
        times = self._times
        if all(map(le, times, islice(times, 1, None))):
            return self
        order = array("Q", sorted(range(len(times)), key=times.__getitem__))
        times, places = (array("Q", map(values.__getitem__, order)) for values in (times, self._places))
        return LazyItems(times, places, self._make, self._kept_bytes)


@overload
def map_items(callback: Callable[[_Item], _Other], items: list[_Item]) -> list[_Other]: ...
@overload
def map_items(
    callback: Callable[[_Item], _Other], items: list[_Item] | LazyItems[_Item]
) -> list[_Other] | LazyItems[_Other]: ...
def map_items(
    callback: Callable[[_Item], _Other], items: list[_Item] | LazyItems[_Item]
) -> list[_Other] | LazyItems[_Other]:
    """Return the callback's results for items."""
    return items.map(callback) if isinstance(items, LazyItems) else list(map(callback, items))


def filter_items(
    test: Callable[[_Item], bool], items: list[_Item] | LazyItems[_Item]
) -> list[_Item] | LazyItems[_Item]:
    """Return the items for which ``test`` is true."""
    return items.filter(test) if isinstance(items, LazyItems) else list(filter(test, items))
