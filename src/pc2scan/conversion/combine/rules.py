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
    """Each leading message leads a scan, with the nearest message of each other topic.

    A message that is nearer to a later leading message is left to that, so no message is in two scans. Of equally near
    ones, the earlier is taken; equal stamps are in the order of the file.

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
        next_ns = next((each.stamp_ns for each in leads if each.stamp_ns > lead_ns), None)
        for own, window_ns, (coming_ns, _) in zip(held[1:], self.windows_ns[1:], coming[1:], strict=True):
            begin = bisect_left(own, (lead_ns - window_ns, 0), key=KEY)
            within = own[begin : bisect_left(own, (lead_ns + window_ns + 1, 0), key=KEY)]
            if next_ns is not None:
                within = [each for each in within if abs(each.stamp_ns - next_ns) >= abs(each.stamp_ns - lead_ns)]
            partner = min(within, key=lambda each: abs(each.stamp_ns - lead_ns), default=None)
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
