"""Reads several sources as one recording: connections are unified, messages merged by log time.

The reader of split rosbag2 recordings (`pc2scan.bags.rosbag2.read`) is a subclass.
"""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import replace
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING

from pc2scan.errors import UsageError
from pc2scan.model import Summary

from .reader import UNKNOWN_START_NS, ConnectionLimit, Reader, Wanted

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.model import Attachment, Connection, Metadata, RawMessage

    from .damage import Damage
    from .reader import Chunk


_identity_of = attrgetter(
    "topic", "msgtype", "serialization", "definition", "digest", "callerid", "latching", "qos"
)  # fmt: skip


class MergedReader(Reader):
    """Reads several open recordings as one.

    Parameters
    ----------
    readers
        At least one; `close` closes them.
    path
        Default: the first source's.

    Raises
    ------
    UsageError
        If a path is given twice, or ROS 1 and ROS 2 recordings are mixed. The readers stay open.
    RecordingError
        If they have too many connections together.

    Notes
    -----
    With a single reader, connections and their ids are unchanged. Otherwise the ids are new and start at 1.
    """

    def __init__(self, readers: Sequence[Reader], path: Path | None = None) -> None:
        _refuse_repeated(readers)
        _refuse_mixed_ros_versions(readers)
        self.path = path or readers[0].path
        self._readers = tuple(readers)
        #: In the order of the sources.
        self.connections: Sequence[Connection] = tuple(readers[0].connections)
        ids = [{connection.id: connection.id for connection in self.connections}]
        self._unchanged = len(readers) == 1
        if not self._unchanged:
            merged, ids = unify_connections([reader.connections for reader in readers])
            ConnectionLimit(self.path).add(count=len(merged))
            self.connections = tuple(merged)
        by_id = {connection.id: connection for connection in self.connections}
        #: For each source: the merged connection of each of its own.
        self._maps = [{own: by_id[number] for own, number in numbers.items()} for numbers in ids]
        self.summary = merge_summaries([reader.summary for reader in readers])
        self.has_chunks = all(reader.has_chunks for reader in readers)
        self.has_extras = any(reader.has_extras for reader in readers)

    def _amend(self, amended: Mapping[int, Connection], added: Iterable[Connection] = ()) -> None:
        """Replace connections by ones with more information and the same ids, and add some without messages."""
        completed = (*(amended.get(connection.id, connection) for connection in self.connections), *added)
        self._unchanged = self._unchanged and completed == self.connections
        self.connections = completed
        self._maps = [
            {own: amended.get(connection.id, connection) for own, connection in known.items()} for known in self._maps
        ]

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage of all sources."""
        return tuple(damage for reader in self._readers for damage in reader.damage)

    @property
    def remarks(self) -> Sequence[str]:
        """The remarks of all sources."""
        return [remark for reader in self._readers for remark in reader.remarks]

    def chunks(self, wanted: Wanted) -> Iterable[Chunk]:
        """Return the chunks of all sources; equal log times are in the order of the sources.

        A source is read when its first message is due, if its summary has that time. Chunks stay whole if no other
        source has messages at their time and their ids are unchanged.
        """
        if self._unchanged:
            return self._readers[0].chunks(wanted)
        connections, start_ns, stop_ns, rule = wanted
        ids = None if connections is None else {connection.id for connection in connections}
        sources = []
        for number, (reader, known) in enumerate(zip(self._readers, self._maps, strict=True)):
            chosen = [own for own in reader.connections if ids is None or known[own.id].id in ids]
            first_ns = reader.summary.start_ns
            first_ns = UNKNOWN_START_NS if first_ns is None else first_ns
            if (ids is not None and not chosen) or (stop_ns is not None and first_ns >= stop_ns):
                continue
            own_rule = None
            if rule is not None and self._stands_alone(reader):
                same = frozenset(own for own, connection in known.items() if own == connection.id)
                own_rule = rule._replace(connection_ids=rule.connection_ids & same)
            source = reader.chunks(Wanted(None if ids is None else chosen, start_ns, stop_ns, own_rule))
            sources.append((first_ns, _merged_chunks(source, number, known)))
        return _in_turn(sources)

    def _stands_alone(self, reader: Reader) -> bool:
        """Whether no other source has messages between the first and the last of this one."""
        start_ns, end_ns = reader.summary.start_ns, reader.summary.end_ns
        if start_ns is None or end_ns is None or end_ns < start_ns:
            return False
        others = [other.summary for other in self._readers if other is not reader and other.summary.message_count != 0]
        return all(
            (other.start_ns is not None and end_ns < other.start_ns)
            or (other.end_ns is not None and other.end_ns < start_ns)
            for other in others
        )

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count the messages of each connection in all sources; see `pc2scan.bags.reader.Reader`."""
        totals = dict.fromkeys((connection.id for connection in connections), 0)
        for reader, known in zip(self._readers, self._maps, strict=True):
            requested = [own for own in reader.connections if known[own.id].id in totals]
            counted = reader.counts(requested, start_ns, stop_ns)
            for own in requested:
                merged_id = known[own.id].id
                if own.id in counted and merged_id in totals:
                    totals[merged_id] += counted[own.id]
                else:
                    totals.pop(merged_id, None)
        return totals

    def attachments(self) -> Iterator[Attachment]:
        """Yield MCAP attachments, source by source."""
        for reader in self._readers:
            yield from reader.attachments()

    def metadata(self) -> Iterator[Metadata]:
        """Yield MCAP metadata records, source by source."""
        for reader in self._readers:
            yield from reader.metadata()

    def close(self) -> None:
        """Close every source."""
        for reader in self._readers:
            reader.close()


class ChangedReader(MergedReader):
    """Reads an open recording, and changes the messages of some connections: whoever reads it gets the changed ones.

    Parameters
    ----------
    reader
        The recording; `close` closes it.
    changes
        What returns a message instead of another one of the same connection and log time, by the id of the connection.
        Called on any thread, and again. Chunks with such messages are never copied.
    notices
        What changes notice about the messages that were read.
    """

    def __init__(
        self, reader: Reader, changes: Mapping[int, Callable[[RawMessage], RawMessage]], notices: Collection[str] = ()
    ) -> None:
        super().__init__([reader])
        self._changes = changes
        self._notices = notices

    @property
    def remarks(self) -> Sequence[str]:
        """What the other reader and the changes noticed."""
        return [*super().remarks, *self._notices]

    def chunks(self, wanted: Wanted) -> Iterable[Chunk]:
        """Return the chunks of the recording, with changed messages."""
        if (rule := wanted.rule) is not None:
            wanted = wanted._replace(rule=rule._replace(connection_ids=rule.connection_ids - self._changes.keys()))
        return (chunk.changed(self._changed) for chunk in super().chunks(wanted))

    def _changed(self, message: RawMessage) -> RawMessage:
        change = self._changes.get(message.connection.id)
        return message if change is None else change(message)


def _merged_chunks(chunks: Iterable[Chunk], number: int, known: Mapping[int, Connection]) -> Iterator[Chunk]:
    """Yield the chunks of a source, with messages of the merged connections."""

    def merged(message: RawMessage) -> RawMessage:
        return message._replace(connection=known[message.connection.id])

    for chunk in chunks:
        ids = chunk.connection_ids
        yield chunk._replace(
            place=(number, *chunk.place),
            connection_ids=None if ids is None else frozenset(known[own].id for own in ids & known.keys()),
        ).changed(merged)


def _in_turn(sources: Iterable[tuple[int, Iterator[Chunk]]]) -> Iterator[Chunk]:
    """Yield the chunks of all sources by start; a source is read from its start on."""
    waiting = sorted(sources, key=itemgetter(0), reverse=True)
    # Places differ, as they begin with the number of the source.
    heap: list[tuple[tuple[int, tuple[int, ...]], Chunk, Iterator[Chunk]]] = []
    while waiting or heap:
        if waiting and (not heap or waiting[-1][0] <= heap[0][0][0]):
            _, chunks = waiting.pop()
        else:
            _, chunk, chunks = heapq.heappop(heap)
            yield chunk
        if (following := next(chunks, None)) is not None:
            heapq.heappush(heap, (following.due, following, chunks))


def unify_connections(sources: Sequence[Sequence[Connection]]) -> tuple[list[Connection], list[dict[int, int]]]:
    """Find the connections that several sources share.

    Connections are the same if they agree in everything but id and message count. Two such connections within one
    source are two publishers and stay two: the k-th of one source is the k-th of the other.

    Parameters
    ----------
    sources
        The connections of each source.

    Returns
    -------
    connections
        With ids from 1 on and added counts (None if any is None).
    ids
        For each source: from its own id to the new one.
    """
    merged: list[Connection] = []
    places: dict[Hashable, int] = {}
    ids: list[dict[int, int]] = []
    for connections in sources:
        seen: Counter[Hashable] = Counter()
        numbers: dict[int, int] = {}
        for connection in connections:
            identity = _identity_of(connection), frozenset(connection.metadata.items())
            place = places.setdefault((identity, seen[identity]), len(merged))
            seen[identity] += 1
            if place == len(merged):
                merged.append(replace(connection, id=place + 1))
            else:
                count = _sum((merged[place].message_count, connection.message_count))
                merged[place] = replace(merged[place], message_count=count)
            numbers[connection.id] = place + 1
        ids.append(numbers)
    return merged, ids


def merge_summaries(summaries: Sequence[Summary]) -> Summary:
    """Merge summaries: sizes and counts are added, times span all.

    A value that is unknown in one is unknown in the result. ``container``, ``storage`` and ``profile`` are those that
    all have, else ``mixed`` (the container) or empty.
    """
    # An empty source has no times; they are not unknown.
    timed = [summary for summary in summaries if summary.message_count != 0]

    def common(name: str) -> str:
        values = {getattr(summary, name) for summary in summaries}
        return str(values.pop()) if len(values) == 1 else ""

    return Summary(
        container=common("container") or "mixed",
        storage=common("storage"),
        compression=tuple(sorted({name for summary in summaries for name in summary.compression})),
        size_bytes=sum(summary.size_bytes for summary in summaries),
        message_count=_sum([summary.message_count for summary in summaries]),
        start_ns=_extreme(min, [summary.start_ns for summary in timed]),
        end_ns=_extreme(max, [summary.end_ns for summary in timed]),
        profile=common("profile"),
    )


def _sum(values: Sequence[int | None]) -> int | None:
    known = [value for value in values if value is not None]
    return sum(known) if len(known) == len(values) else None


def _extreme(choose: Callable[[list[int]], int], values: Sequence[int | None]) -> int | None:
    known = [value for value in values if value is not None]
    return choose(known) if known and len(known) == len(values) else None


def _refuse_repeated(readers: Sequence[Reader]) -> None:
    seen = set()
    for reader in readers:
        status = reader.path.stat()
        identity = (status.st_dev, status.st_ino)
        if identity in seen:
            raise UsageError("the recording is given twice", path=reader.path)
        seen.add(identity)


def _refuse_mixed_ros_versions(readers: Sequence[Reader]) -> None:
    by_version: dict[int, Path] = {}
    for reader in readers:
        ros_versions = {connection.ros_version for connection in reader.connections} - {None}
        # A single source may have both.
        if len(ros_versions) == 1:
            by_version.setdefault(ros_versions.pop() or 0, reader.path)
    if len(by_version) > 1:
        raise UsageError(
            f"{by_version[1]} is a ROS 1 recording and {by_version[2]} is a ROS 2 recording; they cannot be merged",
            hint="convert them one by one, or with pc2scan batch",
        )
