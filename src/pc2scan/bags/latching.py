"""Messages that stay valid until the next one: those of latched topics, and static transforms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Collection, Hashable, Iterator

    from pc2scan.model import Connection

Item = TypeVar("Item")


def is_static(topic: str) -> bool:
    """Whether transforms on this topic are valid at any time."""
    return topic.rsplit("/", 1)[-1] == "tf_static"


def is_latched(connection: Connection) -> bool:
    """Whether messages of a connection stay valid until the next one, or for ever."""
    return connection.latching or is_static(connection.topic)


class NewestItems(Generic[Item]):
    """Items with names, of which those are kept that are the newest one of any name, in the order of adding.

    Parameters
    ----------
    most
        How many are kept at most, the last ones; None: all.
    """

    def __init__(self, most: int | None = None) -> None:
        self._most = most
        self._number = 0
        self._items: dict[int, tuple[Item, set[Hashable]]] = {}
        self._numbers: dict[Hashable, int] = {}

    def add(self, names: Collection[Hashable], item: Item) -> None:
        """Add an item; without names, it is not kept."""
        for name in names:
            self._release(name)
        if names:
            self._number += 1
            self._items[self._number] = item, set(names)
            self._numbers.update(dict.fromkeys(names, self._number))
        if self._most is not None and len(self._items) > self._most:
            _, oldest = next(iter(self._items.values()))
            for name in [*oldest]:
                self._release(name)

    def __iter__(self) -> Iterator[Item]:
        return (item for item, _ in self._items.values())

    def _release(self, name: Hashable) -> None:
        """Drop a name, and the item that it was the last name of."""
        number = self._numbers.pop(name, None)
        if number is not None:
            names = self._items[number][1]
            names.discard(name)
            if not names:
                del self._items[number]
