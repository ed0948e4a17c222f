"""A recording, some of whose messages are changed as they are read: whoever reads it gets the changed messages."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from .reader import WrappedReader

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
    from typing import TypeAlias

    from pc2scan.model import ChunkRule, Connection, RawMessage

    from .reader import Reader
    from .units import Load, Loaded, Unit

    #: Returns a message instead of another one of the same connection and log time. Called on any thread, and again.
    Change: TypeAlias = Callable[[RawMessage], RawMessage]


class ChangedReader(WrappedReader):
    """Reads an open recording, and changes the messages of some connections.

    Parameters
    ----------
    reader
        The recording; `close` closes it.
    changes
        What returns the changed message, by the id of the connection. Chunks with such messages are never copied.
    remarks
        What changes notice about the messages that were read.
    """

    def __init__(self, reader: Reader, changes: Mapping[int, Change], remarks: Sequence[str] = ()) -> None:
        super().__init__(reader)
        self._changes = changes
        self._remarks = remarks

    @property
    def remarks(self) -> Sequence[str]:
        """What the other reader and the changes noticed."""
        return [*super().remarks, *self._remarks]

    def units(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> Iterable[Unit]:
        """Return the units of the recording, with changed messages."""
        if rule is not None:
            rule = rule._replace(connection_ids=rule.connection_ids - self._changes.keys())
        for unit in super().units(connections, start_ns, stop_ns, rule):
            yield unit._replace(load=partial(self._load, unit.load))

    def _load(self, load: Load, callback: Callable[[RawMessage], Any], *, whole: bool) -> Loaded[Any]:
        changes = self._changes

        def changed(message: RawMessage) -> Any:
            change = changes.get(message.connection.id)
            return callback(message if change is None else change(message))

        return load(changed, whole=whole)
