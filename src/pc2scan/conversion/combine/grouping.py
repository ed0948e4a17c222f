"""Groups messages that belong together: in the order of the recording, within bounds of memory.

A `Grouper` takes one message after the other, and returns the messages of a scan as soon as it is certain which these
are. The result depends only on the order and the times of the messages. `rules` has which stamps belong to a scan. Log
times decide only how long a scan waits.

A `Series` has messages whose stamps are of one clock. Within a topic, stamps that come are not before those that came.
A message is expected within a second of log time: once another message was logged a second ago, no message with its
stamp or an earlier one comes any more, of any topic. So scans do not depend on the order in which topics are logged,
and neither a topic that is silent nor one that begins late makes anything wait, or be held, for longer.

A stamp that jumps, back or ahead, by far more than the log times did, begins another series: messages from before and
after it are in no scan together, and the messages that still come from before it continue theirs.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from pc2scan.errors import UsageError, stamp_text

from .counts import NO_RUN, SourceCounts
from .rules import KEY, SourceMessage

if TYPE_CHECKING:
    from .rules import Key, Rule

Item = TypeVar("Item")

#: The most bytes of messages that a grouper holds. A scan that is being made may hold as many again.
MAX_HELD_BYTES = 96 << 20

#: A series ends when nothing has continued it for this long, nanoseconds of log time, and another one has begun; and
#: how many there are at most.
_SILENCE_NS = 10_000_000_000
_MOST_SERIES = 4

#: Within how much log time messages of equal stamps come, nanoseconds.
PATIENCE_NS = 1_000_000_000

#: How far the stamps of a topic may go back, nanoseconds: messages that are out of order.
_BACK_NS = 1_000_000_000

#: How far the stamps of two topics of one clock may differ when they are logged, nanoseconds; slow drivers delay
#: messages. And how much faster than log times stamps may go on: recordings are played faster and recorded again.
_APART_NS = 2_000_000_000

_FASTER = 10

#: Places before and after all others.
_BEFORE_ALL: Key = (-1 << 80, 0)

_AFTER_ALL: Key = (1 << 80, 0)


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


class MessageTime(NamedTuple):
    """The stamp and the log time of a message, nanoseconds."""

    stamp_ns: int
    log_time_ns: int


@dataclass(frozen=True, slots=True)
class Group(Generic[Item]):
    """The messages of one scan: the one whose time the scan has, and all of them, sorted by source and stamp."""

    lead: SourceMessage[Item]
    members: tuple[SourceMessage[Item], ...]


def drift_ns(one: MessageTime, other: MessageTime) -> int:
    """Return how much further stamps went than log times, from another message to one; negative: back."""
    return one.stamp_ns - other.stamp_ns - one.log_time_ns + other.log_time_ns


def follows(one: MessageTime, other: MessageTime, back_ns: int = _BACK_NS, apart_ns: int = _APART_NS) -> bool:
    """Whether a message continues another one: its stamp is not much further on than the log times are, nor before it.

    Parameters
    ----------
    one, other
        The message that may continue, and an earlier one.
    back_ns, apart_ns
        How far its stamp may go back, and ahead, compared with the log times.
    """
    further_ns = one.stamp_ns - other.stamp_ns
    return -back_ns <= further_ns <= apart_ns + _FASTER * max(0, one.log_time_ns - other.log_time_ns)


class Series(Generic[Item]):
    """A series of messages whose stamps are of one clock.

    Parameters
    ----------
    rule
        Which messages belong to a scan.
    counts
        The counts of each topic, which several series share.
    apart_ns
        How far the clocks of two topics differ, if that is known.
    first
        The times of the first message.

    Attributes
    ----------
    size
        Bytes of the messages that are held.
    newest
        The times of the message that was logged last.
    """

    def __init__(self, rule: Rule, counts: list[SourceCounts], apart_ns: int, first: MessageTime) -> None:
        self.size = 0
        self.newest = first
        self._rule = rule
        self._counts = counts
        self._apart_ns = _APART_NS + apart_ns
        self._patience_ns = PATIENCE_NS + apart_ns
        #: How long a scan waits if stamps do not go on.
        self._longest_ns = self._patience_ns + rule.reach_ns
        self._held: list[list[SourceMessage[Item]]] = [[] for _ in counts]
        #: The leading messages of the scans that are not made yet, sorted.
        self._leads: list[SourceMessage[Item]] = []
        self._last: list[MessageTime | None] = [None] * len(counts)
        #: The first place of each topic that a message may still come for.
        self._coming: list[Key] = [_BEFORE_ALL] * len(counts)
        #: The highest stamps of the last second of log time, both times rising; and the highest of all.
        self._recent = deque([first])
        self._highest = first
        #: Of each topic, the scans without it, and the messages in no scan, that came last in a row.
        self._silence = [NO_RUN for _ in counts]
        self._left = [NO_RUN for _ in counts]
        self._begin_ns: int | None = None
        #: The end of the last interval whose scan is made.
        self._over: Key = _BEFORE_ALL

    def strays_ns(self, source: int, moment: MessageTime) -> int | None:
        """Return how far a message is off this series: 0 for one of its clock, None for one that does not continue it.

        It continues the series if it follows the last message of its topic, or that of any topic.
        """
        own, newest, apart_ns = self._last[source], self.newest, self._apart_ns
        if own is not None and moment.stamp_ns < own.stamp_ns - _BACK_NS:
            return None
        # Nearly every message is of the clock of the one before, and there may be thousands in a second.
        if -apart_ns <= drift_ns(moment, newest) <= apart_ns:
            return 0
        known = (newest,) if own is None else (newest, own)
        off = [abs(drift_ns(moment, each)) for each in known if follows(moment, each, apart_ns, apart_ns)]
        return max(0, min(off) - apart_ns) if off else None

    def add(self, source: int, moment: MessageTime, size: int, item: Item) -> None:
        """Take a message, which was logged after those before."""
        stamp_ns, log_time_ns = moment
        held = self._held[source]
        # Nearly every stamp is after those before.
        end = bisect_left(held, (stamp_ns + 1, 0), key=KEY) if held and held[-1].key[0] > stamp_ns else len(held)
        number = held[end - 1].key[1] + 1 if end and held[end - 1].key[0] == stamp_ns else 0
        key = (stamp_ns, number)
        entry = SourceMessage(source, key, log_time_ns, size, item)
        held.insert(end, entry)
        self.size += size
        if self._coming[source] <= key:
            self._coming[source] = (stamp_ns, number + 1)
        self._last[source] = self.newest = moment
        if stamp_ns > self._highest.stamp_ns:
            self._highest = moment
            self._recent.append(moment)
        if source == 0:
            self._lead(entry)

    def closed(self, log_time_ns: int) -> list[Group[Item]]:
        """Return the scans that are certain by now, and forget what no other scan needs."""
        past: MessageTime | None = None
        while self._recent and log_time_ns - self._recent[0].log_time_ns > self._patience_ns:
            past = self._recent.popleft()
        if past is not None:
            place = (past.stamp_ns + 1, 0)
            for source, each in enumerate(self._coming):
                if each < place:
                    self._coming[source] = place
        groups: list[Group[Item]] = []
        while self._leads:
            members = self._rule.members(self._leads, self._held, self._coming)
            if members is not None:
                groups.append(self._close(members))
            elif log_time_ns - max(self._leads[0].since_ns, self._highest.log_time_ns) > self._longest_ns:
                # Stamps do not go on with the log times, so nothing becomes certain by them.
                groups.append(self._close_now())
            else:
                break
        self._forget()
        return groups

    def relieved(self) -> Group[Item] | None:
        """Close the first scan with the messages that it has now, and forget what no other needs; None without any."""
        if not self._leads:
            return None
        group = self._close_now()
        self._forget()
        return group

    def finish(self) -> list[Group[Item]]:
        """Return all scans that are open, and forget everything."""
        groups = []
        while (group := self.relieved()) is not None:
            groups.append(group)
        for source, held in enumerate(self._held):
            self._drop(source, len(held))
        return groups

    @property
    def held(self) -> int:
        """How many messages are held."""
        return sum(map(len, self._held))

    def _lead(self, entry: SourceMessage[Any]) -> None:
        """Take a message of the leading topic: it leads a scan, or one with the others of its interval."""
        if self._begin_ns is None:
            self._begin_ns = self._rule.begin_ns(entry.stamp_ns)
        if self._rule.every_ns:
            if entry.key < self._over:
                return
            entry.end_ns = self._end_ns(entry.stamp_ns)
            for number, same in enumerate(self._leads):
                if same.end_ns == entry.end_ns:
                    if same.key < entry.key:
                        entry.since_ns = same.since_ns
                        self._leads[number] = entry
                    return
        insort(self._leads, entry, key=KEY)

    def _end_ns(self, stamp_ns: int) -> int:
        """Return the end of the interval that a stamp is in."""
        begin_ns = self._rule.begin_ns(stamp_ns) if self._begin_ns is None else self._begin_ns
        return self._rule.end_ns(stamp_ns, begin_ns)

    def _close_now(self) -> Group[Item]:
        """Make the group of the first leading message with the messages that are there."""
        members = self._rule.members(self._leads, self._held, [_AFTER_ALL] * len(self._coming))
        assert members is not None  # nothing comes after all
        return self._close(members)

    def _close(self, members: list[SourceMessage[Item]]) -> Group[Item]:
        """Make the group of the first leading message."""
        lead = self._leads.pop(0)
        if self._rule.every_ns:
            self._over = (lead.end_ns, 0)
        there = {entry.source for entry in members}
        for source, counts in enumerate(self._counts):
            self._silence[source] = NO_RUN if source in there else counts.lack(lead.stamp_ns, self._silence[source])
        for entry in members:
            if not entry.used:
                entry.used = True
                self._counts[entry.source].used += 1
        if not self._rule.gathers:
            for entry in members:
                held = self._held[entry.source]
                at = bisect_left(held, entry.key, key=KEY)
                del held[at]
                self._let_go(entry)
        return Group(lead, tuple(members))

    def _forget(self) -> None:
        """Drop the messages that no scan needs."""
        if self._leads:
            first, end_ns = self._leads[0].key, self._leads[0].end_ns
        else:
            first = max(self._coming[0], self._over)
            end_ns = self._end_ns(first[0]) if self._rule.every_ns else 0
        for source, held in enumerate(self._held):
            if count := self._rule.needless(held, source, first, end_ns):
                self._drop(source, count)

    def _drop(self, source: int, count: int) -> None:
        """Drop the first messages of a topic."""
        held = self._held[source]
        for entry in held[:count]:
            self._let_go(entry)
        del held[:count]

    def _let_go(self, entry: SourceMessage[Item]) -> None:
        """Count a message that is not held any more."""
        source = entry.source
        self.size -= entry.size
        self._left[source] = NO_RUN if entry.used else self._counts[source].leave(entry.stamp_ns, self._left[source])
