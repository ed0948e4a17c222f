"""Reads several sources as one recording: connections are unified, messages merged by log time.

The reader of split rosbag2 recordings (`pc2scan.bags.rosbag2.read`) is a subclass.
"""

from __future__ import annotations

import heapq
from dataclasses import replace
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.reader import ConnectionLimit
from pc2scan.errors import UsageError
from pc2scan.model import Summary

from .loading import UNKNOWN_START_NS
from .reader import Reader

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.model import Attachment, ChunkRule, Connection, Metadata, RawMessage

    from .damage import Damage
    from .loading import Chunk


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
        if not readers:
            raise UsageError("no recording was given")
        _refuse_repeated(readers)
        _refuse_mixed_ros_versions(readers)
        self._readers = tuple(readers)
        connections: Sequence[Connection]
        maps: list[dict[int, Connection]]
        if len(readers) == 1:
            connections = readers[0].connections
            maps = [{connection.id: connection for connection in connections}]
        else:
            connections, ids = unify_connections([reader.connections for reader in readers])
            ConnectionLimit(readers[0].path).add(count=len(connections))
            by_id = {connection.id: connection for connection in connections}
            maps = [{own: by_id[merged] for own, merged in numbers.items()} for numbers in ids]
        self.path = path or readers[0].path
        #: In the order of the sources.
        self.connections = tuple(connections)
        self.summary = merge_summaries([reader.summary for reader in readers])
        self.has_chunks = all(reader.has_chunks for reader in readers)
        self._maps = maps
        self._unchanged = len(readers) == 1

    def _amend(self, amended: Mapping[int, Connection], added: Iterable[Connection] = ()) -> None:
        """Replace connections by ones with more information and the same ids, and add some without messages."""
        changed = [amended.get(connection.id, connection) for connection in self.connections]
        completed = (*changed, *added)
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

    def chunks(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> Iterable[Chunk]:
        """Return the chunks of all sources; equal log times are in the order of the sources.

        A source is read when its first message is due, if its summary has that time. Chunks stay whole if no other
        source has messages at their time and their ids are unchanged.
        """
        if self._unchanged:
            return self._readers[0].chunks(connections, start_ns, stop_ns, rule)
        return _chunks_in_turn(self._sources(connections, start_ns, stop_ns, rule))

    def _sources(
        self,
        connections: Collection[Connection] | None,
        start_ns: int | None,
        stop_ns: int | None,
        rule: ChunkRule | None,
    ) -> list[_Source]:
        """Return the sources that may have such messages, each with what is read of it."""
        wanted = None if connections is None else {connection.id for connection in connections}
        sources = []
        for index, (reader, known) in enumerate(zip(self._readers, self._maps, strict=True)):
            chosen = None
            if wanted is not None:
                chosen = [own for own in reader.connections if known[own.id].id in wanted]
                if not chosen:
                    continue
            first_ns = reader.summary.start_ns
            if first_ns is not None and stop_ns is not None and first_ns >= stop_ns:
                continue
            own_rule = None
            if rule is not None and self._stands_alone(reader):
                same = frozenset(own for own, connection in known.items() if own == connection.id)
                own_rule = rule._replace(connection_ids=rule.connection_ids & same)
            sources.append(_Source(index, reader, known, (chosen, start_ns, stop_ns, own_rule)))
        return sources

    def _stands_alone(self, reader: Reader) -> bool:
        """Whether no other source has messages between the first and the last of this one."""
        start_ns, end_ns = reader.summary.start_ns, reader.summary.end_ns
        if start_ns is None or end_ns is None or end_ns < start_ns:
            return len(self._readers) == 1
        return all(
            other is reader
            or other.summary.message_count == 0
            or (other.summary.start_ns is not None and end_ns < other.summary.start_ns)
            or (other.summary.end_ns is not None and other.summary.end_ns < start_ns)
            for other in self._readers
        )

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count the messages of each connection in all sources; see `pc2scan.bags.reader.Reader`."""
        found = dict.fromkeys((connection.id for connection in connections), 0)
        for reader, known in zip(self._readers, self._maps, strict=True):
            requested = [own for own in reader.connections if known[own.id].id in found]
            counted = reader.counts(requested, start_ns, stop_ns)
            for own in requested:
                merged_id = known[own.id].id
                if own.id in counted and merged_id in found:
                    found[merged_id] += counted[own.id]
                else:
                    found.pop(merged_id, None)
        return found

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


class _Source(NamedTuple):
    """One reader of several, with its merged connections and the selection to read."""

    number: int
    reader: Reader
    known: Mapping[int, Connection]
    selection: tuple[Collection[Connection] | None, int | None, int | None, ChunkRule | None]

    @property
    def start_ns(self) -> int:
        """The first log time; if it is unknown, it may be any."""
        start_ns = self.reader.summary.start_ns
        return UNKNOWN_START_NS if start_ns is None else start_ns

    def chunks(self) -> Iterator[Chunk]:
        """Yield its chunks, with messages of the merged connections."""
        for chunk in self.reader.chunks(*self.selection):
            if (ids := chunk.connection_ids) is not None:
                ids = frozenset(self.known[own].id for own in ids & self.known.keys())
            place = (self.number, *chunk.place)
            yield chunk._replace(place=place, connection_ids=ids).changed(self._merged)

    def _merged(self, message: RawMessage) -> RawMessage:
        return message._replace(connection=self.known[message.connection.id])


def _chunks_in_turn(sources: Iterable[_Source]) -> Iterator[Chunk]:
    """Yield the chunks of all sources by start; a source is read from its start on."""
    waiting = sorted(sources, key=attrgetter("start_ns"), reverse=True)
    # Places differ, as they begin with the number of the source.
    heap: list[tuple[tuple[int, tuple[int, ...]], Chunk, Iterator[Chunk]]] = []
    while waiting or heap:
        if waiting and (not heap or waiting[-1].start_ns <= heap[0][0][0]):
            chunks = waiting.pop().chunks()
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
    places: dict[tuple[Hashable, int], int] = {}
    ids: list[dict[int, int]] = []
    for connections in sources:
        seen: dict[Hashable, int] = {}
        numbers: dict[int, int] = {}
        for connection in connections:
            identity = _identity(connection)
            occurrence = seen.get(identity, 0)
            seen[identity] = occurrence + 1
            place = places.setdefault((identity, occurrence), len(merged))
            if place == len(merged):
                merged.append(replace(connection, id=place + 1))
            else:
                count = _sum((merged[place].message_count, connection.message_count))
                merged[place] = replace(merged[place], message_count=count)
            numbers[connection.id] = place + 1
        ids.append(numbers)
    return merged, ids


def _identity(connection: Connection) -> Hashable:
    return (
        connection.topic,
        connection.msgtype,
        connection.serialization,
        connection.definition,
        connection.digest,
        connection.callerid,
        connection.latching,
        connection.qos,
        frozenset(connection.metadata.items()),
    )


def merge_summaries(summaries: Sequence[Summary]) -> Summary:
    """Merge summaries: sizes and counts are added, times span all.

    A value that is unknown in one is unknown in the result. ``container``, ``storage`` and ``profile`` are those that
    all have, else ``mixed`` (the container) or empty.
    """
    # An empty source has no times; they are not unknown.
    timed = [summary for summary in summaries if summary.message_count != 0]
    return Summary(
        container=_common([summary.container for summary in summaries], "mixed"),
        storage=_common([summary.storage for summary in summaries], ""),
        compression=tuple(sorted({name for summary in summaries for name in summary.compression})),
        size_bytes=sum(summary.size_bytes for summary in summaries),
        message_count=_sum([summary.message_count for summary in summaries]),
        start_ns=_extreme(min, [summary.start_ns for summary in timed]),
        end_ns=_extreme(max, [summary.end_ns for summary in timed]),
        profile=_common([summary.profile for summary in summaries], ""),
    )


def _sum(values: Sequence[int | None]) -> int | None:
    known = [value for value in values if value is not None]
    return sum(known) if len(known) == len(values) else None


def _extreme(choose: Callable[[list[int]], int], values: Sequence[int | None]) -> int | None:
    known = [value for value in values if value is not None]
    return choose(known) if known and len(known) == len(values) else None


def _common(values: Sequence[str], otherwise: str) -> str:
    return values[0] if len(set(values)) == 1 else otherwise


def _refuse_repeated(readers: Sequence[Reader]) -> None:
    seen: dict[tuple[int, int], Path] = {}
    for reader in readers:
        status = reader.path.stat()
        identity = (status.st_dev, status.st_ino)
        if identity in seen:
            other = "" if seen[identity] == reader.path else f" (as {seen[identity]} too)"
            raise UsageError(f"the recording is given twice{other}", path=reader.path)
        seen[identity] = reader.path


def _refuse_mixed_ros_versions(readers: Sequence[Reader]) -> None:
    found: dict[int, Path] = {}
    for reader in readers:
        ros_versions = {connection.ros_version for connection in reader.connections} - {None}
        # A single source may have both.
        if len(ros_versions) == 1:
            found.setdefault(ros_versions.pop() or 0, reader.path)
    if len(found) > 1:
        raise UsageError(
            f"{found[1]} is a ROS 1 recording and {found[2]} is a ROS 2 recording; they cannot be merged",
            hint="convert them one by one, or with pc2scan batch",
        )
