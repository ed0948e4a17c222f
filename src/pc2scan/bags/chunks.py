"""Common parts of containers with chunks: segments, which are read, copied as a whole, or salvaged."""

from __future__ import annotations

import struct
from abc import abstractmethod
from bisect import bisect_right
from dataclasses import dataclass, field
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.errors import DamageError
from pc2scan.files.compression import CompressionError, allowed_bytes, decompress
from pc2scan.files.source_file import SourceFile, lend
from pc2scan.model import RawMessage, StoredChunk, declared_counts

from .reader import Chunk, Reader, check_number

if TYPE_CHECKING:
    import re
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.model import ChunkRule, Connection

    from .reader import Loaded, Wanted

    Bools = NDArray[np.bool_]
    Numbers = NDArray[np.uint64]

#: Reading fewer uncompressed bytes takes less time than handing them to another thread.
_WORTH_A_THREAD = 1 << 20

#: The least number of bytes that an index has for a message.
_ENTRY_BYTES = 12

#: Chunks smaller than this, uncompressed, are not copied: their messages are collected in larger ones.
MIN_WHOLE_BYTES = 256 << 10

#: The fewest and the most bytes that are searched at a time.
_SEARCHED = range(1 << 12, 1 << 20)

#: The latest log time that containers can store.
_LATEST_NS = (1 << 64) - 1


@dataclass(slots=True, eq=False)
class Segment:
    """A part of a file with messages: a chunk, or consecutive records outside any chunk.

    Attributes
    ----------
    offset, length
        The stored payload's place in the file, bytes.
    uncompressed_size
        Bytes after decompression.
    start_ns, end_ns
        Log times of the earliest and the latest message, both inclusive.
    crc
        CRC-32 of the uncompressed payload; 0 when there is none.
    record_offset
        Offset of the chunk's record in the file; 0 outside chunks, and for readers that do not need it.
    index_length
        Bytes of the message indexes after it; 0 if unknown.
    padding
        Bytes of the record after its payload: fields that are unknown here.
    compression
        ``none``, ``bz2``, ``lz4`` or ``zstd``.
    connection_ids
        The connections with messages in it; None if unknown until it is read.
    message_count
        How many messages it has by the index; None if that is unknown.
    """

    offset: int
    length: int
    uncompressed_size: int
    start_ns: int
    end_ns: int
    crc: int = 0
    record_offset: int = 0
    index_length: int = 0
    padding: int = 0
    compression: str = "none"
    connection_ids: frozenset[int] | None = None
    message_count: int | None = None

    @property
    def stop(self) -> int:
        """Offset of the record after it."""
        return self.offset + self.length + self.padding


def unpacked(chunk: Segment, stored: memoryview, file_size: int) -> memoryview:
    """Decompress the records of a chunk into exactly the declared size, which a file of its size may have.

    Raises
    ------
    CompressionError
        If they cannot be decompressed, or have another size.
    """
    compression, size = chunk.compression, chunk.uncompressed_size
    if size > (most := allowed_bytes(file_size, len(stored))):
        raise CompressionError(
            f"it declares {size} bytes uncompressed; at most {most} are possible in a file of this size"
        )
    if compression == "none" or not stored:
        if len(stored) != size:
            raise CompressionError(f"it has {len(stored)} bytes, and declares {size}")
        return stored
    try:
        records = lend(size)
        decompress(compression, stored, records)
    except (CompressionError, MemoryError, OverflowError) as err:
        raise CompressionError(
            f"its {compression} data cannot be decompressed to the declared {size} bytes: {err}"
        ) from err
    return records.toreadonly()


class NearbyFile(SourceFile):
    """Reads a file in which small records follow each other: these need no system call each."""

    #: Bytes that were read ahead, and their place: replaced as one, because loads on several threads read records.
    _ahead = (0, b"")

    def nearby(self, offset: int, length: int) -> bytes:
        """Read exactly these few bytes, and some more for the next call."""
        origin, ahead = self._ahead
        if not origin <= offset <= offset + length <= origin + len(ahead):
            # After a large record that was skipped, another one is likely: little is read ahead.
            more = (1 << 16) if origin <= offset <= origin + len(ahead) else (1 << 12)
            origin, ahead = offset, self.read(offset, max(length, min(more, self.size - offset)))
            self._ahead = origin, ahead
        return ahead[offset - origin : offset - origin + length]

    def search(self, pattern: re.Pattern[bytes], start: int, stop: int, reach: int) -> Iterator[int]:
        """Yield where a pattern, of ``reach`` bytes at most, begins in a part of the file; perhaps twice."""
        size = _SEARCHED.start
        while start < stop:
            window = self.read(start, min(size + reach, stop - start))
            yield from (start + match.start() for match in pattern.finditer(window))
            start, size = start + size, min(2 * size, _SEARCHED.stop)


#: The numbers of a segment, in the order of its attributes.
_NUMBERS = (
    "offset", "length", "uncompressed_size", "start_ns", "end_ns", "crc", "record_offset", "index_length", "padding",
)  # fmt: skip
_numbers_of = attrgetter(*_NUMBERS)

#: A row has these, the number of the segment's kind, and its count plus one; 0 if that is unknown.
_ROW = np.dtype([(name, "<u8") for name in (*_NUMBERS, "kind", "count")])
_PACKED = struct.Struct(f"<{len(_NUMBERS) + 2}Q")


@dataclass(slots=True, eq=False)
class Segments:
    """The segments of a file, as a table of numbers: a long recording has 200,000. Each `Segment` is made when needed.

    Attributes
    ----------
    kinds
        What segments have in common with many others, compression and connections, in the place that `rows` names.
    """

    kinds: list[tuple[str, frozenset[int] | None]] = field(default_factory=list)
    _numbers: dict[tuple[str, frozenset[int] | None], int] = field(default_factory=dict)
    _packed: bytearray = field(default_factory=bytearray)

    @property
    def rows(self) -> NDArray[np.void]:
        """The table, shape (segments,), to be read and changed in place; no segment is added while it is held."""
        return np.frombuffer(self._packed, _ROW)

    def append(self, segment: Segment) -> None:
        """Add a segment."""
        kind = segment.compression, segment.connection_ids
        number = self._numbers.setdefault(kind, len(self.kinds))
        if number == len(self.kinds):
            self.kinds.append(kind)
        count = 0 if segment.message_count is None else segment.message_count + 1
        self._packed += _PACKED.pack(*_numbers_of(segment), number, count)

    def pop(self) -> Segment:
        """Remove the last segment, and return it."""
        last = self[-1]
        del self._packed[-_PACKED.size :]
        return last

    def __len__(self) -> int:
        return self.rows.size

    def __getitem__(self, place: int) -> Segment:
        *numbers, kind, count = _PACKED.unpack_from(self._packed, place * _PACKED.size)
        segment = Segment(*numbers)
        segment.compression, segment.connection_ids = self.kinds[kind]
        segment.message_count = count - 1 if count else None
        return segment

    def __iter__(self) -> Iterator[Segment]:
        return map(self.__getitem__, range(self.rows.size))

    def select(self, chosen: Bools) -> Segments:
        """Return the chosen segments; ``chosen`` has the shape (segments,)."""
        return Segments(self.kinds, self._numbers, bytearray(self.rows[chosen].view(np.uint8).data))

    def sort(self) -> None:
        """Sort them as they are in the file, which they usually are."""
        rows = self.rows
        if (rows["offset"][1:] < rows["offset"][:-1]).any():
            rows[:] = rows[np.argsort(rows["offset"], kind="stable")]


def _limits(start_ns: int | None, stop_ns: int | None) -> tuple[np.uint64, np.uint64]:
    """Return the first and the last log time of a cut, ns; of one that has none, the last is before the first."""
    first = max(start_ns or 0, 0)
    last = _LATEST_NS if stop_ns is None else min(stop_ns - 1, _LATEST_NS)
    return (np.uint64(first), np.uint64(last)) if first <= last else (np.uint64(1), np.uint64(0))


def whole_chunks(
    segments: Segments, rule: ChunkRule | None, start_ns: int | None, stop_ns: int | None
) -> tuple[Bools, Numbers]:
    """Find the chunks that can be copied as a whole, by the index alone.

    A chunk that is wanted completely is copied if it can stay behind everything that is before it in the file, and
    before everything behind it that is read message by message. Messages that are read one by one are written by log
    time, so these are two conditions on log times. The messages in and around such a chunk may be written unsorted, as
    they are in the source: readers order them by the index, and equal log times keep their order.

    Parameters
    ----------
    segments
        All segments to read, in the order of the file.
    rule
        The chunks that the destination accepts; None: none.
    start_ns, stop_ns
        The cut, ``start_ns <= log_time_ns < stop_ns``.

    Returns
    -------
    whole
        Which segments these are, shape (segments,).
    due
        When each segment is due, ns, shape (segments,): at its first log time; one that can be copied, when all before
        it in the file have ended, too.
    """
    rows = segments.rows
    starts, ends = rows["start_ns"], rows["end_ns"]
    if rule is None:
        return np.zeros(len(rows), bool), starts
    known, (first, last) = rule.connection_ids, _limits(start_ns, stop_ns)
    whole = np.array([ids is not None and ids <= known for _, ids in segments.kinds], bool)[rows["kind"]]
    whole &= (rows["uncompressed_size"] >= MIN_WHOLE_BYTES) & (starts >= first) & (ends <= last)
    if rule.last_ns is not None:
        whole &= ends <= np.uint64(rule.last_ns)
    # When all messages before it in the file are written.
    due = starts.copy()
    np.maximum(due[1:], np.maximum.accumulate(ends)[:-1], out=due[1:])
    # The first message behind it that is read by itself.
    following = _LATEST_NS
    backwards = (column[::-1].data for column in (starts, due, whole))
    for place, (begin_ns, due_ns, is_allowed) in enumerate(zip(*backwards, strict=True), 1):
        if not is_allowed or due_ns > following:
            whole[-place] = False
            following = min(following, begin_ns)
    return whole, np.where(whole, due, starts)


def times_around(segments: Segments) -> Callable[[int, int], dict[str, int | None]]:
    """Return a function that finds the log times around a part of the file.

    It takes the part's start and stop, and returns ``first_ns``, the latest log time before it, and ``last_ns``, the
    earliest after it; None if there are no messages. Segments without times (``end_ns`` 0) are ignored. They are in the
    order of the file.
    """
    timed = segments.rows[segments.rows["end_ns"] > 0]
    offsets = timed["offset"]
    latest = np.maximum.accumulate(timed["end_ns"])
    earliest = np.minimum.accumulate(timed["start_ns"][::-1])[::-1]

    def around(start: int, stop: int) -> dict[str, int | None]:
        before, behind = np.searchsorted(offsets, np.array((start, stop), np.uint64))
        return {
            "first_ns": int(latest[before - 1]) if before else None,
            "last_ns": int(earliest[behind]) if behind < len(earliest) else None,
        }

    return around


def segment_chunks(
    segments: Segments, load: Callable[..., Loaded], file: SourceFile, whole: Bools, due: Numbers
) -> Iterator[Chunk]:
    """Yield the segments of a file as chunks, in the order in which `whole_chunks` says that they are due.

    ``load`` loads a segment for a callback, ``whole`` if it may be copied; see `Chunk`. The segments are in the order
    of the file. Each chunk is made when it is due: it takes more memory than its segment.
    """
    for place in np.argsort(due, kind="stable").data:
        segment = segments[place]
        yield Chunk(
            start_ns=int(due[place]),
            place=(segment.offset,),
            size=segment.uncompressed_size,
            load=partial(load, segment, whole=bool(whole[place])),
            is_quick=segment.compression == "none" and segment.uncompressed_size < _WORTH_A_THREAD,
            file=file,
            offset=segment.offset,
            length=segment.length,
            end_ns=segment.end_ns,
            connection_ids=segment.connection_ids,
        )


class Record(NamedTuple):
    """A record in a damaged chunk.

    Attributes
    ----------
    stop
        Where it ends, by its own length: perhaps behind the data.
    connection_id
        Of a message: its connection; else None.
    log_time_ns, publish_time_ns, sequence
        Those of a message.
    start
        Where its data begin.
    """

    stop: int
    start: int = 0
    connection_id: int | None = None
    log_time_ns: int = 0
    publish_time_ns: int = 0
    sequence: int = 0


def sound_records(
    data: memoryview,
    record_at: Callable[[memoryview, int], Record | None],
    entries: Iterable[tuple[int, int]] = (),
    *,
    is_whole: bool = False,
) -> Iterator[tuple[int, int, Record]]:
    """Yield where the records of a damaged chunk begin and end, and what they are.

    They are one behind the other; behind damage, the next is where the index has a message. A message with a wrong
    length ends there; the last one ends with the data, if these ``is_whole``.

    Parameters
    ----------
    data
        Its records, as far as they could be decompressed.
    record_at
        Returns the record that begins at a place; None if none does.
    entries
        The log times and the places of its messages in its index.
    is_whole
        Whether these are all of its bytes.
    """
    heads = ((place, record_at(data, place)) for _, place in entries)
    places = sorted(place for place, record in heads if record is not None and record.connection_id is not None)
    position = 0
    while position < len(data):
        number = bisect_right(places, position)
        following = places[number] if number < len(places) else len(data)
        record = record_at(data, position)
        stop = following if record is None else min(record.stop, following)
        if record is not None and (
            stop == record.stop or (record.connection_id is not None and (stop < len(data) or is_whole))
        ):
            yield position, stop, record
        position = stop


def salvage(
    data: memoryview,
    record_at: Callable[[memoryview, int], Record | None],
    segment: Segment,
    known: Mapping[int, Connection],
    entries: Sequence[tuple[int, int]],
) -> tuple[list[RawMessage], dict[str, int | None]]:
    """Return the messages of a damaged chunk, and what is lost: bytes, messages, and between which log times.

    ``known`` has the connections by id; for the others, see `sound_records`.
    """
    messages: list[RawMessage] = []
    covered = unknown = last = 0
    for start, stop, record in sound_records(data, record_at, entries, is_whole=len(data) >= segment.uncompressed_size):
        covered += stop - start
        own = None if record.connection_id is None else known.get(record.connection_id)
        if own is not None:
            view = data[record.start : stop]
            messages.append(RawMessage(own, record.log_time_ns, view, record.publish_time_ns, record.sequence))
            check_number(messages)
            last = stop
        else:
            unknown += record.connection_id is not None
    # Of a chunk that is cut off, what is lost came behind its last message.
    is_front = len(data) < segment.uncompressed_size and covered == last > 0
    return messages, {
        "bytes_lost": max(segment.uncompressed_size, len(data)) - covered,
        "messages_lost": max(0, len(entries) - len(messages)) if entries else unknown or None,
        "first_ns": max(message.log_time_ns for message in messages) if is_front else segment.start_ns,
        "last_ns": segment.end_ns,
    }


class Selection(NamedTuple):
    """What is wanted of the segments of a file.

    Attributes
    ----------
    wanted
        The connections by id.
    start_ns, stop_ns
        Only messages with ``start_ns <= log_time_ns < stop_ns``.
    rule
        Which chunks may be copied as a whole; None: none.
    needed
        The connections that chunks have to describe to be copied, by the chunk's offset.
    """

    wanted: Mapping[int, Connection]
    start_ns: int
    stop_ns: int
    rule: ChunkRule | None = None
    needed: Mapping[int, frozenset[int]] = {}


class ChunkedReader(Reader):
    """Reads a file with chunks."""

    has_chunks = True
    #: The container whose chunks are copied as a whole.
    _container: str
    _file: SourceFile
    #: Returns the record that begins at a place of a damaged segment; None if none does.
    _record_at: Callable[[memoryview, int], Record | None]
    #: The segments of the index, in the order of the file.
    _segments: Segments
    #: The connections by id.
    _known: Mapping[int, Connection]

    @abstractmethod
    def _read(self, selection: Selection, segment: Segment, *, whole: bool) -> StoredChunk | list[RawMessage]:
        """Return the wanted messages of a segment in the order of the file; or a chunk to be copied as a whole.

        Raises
        ------
        DamageError
            If it is damaged.
        """

    @abstractmethod
    def _prefix(self, segment: Segment, problem: DamageError) -> tuple[Segment, memoryview, DamageError]:
        """Return a damaged segment where it is, its records as far as they can be decompressed, and what is wrong."""

    @abstractmethod
    def _entries(self, segment: Segment) -> Iterator[tuple[int, Iterable[tuple[int, int]]]]:
        """Yield the connections, and the log times and places of their messages, of the index records after a chunk."""

    def chunks(self, wanted: Wanted) -> Iterator[Chunk]:
        """Return chunks, and segments of records outside chunks, by start; see `pc2scan.bags.reader.Reader`."""
        connections, start_ns, stop_ns, rule = wanted
        known = self._known
        if connections is not None:
            known = {own.id: known[own.id] for own in connections if own.id in known}
            if not known:
                return iter(())
        # An index that is damaged may have wrong ids.
        ids = None if len(known) == len(self._known) else frozenset(known)
        rule = rule if rule and rule.container == self._container else None
        segments = self._segments_with(ids, start_ns, stop_ns)
        whole, due = whole_chunks(segments, rule, start_ns, stop_ns)
        needed = self._needed(segments, due, start_ns) if whole.any() else {}
        cut = (0 if start_ns is None else start_ns, _LATEST_NS + 1 if stop_ns is None else stop_ns)
        load = partial(self._load, Selection(known, *cut, rule, needed))
        return segment_chunks(segments, load, self._file, whole, due)

    def _needed(self, segments: Segments, due: Numbers, start_ns: int | None) -> dict[int, frozenset[int]]:  # noqa: ARG002
        """Return the connections that chunks have to describe to be copied, by the chunk's offset."""
        return {}

    def _load(
        self, selection: Selection, segment: Segment, callback: Callable[[RawMessage], Any], *, whole: bool
    ) -> Loaded:
        """Load a segment; see `pc2scan.bags.reader.Chunk`. What is sound of a damaged one is read once more."""
        try:
            content = self._read(selection, segment, whole=whole)
        except DamageError as err:
            problem = err
        else:
            return content if isinstance(content, StoredChunk) else list(map(callback, content))
        if self._log.strict:
            raise problem
        actual, data, problem = self._prefix(segment, problem)
        entries = [entry for _, more in self._entries(actual) for entry in more]
        messages, lost = salvage(data, self._record_at, actual, self._known, entries)
        self._log.note(problem, offset=segment.record_offset or segment.offset, **lost)
        wanted, start_ns, stop_ns, *_ = selection
        return [
            callback(message)
            for message in self._unpacked(segment, messages)
            if message.connection.id in wanted and start_ns <= message.log_time_ns < stop_ns
        ]

    def _unpacked(self, segment: Segment, messages: list[RawMessage]) -> list[RawMessage]:  # noqa: ARG002
        """Return messages decompressed, where a container has them compressed one by one."""
        return messages

    def _mend_times(self, times_in: Callable[[Segment], Collection[int]]) -> None:
        """Read the chunks with impossible times: some recorders write zeros for unknown ones.

        ``times_in`` returns the log times of the messages in a chunk.
        """
        rows = self._segments.rows
        for place in np.flatnonzero((rows["start_ns"] > rows["end_ns"]) | (rows["end_ns"] == 0)):
            times = times_in(self._segments[int(place)])
            # The end is zero of chunks without messages.
            rows["start_ns"][place], rows["end_ns"][place] = (min(times), max(*times, 1)) if times else (0, 0)

    def _segments_with(self, ids: frozenset[int] | None, start_ns: int | None, stop_ns: int | None) -> Segments:
        """Return the segments that may have messages of these connections (None: of any) in a cut."""
        segments, (first, last) = self._segments, _limits(start_ns, stop_ns)
        rows = segments.rows
        are_wanted = [ids is None or own is None or not ids.isdisjoint(own) for _, own in segments.kinds]
        chosen = np.array(are_wanted, bool)[rows["kind"]] & (rows["end_ns"] >= first) & (rows["start_ns"] <= last)
        return segments if chosen.all() else segments.select(chosen)

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count by the declared counts, or by the index records after chunks if there are none, or for a cut."""
        declared = declared_counts(connections) if start_ns is None and stop_ns is None else {}
        ids = frozenset(connection.id for connection in connections) - declared.keys()
        counts = dict.fromkeys(ids, 0)
        entries = 0
        for segment in self._segments_with(ids, start_ns, stop_ns) if ids else ():
            if segment.connection_ids is None:
                return declared
            missing = set(segment.connection_ids & ids)
            for identity, more in self._entries(segment) if missing else ():
                if identity in ids:
                    times = [time_ns for time_ns, _ in more]
                    entries += len(times)
                    inside = (stamp for stamp in times if start_ns is None or start_ns <= stamp)
                    counts[identity] += sum(stop_ns is None or stamp < stop_ns for stamp in inside)
                    missing.discard(identity)
            # Chunks of a hostile file may share their index records, which would take quadratic time.
            if missing or entries * _ENTRY_BYTES > self._file.size:
                return declared
        return declared | counts

    def close(self) -> None:
        """Release the file."""
        self._file.close()
        super().close()
