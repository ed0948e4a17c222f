"""Observers: each takes something from messages of some connections, and all of them share one reading of a recording.

A message that several observers want is read once, and a chunk is decompressed once. What an observer takes is taken
while the message is in memory; nothing else of it is kept.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from pc2scan.errors import MessageError
from pc2scan.model import RawMessage, copied_message

from .reader import Wanted, merge_by_time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from pc2scan.model import Connection
    from pc2scan.progress import Meter

    from .reader import Chunk, Loaded, Reader

_Value = TypeVar("_Value")


class Spread(NamedTuple):
    """Equal parts of an interval; the first message of each part is wanted.

    Attributes
    ----------
    start_ns, stop_ns
        The time: ``start_ns <= log_time_ns < stop_ns``.
    parts
        How many parts it has.
    """

    start_ns: int
    stop_ns: int
    parts: int

    @classmethod
    def of(cls, connections: Iterable[Connection], start_ns: int, stop_ns: int, samples: int) -> Spread | None:
        """Return the parts for so many samples of connections; None if all their messages are wanted."""
        counts = [connection.message_count for connection in connections]
        if None not in counts and samples >= sum(count or 0 for count in counts):
            return None
        return cls(start_ns, stop_ns, max(1, min(samples, stop_ns - start_ns)))

    def part_of(self, time_ns: int) -> int:
        """Return the part that a time is in."""
        return (time_ns - self.start_ns) * self.parts // (self.stop_ns - self.start_ns)

    def begin_ns(self, part: int) -> int:
        """Return the first time of a part."""
        return self.start_ns - (self.start_ns - self.stop_ns) * part // self.parts


def first_messages(
    reader: Reader, connections: Sequence[Connection], start_ns: int, stop_ns: int, samples: int
) -> Iterator[RawMessage]:
    """Yield so many messages of connections, spread over ``start_ns <= log_time_ns < stop_ns``; all if few."""
    spread = Spread.of(connections, start_ns, stop_ns, samples)
    if spread is None:
        yield from reader.messages(connections, start_ns, stop_ns)
        return
    for part in range(spread.parts):
        yield from islice(reader.messages(connections, spread.begin_ns(part), spread.begin_ns(part + 1)), 1)


@dataclass(slots=True, eq=False)
class Observer(Generic[_Value]):
    """Takes a value from each of the first messages of some connections.

    Attributes
    ----------
    connections
        Those whose messages are wanted.
    take
        Returns what is kept of a message, and no view of its data, which would keep a whole chunk in memory. It may be
        called again for a message, and for some that are not among the first. If it raises a `MessageError`, nothing
        is kept; the message counts.
    decode
        Returns what ``take`` gets before the message; a message is decoded once for all observers that do it in the
        same way. None: it gets the message alone.
    most
        How many messages are wanted; None: all.
    start_ns, stop_ns
        Only messages with ``start_ns <= log_time_ns < stop_ns``; None: no limit.
    spread
        Only the first message of each of these parts is wanted; None: of no parts.
    keep
        Receives the values, in the order of log time; None: they are `values`.
    is_needless
        Whether no more messages are wanted, by what other observers found.
    values
        The values.
    filled
        The parts of which the first message was found.
    has_ended
        Whether the recording was read.
    """

    connections: Sequence[Connection]
    take: Callable[..., _Value]
    most: int | None = None
    start_ns: int | None = None
    stop_ns: int | None = None
    decode: Callable[[RawMessage], Any] | None = None
    spread: Spread | None = None
    keep: Callable[[_Value], object] | None = None
    is_needless: Callable[[], bool] | None = None
    values: list[_Value] = field(default_factory=list)
    filled: set[int] = field(default_factory=set)
    has_ended: bool = False
    _count: int = 0
    _earliest: dict[int, int] = field(default_factory=dict)

    @property
    def is_done(self) -> bool:
        """Whether no more messages are wanted."""
        return (
            self.has_ended
            or (self.most is not None and self._count >= self.most)
            or (self.spread is not None and len(self.filled) == self.spread.parts)
            or (self.is_needless is not None and self.is_needless())
        )

    @property
    def takes_all_messages(self) -> bool:
        """Whether it takes all messages as they are."""
        limits = (self.most, self.start_ns, self.stop_ns, self.spread, self.is_needless)
        return self.take is copied_message and limits == (None,) * 5

    def wants(self, chunk: Chunk) -> bool:
        """Return whether messages of a chunk are wanted, by their times."""
        if self.is_done or (self.stop_ns is not None and chunk.start_ns >= self.stop_ns):
            return False
        if chunk.end_ns is None:
            return True
        if self.start_ns is not None and chunk.end_ns < self.start_ns:
            return False
        if self.spread is None:
            return True
        first = self.spread.part_of(max(chunk.start_ns, self.spread.start_ns))
        last = self.spread.part_of(min(chunk.end_ns, self.spread.stop_ns - 1))
        return last - first >= len(self.filled) or any(part not in self.filled for part in range(first, last + 1))

    def value_of(
        self, message: RawMessage, decoded: dict[Callable[[RawMessage], Any], Any]
    ) -> tuple[Observer[Any], _Value | None] | None:
        """Return what is kept of a message; None if it is not wanted. ``decoded`` has what it was decoded to so far."""
        time_ns = message.log_time_ns
        if (self.start_ns is not None and time_ns < self.start_ns) or (
            self.stop_ns is not None and time_ns >= self.stop_ns
        ):
            return None
        if self.spread is not None:
            part = self.spread.part_of(time_ns)
            if part in self.filled or time_ns > self._earliest.setdefault(part, time_ns):
                return None
            self._earliest[part] = time_ns
        if self.most is not None and self.is_done:
            return None
        try:
            if self.decode is None:
                return self, self.take(message)
            if self.decode not in decoded:
                decoded[self.decode] = self.decode(message)
            return self, self.take(decoded[self.decode], message)
        except MessageError:
            return self, None

    def add(self, value: _Value | None, log_time_ns: int) -> bool:
        """Count the next message, and keep its value; return whether no more messages are wanted."""
        if self.spread is not None:
            part = self.spread.part_of(log_time_ns)
            if part in self.filled:
                return False
            self.filled.add(part)
        if self.most is not None:
            if self.is_done:
                return False
            self._count += 1
        if value is not None:
            if self.keep is None:
                self.values.append(value)
            else:
                self.keep(value)
        return (self.most is not None or self.spread is not None) and self.is_done


class _Seen(NamedTuple):
    """What observers take of a message; an item of `merge_by_time`."""

    log_time_ns: int
    size: int
    values: Sequence[tuple[Observer[Any], Any]]


def _bytes_for(reader: Reader, observers: Iterable[Observer[Any]]) -> int:
    """Return how many bytes are read for those observers that want all messages; the others want few."""
    lasting = [
        observer
        for observer in observers
        if observer.most is None and observer.spread is None and observer.is_needless is None
    ]
    connections = {connection.id: connection for observer in lasting for connection in observer.connections}
    return reader.stored_bytes(list(connections.values())) if connections else 0


def observe(*sources: tuple[Reader, Sequence[Observer[Any]]], meter: Meter | None = None) -> None:
    """Show the messages of recordings to observers.

    A recording with chunks is read once for all of them. Of one with rows, which are read topic by topic without
    reading others, only those observers share a reading that want the same connections.

    Parameters
    ----------
    sources
        Each recording, and what takes its messages.
    meter
        Counts the bytes; None: nothing is reported.

    Raises
    ------
    RecordingError
        If a file cannot be read.
    DamageError
        If a file is damaged, and damage is an error.
    """
    if meter is not None:
        meter.expect(sum(_bytes_for(*source) for source in sources) + meter.following)
    for reader, observers in sources:
        groups: dict[object, list[Observer[Any]]] = {}
        for observer in observers:
            ids = frozenset(connection.id for connection in observer.connections)
            limits = ids, observer.start_ns, observer.stop_ns, observer.spread
            groups.setdefault(reader.has_chunks or limits, []).append(observer)
        for group in groups.values():
            if not all(observer.is_done for observer in group):
                _observe_together(reader, group, meter)
            for observer in group:
                observer.has_ended = True


def _observe_together(reader: Reader, observers: Sequence[Observer[Any]], meter: Meter | None) -> None:
    """Read a recording once."""
    connections = {connection.id: connection for observer in observers for connection in observer.connections}
    by_connection: dict[int, list[Observer[Any]]] = {}
    lone: dict[int, Callable[[RawMessage], object]] = {}

    def sort_out() -> None:
        """Find the observers that still want messages of each connection; a lone one gets all of them at once."""
        by_connection.update({key: [] for key in connections})
        for observer in observers:
            if not observer.is_done:
                for key in {connection.id for connection in observer.connections}:
                    by_connection[key].append(observer)
        for key, (first, *further) in ((key, own) for key, own in by_connection.items() if own):
            if not further and first.takes_all_messages:
                lone[key] = first.keep or first.values.append

    def take(message: RawMessage) -> _Seen | RawMessage:
        key = message.connection.id
        # There may be a million transforms.
        if key in lone:
            return copied_message(message)
        decoded: dict[Callable[[RawMessage], Any], Any] = {}
        values = [value for observer in by_connection[key] if (value := observer.value_of(message, decoded))]
        return _Seen(message.log_time_ns, len(message.data), values)

    def is_wanted(chunk: Chunk) -> bool:
        """Whether an observer wants messages of a chunk by now."""
        ids = connections.keys() if chunk.connection_ids is None else connections.keys() & chunk.connection_ids
        return any(observer.wants(chunk) for key in ids for observer in by_connection[key])

    def load(chunk: Chunk, callback: Callable[[RawMessage], Any]) -> Loaded:
        """Load a chunk whose messages are due, if any observer wants them by then."""
        if not is_wanted(chunk):
            return []
        if meter is not None:
            meter.add(chunk.stored)
        return chunk.load(callback)

    sort_out()
    starts, stops = zip(*((observer.start_ns, observer.stop_ns) for observer in observers), strict=True)
    spread = next((observer for observer in observers if observer.spread is not None), None)
    if spread is not None and not reader.has_chunks:
        chunks: Iterable[Chunk] = _chunks_of_parts(reader, spread)
    else:
        start_ns, stop_ns = None if None in starts else min(starts), None if None in stops else max(stops)
        chunks = reader.chunks(Wanted(list(connections.values()), start_ns, stop_ns))
    # Twice: when chunks are announced to the system, and when they are due.
    chosen = (chunk._replace(load=partial(load, chunk)) for chunk in chunks if is_wanted(chunk))
    with closing(merge_by_time(chosen, take, holds_chunks=False, path=reader.path)) as messages:
        for seen in messages:
            if isinstance(seen, RawMessage):
                lone[seen.connection.id](seen)
                continue
            assert isinstance(seen, _Seen)
            has_enough = True in [observer.add(value, seen.log_time_ns) for observer, value in seen.values]
            # What was handed out is not kept while the next chunk is loaded.
            del seen
            if has_enough:
                sort_out()
                if not any(by_connection.values()):
                    return


def _chunks_of_parts(reader: Reader, observer: Observer[Any]) -> Iterator[Chunk]:
    """Yield, for each part of a recording that has rows, its chunks up to its first message."""
    spread = observer.spread
    assert spread is not None
    for part in range(spread.parts):
        wanted = Wanted(observer.connections, spread.begin_ns(part), spread.begin_ns(part + 1))
        for chunk in reader.chunks(wanted):
            if part in observer.filled or observer.is_done:
                break
            yield chunk
