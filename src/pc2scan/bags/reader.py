"""The base class of readers; loading the chunks of a recording, and merging their messages by log time.

A chunk is a part of a recording that can be loaded by itself: a chunk of a file, consecutive records outside chunks, or
some rows of a database. A reader lists them. Each is loaded, on any thread, when its first message is due or some way
ahead, and its messages are merged with those of others, because chunks overlap in time if the recorder had several
buffers. Sorting a whole index would need memory that grows with the recording.
"""

from __future__ import annotations

import heapq
from abc import ABC, abstractmethod
from collections import deque
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import islice
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast

from pc2scan.errors import RecordingError
from pc2scan.files.compression import allowed_bytes
from pc2scan.model import RawMessage, StoredChunk
from pc2scan.threads import InOrder

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence, Sized
    from pathlib import Path
    from tempfile import TemporaryDirectory

    from pc2scan.files.source_file import SourceFile
    from pc2scan.model import Attachment, ChunkRule, Connection, Metadata, Summary
    from pc2scan.progress import Meter
    from pc2scan.threads import Threads

    from .damage import Damage, DamageLog

#: Limit of loaded chunks; beyond it, those needed last are dropped and later loaded again.
MAX_OPEN_BYTES = 96 << 20

#: Bytes that are loaded ahead for every thread. Of chunks up to the second size, always one for each thread; larger
#: ones are loaded one by one.
AHEAD_BYTES = 6 << 20
LARGEST_AHEAD = 20 << 20

#: The start of a chunk with an unknown first log time: it is due at once.
UNKNOWN_START_NS = -1 << 63

_LOG_TIME = attrgetter("log_time_ns")

#: Later than everything.
_NEVER = (1 << 64, ())

#: Limit for loading chunks again, as a multiple of the size of all chunks; a gigabyte is always allowed.
_MAX_AGAIN = 4

#: Maximum number of messages in a recording, whatever its size; one more is allowed for each stored byte.
_MAX_FREE_MESSAGES = 1_000_000

#: Chunks that are announced to the system before they are read: it reads them while others are decompressed.
_ANNOUNCED_CHUNKS = 16

#: Smaller chunks are not announced: the system reads some way ahead itself.
_ANNOUNCED_FROM = 64 << 10

#: Maximum number of messages in a chunk. Usual chunks have some thousands; as objects, these take 200 MB.
MAX_CHUNK_MESSAGES = 1 << 19

#: Bytes that an item takes besides its data.
ITEM_BYTES = 400


def check_number(messages: Sized) -> None:
    """Raise if a chunk has more messages than `MAX_CHUNK_MESSAGES`."""
    if len(messages) > MAX_CHUNK_MESSAGES:
        raise RecordingError(f"a chunk has more than {MAX_CHUNK_MESSAGES:,} messages")


#: What a chunk is loaded as: items in the order of the file, or the chunk as a whole.
Loaded: TypeAlias = list[Any] | StoredChunk


class Chunk(NamedTuple):
    """A part of a recording that can be loaded by itself.

    Attributes
    ----------
    start_ns
        Log time of its first message, or earlier. Of a chunk that may be copied as a whole: when it is due.
    place
        Order among chunks: messages of one log time are in this order.
    size
        Bytes of memory when it is loaded.
    load
        Returns the callback's result for each message, in the order of the file, or a chunk that is copied as a whole.
        May be called on any thread, and again. The callback is called with each wanted message on the thread that read
        it, while it is still in that core's cache. A message that is kept goes through
        `pc2scan.model.copied_message`, or it may keep a whole chunk in memory.
    is_quick
        Whether loading it takes less time than handing it to another thread.
    file, offset, length
        Its place; no file if it is not in one piece.
    end_ns
        Log time of its last message, or later; None if that is unknown.
    connection_ids
        The connections with messages in it; None if they are unknown, or those that were asked for.
    """

    start_ns: int
    place: tuple[int, ...]
    size: int
    load: Callable[[Callable[[RawMessage], Any]], Loaded]
    is_quick: bool = False
    file: SourceFile | None = None
    offset: int = 0
    length: int = 0
    end_ns: int | None = None
    connection_ids: frozenset[int] | None = None

    @property
    def stored(self) -> int:
        """Its bytes in the file, or those of its messages if it is not in one piece."""
        return self.size if self.file is None else self.length

    def changed(self, change: Callable[[RawMessage], RawMessage]) -> Chunk:
        """Return the chunk with other messages: ``change`` is called with each."""
        load = self.load
        return self._replace(load=lambda callback: load(lambda message: callback(change(message))))

    @property
    def due(self) -> tuple[int, tuple[int, ...]]:
        """When it is loaded: at its start; chunks that start together, in the order of their places."""
        return self.start_ns, self.place


class _OpenChunk:
    """The items of a chunk on the heap, by the next one's log time and the chunk's place; None if they were dropped."""

    __slots__ = ("chunk", "items", "key", "position", "size")

    def __init__(self, chunk: Chunk, items: list[Any], max_open_bytes: int) -> None:
        self.chunk = chunk
        self.items: list[Any] | None = items
        self.position = 0
        self.key = (items[0].log_time_ns, chunk.place)
        self.size = chunk.size
        if chunk.size > max_open_bytes:
            # A damaged chunk may declare any size: its actual size counts, so that others are not dropped for it.
            # So does what is left of a chunk that is not held.
            self.size = min(chunk.size, sum(item.size for item in items))
        self.size += ITEM_BYTES * len(items)

    def __lt__(self, other: _OpenChunk) -> bool:
        return self.key < other.key


def merge_by_time(
    chunks: Iterable[Chunk],
    callback: Callable[[RawMessage], Any] = lambda message: message,
    threads: Threads | None = None,
    *,
    window: int | None = None,
    max_open_bytes: int = MAX_OPEN_BYTES,
    holds_chunks: bool = True,
    path: Path | None = None,
    meter: Meter | None = None,
) -> Generator[Any]:
    """Load chunks, and merge the messages of those that overlap in time.

    Parameters
    ----------
    chunks
        In the order in which they are due. They may come from a generator.
    callback
        Makes the items of messages; see `Chunk.load`. Called once a message, except that a chunk is loaded again if
        more than ``max_open_bytes`` of chunks overlap at one time.
    threads
        All threads, or None for the caller's alone. The items do not depend on it.
    window
        How many chunks may be loaded ahead; None: as many as memory allows.
    max_open_bytes
        Bound on the chunks held at one time (one is always held).
    holds_chunks
        Whether items may keep the memory of their chunk. Otherwise it counts as much as its items.
    path
        The recording, for the error.
    meter
        Gets the bytes of each chunk that is loaded.

    Yields
    ------
    object
        What the callback returned, with ``log_time_ns`` and ``size``, or a `StoredChunk` when it is due. By log time;
        equal log times in the order of places. An exception of the callback is raised in the place of its item.

    Raises
    ------
    RecordingError
        If chunks that overlap would have to be loaded again and again.
    """
    with closing(_load_ahead(_announce(chunks), callback, threads, window)) as loading:
        heap: list[_OpenChunk] = []
        coming = next(loading, None)
        total = again = 0
        most = _MAX_FREE_MESSAGES
        while heap or coming is not None:
            while coming is not None and (not heap or coming[0].due < heap[0].key):
                chunk, result = coming
                total += chunk.size
                # Makes room before loading.
                _evict(heap, max_open_bytes - chunk.size)
                loaded = result()
                if isinstance(loaded, StoredChunk):
                    yield loaded
                elif loaded:
                    most += chunk.length - len(loaded) if chunk.file else 0
                    if most < 0:
                        raise RecordingError("has more messages than bytes, which no recording does", path=path)
                    # A stable sort, which takes almost no time if the messages are in order.
                    loaded.sort(key=_LOG_TIME)
                    heapq.heappush(heap, _OpenChunk(chunk, loaded, max_open_bytes if holds_chunks else 0))
                    _evict(heap, max_open_bytes)
                if meter is not None:
                    meter.add(chunk.stored)
                del loaded, chunk, result, coming
                coming = next(loading, None)
            if not heap:
                continue
            current = heapq.heappop(heap)
            if current.items is None:
                again += current.chunk.size
                if again > _MAX_AGAIN * total + (1 << 30):
                    raise RecordingError(
                        f"its chunks overlap in time so much that each would have to be read {_MAX_AGAIN} times",
                        path=path,
                    )
                _evict(heap, max_open_bytes - current.chunk.size)
                current.items = sorted(cast("list[Any]", current.chunk.load(callback)), key=_LOG_TIME)
            # All items up to the next chunk's turn are from this one, without a heap operation for each.
            limit = min(heap[0].key if heap else _NEVER, coming[0].due if coming else _NEVER)
            items, position, place = current.items, current.position, current.chunk.place
            if (items[-1].log_time_ns, place) < limit:
                yield from islice(items, position, None)
                position = len(items)
            while position < len(items) and (items[position].log_time_ns, place) < limit:
                yield items[position]
                position += 1
            if position < len(items):
                current.position = position
                current.key = (items[position].log_time_ns, place)
                heapq.heappush(heap, current)
                _evict(heap, max_open_bytes)
            # The generator's frame must not keep a used chunk in memory while the next one is loaded.
            del items, current


def _evict(heap: list[_OpenChunk], max_open_bytes: int) -> None:
    """Drop the items of the chunks that are needed last, until the rest fits."""
    if len(heap) <= 1:
        return
    held = sorted((entry for entry in heap if entry.items is not None), reverse=True)
    total = sum(entry.size for entry in held)
    for entry in held[:-1]:
        if total <= max_open_bytes:
            return
        entry.items = None
        total -= entry.size


def _load_ahead(
    chunks: Iterable[Chunk], callback: Callable[[RawMessage], Any], threads: Threads | None, window: int | None
) -> Generator[tuple[Chunk, Callable[[], Loaded]]]:
    """Yield each chunk, and a function that returns what it is loaded as, by now or ahead on another thread."""
    if threads is None:
        for chunk in chunks:
            yield chunk, partial(chunk.load, callback)
        return
    waiting: deque[Chunk] = deque()
    results: InOrder[Loaded] = InOrder(threads, AHEAD_BYTES, threads.jobs, window)
    try:
        for chunk in chunks:
            too_large = chunk.size > LARGEST_AHEAD
            while waiting and (too_large or not results.has_room(chunk.size)):
                yield waiting.popleft(), results.take
            if too_large:
                yield chunk, partial(chunk.load, callback)
            else:
                results.put(partial(chunk.load, callback), chunk.size, at_its_turn=chunk.is_quick)
                waiting.append(chunk)
        while waiting:
            yield waiting.popleft(), results.take
    finally:
        results.cancel()


def _announce(chunks: Iterable[Chunk]) -> Iterator[Chunk]:
    """Yield the chunks, and announce the places of large ones to the system some way ahead of their turn."""
    coming: deque[Chunk] = deque()
    for chunk in chunks:
        coming.append(chunk)
        if chunk.file is not None and chunk.length >= _ANNOUNCED_FROM:
            chunk.file.expect(chunk.offset, chunk.length)
        # Rows of a database are in memory already.
        while coming and (chunk.file is None or len(coming) > _ANNOUNCED_CHUNKS):
            yield coming.popleft()
    yield from coming


# --- Readers ---

#: Connections of a recording: nearly as many as MCAP has numbers for. One takes up to 3 kB of memory in a conversion.
MAX_CONNECTIONS = 65_000


class Wanted(NamedTuple):
    """What is wanted of a recording.

    Attributes
    ----------
    connections
        Only messages of these; None means all. Parts of the file without any are not listed.
    start_ns, stop_ns
        Only messages with ``start_ns <= log_time_ns < stop_ns``.
    rule
        Which chunks may be loaded as a whole; None means none.
    """

    connections: Collection[Connection] | None = None
    start_ns: int | None = None
    stop_ns: int | None = None
    rule: ChunkRule | None = None


class Reader(ABC):
    """Reads an open recording, chunk by chunk.

    Attributes
    ----------
    path
        The recording.
    connections
        All connections, in the container's order.
    summary
        The summary, made without reading messages.
    has_chunks
        Whether messages of several topics are stored together, so that reading one topic reads others, too.
    has_extras
        Whether it may have attachments and metadata records.
    """

    path: Path
    connections: Sequence[Connection]
    summary: Summary
    has_chunks: bool = False
    has_extras: bool = False
    _log: DamageLog
    _temporary: TemporaryDirectory[str] | None = None

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage in the parts that were read."""
        return self._log.places

    @property
    def remarks(self) -> Sequence[str]:
        """What was noticed about the recording and the messages that were read, for users."""
        return ()

    @abstractmethod
    def chunks(self, wanted: Wanted) -> Iterable[Chunk]:
        """Return the chunks of the recording that have what is wanted, by start."""

    @abstractmethod
    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count messages without reading them, as far as the index allows.

        Parameters
        ----------
        connections
            Only messages of these.
        start_ns, stop_ns
            Only messages with ``start_ns <= log_time_ns < stop_ns``.

        Returns
        -------
        dict[int, int]
            By connection id. A missing connection can only be counted by reading its messages.
        """

    def stored_bytes(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> int:
        """Return about how many bytes of the file are read for these messages, for progress; see `chunks`."""
        if self.has_chunks:
            return sum(chunk.stored for chunk in self.chunks(Wanted(connections, start_ns, stop_ns)))
        # To list the rows of a database is to read them.
        messages = sum(self.counts(connections, start_ns, stop_ns).values())
        return self.summary.size_bytes * messages // max(1, self.summary.message_count or 0)

    def close(self) -> None:
        """Release the files. Messages that were handed out stay valid."""
        if self._temporary is not None:
            self._temporary.cleanup()

    def stand_for(self, path: Path, copy: TemporaryDirectory[str], damage: DamageLog) -> None:
        """Read a file that is compressed as a whole, from its copy in a folder that `close` removes.

        ``damage`` has what of it could not be decompressed.
        """
        self.path, self._temporary = path, copy
        self._log.stand_for(path, damage)
        self.summary = self.summary._replace(
            compression=tuple(sorted({"zstd", *self.summary.compression} - {"none"})), size_bytes=path.stat().st_size
        )

    def messages(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        threads: Threads | None = None,
        meter: Meter | None = None,
    ) -> Generator[RawMessage]:
        """Yield messages in the order of log time; those of one log time in the order of the file.

        Parameters
        ----------
        connections
            Only messages of these; None means all.
        start_ns, stop_ns
            Only messages with ``start_ns <= log_time_ns < stop_ns``.
        threads, meter
            See `merge_by_time`.

        Yields
        ------
        RawMessage
            ``data`` may be a view into a decompressed chunk, which it keeps in memory.

        Raises
        ------
        RecordingError
            If the file cannot be read.
        DamageError
            If the file is damaged, and damage is an error.
        """
        chunks = self.chunks(Wanted(connections, start_ns, stop_ns))
        return cast("Generator[RawMessage]", merge_by_time(chunks, threads=threads, path=self.path, meter=meter))

    def attachments(self) -> Iterator[Attachment]:
        """Yield MCAP attachments; other containers have none."""
        return iter(())

    def metadata(self) -> Iterator[Metadata]:
        """Yield MCAP metadata records; other containers have none."""
        return iter(())


@dataclass(slots=True, eq=False)
class ConnectionLimit:
    """Counts the connections of a recording and their descriptions as they are found, and refuses too many.

    Everything that collects connections asks it: readers with or without an index, and readers of several files or
    parts.

    Parameters
    ----------
    path
        The recording.
    size
        Its bytes.
    """

    path: Path
    size: int = 0
    _count: int = 0
    _bytes: int = 0

    def add(self, described: int = 0, *, count: int = 1, most: int | None = None) -> None:
        """Count connections that take so many bytes to describe, with their definitions.

        Raises
        ------
        RecordingError
            If there are more than ``most`` (`MAX_CONNECTIONS`), or their descriptions are larger than `allowed_bytes`.
        """
        self._count += count
        self._bytes += described
        most = MAX_CONNECTIONS if most is None else most
        if self._count > most:
            raise RecordingError(
                f"has more than {most:,} connections (one for each publisher of a topic), the largest number that is "
                "read",
                path=self.path,
            )
        if self._bytes > (allowed := allowed_bytes(self.size)):
            raise RecordingError(
                f"describes its connections in more than {allowed:,} bytes, the largest size for a recording of "
                f"{self.size:,} bytes",
                path=self.path,
            )

    def add_file(self, connections: Sequence[Connection], size: int) -> None:
        """Count the connections of a file of ``size`` bytes among those of several.

        Those that files share count in each, because each reader keeps its own; so files of any size may repeat them, a
        kilobyte for each. Definitions that connections share count once.
        """
        self.size += size
        definitions = {id(own.definition.data): own.definition.data for own in connections}
        described = sum(map(len, definitions.values())) + sum(len(own.qos) for own in connections)
        self.add(described, count=len(connections), most=MAX_CONNECTIONS + self.size // 1000)
