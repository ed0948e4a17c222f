"""Groups messages that belong together: in the order of the recording, within bounds of memory.

A `Grouper` takes one message after the other, and returns the messages of a scan as soon as it is certain which these
are. The result depends only on the order and the times of the messages. `rules` has which stamps belong to a scan,
`series` when that is certain and what can be forgotten.

A stamp that jumps, back or ahead, by far more than the log times did, begins another series: messages from before and
after it are in no scan together, and the messages that still come from before it continue theirs.
"""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING, Generic, TypeVar

from pc2scan.errors import UsageError, stamp_text

from .counts import SourceCounts
from .series import Group, MessageTime, Series, drift_ns, follows

if TYPE_CHECKING:
    from .rules import Rule

Item = TypeVar("Item")

#: The most bytes of messages that a grouper holds. A scan that is being made may hold as many again.
MAX_HELD_BYTES = 96 << 20

#: A series ends when nothing has continued it for this long, nanoseconds of log time, and another one has begun; and
#: how many there are at most.
_SILENCE_NS = 10_000_000_000
_MOST_SERIES = 4


class Grouper(Generic[Item]):
    """Collects messages into groups.

    Parameters
    ----------
    rule
        Which messages belong to a scan.
    sources
        The number of topics; topic 0 leads.
    apart_ns
        How far the clocks of two topics differ at most, nanoseconds, if the user knows of it.

    Attributes
    ----------
    counts
        The counts of each topic.
    """

    def __init__(self, rule: Rule, sources: int, *, apart_ns: int = 0) -> None:
        self.counts = [SourceCounts() for _ in range(sources)]
        self._rule = rule
        self._apart_ns = apart_ns
        self._open: list[Series[Item]] = []
        #: Of each topic, the series of the last message, and its times.
        self._series: list[Series[Item] | None] = [None] * sources
        self._last: list[MessageTime | None] = [None] * sources

    def add(self, source: int, stamp_ns: int, log_time_ns: int, size: int, item: Item) -> list[Group[Item]]:
        """Take the next message, and return the groups that are complete now.

        Raises
        ------
        UsageError
            If the messages of one scan take more than `MAX_HELD_BYTES`.
        """
        self.counts[source].messages += 1
        moment = MessageTime(stamp_ns, log_time_ns)
        series = self._continued(source, moment)
        series.add(source, moment, size, item)
        if len(self._open) == 1:
            groups = series.closed(log_time_ns)
            held = series.size
        else:
            groups = [group for each in self._open for group in each.closed(log_time_ns)]
            groups += self._ended(series, log_time_ns)
            held = sum(each.size for each in self._open)
        if held > MAX_HELD_BYTES:
            groups += self._relieved(series, stamp_ns)
        return groups

    def finish(self) -> list[Group[Item]]:
        """Return the groups that are still open."""
        groups = [group for each in self._open for group in each.finish()]
        self._open.clear()
        return groups

    def _continued(self, source: int, moment: MessageTime) -> Series[Item]:
        """Return the series that a message belongs to; count a jump if its topic's stamps do not go on."""
        before, last = self._series[source], self._last[source]
        found, least = None, None
        for each in self._open:
            far_ns = each.strays_ns(source, moment)
            if far_ns is not None:
                # Of several series of its clock that of the leading topic, because the others have no scans.
                order = (far_ns, each is not self._series[0])
                if least is None or order < least:
                    found, least = each, order
        if found is None:
            found = Series(self._rule, self.counts, self._apart_ns, moment)
            self._open.append(found)
        if last is not None and found is not before and not follows(moment, last):
            self.counts[source].jump(moment.stamp_ns, drift_ns(moment, last))
        self._series[source], self._last[source] = found, moment
        return found

    def _ended(self, current: Series[Item], log_time_ns: int) -> list[Group[Item]]:
        """End the series that nothing continues; return their groups."""
        groups: list[Group[Item]] = []
        for each in sorted(self._open, key=attrgetter("newest.log_time_ns")):
            silent_ns = log_time_ns - each.newest.log_time_ns
            if each is not current and (silent_ns > _SILENCE_NS or len(self._open) > _MOST_SERIES):
                groups += each.finish()
                self._open.remove(each)
        return groups

    def _relieved(self, current: Series[Item], stamp_ns: int) -> list[Group[Item]]:
        """Free memory; return the groups that are closed for that."""
        groups: list[Group[Item]] = []
        for each in self._open[:]:
            if each is not current:
                groups += each.finish()
                self._open.remove(each)
        if current.size > MAX_HELD_BYTES and self._rule.gathers:
            raise UsageError(
                f"the points of {current.held} messages up to the stamp {stamp_text(stamp_ns)} are held for one scan, "
                f"which takes more than {MAX_HELD_BYTES >> 20} MiB",
                hint="give `accumulate` or `every` less time, or select points with `where`, `exclude_box` and such",
            )
        # The groups close with the messages that they have now; later ones are unmatched.
        while current.size > MAX_HELD_BYTES and (group := current.relieved()) is not None:
            groups.append(group)
        if current.size > MAX_HELD_BYTES:
            groups += current.finish()
        return groups
