"""Compares the log times that an index declares for chunks with those in the chunks and their index records.

A wrong time would hide messages, because a cut reads only chunks within its times. Comparing all chunks would take
longer than the cut itself, so only some are compared: the first and the last chunk, from which ``start`` and
``end`` count, the chunks next to a cut, and those with impossible times. The index records after a chunk repeat the
times of its messages. If these differ from the index, the chunk itself is read.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from operator import attrgetter
from typing import TYPE_CHECKING

from pc2scan.bags.damage import RECOVER
from pc2scan.errors import DamageError, stamp_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from pc2scan.bags.chunked.segments import Segment
    from pc2scan.bags.damage import DamageLog
    from pc2scan.files.source import SourceFile

    #: The first and the last log time.
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
                self._file.located(
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
