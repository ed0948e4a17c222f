"""Reads ROS 1 bags, one chunk at a time."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING

from pc2scan.bags.chunked.index_checks import IndexCheck, SpanCheck
from pc2scan.bags.chunked.segments import count_messages, isolated_chunks, segment_units
from pc2scan.bags.concatenation import NextRecordingError, PartReader, note_next, open_parts
from pc2scan.bags.damage import DamageLog
from pc2scan.bags.lazy_items import LazyItems, map_items
from pc2scan.model import StoredChunk, Summary

from .chunks import Places, borrow_payload, decompress_chunk, is_readable_lz4, scan_messages
from .index import ConnectionCheck, contained_span, read_index
from .index_data import index_check
from .records import BagFile, FormatError, uint32_field

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.chunked.salvage import SalvagedMessages
    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.bags.damage import Damage
    from pc2scan.bags.formats import ReadOptions
    from pc2scan.bags.reader import Reader
    from pc2scan.bags.units import Item, Loaded, Unit
    from pc2scan.model import Buffer, ChunkRule, Connection, RawMessage

    from .index import BagIndex


def open_reader(path: Path, options: ReadOptions) -> Reader:
    """Open a ROS 1 bag; see `pc2scan.bags.formats.Format`."""
    return open_parts(lambda start: Rosbag1Reader(path, strict=options.strict, start=start))


class Rosbag1Reader(PartReader):
    """Reads an open ROS 1 bag.

    Opening reads the index and the headers of the chunks. Chunks are read and decompressed one at a time,
    when their first message is due, and their messages are views into them.

    Parameters
    ----------
    path
        A bag of format 2.0.

    strict
        Whether damage is an error; otherwise it is in `damage`, and the rest is recovered. Without a usable index,
        opening a bag reads the chunks whose own index records are not usable either.

    Raises
    ------
    RecordingError
        If it cannot be opened, is of format 1.x or encrypted.
    DamageError
        With ``strict``, if it has no index or contradicts itself; while messages are read, if a chunk does.
    """

    def __init__(self, path: Path, *, strict: bool = False, start: int = 0) -> None:
        self._path = path
        self._log = DamageLog(strict=strict, start=start)
        self._file = BagFile(path, start)
        self._bytes_read = 0
        #: Whether nothing is damaged outside of the chunks.
        self._is_whole = False
        try:
            try:
                self._index = self._found_index()
            except NextRecordingError as other:
                self._file.end_at(other.offset)
                self._index = self._found_index()
            note_next(self._file, self._log)
            for identity in sorted(self._index.unlisted):
                error = f"connection {identity} has messages, and only chunks describe it"
                self._log.note(self._file.damage_error(error), key=("unlisted", identity), messages_lost=0)
            self._connection_check = ConnectionCheck(self._index.connections)
            self._spans = SpanCheck(
                self._index.segments, self._indexed_span, self._contained_span, self._file, self._log, trusted=False
            )
            self._spans.compare_ends()
            self._is_whole = not self._log.found
        except BaseException:
            self.close()
            raise

    def _found_index(self) -> BagIndex:
        """Index the bag, by its own index or without it."""
        try:
            return read_index(self._file)
        except FormatError as err:
            problem = self._file.damage_error(f"its index cannot be read: {err}")
        from .recovery import recover_index  # noqa: PLC0415  # only damaged bags pay for it

        return recover_index(self._file, problem, self._log)

    has_chunks = True

    @property
    def next_start(self) -> int | None:
        """Offset of the bag that follows this one in the file."""
        return self._file.next_start

    @property
    def path(self) -> Path:
        """The path of the file."""
        return self._path

    @property
    def connections(self) -> Sequence[Connection]:
        """All connections, in the order of the index; those that only chunks describe come last."""
        return tuple(self._index.connections.values())

    @property
    def summary(self) -> Summary:
        """The summary, made from the index."""
        segments = self._index.segments
        counts = [connection.message_count for connection in self.connections]
        return Summary(
            container="rosbag1",
            storage="",
            compression=tuple(sorted({segment.compression for segment in segments})),
            size_bytes=self._file.size,
            message_count=None if None in counts else sum(filter(None, counts)),
            start_ns=min((segment.start_ns for segment in segments), default=None),
            end_ns=max((segment.end_ns for segment in segments), default=None),
        )

    @property
    def bytes_read(self) -> int:
        """Stored bytes of the chunks that the latest call of `messages` has read so far."""
        return min(self._bytes_read, self._file.size)

    def units(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> list[Unit]:
        """Return chunks by start; see `pc2scan.bags.reader.Reader`. Whole chunks are decompressed to be checked."""
        rule = rule if rule and rule.container == "rosbag1" else None
        known = self._index.connections
        ids = None if connections is None else frozenset(connection.id for connection in connections)
        wanted = {key: item if ids is None or key in ids else None for key, item in known.items()}
        chosen = frozenset(key for key, item in wanted.items() if item is not None)
        self._bytes_read = 0
        self._spans.compare_beside(ids, start_ns, stop_ns)
        due = [segment for segment in self._index.segments if segment.may_hold(ids, start_ns, stop_ns)]
        alone = isolated_chunks(due, rule, start_ns, stop_ns) if rule else frozenset()
        needed = first_uses(due, start_ns) if alone else {}

        def load_whole(segment: Segment, rule: ChunkRule) -> Loaded[RawMessage]:
            stored = self._file.read(segment.offset, segment.length)
            chunk = decompress_chunk(self._file, segment, stored)
            places = Places()

            def describe(fields: Mapping[bytes, bytes], body: Buffer) -> None:
                places.described.add(uint32_field(fields, "conn"))
                if not self._agrees(segment, fields, body):
                    places.contradicts = True

            span = (segment.start_ns, segment.end_ns)
            check = self._check_index(segment, chunk, chosen)
            messages = scan_messages(
                chunk, wanted, start_ns, stop_ns, span=span, places=places.messages, describe=describe
            )
            self._compare_index(segment, check, len(messages))
            if isinstance(messages, LazyItems):
                return messages
            return whole_chunk(segment, stored, chunk, messages, places, rule, needed[segment]) or messages

        def load(segment: Segment, callback: Callable[[RawMessage], Item], *, whole: bool) -> Loaded[Item]:
            self._bytes_read += segment.length
            if rule and whole:
                # Damaged chunks are not copied.
                with suppress(FormatError):
                    found = load_whole(segment, rule)
                    return found if isinstance(found, StoredChunk) else map_items(callback, found)

            try:
                # The messages refer to the chunk, which is overwritten as soon as nothing refers to `payload`.
                payload = borrow_payload(self._file, segment)
                describe, span = partial(self._agrees, segment), (segment.start_ns, segment.end_ns)
                check = self._check_index(segment, payload.data, chosen)
                messages = scan_messages(payload.data, wanted, start_ns, stop_ns, span=span, describe=describe)
                is_cut = segment.start_ns < (start_ns or 0) or (stop_ns is not None and stop_ns <= segment.end_ns)
                self._compare_index(segment, check, None if is_cut else len(messages))
                return map_items(callback, messages)
            except FormatError as err:
                problem = err
            return map_items(callback, self._salvage(segment, problem).select(chosen, start_ns, stop_ns))

        return segment_units(due, load, alone, self._file)

    def _check_index(self, segment: Segment, chunk: Buffer, ids: frozenset[int]) -> IndexCheck:
        """Compare the index records after a chunk with it; those of a damaged bag are not compared."""
        return index_check(self._file, segment, chunk, ids) if self._is_whole else IndexCheck()

    def _compare_index(self, segment: Segment, check: IndexCheck, found: int | None) -> None:
        """Note wrong index records after a chunk, given how many messages it has."""
        if trouble := check.trouble(found):
            error = f"the index after the chunk with data at byte {segment.offset} contradicts it: {trouble}"
            self._log.note(
                self._file.damage_error(error),
                offset=segment.offset,
                key="index",
                messages_lost=check.lost(found),
                first_ns=segment.start_ns,
                last_ns=segment.end_ns,
            )

    def _agrees(self, segment: Segment, fields: Mapping[bytes, bytes], body: Buffer) -> bool:
        """Whether a chunk describes a connection as the index does; notes it if not."""
        difference = self._connection_check.difference(fields, body)
        if difference is not None:
            error = f"the chunk with data at byte {segment.offset} contradicts the index: {difference}"
            self._log.note(self._file.damage_error(error), offset=segment.offset, key=difference, messages_lost=0)
        return difference is None

    def _indexed_span(self, segment: Segment) -> tuple[int, int] | None:
        from .index_data import indexed_span  # noqa: PLC0415

        return indexed_span(self._file, segment)

    def _contained_span(self, segment: Segment) -> tuple[int, int] | None:
        try:
            return contained_span(self._file, segment)
        except FormatError:
            return None

    def _salvage(self, segment: Segment, problem: FormatError) -> SalvagedMessages:
        """Note a damaged chunk, and recover its messages."""
        error = self._file.damage_error(f"the chunk with data at byte {segment.offset} cannot be read: {problem}")
        if self._log.strict:
            raise error from problem
        from pc2scan.bags.chunked.salvage import note_salvaged  # noqa: PLC0415  # only damaged bags pay for it

        from .recovery import payload_prefix, salvage_messages  # noqa: PLC0415

        chunk = payload_prefix(self._file, segment)
        left = salvage_messages(chunk, self._index.connections, (segment.start_ns, segment.end_ns))
        check = self._check_index(segment, chunk, frozenset(self._index.connections))
        counted = None not in (connection.message_count for connection in self.connections)
        note_salvaged(self._log, error, segment, segment.offset, len(chunk), left, check.total, counted=counted)
        return left

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count by the index, or for a cut by the chunks' index records; see `pc2scan.bags.reader.Reader`."""

        def by_index(ids: frozenset[int]) -> dict[int, int]:
            from .index_data import counts_between  # noqa: PLC0415  # only topics that are skipped need it

            return counts_between(self._file, self._index.segments, ids, start_ns, stop_ns)

        return count_messages(connections, start_ns, stop_ns, by_index)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage in the parts that were read."""
        return self._log.found

    def close(self) -> None:
        """Release the file. Messages that were handed out stay valid."""
        self._file.close()


def first_uses(segments: Collection[Segment], start_ns: int | None) -> dict[Segment, frozenset[int]]:
    """Find the connections that each chunk has to describe, because no earlier chunk does.

    ROS 1's ``rosbag reindex`` needs a connection's description in the chunk of its first message.

    Parameters
    ----------
    segments
        All segments to read.
    start_ns
        The start of the cut: a chunk across it may be written without its first messages.
    """
    uses = {}
    seen: frozenset[int] = frozenset()
    for segment in sorted(segments, key=attrgetter("start_ns", "offset")):
        ids = segment.connection_ids or frozenset()
        uses[segment] = ids - seen
        if start_ns is None or start_ns <= segment.start_ns:
            seen |= uses[segment]
    return uses


def whole_chunk(
    segment: Segment,
    stored: Buffer,
    records: Buffer,
    messages: Sequence[RawMessage],
    places: Places,
    rule: ChunkRule,
    needed: Collection[int],
) -> StoredChunk | None:
    """Return a chunk that was read as one to copy.

    Parameters
    ----------
    stored, records
        Its records, compressed and decompressed.
    messages, places
        Its messages and their offsets.
    needed
        The connections that it has to describe.

    Returns
    -------
    StoredChunk | None
        None if ``rule`` does not allow to copy it, its messages are not sorted by log time, or it contradicts the
        index. LZ4 frames that ROS 1's own reader refuses are compressed again.
    """
    if places.contradicts:
        return None
    times = [message.log_time_ns for message in messages]
    if not times or len(times) != len(places.messages) or times != sorted(times):
        return None
    if times[0] < segment.start_ns or segment.end_ns < times[-1]:
        return None
    if not places.described <= rule.connection_ids or not places.described.issuperset(needed):
        return None
    index: dict[int, list[tuple[int, int]]] = {}
    for message, place in zip(messages, places.messages, strict=True):
        index.setdefault(message.connection.id, []).append((message.log_time_ns, place))
    if not index.keys() <= rule.connection_ids:
        return None
    if segment.compression not in rule.compressions or (segment.compression == "lz4" and not is_readable_lz4(stored)):
        return StoredChunk("", records, len(records), 0, index)
    return StoredChunk(segment.compression, stored, len(records), 0, index)
