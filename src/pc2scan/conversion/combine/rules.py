"""Which messages belong to a scan of several messages: pure functions of their stamps.

A rule knows nothing of log times. It is given what is known of the stamps: the messages so far, and for each topic the
first stamp that may still come. It returns the messages of a scan, or that it is not certain yet; and which messages no
later scan needs. Within a topic, messages of equal stamps are in the order of the file.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, ClassVar, TypeAlias

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
    """Each leading message leads a scan, with at most one message of each other topic: the best assignment.

    Of all pairs of a leading message and a message of the other topic that are not farther apart than the window, the
    closest pair is in one scan, then the closest pair of the messages that are left, and so on. Of equally close pairs
    the one with the earlier leading message is first, then the one with the earlier other message; equal stamps are in
    the order of the file. So each message goes to the scan whose stamp is nearest unless that has a nearer one, no
    message is in two scans, and no scan lacks a topic while a message within the window is left.

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
        messages = [leads[0]]
        for source in range(1, len(held)):
            window_ns = self.windows_ns[source]
            is_certain, partner = _partner(leads, held[source], window_ns, coming[0][0], coming[source][0])
            if not is_certain:
                return None
            if partner is not None:
                messages.append(partner)
        return messages

    def needless(self, held: Messages, source: int, first: Key, end_ns: int) -> int:  # noqa: ARG002
        """Return how many messages no scan needs; see `Rule.needless`."""
        return _before(held, (first[0] - self.windows_ns[source], 0) if source else first)


def _partner(
    leads: Messages,
    others: Messages,
    window_ns: int,
    coming_lead_ns: int,
    coming_ns: int,
) -> tuple[bool, SourceMessage | None]:
    """Return whether it is certain which message is in the scan of the first leading message, and that message.

    A pair is in a scan if no closer pair that shares a message with it is. So pairs are judged from the closest one on.
    A pair is in doubt if a message that may still come could make a closer pair with one of its two, or if a closer
    pair that shares one of the two is in doubt.
    """
    first_ns = leads[0].stamp_ns
    begin = bisect_left(others, (first_ns - window_ns, 0), key=KEY)
    at = bisect_left(others, leads[0].key, lo=begin, key=KEY)
    nearest_ns = min((abs(each.stamp_ns - first_ns) for each in others[max(begin, at - 1) : at + 1]), default=None)
    if nearest_ns is None or nearest_ns > window_ns:
        return coming_ns > first_ns + window_ns, None
    if coming_ns < first_ns + nearest_ns:
        return False, None
    pairs = []
    for i, lead in enumerate(leads):
        j = bisect_left(others, (lead.stamp_ns - window_ns, 0), key=KEY)
        while j < len(others) and others[j].stamp_ns <= lead.stamp_ns + window_ns:
            pairs.append((abs(others[j].stamp_ns - lead.stamp_ns), i, j))
            j += 1
    pairs.sort()
    taken: tuple[set[int], set[int]] = (set(), set())
    doubtful: tuple[set[int], set[int]] = (set(), set())
    for distance_ns, i, j in pairs:
        if i in taken[0] or j in taken[1]:
            continue
        may_change = coming_ns < leads[i].stamp_ns + distance_ns or coming_lead_ns < others[j].stamp_ns + distance_ns
        is_certain = not (may_change or i in doubtful[0] or j in doubtful[1])
        if i == 0:
            return is_certain, others[j] if is_certain else None
        one, other = taken if is_certain else doubtful
        one.add(i)
        other.add(j)
    return coming_ns > first_ns + window_ns, None


@dataclass(frozen=True)
class Recent(Rule):
    """A scan has the messages of the last seconds, or the last few messages, up to its leading message.

    Of each other topic, messages with the leading message's own stamp belong to it, too: as many as of the leading
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
