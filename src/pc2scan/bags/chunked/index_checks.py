"""Compares what an index says about chunks with the chunks: their log times, and the entries of their messages.

A wrong time of a chunk would hide messages, because a cut reads only chunks within its times. Comparing all chunks
would take longer than the cut itself, so only some are compared: the first and the last chunk, from which ``start`` and
``end`` count, the chunks next to a cut, and those with impossible times. The index records after a chunk repeat the
times of its messages. If these differ from the index, the chunk itself is read.

Each entry has the time and the offset of a message. Checksums do not detect wrong entries: ROS 1 bags have none, and a
program may have changed messages and not the index.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.damage import RECOVER
from pc2scan.errors import DamageError, stamp_text

if TYPE_CHECKING:
    import struct
    from collections.abc import Callable, Iterator, Sequence

    from pc2scan.bags.damage import DamageLog
    from pc2scan.files.source import SourceFile
    from pc2scan.model import Buffer

    from .segments import Segment

    Span = tuple[int, int]


class SpanCheck:
    """Corrects the declared times of segments, and notes those that are wrong.

    Parameters
    ----------
    segments
        All segments of a file. Those with wrong times are replaced in this list.
    repeated
        Returns the times in the index records after a chunk; None if there are none, or if they are malformed.
    contained
        Reads a chunk and returns the times of its messages; None if there are none, or if it is damaged.
    file
        The file.
    log
        Gets wrong times.
    trusted
        Whether a checksum verifies the declared times. Only impossible ones are compared then.
    """

    def __init__(
        self,
        segments: list[Segment],
        repeated: Callable[[Segment], Span | None],
        contained: Callable[[Segment], Span | None],
        file: SourceFile,
        log: DamageLog,
        *,
        trusted: bool,
    ) -> None:
        self._segments = segments
        self._repeated = repeated
        self._contained = contained
        self._file = file
        self._log = log
        self._trusted = trusted
        self._compared: set[int] = set()
        self._places: dict[int, int] = {}
        self._ordered: list[Segment] = []
        for segment in [s for s in segments if s.start_ns > s.end_ns or s.end_ns == 0]:
            self._confirm(segment)

    def compare_ends(self) -> None:
        """Compare the chunk that begins first and the one that ends last with their index records."""
        if self._trusted or not self._segments:
            return
        if not self._confirm_repeated(min(self._segments, key=attrgetter("start_ns"))):
            # Chunks are corrected until the first one is right.
            any(map(self._confirm_repeated, sorted(self._segments, key=attrgetter("start_ns"))))
        if not self._confirm_repeated(max(self._segments, key=attrgetter("end_ns"))):
            any(map(self._confirm_repeated, sorted(self._segments, key=attrgetter("end_ns"), reverse=True)))

    def compare_beside(self, ids: frozenset[int] | None, start_ns: int | None, stop_ns: int | None) -> None:
        """Compare the chunks next to a cut that may have messages of these connections (None: of any)."""
        if self._trusted or (start_ns is None and stop_ns is None):
            return
        self._ordered = self._ordered or sorted(self._segments, key=attrgetter("offset"))
        for segment in list(beside_cut(self._ordered, start_ns, stop_ns)):
            if segment.may_hold(ids, None, None):
                self._confirm(segment)

    def _confirm_repeated(self, segment: Segment) -> bool:
        """Do the same, but if the file does not repeat the times, read no chunk."""
        return self._repeated(segment) is None or self._confirm(segment)

    def _confirm(self, segment: Segment) -> bool:
        """Compare a segment's times once; return whether they are right."""
        if segment.offset in self._compared:
            return True
        self._compared.add(segment.offset)
        declared = first_ns, last_ns = (segment.start_ns, segment.end_ns)
        repeated = self._repeated(segment)
        if repeated == declared:
            return True
        actual = self._contained(segment)
        if actual is None:
            actual = (min(declared), max(declared))
        hides = actual[0] < first_ns or last_ns < actual[1]
        # A span that is too large hides no messages, and some writers do not compute it exactly.
        if actual == declared or not (hides or repeated == actual):
            return True
        # Some writers write zeros for unknown times.
        if last_ns:
            self._note(segment, actual)
        if not self._places:
            self._places = {other.offset: place for place, other in enumerate(self._segments)}
        self._segments[self._places[segment.offset]] = replace(segment, start_ns=actual[0], end_ns=actual[1])
        self._ordered = []
        return False

    def _note(self, segment: Segment, actual: Span) -> None:
        declared, found = (
            f"{stamp_text(first)} to {stamp_text(last)}" for first, last in ((segment.start_ns, segment.end_ns), actual)
        )
        self._log.note(
            DamageError(
                self._file.with_location(
                    f"the index has log times {declared} for the chunk with data at byte {segment.offset}, "
                    f"its messages have {found}"
                ),
                path=self._file.path,
                hint=RECOVER,
            ),
            offset=segment.offset,
            key="span",
            messages_lost=0,
            first_ns=actual[0],
            last_ns=actual[1],
        )


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


#: For more entries than this, NumPy is faster.
_FEW = 32


class EntryForm(NamedTuple):
    """The layout of a container's index entries, and of the messages that they point to.

    An entry begins with the log time, in the same eight bytes as in the message.

    Attributes
    ----------
    entry
        An entry: eight bytes of time, and the message's place in the chunk.
    identity
        The connection's id in a message.
    id_at, time_at
        Offsets of id and time in a message's record.
    """

    entry: struct.Struct
    identity: struct.Struct
    id_at: int
    time_at: int


class IndexCheck(NamedTuple):
    """The result of comparing index entries with their chunk, except for the number of messages.

    Entries are compared before the chunk is scanned: that is nearly free, since the scan finds the messages' headers
    in the processor's cache. After the scan it costs up to 6 % of a conversion of small messages.

    Attributes
    ----------
    problem
        What is wrong with the entries; None if nothing is.
    total
        How many there are; None if there is no index.
    astray
        How many of them match no message.
    """

    problem: str | None = None
    total: int | None = None
    astray: int = 0

    def trouble(self, found: int | None) -> str | None:
        """Return what is wrong, given the number of messages in the chunk; None if not all were counted."""
        if self.problem is None and self.total is not None and found is not None and self.total != found:
            return f"it has entries for {self.total} messages, the chunk has {found}"
        return self.problem

    def lost(self, found: int | None) -> int | None:
        """Return how many messages of a chunk in trouble are missing.

        That is unknown (None) if the chunk has fewer messages than entries, or if several entries match none: the
        chunk may be another, or have lost some and others twice.
        """
        if self.total is None:
            return 0
        fewer = found is None or found < self.total
        return None if fewer or self.astray > 1 else 0


def count_wrong_entries(records: Buffer, groups: Sequence[tuple[int, Buffer]], form: EntryForm) -> int:
    """Count the wrong entries: those without a message of their connection and time, and repeated ones.

    Parameters
    ----------
    records
        The decompressed records of the chunk.
    groups
        Connection ids, each with all its entries.
    form
        The layout of the entries.
    """
    total = sum(len(entries) for _, entries in groups) // form.entry.size
    return (_count_in_python if total <= _FEW else _count_in_numpy)(records, groups, form)


def _count_in_python(records: Buffer, groups: Sequence[tuple[int, Buffer]], form: EntryForm) -> int:
    entry, identity, id_at, time_at = form.entry, form.identity, form.id_at, form.time_at
    last = len(records) - max(id_at + identity.size, time_at + 8)
    # Usually the entries of a connection are in the order of its messages. Then no entry is repeated.
    for number, entries in groups:
        own = identity.pack(number)
        after = -1
        for time, place in entry.iter_unpack(entries):
            if not (
                after < place <= last
                and records[place + time_at : place + time_at + 8] == time
                and records[place + id_at : place + id_at + identity.size] == own
            ):
                return _count_in_numpy(records, groups, form)
            after = place
    return 0


def _count_in_numpy(records: Buffer, groups: Sequence[tuple[int, Buffer]], form: EntryForm) -> int:
    import numpy as np  # noqa: PLC0415  # only chunks of small messages need it

    size, last = form.entry.size, len(records) - max(form.id_at + form.identity.size, form.time_at + 8)
    if last < 0:
        return sum(len(entries) for _, entries in groups) // size
    entries = np.frombuffer(
        b"".join(part for _, part in groups), np.dtype([("time", "<u8"), ("place", f"<u{size - 8}")])
    )
    counts = [len(part) // size for _, part in groups]
    ids = np.repeat(np.array([number for number, _ in groups], np.uint32), counts)
    inside = entries["place"] <= last
    places = np.where(inside, entries["place"], 0).astype(np.int64)
    # Numbers at every offset of the chunk, aligned or not.
    times = np.ndarray((last + 1,), "<u8", records, form.time_at, (1,))[places]
    owners = np.ndarray((last + 1,), f"<u{form.identity.size}", records, form.id_at, (1,))[places]
    sound = int(np.count_nonzero(inside & (times == entries["time"]) & (owners == ids)))
    if sound < len(entries):
        return len(entries) - sound
    places.sort()
    return int(np.count_nonzero(places[1:] == places[:-1]))
