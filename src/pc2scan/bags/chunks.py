"""Common parts of containers with chunks: segments, which of them are read, and which may be copied as a whole."""

from __future__ import annotations

from abc import abstractmethod
from bisect import bisect_left
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import accumulate, pairwise
from operator import attrgetter
from typing import TYPE_CHECKING, Protocol, TypeVar

from pc2scan.errors import stamp_text
from pc2scan.model import declared_counts

from .reader import Reader
from .units import Extent, Unit

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence

    from pc2scan.files.source import SourceFile
    from pc2scan.model import ChunkRule, Connection, RawMessage

    from .units import Item, Loaded

    Span = tuple[int, int]
    Shared = TypeVar("Shared", bound=Hashable)

#: Reading fewer uncompressed bytes takes less time than handing them to another thread.
_WORTH_A_THREAD = 1 << 20

#: The least number of bytes that an index has for a message.
_ENTRY_BYTES = 12

#: Chunks smaller than this, uncompressed, are not copied: their messages are collected in larger ones.
MIN_WHOLE_BYTES = 256 << 10


@lru_cache(1024)
def shared(value: Shared) -> Shared:
    """Return the first value that was equal: a long recording has 100,000 chunks, which have few different ones."""
    return value


@dataclass(slots=True, eq=False)
class Segment:
    """A part of a file with messages: a chunk, or consecutive records outside any chunk.

    Attributes
    ----------
    offset, length
        The stored payload's place in the file, bytes.
    compression
        ``none``, ``bz2``, ``lz4`` or ``zstd``.
    uncompressed_size
        Bytes after decompression.
    crc
        CRC-32 of the uncompressed payload; 0 when there is none.
    start_ns, end_ns
        Log times of the earliest and the latest message, both inclusive.
    connection_ids
        The connections with messages in it; None if unknown until it is read.
    message_count
        How many messages it has by the index; None if that is unknown.
    """

    offset: int
    length: int
    compression: str
    uncompressed_size: int
    crc: int
    start_ns: int
    end_ns: int
    connection_ids: frozenset[int] | None = None
    message_count: int | None = None

    @property
    def messages(self) -> int:
        """How many messages it has by the index; 0 if that is unknown."""
        return self.message_count or 0

    def may_hold(self, ids: frozenset[int] | None, start_ns: int | None, stop_ns: int | None) -> bool:
        """Whether a message of these connections and times can be in it (``ids`` None: any connection)."""
        return (
            (start_ns is None or self.end_ns >= start_ns)
            and (stop_ns is None or self.start_ns < stop_ns)
            and (ids is None or self.connection_ids is None or not self.connection_ids.isdisjoint(ids))
        )


def whole_chunks(
    segments: Collection[Segment], rule: ChunkRule, start_ns: int | None, stop_ns: int | None
) -> dict[Segment, int]:
    """Find the chunks that can be copied as a whole, by the index alone.

    A chunk that is wanted completely is copied if it can stay behind everything that is before it in the file, and
    before everything behind it that is read message by message. Messages that are read one by one are written by log
    time, so these are two conditions on log times. The messages in and around such a chunk may be written unsorted, as
    they are in the source: readers order them by the index, and equal log times keep their order.

    Parameters
    ----------
    segments
        All segments to read.
    rule
        The chunks that the destination accepts.
    start_ns, stop_ns
        The cut, ``start_ns <= log_time_ns < stop_ns``.

    Returns
    -------
    dict[Segment, int]
        The chunks, and the log time at which each is due: when it has begun, and all before it in the file has ended.
    """
    ordered = sorted(segments, key=attrgetter("offset"))
    # A chunk is due when all messages before it in the file are written.
    ends = accumulate((segment.end_ns for segment in ordered), max, initial=0)
    due = [max(segment.start_ns, latest) for segment, latest in zip(ordered, ends, strict=False)]
    found: dict[Segment, int] = {}
    # The first message behind it that is read by itself.
    following: int | None = None
    for segment, due_ns in zip(reversed(ordered), reversed(due), strict=True):
        if (
            (following is None or due_ns <= following)
            and segment.connection_ids is not None
            and segment.connection_ids <= rule.connection_ids
            and segment.uncompressed_size >= MIN_WHOLE_BYTES
            and (start_ns is None or start_ns <= segment.start_ns)
            and (stop_ns is None or segment.end_ns < stop_ns)
            and (rule.last_ns is None or segment.end_ns <= rule.last_ns)
            and not rule.is_cut(segment.start_ns, max(segment.end_ns, due_ns))
        ):
            found[segment] = due_ns
        else:
            following = segment.start_ns if following is None else min(following, segment.start_ns)
    return found


def times_around(segments: Iterable[Segment]) -> Callable[[int, int], dict[str, int | None]]:
    """Return a function that finds the log times around a part of the file.

    It takes the part's start and stop, and returns ``first_ns``, the latest log time before it, and ``last_ns``, the
    earliest after it; None if there are no messages. Segments without times (``end_ns`` 0) are ignored.
    """
    timed = sorted((segment for segment in segments if segment.end_ns), key=attrgetter("offset"))
    offsets = [segment.offset for segment in timed]
    latest = list(accumulate((segment.end_ns for segment in timed), max))
    earliest = list(accumulate((segment.start_ns for segment in reversed(timed)), min))[::-1]

    def around(start: int, stop: int) -> dict[str, int | None]:
        before, behind = bisect_left(offsets, start), bisect_left(offsets, stop)
        return {
            "first_ns": latest[before - 1] if before else None,
            "last_ns": earliest[behind] if behind < len(earliest) else None,
        }

    return around


class LoadSegment(Protocol):
    """Loads a segment; see `pc2scan.bags.units.Load`."""

    def __call__(self, segment: Segment, callback: Callable[[RawMessage], Item], *, whole: bool) -> Loaded[Item]:
        """Return the callback's result for each message, or the chunk as a whole."""
        ...


def segment_units(
    segments: Iterable[Segment], load: LoadSegment, whole: Mapping[Segment, int], file: SourceFile
) -> Iterator[Unit]:
    """Yield the segments of a file as units, by start; those that `whole_chunks` found may be whole.

    Each unit is made when it is due: it takes more memory than its segment.
    """
    # Stable sorts, without a key for each segment that lasts.
    ordered = sorted(segments, key=attrgetter("offset"))
    ordered.sort(key=(lambda segment: whole.get(segment, segment.start_ns)) if whole else attrgetter("start_ns"))
    for segment in ordered:
        yield Unit(
            start_ns=whole.get(segment, segment.start_ns),
            place=(segment.offset,),
            size=segment.uncompressed_size,
            load=partial(load, segment),
            is_quick=segment.compression == "none" and segment.uncompressed_size < _WORTH_A_THREAD,
            may_be_whole=segment in whole,
            extent=Extent(file, segment.offset, segment.length),
            messages=segment.messages,
            compression=segment.compression,
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
    #: The segments of the index; those with wrong times are replaced.
    _segments: list[Segment]
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
        segments = self._segments
        self._compared: set[int] = set()
        self._places: dict[int, int] = {}
        self._ordered: list[Segment] = []
        for segment in [s for s in segments if s.start_ns > s.end_ns or s.end_ns == 0]:
            self._confirm(segment)
        for key, backwards in () if self._are_times_verified else (("start_ns", False), ("end_ns", True)):
            # The first or the last one; if its times are wrong, the next one.
            for segment in sorted(segments, key=attrgetter(key), reverse=backwards):
                if self._confirm(segment, unless_repeated=True):
                    break

    def _segments_with(self, ids: frozenset[int] | None, start_ns: int | None, stop_ns: int | None) -> list[Segment]:
        """Return the segments that may have messages of these connections (None: of any) in a cut."""
        if not (self._are_times_verified or (start_ns is None and stop_ns is None)):
            self._ordered = self._ordered or sorted(self._segments, key=attrgetter("offset"))
            for segment in list(beside_cut(self._ordered, start_ns, stop_ns)):
                if segment.may_hold(ids, None, None):
                    self._confirm(segment)
        return [segment for segment in self._segments if segment.may_hold(ids, start_ns, stop_ns)]

    def _confirm(self, segment: Segment, *, unless_repeated: bool = False) -> bool:
        """Compare a segment's times once; return whether they are right.

        With ``unless_repeated``, the times of a chunk are right if nothing repeats them; else it is read.
        """
        if segment.offset in self._compared:
            return True
        declared = first_ns, last_ns = (segment.start_ns, segment.end_ns)
        repeated = self._repeated_span(segment)
        if repeated is None and unless_repeated:
            return True
        self._compared.add(segment.offset)
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
        self._places = self._places or {other.offset: place for place, other in enumerate(self._segments)}
        self._segments[self._places[segment.offset]] = replace(segment, start_ns=actual[0], end_ns=actual[1])
        self._ordered = []
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
        for segment in self._segments:
            if not segment.may_hold(ids, start_ns, stop_ns):
                continue
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


def beside_cut(ordered: Sequence[Segment], start_ns: int | None, stop_ns: int | None) -> Iterator[Segment]:
    """Find the segments next to a cut: outside of it, with the segment before or after them inside.

    In a recording in order these are two. If their declared times are wrong, they may hold messages of the cut.

    Parameters
    ----------
    ordered
        In the order of the file.
    start_ns, stop_ns
        The cut, ``start_ns <= log_time_ns < stop_ns``.
    """
    if stop_ns is not None:
        if ordered and ordered[0].start_ns >= stop_ns:
            yield ordered[0]
        for before, segment in pairwise(ordered):
            if segment.start_ns >= stop_ns > before.start_ns:
                yield segment
    if start_ns is not None:
        for segment, behind in pairwise(ordered):
            if segment.end_ns < start_ns <= behind.end_ns:
                yield segment
        if ordered and ordered[-1].end_ns < start_ns:
            yield ordered[-1]
