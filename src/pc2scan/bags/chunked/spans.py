"""The log times that an index declares for chunks, compared with what lies in the chunks and behind them.

A wrong time hides messages: chunks that a cut does not touch are never read. To compare them all would take longer
than the rest of a cut. So those are compared whose times matter: the first and the last chunk, from which ``--start``
and ``--end`` count, the chunks beside a cut, and those whose times cannot be. The records behind a chunk repeat the
times of its messages. Where these disagree with the index, the chunk itself decides.
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

__all__ = ["SpanCheck", "beside_cut"]


class SpanCheck:
    """Corrects the declared times of segments, and notes those that are wrong.

    Parameters
    ----------
    segments
        All of a file. Those with wrong times are replaced in this list.
    repeated
        Returns the times that the records behind a chunk have; None if there are none, or if they are malformed.
    contained
        Returns the times of the messages in a chunk, which it reads; None if there are none, or if it is damaged.
    file
        The file.
    log
        Takes note of wrong times.
    trusted
        Whether a checksum holds for the declared times. Only those that cannot be are looked into then.
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
        """Compare the chunk that begins first and the one that ends last with the records behind them."""
        if self._trusted or not self._segments:
            return
        if not self._confirm_repeated(min(self._segments, key=attrgetter("start_ns"))):
            # Those with wrong times move up, until one comes first that is right.
            any(map(self._confirm_repeated, sorted(self._segments, key=attrgetter("start_ns"))))
        if not self._confirm_repeated(max(self._segments, key=attrgetter("end_ns"))):
            any(map(self._confirm_repeated, sorted(self._segments, key=attrgetter("end_ns"), reverse=True)))

    def compare_beside(self, ids: frozenset[int] | None, start_ns: int | None, stop_ns: int | None) -> None:
        """Compare the chunks beside a cut that can have messages of these connections (None: of any)."""
        if self._trusted or (start_ns is None and stop_ns is None):
            return
        self._ordered = self._ordered or sorted(self._segments, key=attrgetter("offset"))
        for segment in list(beside_cut(self._ordered, start_ns, stop_ns)):
            if segment.may_hold(ids, None, None):
                self._confirm(segment)

    def _confirm_repeated(self, segment: Segment) -> bool:
        """Do the same, but read no chunk to open a file that does not repeat the times."""
        return self._repeated(segment) is None or self._confirm(segment)

    def _confirm(self, segment: Segment) -> bool:
        """Compare a segment's times once; returns whether they are right."""
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
        # Times of a larger stretch do no harm, and who wrote them may have known no better.
        if actual == declared or not (hides or repeated == actual):
            return True
        # Zeros are of a writer that did not know.
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
    """Find the segments that a cut leaves out, while it does not leave out the one in front of them or behind them.

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
