"""Writes a recording in several files, by time or by size."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pc2scan.errors import OutputError, UnwritableError, UsageError

from .topics import NewestItems, is_latched, is_static

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence
    from pathlib import Path

    from pc2scan.model import Attachment, Buffer, ChunkRule, Connection, Metadata, StoredChunk, Writer
    from pc2scan.threads import Threads

#: More files than this are a unit that was mistaken.
_MOST_PARTS = 10_000

#: Bytes that a message takes besides its data: its record, and its entry in an index.
_RECORD = 40

#: Maximum number of static transforms of one connection that are repeated. A robot has some dozens.
_MOST_STATIC = 1_000


@dataclass(frozen=True, slots=True)
class Cut:
    """Where a new file begins.

    Attributes
    ----------
    duration_ns
        Each file has the messages of so many nanoseconds of log time, counted from ``begin_ns``; 0: whatever time.
    size
        A file's messages have at most so many bytes before compression; 0: however many.
    repeats
        Whether latched messages and static transforms are repeated at the beginning of each file.
    begin_ns
        Where the first file begins.
    """

    duration_ns: int = 0
    size: int = 0
    repeats: bool = False
    begin_ns: int = 0

    def cell(self, log_time_ns: int) -> int:
        """Number of the stretch of ``duration_ns`` that a log time is in; 0 where time does not cut."""
        return max((log_time_ns - self.begin_ns) // self.duration_ns, 0) if self.duration_ns else 0


@dataclass(slots=True)
class RecordingPart:
    """One of the files.

    Attributes
    ----------
    path
        The file, as it is written.
    counts
        Messages by handle, repeated ones included.
    span_ns
        The first and the last log time; None without messages.
    size
        Bytes of its messages, as `Cut` counts them.
    own
        Messages and chunks, without the repeated ones.
    """

    path: Path
    counts: dict[int, int] = field(default_factory=dict)
    span_ns: tuple[int, int] | None = None
    size: int = 0
    own: int = 0

    def note(self, handle: int, count: int, first_ns: int, last_ns: int) -> None:
        """Count messages that were written."""
        self.counts[handle] = self.counts.get(handle, 0) + count
        earliest_ns, latest_ns = self.span_ns or (first_ns, last_ns)
        self.span_ns = (min(earliest_ns, first_ns), max(latest_ns, last_ns))


def narrow_rule(rule: ChunkRule, cut: Cut, connections: Sequence[Connection]) -> ChunkRule:
    """Return the rule of the chunks that can be copied whole into parts.

    No part ends within one, and none has messages that are to be repeated.

    Parameters
    ----------
    rule
        The rule for one file.
    cut
        Where a new part begins.
    connections
        Those of the source.
    """
    latched = {each.topic for each in connections if cut.repeats and is_latched(each)}
    ids = {each.id for each in connections if each.topic in latched}
    grid = (cut.begin_ns, cut.duration_ns) if cut.duration_ns else None
    return rule._replace(connection_ids=rule.connection_ids - ids, grid=grid)


class SplitWriter:
    """Writes files one after the other, each with all connections and their ids; see `pc2scan.model.Writer`.

    A message or a chunk is never divided. The order of messages and their sizes before compression decide where a file
    ends, so the files do not depend on threads.

    Parameters
    ----------
    path_of
        Returns the path of a part by its number, from 0 on.
    open_part
        Starts a part: returns its writer, and what is called with the part before its writer finishes.
    cut
        Where a new part begins.

    Attributes
    ----------
    parts
        The files so far.
    """

    def __init__(
        self,
        path_of: Callable[[int], Path],
        open_part: Callable[[Path], tuple[Writer, Callable[[RecordingPart], None]]],
        cut: Cut,
    ) -> None:
        self._path_of = path_of
        self._open_part = open_part
        self._cut = cut
        self._cell = 0
        self._reserved: Collection[Connection] = ()
        self._connections: list[Connection] = []
        self._pool: Threads | None = None
        #: By handle: the data to repeat, each with its sequence number.
        self._latched: dict[int, NewestItems[tuple[bytes, int]]] = {}
        self._all_last: set[int] = set()
        self.parts = [RecordingPart(path_of(0))]
        self._writer, self._before_finish = open_part(self.parts[0].path)

    def keep_ids(self, connections: Collection[Connection]) -> None:
        """Reserve ids in every part."""
        self._reserved = connections
        self._writer.keep_ids(connections)

    def add_connection(self, connection: Connection) -> int:
        """Declare a connection, in every part with the same handle."""
        handle = self._writer.add_connection(connection)
        self._connections.append(connection)
        if self._cut.repeats and is_latched(connection):
            self._latched[handle] = NewestItems(_MOST_STATIC)
            if is_static(connection.topic):
                self._all_last.add(handle)
        return handle

    def declarations(self) -> frozenset[bytes]:
        """Return the declarations that a chunk may repeat: every part has the same."""
        return self._writer.declarations()

    def compress_ahead(self, pool: Threads) -> None:
        """Compress on these threads from now on."""
        self._pool = pool
        self._writer.compress_ahead(pool)

    def write(self, handle: int, log_time_ns: int, data: Buffer, publish_time_ns: int, sequence: int = 0) -> None:
        """Append a message, to a new part if it is time."""
        size = len(data) + _RECORD
        self._make_room(log_time_ns, size)
        self._writer.write(handle, log_time_ns, data, publish_time_ns, sequence)
        self._note(log_time_ns, size)
        self.parts[-1].note(handle, 1, log_time_ns, log_time_ns)
        kept = self._latched.get(handle)
        if kept is not None:
            # Of static transforms all that differ.
            kept.add([bytes(data) if handle in self._all_last else None], (bytes(data), sequence))

    def write_chunk(self, chunk: StoredChunk) -> None:
        """Append a whole chunk, to a new part if it is time."""
        first_ns, last_ns = chunk.span_ns()
        self._make_room(first_ns, chunk.size)
        self._writer.write_chunk(chunk)
        self._note(first_ns, chunk.size)
        for handle, entries in chunk.index.items():
            self.parts[-1].note(handle, len(entries), first_ns, last_ns)

    def add_attachment(self, attachment: Attachment) -> None:
        """Append an attachment to the part that is being written: the first one."""
        self._writer.add_attachment(attachment)

    def add_metadata(self, metadata: Metadata) -> None:
        """Append a metadata record to the part that is being written: the first one."""
        self._writer.add_metadata(metadata)

    def finish(self) -> None:
        """Complete the last part."""
        part = self.parts[-1]
        if not part.own and len(self.parts) > 1:
            # The message that it began with could not be written.
            self.parts.pop()
            self._writer.abort()
            try:
                part.path.unlink()
            except OSError as err:
                raise OutputError(f"cannot be removed: {err.strerror}", path=part.path) from err
            return
        self._before_finish(part)
        self._writer.finish()

    def abort(self) -> None:
        """Release the last part; the caller removes all of them."""
        self._writer.abort()

    def _make_room(self, log_time_ns: int, size: int) -> None:
        """Begin a new part if a message of this time and size does not belong to this one."""
        part, cut = self.parts[-1], self._cut
        if part.own and (
            (cut.duration_ns and cut.cell(log_time_ns) > self._cell) or (cut.size and part.size + size > cut.size)
        ):
            self._begin(log_time_ns)

    def _note(self, log_time_ns: int, size: int) -> None:
        """Note the time and size of a written message or chunk."""
        part = self.parts[-1]
        part.own += 1
        part.size += size
        self._cell = max(self._cell, self._cut.cell(log_time_ns))

    def _begin(self, log_time_ns: int) -> None:
        """Complete a part, and begin the next one with the connections and the repeated messages."""
        number = len(self.parts)
        if number >= _MOST_PARTS:
            raise UsageError(
                f"`split` makes more than {_MOST_PARTS:,} files", hint="give a longer time or a larger size"
            )
        self._before_finish(self.parts[-1])
        self._writer.finish()
        part = RecordingPart(self._path_of(number))
        self._writer, self._before_finish = self._open_part(part.path)
        self.parts.append(part)
        if self._reserved:
            self._writer.keep_ids(self._reserved)
        for connection in self._connections:
            self._writer.add_connection(connection)
        if self._pool is not None:
            self._writer.compress_ahead(self._pool)
        for handle, messages in self._latched.items():
            for data, sequence in messages:
                # Like `rosbag record --repeat-latched`: with their own times, a gap would follow them.
                try:
                    self._writer.write(handle, log_time_ns, data, log_time_ns, sequence)
                except UnwritableError:
                    # It was written before: it is the time that the format cannot hold, and the next message says so.
                    return
                part.note(handle, 1, log_time_ns, log_time_ns)
                part.size += len(data) + _RECORD
