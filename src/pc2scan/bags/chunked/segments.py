"""The segments of a file with chunks, and which chunks may be copied as a whole."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from functools import partial
from itertools import accumulate, zip_longest
from operator import attrgetter
from typing import TYPE_CHECKING, Protocol

from pc2scan.bags.units import Extent, Unit, sort_units
from pc2scan.model import declared_counts

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from pc2scan.bags.units import Item, Loaded
    from pc2scan.files.source import SourceFile
    from pc2scan.model import ChunkRule, Connection, RawMessage

#: Reading fewer uncompressed bytes takes less time than handing them to another thread.
_WORTH_A_THREAD = 1 << 20

#: Chunks smaller than this, uncompressed, are not copied: their messages are collected in larger ones.
MIN_WHOLE_BYTES = 256 << 10


@dataclass(frozen=True, slots=True)
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
    """

    offset: int
    length: int
    compression: str
    uncompressed_size: int
    crc: int
    start_ns: int
    end_ns: int
    connection_ids: frozenset[int] | None = None

    def may_hold(self, ids: frozenset[int] | None, start_ns: int | None, stop_ns: int | None) -> bool:
        """Whether a message of these connections and times can be in it (``ids`` None: any connection)."""
        return (
            (start_ns is None or self.end_ns >= start_ns)
            and (stop_ns is None or self.start_ns < stop_ns)
            and (ids is None or self.connection_ids is None or not self.connection_ids.isdisjoint(ids))
        )


def isolated_chunks(
    segments: Collection[Segment], rule: ChunkRule, start_ns: int | None, stop_ns: int | None
) -> frozenset[Segment]:
    """Find the chunks that can be copied as a whole, by the index alone.

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
    frozenset[Segment]
        Chunks that are wanted completely, if no other segment has messages between their first and last.
    """
    ordered = sorted(segments, key=attrgetter("start_ns", "offset"))
    alone = []
    latest = (-1, 0)
    for segment, following in zip_longest(ordered, ordered[1:]):
        if (
            latest < (segment.start_ns, segment.offset)
            and (following is None or segment.end_ns < following.start_ns)
            and segment.connection_ids is not None
            and segment.connection_ids <= rule.connection_ids
            and segment.uncompressed_size >= MIN_WHOLE_BYTES
            and (start_ns is None or start_ns <= segment.start_ns)
            and (stop_ns is None or segment.end_ns < stop_ns)
            and (rule.last_ns is None or segment.end_ns <= rule.last_ns)
            and not rule.is_cut(segment.start_ns, segment.end_ns)
        ):
            alone.append(segment)
        latest = max(latest, (segment.end_ns, segment.offset))
    return frozenset(alone)


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


def count_messages(
    connections: Collection[Connection],
    start_ns: int | None,
    stop_ns: int | None,
    counts_between: Callable[[frozenset[int]], dict[int, int]],
) -> dict[int, int]:
    """Count messages: by the counts that the file declares, or by its index if there are none or for a cut.

    Parameters
    ----------
    connections, start_ns, stop_ns
        As for `pc2scan.bags.reader.Reader.counts`.
    counts_between
        Counts the messages of connections with these ids, by the index.
    """
    declared = declared_counts(connections) if start_ns is None and stop_ns is None else {}
    ids = frozenset(connection.id for connection in connections) - declared.keys()
    return declared | counts_between(ids) if ids else declared


def segment_units(
    segments: Iterable[Segment], load: LoadSegment, alone: Collection[Segment], file: SourceFile
) -> list[Unit]:
    """Return the segments of a file as units; those in ``alone`` may be whole."""
    return sort_units(
        Unit(
            start_ns=segment.start_ns,
            place=(segment.offset,),
            size=segment.uncompressed_size,
            load=partial(load, segment),
            is_quick=segment.compression == "none" and segment.uncompressed_size < _WORTH_A_THREAD,
            may_be_whole=segment in alone,
            extent=Extent(file, segment.offset, segment.length),
        )
        for segment in segments
    )
