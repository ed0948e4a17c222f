"""Groups messages that belong together: in the order of the recording, within bounds of memory.

A `Grouper` takes one message after the other, and returns the messages of a scan as soon as it is certain which these
are. The result depends only on the order and the times of the messages. A `Rule` has which stamps belong to a scan. Log
times decide only how long a scan waits.

Within a topic, stamps that come are not before those that came. A message is expected within a second of log time: once
another message was logged a second ago, no message with its stamp or an earlier one comes any more, of any topic. So
scans do not depend on the order in which topics are logged, and neither a topic that is silent nor one that begins late
makes anything wait, or be held, for longer.

If the stamps of the leading topic jump, back or ahead, by far more than the log times did, everything begins anew:
messages from before and after it are in no scan together. A message of another topic whose stamp jumps is in no scan.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left, bisect_right, insort
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple, TypeAlias

from pc2scan.errors import UsageError, stamp_text

#: The most bytes of messages that a grouper holds. A scan that is being made may hold as many again.
MAX_HELD_BYTES = 96 << 20

#: Within how much log time messages of equal stamps come, nanoseconds.
_PATIENCE_NS = 1_000_000_000

#: How far the stamps of a topic may go back, nanoseconds: messages that are out of order.
_BACK_NS = 1_000_000_000

#: How far the stamps of two topics of one clock may differ when they are logged, nanoseconds; slow drivers delay
#: messages. And how much faster than log times stamps may go on: recordings are played faster and recorded again.
_APART_NS = 2_000_000_000
_FASTER = 10

#: Places before and after all others.
_BEFORE_ALL: Key = (-1 << 80, 0)
_AFTER_ALL: Key = (1 << 80, 0)


class Run(NamedTuple):
    """Messages in a row: the stamps of the first and the last, and their number."""

    first_stamp_ns: int
    last_stamp_ns: int
    number: int


@dataclass(slots=True)
class SourceCounts:
    """Counts of the messages of a topic that become scans together with others.

    Attributes
    ----------
    messages, used, unmatched
        All messages, those in a scan, and those in no scan.
    scans_without, edges
        Scans without a message of this topic, and whether the first and the last one are.
    longest_unmatched
        The longest run of messages in no scan; None without any.
    jumped
        How many stamps do not continue those before.
    first_jump
        The first of these stamps, and how much further the stamps went than the log times, nanoseconds; negative: back.
    """

    messages: int = 0
    used: int = 0
    unmatched: int = 0
    scans_without: int = 0
    longest_unmatched: Run | None = None
    jumped: int = 0
    first_jump: tuple[int, int] = field(default=(0, 0), repr=False)
    edges: Sequence[bool] = field(default=(), repr=False)
    _unmatched: Run | None = field(default=None, repr=False, compare=False)

    def let_go(self, stamp_ns: int, *, used: bool) -> None:
        """Count a message that no later scan has."""
        if used:
            self._unmatched = None
            return
        self.unmatched += 1
        first_ns, _, number = self._unmatched or (stamp_ns, stamp_ns, 0)
        self._unmatched = Run(first_ns, stamp_ns, number + 1)
        if self.longest_unmatched is None or number + 1 > self.longest_unmatched.number:
            self.longest_unmatched = self._unmatched


class _Moment(NamedTuple):
    """The stamp and the log time of a message, nanoseconds."""

    stamp_ns: int
    log_time_ns: int

    def follows(self, other: _Moment, back_ns: int, apart_ns: int) -> bool:
        """Whether the stamp is not much further on than the log times are, nor before that of an earlier message."""
        further_ns = self.stamp_ns - other.stamp_ns
        return -back_ns <= further_ns <= apart_ns + _FASTER * max(0, self.log_time_ns - other.log_time_ns)


class Group(NamedTuple):
    """The messages of one scan: the one whose time the scan has, and all of them, sorted by source and stamp."""

    lead: SourceMessage
    members: Sequence[SourceMessage]


class Grouper:
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
        self._apart_ns = _APART_NS + apart_ns
        self._patience_ns = _PATIENCE_NS + apart_ns
        #: The last message of each topic, also of those that jump.
        self._last: list[_Moment | None] = [None] * sources
        self._begin()

    def _begin(self) -> None:
        """Begin anew: nothing is held."""
        sources = len(self.counts)
        #: Bytes of the messages that are held.
        self._size = 0
        self._held: list[list[SourceMessage]] = [[] for _ in range(sources)]
        #: The leading messages of the scans that are not made yet, sorted.
        self._leads: list[SourceMessage] = []
        #: The last message of all topics, and that of each.
        self._newest: _Moment | None = None
        self._own: list[_Moment | None] = [None] * sources
        #: The first place of each topic that a message may still come for.
        self._coming: list[Key] = [_BEFORE_ALL] * sources
        #: The highest stamps of the last second of log time, both times rising.
        self._recent: deque[_Moment] = deque()
        self._highest = _Moment(*_BEFORE_ALL)
        #: Where the first interval begins, and the end of the last one whose scan is made.
        self._begin_ns: int | None = None
        self._over: Key = _BEFORE_ALL

    def add(self, source: int, stamp_ns: int, log_time_ns: int, size: int, item: Any) -> list[Group]:
        """Take the next message, and return the groups that are complete now.

        Raises
        ------
        UsageError
            If the messages of one scan take more than `MAX_HELD_BYTES`.
        """
        counts, moment = self.counts[source], _Moment(stamp_ns, log_time_ns)
        counts.messages += 1
        last, self._last[source] = self._last[source], moment
        groups: list[Group] = []
        if not self._continues(source, moment):
            if last is not None and not moment.follows(last, _BACK_NS, _APART_NS):
                counts.jumped += 1
                if counts.jumped == 1:
                    counts.first_jump = stamp_ns, stamp_ns - last.stamp_ns - log_time_ns + last.log_time_ns
            if source:
                counts.let_go(stamp_ns, used=False)
                return groups
            groups = self.finish()
            self._begin()
        self._hold(source, moment, size, item)
        groups += self._closed(log_time_ns)
        if self._size > MAX_HELD_BYTES:
            groups += self._relieved(stamp_ns)
        return groups

    def finish(self) -> list[Group]:
        """Return the groups that are still open, and forget everything."""
        groups = []
        while self._leads:
            groups.append(self._close_now())
        for source, held in enumerate(self._held):
            self._drop(source, len(held))
        return groups

    def _continues(self, source: int, moment: _Moment) -> bool:
        """Whether a message is of the same clock: it follows the last one of its topic; the first one, any topic's."""
        if (own := self._own[source]) is not None:
            return moment.follows(own, _BACK_NS, self._apart_ns)
        return self._newest is None or moment.follows(self._newest, self._apart_ns, self._apart_ns)

    def _hold(self, source: int, moment: _Moment, size: int, item: Any) -> None:
        """Hold a message."""
        stamp_ns, log_time_ns = moment
        held = self._held[source]
        # Nearly every stamp is after those before.
        end = bisect_left(held, (stamp_ns + 1, 0), key=KEY) if held and held[-1].key[0] > stamp_ns else len(held)
        number = held[end - 1].key[1] + 1 if end and held[end - 1].key[0] == stamp_ns else 0
        key = (stamp_ns, number)
        entry = SourceMessage(source, key, log_time_ns, size, item)
        held.insert(end, entry)
        self._size += size
        if self._coming[source] <= key:
            self._coming[source] = (stamp_ns, number + 1)
        self._own[source] = self._newest = moment
        if stamp_ns > self._highest.stamp_ns:
            self._highest = moment
            self._recent.append(moment)
        if source == 0:
            self._lead(entry)

    def _lead(self, entry: SourceMessage) -> None:
        """Take a message of the leading topic: it leads a scan, or one with the others of its interval."""
        if self._begin_ns is None:
            self._begin_ns = self._rule.begin_ns(entry.key[0])
        if self._rule.every_ns:
            if entry.key < self._over:
                return
            entry.end_ns = self._rule.end_ns(entry.key[0], self._begin_ns)
            for number, same in enumerate(self._leads):
                if same.end_ns == entry.end_ns:
                    if same.key < entry.key:
                        entry.since_ns = same.since_ns
                        self._leads[number] = entry
                    return
        insort(self._leads, entry, key=KEY)

    def _closed(self, log_time_ns: int) -> list[Group]:
        """Return the scans that are certain by now, and forget what no other scan needs."""
        past: _Moment | None = None
        while self._recent and log_time_ns - self._recent[0].log_time_ns > self._patience_ns:
            past = self._recent.popleft()
        if past is not None:
            self._coming = [max(first, (past.stamp_ns + 1, 0)) for first in self._coming]
        groups: list[Group] = []
        longest_ns = self._patience_ns + self._rule.reach_ns
        while self._leads:
            members = self._rule.members(self._leads, self._held, self._coming)
            if members is not None:
                groups.append(self._close(members))
            elif log_time_ns - max(self._leads[0].since_ns, self._highest.log_time_ns) > longest_ns:
                # Stamps do not go on with the log times, so nothing becomes certain by them.
                groups.append(self._close_now())
            else:
                break
        self._forget()
        return groups

    def _relieved(self, stamp_ns: int) -> list[Group]:
        """Free memory; return the groups that are closed for that."""
        if self._rule.gathers:
            raise UsageError(
                f"the points of {sum(map(len, self._held))} messages up to the stamp {stamp_text(stamp_ns)} are held "
                f"for one scan, which takes more than {MAX_HELD_BYTES >> 20} MiB",
                hint="give `accumulate` or `every` less time, or select points with `where`, `exclude_box` and such",
            )
        # The groups close with the messages that they have now; later ones are unmatched.
        groups = []
        while self._size > MAX_HELD_BYTES and self._leads:
            groups.append(self._close_now())
            self._forget()
        return groups

    def _close_now(self) -> Group:
        """Make the group of the first leading message with the messages that are there."""
        members = self._rule.members(self._leads, self._held, [_AFTER_ALL] * len(self._coming))
        assert members is not None  # nothing comes after all
        return self._close(members)

    def _close(self, members: Sequence[SourceMessage]) -> Group:
        """Make the group of the first leading message."""
        lead = self._leads.pop(0)
        if self._rule.every_ns:
            self._over = (lead.end_ns, 0)
        sources = {entry.source for entry in members}
        for source, counts in enumerate(self.counts):
            counts.scans_without += source not in sources
            counts.edges = [*counts.edges[:1], source not in sources]
        for entry in members:
            self.counts[entry.source].used += not entry.used
            entry.used = True
            if not self._rule.gathers:
                held = self._held[entry.source]
                del held[bisect_left(held, entry.key, key=KEY)]
                self._let_go(entry)
        return Group(lead, members)

    def _forget(self) -> None:
        """Drop the messages that no scan needs."""
        if self._leads:
            first, end_ns = self._leads[0].key, self._leads[0].end_ns
        else:
            first, end_ns = max(self._coming[0], self._over), 0
            if self._rule.every_ns:
                begin_ns = self._rule.begin_ns(first[0]) if self._begin_ns is None else self._begin_ns
                end_ns = self._rule.end_ns(first[0], begin_ns)
        for source, held in enumerate(self._held):
            if count := self._rule.needless(held, source, first, end_ns):
                self._drop(source, count)

    def _drop(self, source: int, count: int) -> None:
        """Drop the first messages of a topic."""
        held = self._held[source]
        for entry in held[:count]:
            self._let_go(entry)
        del held[:count]

    def _let_go(self, entry: SourceMessage) -> None:
        """Count a message that is not held any more."""
        self._size -= entry.size
        self.counts[entry.source].let_go(entry.key[0], used=entry.used)


#: The place of a message in its topic: its stamp, nanoseconds, and its number among those with the same stamp.
Key: TypeAlias = tuple[int, int]

KEY = attrgetter("key")


@dataclass(slots=True, eq=False)
class SourceMessage:
    """A message that is held because a scan may need it.

    Attributes
    ----------
    source
        The number of its topic; topic 0 leads.
    key
        Its place in its topic.
    since_ns
        Since when its scan waits, if it leads: its log time, or that of the first leading message of its interval.
    end_ns
        The end of the interval that it is in, if it leads.
    size
        Its size, bytes.
    item
        The message.
    used
        Whether it is in a scan.
    """

    source: int
    key: Key
    since_ns: int
    size: int
    item: Any
    used: bool = False
    end_ns: int = 0

    @property
    def stamp_ns(self) -> int:
        """Its stamp."""
        return self.key[0]


#: Messages of a topic, sorted.
Messages: TypeAlias = Sequence[SourceMessage]


@dataclass(frozen=True)
class Rule(ABC):
    """Which messages lead scans, and which messages belong to a scan.

    Attributes
    ----------
    every_ns
        The length of an interval, of whose leading messages the last one leads a scan; 0: each leads one.
    begins_before_ns
        How long before the first leading message an interval begins.
    gathers
        Whether a scan has all messages of a time. Otherwise it has one of each topic, which is in no other scan.
    """

    every_ns: int = 0
    begins_before_ns: int = 0
    gathers: ClassVar[bool] = True

    @property
    def reach_ns(self) -> int:
        """How far after its leading message's stamp the stamps are on which a scan may depend."""
        return self.every_ns

    def begin_ns(self, first_ns: int) -> int:
        """Return where an interval begins, given the first stamp of the leading topic."""
        return first_ns - self.begins_before_ns

    def end_ns(self, stamp_ns: int, begin_ns: int) -> int:
        """Return the end of the interval that a stamp is in; the end itself is in the next one."""
        return stamp_ns + self.every_ns - (stamp_ns - begin_ns) % self.every_ns

    @abstractmethod
    def members(self, leads: Messages, held: Sequence[Messages], coming: Sequence[Key]) -> Messages | None:
        """Return the messages of the first scan that is to be made, sorted by topic and stamp.

        Parameters
        ----------
        leads
            The leading messages of the scans that are not made yet, sorted.
        held
            The messages of each topic, sorted.
        coming
            The first place of each topic that a message may still come for.

        Returns
        -------
        list of SourceMessage or None
            None if messages that may still come would change it.
        """

    @abstractmethod
    def needless(self, held: Messages, source: int, first: Key, end_ns: int) -> int:
        """Return how many of a topic's first messages no scan needs that is led from a place on.

        Parameters
        ----------
        held
            The messages of the topic, sorted.
        source
            The topic's number.
        first
            The first place of the leading topic that a scan may still be led from.
        end_ns
            The end of the interval that this place is in.
        """


@dataclass(frozen=True)
class Nearest(Rule):
    """Each leading message leads a scan, with the nearest message of each other topic.

    A message that is nearer to a later leading message is left to that, so no message is in two scans. If two are
    equally near, the earlier is taken; equal stamps are in the order of the file.

    Attributes
    ----------
    windows_ns
        The window of each topic, nanoseconds, which itself is within it. That of the leading topic is ignored.
    """

    windows_ns: tuple[int, ...] = ()
    gathers: ClassVar[bool] = False

    @property
    def reach_ns(self) -> int:
        """Twice the window: another leading message may be as far on the other side of a message within it."""
        return 2 * max(self.windows_ns[1:], default=0)

    def members(self, leads: Messages, held: Sequence[Messages], coming: Sequence[Key]) -> Messages | None:
        """Return the messages of the first scan; see `Rule.members`."""
        lead_ns, messages = leads[0].stamp_ns, [leads[0]]
        next_ns = next((lead.stamp_ns for lead in leads if lead.stamp_ns > lead_ns), None)
        for own, window_ns, (coming_ns, _) in zip(held[1:], self.windows_ns[1:], coming[1:], strict=True):
            begin = bisect_left(own, (lead_ns - window_ns, 0), key=KEY)
            within = own[begin : bisect_left(own, (lead_ns + window_ns + 1, 0), key=KEY)]
            if next_ns is not None:
                within = [
                    message for message in within if abs(message.stamp_ns - next_ns) >= abs(message.stamp_ns - lead_ns)
                ]
            partner = min(within, key=lambda message: abs(message.stamp_ns - lead_ns), default=None)
            if partner is None:
                if coming_ns <= lead_ns + window_ns:
                    return None
                continue
            apart_ns = abs(partner.stamp_ns - lead_ns)
            # A nearer message of the other topic may still come, or a leading message that is nearer to this one.
            if coming_ns < lead_ns + apart_ns or coming[0][0] < partner.stamp_ns + apart_ns:
                return None
            messages.append(partner)
        return messages

    def needless(self, held: Messages, source: int, first: Key, end_ns: int) -> int:  # noqa: ARG002
        """Return how many messages no scan needs; see `Rule.needless`."""
        return _before(held, (first[0] - self.windows_ns[source], 0) if source else first)


@dataclass(frozen=True)
class Recent(Rule):
    """A scan has the messages of the last seconds, or the last few messages, up to its leading message.

    Messages of other topics with the leading message's own stamp belong to it, too: as many as of the leading
    topic, in the order of the file.

    Attributes
    ----------
    span_ns
        A scan has the messages whose stamps are less than this long before its leading message's.
    count
        A scan has at most this many messages of each topic, the last ones; 0: all within ``span_ns``.
    """

    span_ns: int = 0
    count: int = 0

    def members(self, leads: Messages, held: Sequence[Messages], coming: Sequence[Key]) -> Messages | None:
        """Return the messages of the first scan; see `Rule.members`."""
        last = leads[0].key
        if self.every_ns and coming[0] < (leads[0].end_ns, 0):
            return None
        for place in coming:
            if place <= last:
                return None
        messages: list[SourceMessage] = []
        for own in held:
            end = bisect_right(own, last, key=KEY)
            begin = max(0, end - self.count) if self.count else _before(own, (last[0] - self.span_ns + 1, 0))
            messages += own[begin:end]
        return messages

    def needless(self, held: Messages, source: int, first: Key, end_ns: int) -> int:  # noqa: ARG002
        """Return how many messages no scan needs; see `Rule.needless`."""
        if self.count:
            return max(0, bisect_right(held, first, key=KEY) - self.count) if len(held) > self.count else 0
        return _before(held, (first[0] - self.span_ns + 1, 0))


@dataclass(frozen=True)
class Interval(Rule):
    """A scan has the messages of an interval that has a leading message; the last of these leads it."""

    def members(self, leads: Messages, held: Sequence[Messages], coming: Sequence[Key]) -> Messages | None:
        """Return the messages of the first scan; see `Rule.members`."""
        begin, end = (leads[0].end_ns - self.every_ns, 0), (leads[0].end_ns, 0)
        for place in coming:
            if place < end:
                return None
        messages: list[SourceMessage] = []
        for own in held:
            messages += own[bisect_left(own, begin, key=KEY) : bisect_left(own, end, key=KEY)]
        return messages

    def needless(self, held: Messages, source: int, first: Key, end_ns: int) -> int:  # noqa: ARG002
        """Return how many messages no scan needs; see `Rule.needless`."""
        return _before(held, (end_ns - self.every_ns, 0))


def _before(held: Messages, place: Key) -> int:
    """Return how many messages are before a place; mostly none is."""
    return bisect_left(held, place, key=KEY) if held and held[0].key < place else 0
