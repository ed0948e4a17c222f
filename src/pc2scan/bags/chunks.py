"""Common parts of containers with chunks: segments, which of them are read, and which may be copied as a whole."""

from __future__ import annotations

import struct
from abc import abstractmethod
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.errors import stamp_text
from pc2scan.model import declared_counts

from .loading import Chunk
from .reader import Reader

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator

    from numpy.typing import NDArray

    from pc2scan.files.source import SourceFile
    from pc2scan.model import ChunkRule, Connection

    from .loading import Loaded

    Span = tuple[int, int]
    Bools = NDArray[np.bool_]
    Numbers = NDArray[np.uint64]

#: Reading fewer uncompressed bytes takes less time than handing them to another thread.
_WORTH_A_THREAD = 1 << 20

#: The least number of bytes that an index has for a message.
_ENTRY_BYTES = 12

#: Chunks smaller than this, uncompressed, are not copied: their messages are collected in larger ones.
MIN_WHOLE_BYTES = 256 << 10

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


class Kind(NamedTuple):
    """What a segment has in common with many others: its class, its compression, and its connections."""

    made_as: type[Segment]
    compression: str
    connection_ids: frozenset[int] | None


#: The numbers of a segment, in the order of its attributes.
_NUMBERS = (
    "offset", "length", "uncompressed_size", "start_ns", "end_ns", "crc", "record_offset", "index_length", "padding",
)  # fmt: skip
_numbers_of = attrgetter(*_NUMBERS)

#: A row has these, the number of the segment's kind, and its count plus one; 0 if that is unknown.
_ROW = np.dtype([(name, "<u8") for name in (*_NUMBERS, "kind", "count")])
_PACKED = struct.Struct(f"<{len(_NUMBERS) + 2}Q")


class Segments:
    """The segments of a file, as a table of numbers: a long recording has 200,000. Each `Segment` is made when needed.

    Parameters
    ----------
    segments
        Those to begin with.
    """

    __slots__ = ("_numbers", "_packed", "kinds")

    def __init__(self, segments: Iterable[Segment] = ()) -> None:
        #: The kinds there are, each in the place that `rows` names.
        self.kinds: list[Kind] = []
        self._numbers: dict[Kind, int] = {}
        self._packed = bytearray()
        for segment in segments:
            self.append(segment)

    @property
    def rows(self) -> NDArray[np.void]:
        """The table, shape (segments,), to be read and changed in place; no segment is added while it is held."""
        return np.frombuffer(self._packed, _ROW)

    def append(self, segment: Segment) -> None:
        """Add a segment."""
        kind = Kind(type(segment), segment.compression, segment.connection_ids)
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
        made_as, compression, connection_ids = self.kinds[kind]
        segment: Segment = made_as(*numbers, compression, connection_ids, count - 1 if count else None)
        return segment

    def __iter__(self) -> Iterator[Segment]:
        return map(self.__getitem__, range(self.rows.size))

    def select(self, chosen: Bools) -> Segments:
        """Return the chosen segments; ``chosen`` has the shape (segments,)."""
        found = Segments()
        found.kinds, found._numbers = self.kinds, self._numbers
        found._packed += self.rows[chosen].view(np.uint8).data
        return found

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
    whole = np.array([ids is not None and ids <= known for _, _, ids in segments.kinds], bool)[rows["kind"]]
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


class ChunkedReader(Reader):
    """Reads a file with chunks. The log times that its index has for them are corrected where they would hide messages.

    A cut reads only chunks within its times. Comparing all chunks would take longer than the cut itself, so only some
    are compared: the first and the last chunk, from which ``start`` and ``end`` count, the chunks next to a cut, and
    those with impossible times. The index records after a chunk repeat the times of its messages. If these differ from
    the index, the chunk itself is read, and is right.
    """

    has_chunks = True
    _file: SourceFile
    #: The segments of the index, in the order of the file; wrong times of them are corrected.
    _segments: Segments
    #: Whether a checksum verifies the times in the index. Only impossible ones are compared then.
    _are_times_verified = False
    #: Returns the log times of a chunk's messages by connection, for connections with these ids (None: all), from the
    #: index records after it; None if these do not have all, or are malformed.
    _indexed_times: Callable[[Segment, frozenset[int] | None], dict[int, list[int]] | None]

    @abstractmethod
    def _contained_span(self, segment: Segment) -> Span | None:
        """Read a chunk and return the times of its messages; None if there are none, or if it is damaged."""

    def _repeated_span(self, segment: Segment) -> Span | None:
        """Return the times in the index records after a chunk; None if there are none, or if they are malformed."""
        stamps = [stamp for found in (self._indexed_times(segment, None) or {}).values() for stamp in found]
        return (min(stamps), max(stamps)) if stamps else None

    def _confirm_ends(self) -> None:
        """Compare impossible times, and those of the first and the last chunk; subclasses call it when they open."""
        self._compared: set[int] = set()
        rows = self._segments.rows
        for place in np.flatnonzero((rows["start_ns"] > rows["end_ns"]) | (rows["end_ns"] == 0)):
            self._confirm(int(place))
        if self._are_times_verified:
            return
        for order in (np.argsort(rows["start_ns"], kind="stable"), np.argsort(rows["end_ns"], kind="stable")[::-1]):
            # The first or the last one; if its times are wrong, the next one.
            for place in order:
                if self._confirm(int(place), unless_repeated=True):
                    break

    def _segments_with(self, ids: frozenset[int] | None, start_ns: int | None, stop_ns: int | None) -> Segments:
        """Return the segments that may have messages of these connections (None: of any) in a cut."""
        segments, (first, last) = self._segments, _limits(start_ns, stop_ns)
        rows = segments.rows
        are_wanted = [ids is None or own is None or not ids.isdisjoint(own) for _, _, own in segments.kinds]
        may_have = np.array(are_wanted, bool)[rows["kind"]]
        if not self._are_times_verified and (start_ns, stop_ns) != (None, None):
            for place in np.flatnonzero(may_have & beside_cut(rows, first, last)):
                self._confirm(int(place))
        chosen = may_have & (rows["end_ns"] >= first) & (rows["start_ns"] <= last)
        return segments if chosen.all() else segments.select(chosen)

    def _confirm(self, place: int, *, unless_repeated: bool = False) -> bool:
        """Compare a segment's times once; return whether they are right.

        With ``unless_repeated``, the times of a chunk are right if nothing repeats them; else it is read.
        """
        if place in self._compared:
            return True
        segment = self._segments[place]
        declared = first_ns, last_ns = (segment.start_ns, segment.end_ns)
        repeated = self._repeated_span(segment)
        if repeated is None and unless_repeated:
            return True
        self._compared.add(place)
        if repeated == declared:
            return True
        actual = self._contained_span(segment)
        if actual is None:
            actual = (min(declared), max(declared))
        hides = actual[0] < first_ns or last_ns < actual[1]
        # A span that is too large hides no messages, and some writers do not compute it exactly.
        if actual == declared or not (hides or repeated == actual):
            return True
        # Some writers write zeros for unknown times.
        if last_ns:
            wrong, right = (f"{stamp_text(first)} to {stamp_text(last)}" for first, last in (declared, actual))
            self._log.note_index(
                self._file,
                segment.offset,
                f"it has log times {wrong} for the chunk with data at byte {segment.offset}, its messages have {right}",
            )
        rows = self._segments.rows
        rows["start_ns"][place], rows["end_ns"][place] = actual
        return False

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count by the declared counts, or by the index records after chunks if there are none, or for a cut."""
        declared = declared_counts(connections) if start_ns is None and stop_ns is None else {}
        ids = frozenset(connection.id for connection in connections) - declared.keys()
        if not ids:
            return declared
        counts = dict.fromkeys(ids, 0)
        entries = 0
        for segment in self._segments_with(ids, start_ns, stop_ns):
            times = None if segment.connection_ids is None else self._indexed_times(segment, ids)
            entries += sum(map(len, (times or {}).values()))
            # Chunks of a hostile file may share their index records, which would take quadratic time.
            if times is None or entries * _ENTRY_BYTES > self._file.size:
                return declared
            for identity, stamps in times.items():
                inside = (stamp for stamp in stamps if start_ns is None or start_ns <= stamp)
                counts[identity] += sum(stop_ns is None or stamp < stop_ns for stamp in inside)
        return declared | counts

    def close(self) -> None:
        """Release the file. Messages that were handed out stay valid."""
        self._file.close()


def beside_cut(rows: NDArray[np.void], first: np.uint64, last: np.uint64) -> Bools:
    """Find the segments next to a cut: outside of it, with the segment before or after them inside.

    In a recording in order these are two. If their declared times are wrong, they may hold messages of the cut.

    Parameters
    ----------
    rows
        Those of `Segments`, in the order of the file.
    first, last
        The cut, ``first <= log_time_ns <= last``.
    """
    behind, before = rows["start_ns"] > last, rows["end_ns"] < first
    behind[1:] = behind[1:] & ~behind[:-1]
    before[:-1] = before[:-1] & ~before[1:]
    return np.asarray(behind | before)
