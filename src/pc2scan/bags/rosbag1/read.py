"""Reads ROS 1 bags, one chunk at a time.

Messages are found by walking through a chunk. The INDEX DATA records after it are only used to correct the times of
chunks and to count: they have no further information, and some recorders write wrong lengths.
"""

from __future__ import annotations

from array import array
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.bags.chunks import ChunkedReader, segment_chunks, whole_chunks
from pc2scan.bags.damage import AnotherRecordingError, DamageLog
from pc2scan.bags.loading import MAX_LISTED_ITEMS, LazyItems, map_items
from pc2scan.errors import stamp_text
from pc2scan.files.compression import LZ4_MAGIC
from pc2scan.model import RawMessage, StoredChunk, Summary
from pc2scan.text import counted

from .index import contained_span, indexed_entries, indexed_times, read_index
from .records import (
    CONNECTION,
    LAYOUTS,
    MESSAGE,
    SECOND_NS,
    UINT32,
    UINT32_MAX,
    USUAL_LAYOUT,
    BagFile,
    FormatError,
    borrow_payload,
    decompress_chunk,
    kind_of,
    message_at,
    number_field,
    parse_connection,
    record_in,
    time_field,
)
from .recover import payload_prefix, recover_index, refuse_more, salvage_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.chunks import Numbers, Segment, Segments
    from pc2scan.bags.formats import ReadOptions
    from pc2scan.bags.loading import Chunk, Item, Loaded
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Buffer, ChunkRule, Connection

    from .index import BagIndex

    #: Takes the fields and the body of a connection that a chunk describes.
    Describe = Callable[[Mapping[bytes, bytes], Buffer], object]

#: Later than any time that a bag can hold.
_LATEST_NS = (UINT32_MAX + 8) * SECOND_NS


def open_reader(path: Path, options: ReadOptions) -> Reader:
    """Open a ROS 1 bag; see `pc2scan.bags.formats.Format`."""
    return Rosbag1Reader(path, strict=options.strict)


class _Selection(NamedTuple):
    """What is wanted of the chunks.

    Attributes
    ----------
    wanted
        Every connection by id, or None to skip its messages.
    start_ns, stop_ns
        Only messages with ``start_ns <= log_time_ns < stop_ns``.
    rule
        Which chunks may be copied as a whole; None: none.
    needed
        The connections that chunks have to describe, by the chunk's offset; see `first_uses`.
    """

    wanted: dict[int, Connection | None]
    start_ns: int | None
    stop_ns: int | None
    rule: ChunkRule | None
    needed: Mapping[int, frozenset[int]]


class Rosbag1Reader(ChunkedReader):
    """Reads an open ROS 1 bag.

    Opening reads the index and the headers of the chunks. Chunks are read and decompressed one at a time,
    when their first message is due, and their messages are views into them.

    Parameters
    ----------
    path
        A bag of format 2.0. If another one follows in the file, it is not read, which is damage.
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

    _file: BagFile

    def __init__(self, path: Path, *, strict: bool = False) -> None:
        self.path = path
        self._log = DamageLog(strict=strict)
        self._file = BagFile(path)
        #: The latest description of each connection in a chunk, and whether the index has the same: some recorders
        #: repeat connections in every chunk.
        self._described: dict[int, tuple[bytes | None, bytes, bool]] = {}
        try:
            try:
                self._index = self._found_index()
            except AnotherRecordingError as another:
                self._log.note_another(self._file, another.offset)
                self._index = self._found_index()
            for identity in sorted(self._index.unlisted):
                error = f"connection {identity} has messages, and only chunks describe it"
                self._log.note(self._file.damage_error(error), key=("unlisted", identity), messages_lost=0)
            self._segments = self._index.segments
            self._indexed_times = partial(indexed_times, self._file)
            self._confirm_ends()
        except BaseException:
            self.close()
            raise
        #: In the order of the index; those that only chunks describe come last.
        self.connections = tuple(self._index.connections.values())
        self.summary = summary_of(self._index, self._file.size)

    def _found_index(self) -> BagIndex:
        """Index the bag, by its own index or without it."""
        try:
            index = read_index(self._file)
            if index.stop < self._file.size:
                refuse_more(self._file, index.stop)
        except FormatError as err:
            problem = self._file.damage_error(f"its index cannot be read: {err}")
            return recover_index(self._file, problem, self._log)
        return index

    def chunks(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> Iterator[Chunk]:
        """Return chunks by start; see `pc2scan.bags.reader.Reader`. Whole chunks are decompressed to be checked."""
        rule = rule if rule and rule.container == "rosbag1" else None
        ids = None if connections is None else frozenset(connection.id for connection in connections)
        wanted = {key: item if ids is None or key in ids else None for key, item in self._index.connections.items()}
        segments = self._segments_with(ids, start_ns, stop_ns)
        whole, due = whole_chunks(segments, rule, start_ns, stop_ns)
        needed = first_uses(segments, due, start_ns) if whole.any() else {}
        selection = _Selection(wanted, start_ns, stop_ns, rule, needed)
        return segment_chunks(segments, partial(self._load, selection), self._file, whole, due)

    def _load(
        self, selection: _Selection, segment: Segment, callback: Callable[[RawMessage], Item], *, whole: bool
    ) -> Loaded:
        """Load a chunk; see `pc2scan.bags.loading.Load`."""
        try:
            if selection.rule and whole:
                found = self._load_whole(selection, selection.rule, segment)
                return found if isinstance(found, StoredChunk) else map_items(callback, found)
            return map_items(callback, self._scan(selection, segment, borrow_payload(self._file, segment), {}))
        except FormatError as err:
            problem = err
        return map_items(callback, self._salvage(selection, segment, problem))

    def _scan(
        self,
        selection: _Selection,
        segment: Segment,
        chunk: Buffer,
        described: dict[int, bool],
        places: list[int] | None = None,
    ) -> list[RawMessage] | LazyItems[RawMessage]:
        """Find the wanted messages of a chunk; ``described`` and ``places`` are filled for `_load_whole`."""
        messages, found = scan_messages(
            chunk,
            selection.wanted,
            selection.start_ns,
            selection.stop_ns,
            partial(self._compare_connection, segment, described),
            span=(segment.start_ns, segment.end_ns),
            places=places,
        )
        declared = segment.message_count
        if declared is not None and found < declared:
            raise FormatError(f"it has {counted(found, 'message')}, the index counts {declared}")
        if declared is not None and found > declared:
            what = (
                f"the chunk with data at byte {segment.offset} has {counted(found, 'message')}, counted are {declared}"
            )
            self._log.note_index(self._file, segment.offset, what)
        return messages

    def _load_whole(
        self, selection: _Selection, rule: ChunkRule, segment: Segment
    ) -> StoredChunk | list[RawMessage] | LazyItems[RawMessage]:
        """Read a chunk as one to copy; or return its messages if it cannot be copied."""
        stored = self._file.read(segment.offset, segment.length)
        chunk = decompress_chunk(self._file, segment, memoryview(stored))
        described: dict[int, bool] = {}
        places: list[int] = []
        messages = self._scan(selection, segment, chunk, described, places)
        if isinstance(messages, LazyItems) or not all(described.values()):
            return messages
        if not selection.needed.get(segment.offset, frozenset()) <= described.keys() <= rule.connection_ids:
            return messages
        return whole_chunk(segment, stored, chunk, messages, places, rule) or messages

    def _compare_connection(
        self, segment: Segment, described: dict[int, bool], fields: Mapping[bytes, bytes], body: Buffer
    ) -> None:
        """Compare a chunk's description of a connection with the index, and note a difference.

        Parameters
        ----------
        described
            Gets whether the two are the same in everything, by the connection's id.

        Raises
        ------
        FormatError
            If the record does not describe a connection.
        """
        identity = number_field(fields, "conn")
        topic, header = fields.get(b"topic"), bytes(body)
        compared = self._described.get(identity)
        if compared is not None and compared[:2] == (topic, header):
            described[identity] = compared[2]
            return
        copy, known = parse_connection(fields, body), self._index.connections.get(identity)
        described[identity] = known is not None and known == replace(copy, message_count=known.message_count)
        if known is None:
            return
        self._described[identity] = topic, header, described[identity]
        if not described[identity]:
            index, content = (f"{item.topic!r:.80} ({item.msgtype:.80})" for item in (known, copy))
            what = f"connection {identity} is {index} in the one, and {content} in the other"
            if index == content:
                what = f"connection {identity}, {index}, has another definition or header in a chunk"
            self._log.note_index(self._file, segment.offset, what)

    def _contained_span(self, segment: Segment) -> tuple[int, int] | None:
        try:
            return contained_span(self._file, segment)
        except FormatError:
            return None

    def _salvage(
        self, selection: _Selection, segment: Segment, problem: FormatError
    ) -> list[RawMessage] | LazyItems[RawMessage]:
        """Note a damaged chunk, and return its messages that can be recovered."""
        error = self._file.damage_error(f"the chunk with data at byte {segment.offset} cannot be read: {problem}")
        if self._log.strict:
            raise error from problem
        chunk = memoryview(payload_prefix(self._file, segment))
        entries = [entry for _, more in indexed_entries(self._file, segment) for entry in more] or None
        known = self._index.connections
        messages, lost = salvage_of(chunk, known).messages(chunk, segment, known, entries)
        self._log.note(error, offset=segment.offset, **lost)
        start_ns, stop_ns = selection.start_ns or 0, _LATEST_NS if selection.stop_ns is None else selection.stop_ns
        ids = {key for key, connection in selection.wanted.items() if connection is not None}
        wanted = messages.filter(lambda item: item.connection.id in ids and start_ns <= item.log_time_ns < stop_ns)
        return wanted.as_list()


def summary_of(index: BagIndex, size: int) -> Summary:
    """Return the summary of a bag of this size, bytes."""
    rows = index.segments.rows
    counts = [connection.message_count for connection in index.connections.values()]
    return Summary(
        container="rosbag1",
        storage="",
        compression=tuple(sorted({kind.compression for kind in index.segments.kinds})),
        size_bytes=size,
        message_count=None if None in counts else sum(filter(None, counts)),
        start_ns=int(rows["start_ns"].min()) if len(rows) else None,
        end_ns=int(rows["end_ns"].max()) if len(rows) else None,
    )


def first_uses(segments: Segments, due: Numbers, start_ns: int | None) -> dict[int, frozenset[int]]:
    """Find the connections that a chunk has to describe, because no earlier chunk does, by the chunk's offset.

    ROS 1's ``rosbag reindex`` needs a connection's description in the chunk of its first message.

    Parameters
    ----------
    segments
        All segments to read.
    due
        When each of them is; see `whole_chunks`.
    start_ns
        The start of the cut: a chunk across it may be written without its first messages.
    """
    uses = {}
    seen: frozenset[int] = frozenset()
    for place in np.argsort(due, kind="stable").data:
        segment = segments[place]
        if first := (segment.connection_ids or frozenset()) - seen:
            uses[segment.offset] = first
            if start_ns is None or start_ns <= segment.start_ns:
                seen |= first
    return uses


def whole_chunk(
    segment: Segment,
    stored: Buffer,
    records: Buffer,
    messages: Sequence[RawMessage],
    places: Sequence[int],
    rule: ChunkRule,
) -> StoredChunk | None:
    """Return a chunk that was read as one to copy.

    Parameters
    ----------
    stored, records
        Its records, compressed and decompressed.
    messages, places
        Its wanted messages, and the offsets of all.

    Returns
    -------
    StoredChunk | None
        None if ``rule`` does not allow to copy it, or its messages are outside of the times in the index. LZ4 frames
        that ROS 1's own reader refuses are compressed again.
    """
    times = [message.log_time_ns for message in messages]
    if not times or len(times) != len(places):
        return None
    if min(times) < segment.start_ns or segment.end_ns < max(times):
        return None
    index: dict[int, list[tuple[int, int]]] = {}
    for message, place in zip(messages, places, strict=True):
        index.setdefault(message.connection.id, []).append((message.log_time_ns, place))
    if not index.keys() <= rule.connection_ids:
        return None
    if segment.compression not in rule.compressions or (segment.compression == "lz4" and not is_readable_lz4(stored)):
        return StoredChunk("", records, len(records), 0, index)
    return StoredChunk(segment.compression, stored, len(records), 0, index)


def scan_messages(
    chunk: Buffer,
    wanted: Mapping[int, Connection | None],
    start_ns: int | None,
    stop_ns: int | None,
    describe: Describe,
    *,
    span: tuple[int, int] | None = None,
    places: list[int] | None = None,
) -> tuple[list[RawMessage] | LazyItems[RawMessage], int]:
    """Return the wanted messages of a decompressed chunk, and how many it has of all connections and times.

    Parameters
    ----------
    chunk
        Its records; the messages' data are views into it.
    wanted
        Every connection by id, or None to skip its messages.
    start_ns, stop_ns
        Only messages with ``start_ns <= log_time_ns < stop_ns``.
    describe
        Called with the fields and the body of each connection that the chunk describes.
    span
        The first and the last log time in the index.
    places
        Gets the offset of every message, if given.

    Raises
    ------
    FormatError
        If a record does not fit, is not a message or connection, or has a connection not in ``wanted``, or if a wanted
        message is outside of ``span``.
    """
    data = memoryview(chunk)
    end = len(data)
    low = 0 if start_ns is None else start_ns
    high = _LATEST_NS if stop_ns is None else stop_ns
    first, last = span or (0, _LATEST_NS)
    # One comparison for cut and span; only if it fails, the two are distinguished.
    low, high = max(low, first), min(high, last + 1)
    position = dropped = others = 0
    messages: list[RawMessage] = []
    while position < end:
        position, more = _scan_stretch(data, wanted, (low, high), (first, last), position, messages, places, describe)
        others += more
        if len(messages) + dropped > MAX_LISTED_ITEMS:
            dropped += len(messages)
            messages = []
    found = len(messages) + dropped + others
    return (_lazy_messages(data, wanted, low, high) if dropped else messages), found


def _scan_stretch(
    data: memoryview,
    wanted: Mapping[int, Connection | None],
    cut: tuple[int, int],
    span: tuple[int, int],
    position: int,
    messages: list[RawMessage],
    places: list[int] | None,
    describe: Describe,
) -> tuple[int, int]:
    """Find messages from a place on, in so many bytes that they can be no more than `MAX_LISTED_ITEMS`.

    Returns
    -------
    tuple[int, int]
        The place behind them, and how many messages there were that are not wanted.
    """
    (low, high), (first, last) = cut, span
    end = len(data)
    layout, literals, expected, at_connection, at_seconds = current = USUAL_LAYOUT
    prefix = layout.size
    stop = min(end, position + MAX_LISTED_ITEMS * prefix)
    others = 0
    while position < stop:
        origin = position
        values = layout.unpack_from(data, position) if position + prefix <= end else None
        if values and literals(values) == expected:
            identity = values[at_connection]
            stamp = values[at_seconds] * SECOND_NS + values[at_seconds + 1]
            start = position + prefix
            position = start + values[6]
            if position > end:
                raise FormatError(f"a message reaches to byte {position} of a chunk of {end} bytes")
        else:
            fields, start, following = record_in(data, position)
            # Writers use one order of fields: use it from now on, and read this record again.
            other = LAYOUTS.get(tuple(fields), current)
            if other is not current and kind_of(fields) == MESSAGE:
                layout, literals, expected, at_connection, at_seconds = current = other
                continue
            position = following
            if kind_of(fields) == CONNECTION:
                describe(fields, data[start:position])
                continue
            if kind_of(fields) != MESSAGE:
                raise FormatError(f"a record of kind {kind_of(fields)} is in it, allowed are messages and connections")
            identity = number_field(fields, "conn")
            stamp = time_field(fields, "time")
        try:
            connection = wanted[identity]
        except KeyError:
            raise FormatError(f"it has a message of connection {identity}, which is not in the index") from None
        if places is not None:
            places.append(origin)
        if connection is None:
            others += 1
        elif low <= stamp < high:
            messages.append(RawMessage(connection, stamp, data[start:position], stamp))
        elif first <= stamp <= last:
            others += 1
        else:
            raise FormatError(
                f"it has a message of log time {stamp_text(stamp)}, "
                f"declared are {stamp_text(first)} to {stamp_text(last)}"
            )
    return position, others


def _lazy_messages(
    data: memoryview, wanted: Mapping[int, Connection | None], start_ns: int, stop_ns: int
) -> LazyItems[RawMessage]:
    """Return the messages of a sound chunk, each created when it is needed."""
    times, places = array("Q"), array("Q")
    position = 0
    while position < len(data):
        origin, (fields, _, position) = position, record_in(data, position)
        if kind_of(fields) == MESSAGE and wanted[number_field(fields, "conn")] is not None:
            stamp = time_field(fields, "time")
            if start_ns <= stamp < stop_ns:
                times.append(stamp)
                places.append(origin)
    known = {key: item for key, item in wanted.items() if item is not None}
    return LazyItems(times, places, partial(message_at, memoryview(data), known), len(data))


# --- LZ4 frames ---
#
# ROS 1's own reader accepts only frames with independent blocks, no content size, and a checksum.
# Source: ``roslz4/src/lz4s.c`` in ros_comm, and https://github.com/lz4/lz4/blob/dev/doc/lz4_Frame_format.md.

#: Version 1, independent blocks, content checksum; no block checksums, content size or dictionary.
_FLAGS = 0b0110_0100
#: Blocks of at most 64 KiB, 256 KiB, 1 MiB, 4 MiB.
_BLOCK_SIZES = {0x40: 1 << 16, 0x50: 1 << 18, 0x60: 1 << 20, 0x70: 1 << 22}
_STORED = 0x8000_0000
_HEADER_SIZE = 7


def is_readable_lz4(data: Buffer) -> bool:
    """Whether these bytes are exactly one LZ4 frame that ROS 1's own reader accepts."""
    if len(data) < _HEADER_SIZE or data[:4] != LZ4_MAGIC or data[4] != _FLAGS or data[5] not in _BLOCK_SIZES:
        return False
    limit = _BLOCK_SIZES[data[5]]
    position = _HEADER_SIZE
    while position + 4 <= len(data):
        (size,) = UINT32.unpack_from(data, position)
        position += 4
        if size == 0:
            # The checksum, and the end.
            return position + 4 == len(data)
        size &= ~_STORED
        if size > limit:
            return False
        position += size
    return False
