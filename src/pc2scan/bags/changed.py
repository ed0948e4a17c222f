"""A recording, some of whose messages are changed as they are read: whoever reads it gets the changed messages."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from .reader import Reader

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
    from typing import TypeAlias

    from pc2scan.model import Attachment, ChunkRule, Connection, Metadata, RawMessage

    from .damage import Damage
    from .units import Load, Loaded, Unit

    #: Returns a message instead of another one of the same connection and log time. Called on any thread, and again.
    Change: TypeAlias = Callable[[RawMessage], RawMessage]


class ChangedReader(Reader):
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
        self._reader = reader
        self._changes = changes
        self.remarks = remarks
        self.path, self.connections, self.summary = reader.path, reader.connections, reader.summary
        self.has_chunks = reader.has_chunks

    @property
    def bytes_read(self) -> int:
        """Bytes read so far."""
        return self._reader.bytes_read

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage of the recording."""
        return self._reader.damage

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
        for unit in self._reader.units(connections, start_ns, stop_ns, rule):
            yield unit._replace(load=partial(self._load, unit.load))

    def _load(self, load: Load, callback: Callable[[RawMessage], Any], *, whole: bool) -> Loaded[Any]:
        changes = self._changes

        def changed(message: RawMessage) -> Any:
            change = changes.get(message.connection.id)
            return callback(message if change is None else change(message))

        return load(changed, whole=whole)

    def work(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> int:
        """Return how much work it is to read these messages."""
        return self._reader.work(connections, start_ns, stop_ns)

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count messages without reading them, as far as the index allows."""
        return self._reader.counts(connections, start_ns, stop_ns)

    def close(self) -> None:
        """Release the files."""
        self._reader.close()

    def attachments(self) -> Iterator[Attachment]:
        """Yield MCAP attachments."""
        return self._reader.attachments()

    def metadata(self) -> Iterator[Metadata]:
        """Yield MCAP metadata records."""
        return self._reader.metadata()
