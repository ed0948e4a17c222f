"""Groups messages that belong together: by their stamps, in the order of the recording, within bounds of memory.

A grouper takes one message after the other and returns a group as soon as no later message can change it. The result
depends only on the order and the times of the messages. Stamps decide which messages are in a group. Log times decide
only how long a group waits, so it makes no difference which of two messages of different topics was logged first.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left, bisect_right, insort
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, Generic, TypeVar

from pc2scan.errors import UsageError, stamp_text

__all__ = ["MAX_HELD_BYTES", "Entry", "Group", "Grouper", "Intervals", "Nearest", "Recent", "SourceCounts"]

Item = TypeVar("Item")

#: The most bytes of messages that a grouper holds. A scan that is being made may hold as many again.
MAX_HELD_BYTES = 96 << 20

#: How long a group waits for a topic without messages, nanoseconds of log time; or in windows, if that is longer.
_PATIENCE_NS = 1_000_000_000
_PATIENCE_WINDOWS = 4

_STAMP = attrgetter("stamp_ns", "number")


@dataclass(slots=True, eq=False)
class Entry(Generic[Item]):
    """A message that a grouper holds because a group may need it.

    Attributes
    ----------
    source
        The number of its topic; topic 0 leads.
    stamp_ns, log_time_ns
        Its times.
    number
        Its place among all messages, which sorts messages of equal stamps.
    size
        Its size, bytes.
    item
        The message.
    used
        Whether it is in a group.
    """

    source: int
    stamp_ns: int
    log_time_ns: int
    number: int
    size: int
    item: Item
    used: bool = False


@dataclass(frozen=True, slots=True)
class Group(Generic[Item]):
    """The messages of one scan: the one whose time the scan has, and all of them, sorted by source and stamp."""

    lead: Entry[Item]
    members: tuple[Entry[Item], ...]


@dataclass(slots=True)
class SourceCounts:
    """Counts of the messages of one topic.

    Attributes
    ----------
    messages, used, unmatched
        All messages, those in a scan, and those in no scan.
    scans_without
        Scans without a message of this topic.
    silence
        The longest run of such scans: the stamps of its first and its last scan, and their number.
    """

    messages: int = 0
    used: int = 0
    unmatched: int = 0
    scans_without: int = 0
    silence: tuple[int, int, int] = (0, 0, 0)
    _run: tuple[int, int, int] = field(default=(0, 0, 0), repr=False)

    def as_dict(self) -> dict[str, Any]:
        """Return the counts as JSON types."""
        names = ("messages", "used", "unmatched", "scans_without")
        first, last, scans = self.silence
        longest = {"first_stamp_ns": first, "last_stamp_ns": last, "scans": scans} if scans else None
        return {**{name: getattr(self, name) for name in names}, "longest_silence": longest}

    def scan(self, stamp_ns: int, *, has_it: bool) -> None:
        """Count a scan."""
        if has_it:
            self._run = (0, 0, 0)
            return
        self.scans_without += 1
        first, _, count = self._run
        self._run = (first if count else stamp_ns, stamp_ns, count + 1)
        if self._run[2] > self.silence[2]:
            self.silence = self._run


class Grouper(ABC, Generic[Item]):
    """Collects messages into groups.

    Parameters
    ----------
    sources
        The number of topics; topic 0 leads.
    patience_ns
        How long a group waits for a topic without messages, nanoseconds of log time.

    Attributes
    ----------
    counts
        The counts of each topic.
    """

    def __init__(self, sources: int, patience_ns: int = _PATIENCE_NS) -> None:
        self.counts = [SourceCounts() for _ in range(sources)]
        self._held: list[list[Entry[Item]]] = [[] for _ in range(sources)]
        #: The leading messages of the groups that are not closed yet, sorted by stamp.
        self._waiting: list[Entry[Item]] = []
        self._latest_ns: list[int | None] = [None] * sources
        self._patience_ns = patience_ns
        self._bytes = 0
        self._number = 0

    def add(self, source: int, stamp_ns: int, log_time_ns: int, size: int, item: Item) -> list[Group[Item]]:
        """Take the next message, and return the groups that are complete now.

        Raises
        ------
        UsageError
            If the messages of one scan take more than `MAX_HELD_BYTES`.
        """
        entry = Entry(source, stamp_ns, log_time_ns, self._number, size, item)
        self._number += 1
        self.counts[source].messages += 1
        insort(self._held[source], entry, key=_STAMP)
        self._bytes += size
        latest_ns = self._latest_ns[source]
        self._latest_ns[source] = stamp_ns if latest_ns is None else max(latest_ns, stamp_ns)
        if source == 0:
            self._lead(entry)
        groups = self._closed(log_time_ns)
        self._forget(log_time_ns)
        if self._bytes > MAX_HELD_BYTES:
            groups += self._relieved(stamp_ns, log_time_ns)
        return groups

    def finish(self) -> list[Group[Item]]:
        """Return the groups that are still open."""
        groups = []
        while self._waiting:
            groups.append(self._close(self._waiting.pop(0)))
        for source in range(len(self._held)):
            self._drop(source, len(self._held[source]))
        return groups

    @abstractmethod
    def _lead(self, entry: Entry[Item]) -> None:
        """Take a message of the leading topic."""

    @abstractmethod
    def _is_certain(self, lead: Entry[Item]) -> bool:
        """Whether no later message can change the group of the first leading message that waits."""

    @abstractmethod
    def _members(self, lead: Entry[Item]) -> list[Entry[Item]]:
        """Return the messages of a group, sorted by source and stamp."""

    @abstractmethod
    def _needed_from_ns(self, source: int, log_time_ns: int) -> int | None:
        """Return the first stamp of a topic that a group may still need; None: all messages that are held."""

    def _closed(self, log_time_ns: int) -> list[Group[Item]]:
        groups = []
        while self._waiting:
            lead = self._waiting[0]
            if not self._is_certain(lead) and log_time_ns - lead.log_time_ns <= self._patience_ns:
                break
            del self._waiting[0]
            groups.append(self._close(lead))
        return groups

    def _close(self, lead: Entry[Item]) -> Group[Item]:
        members = self._members(lead)
        there = {entry.source for entry in members}
        for source, counts in enumerate(self.counts):
            counts.scan(lead.stamp_ns, has_it=source in there)
        for entry in members:
            if not entry.used:
                entry.used = True
                self.counts[entry.source].used += 1
        return Group(lead, tuple(members))

    def _others_reached(self, stamp_ns: int) -> bool:
        """Whether each of the other topics has a message of this stamp or later."""
        return all(latest_ns is not None and latest_ns >= stamp_ns for latest_ns in self._latest_ns[1:])

    def _forget(self, log_time_ns: int) -> None:
        """Drop the messages that no group will need."""
        for source in range(len(self._held)):
            first_ns = self._needed_from_ns(source, log_time_ns)
            if first_ns is not None:
                self._drop(source, bisect_left(self._held[source], first_ns, key=attrgetter("stamp_ns")))

    def _drop(self, source: int, count: int) -> None:
        """Drop the first messages of a topic."""
        held = self._held[source]
        for entry in held[:count]:
            self._bytes -= entry.size
            if not entry.used:
                self.counts[source].unmatched += 1
        del held[:count]

    def _relieved(self, stamp_ns: int, log_time_ns: int) -> list[Group[Item]]:  # noqa: ARG002  # others need it
        """Free memory; return the groups that are closed for that."""
        held = sum(map(len, self._held))
        raise UsageError(
            f"the points of {held} messages up to the stamp {stamp_text(stamp_ns)} are held for one scan, which takes "
            f"more than {MAX_HELD_BYTES >> 20} MiB",
            hint="give `accumulate` or `every` less time, or select points with `where`, `exclude_box` and such",
        )


class Nearest(Grouper[Item]):
    """A group for each message of the leading topic, with the nearest one of each other topic.

    Each message belongs to the leading message whose stamp is nearest to its own, the earlier one of two. Of several
    messages of one topic that belong to one leading message, the nearest is in the group, the earlier one of two. The
    others are unmatched, and so are messages whose stamps are farther away than the window.

    Parameters
    ----------
    windows_ns
        The window of each topic, nanoseconds. That of the leading topic is ignored.
    """

    def __init__(self, windows_ns: list[int]) -> None:
        longest_ns = max(windows_ns[1:], default=0)
        super().__init__(len(windows_ns), max(_PATIENCE_NS, _PATIENCE_WINDOWS * longest_ns))
        self._windows_ns = windows_ns
        #: The stamp of the last leading message whose group is closed.
        self._before_ns: int | None = None

    def _lead(self, entry: Entry[Item]) -> None:
        insort(self._waiting, entry, key=_STAMP)

    def _is_certain(self, lead: Entry[Item]) -> bool:
        if len(self._held) == 1:
            return True
        # Messages that are nearer to the next leading message do not belong to this one.
        reached = all(
            latest_ns is not None and latest_ns >= lead.stamp_ns + window_ns
            for latest_ns, window_ns in zip(self._latest_ns[1:], self._windows_ns[1:], strict=True)
        )
        return reached and len(self._waiting) > 1

    def _members(self, lead: Entry[Item]) -> list[Entry[Item]]:
        after_ns = self._waiting[0].stamp_ns if self._waiting else None
        found = [lead]
        for source in range(1, len(self._held)):
            window_ns, held = self._windows_ns[source], self._held[source]
            begin = bisect_left(held, lead.stamp_ns - window_ns, key=attrgetter("stamp_ns"))
            end = bisect_right(held, lead.stamp_ns + window_ns, key=attrgetter("stamp_ns"))
            own = [entry for entry in held[begin:end] if not entry.used and self._belongs(entry, lead, after_ns)]
            if own:
                found.append(min(own, key=lambda entry: (abs(entry.stamp_ns - lead.stamp_ns), _STAMP(entry))))
        self._before_ns = lead.stamp_ns
        return found

    def _belongs(self, entry: Entry[Item], lead: Entry[Item], after_ns: int | None) -> bool:
        distance = abs(entry.stamp_ns - lead.stamp_ns)
        if after_ns is not None and abs(entry.stamp_ns - after_ns) < distance:
            return False
        return self._before_ns is None or abs(entry.stamp_ns - self._before_ns) > distance

    def _needed_from_ns(self, source: int, log_time_ns: int) -> int | None:
        if self._waiting:
            first_ns = self._waiting[0].stamp_ns
            return first_ns if source == 0 else first_ns - self._windows_ns[source]
        if source == 0:
            latest_ns = self._latest_ns[0]
            return None if latest_ns is None else latest_ns + 1
        # The next leading message has not come yet; the wait for it is limited.
        over_ns: int | None = None
        for entry in self._held[source]:
            if log_time_ns - entry.log_time_ns <= self._patience_ns:
                break
            over_ns = entry.stamp_ns + 1
        return over_ns

    def _relieved(self, stamp_ns: int, log_time_ns: int) -> list[Group[Item]]:  # noqa: ARG002  # only errors have it
        groups = []
        while self._bytes > MAX_HELD_BYTES and self._waiting:
            # The group closes with the messages that it has now; later ones are unmatched.
            groups.append(self._close(self._waiting.pop(0)))
            self._forget(log_time_ns)
        if self._bytes > MAX_HELD_BYTES:
            for source, held in enumerate(self._held):
                self._drop(source, len(held))
        return groups


class Recent(Grouper[Item]):
    """A group for each message of the leading topic, with all messages of the last seconds, or the last few messages.

    Parameters
    ----------
    sources
        The number of topics.
    span_ns
        A group has the messages with stamps up to the leading message's, and less than this long before it.
    count
        A group has at most this many messages of each topic, the last ones; 0: all within ``span_ns``.
    """

    def __init__(self, sources: int, span_ns: int = 0, count: int = 0, *, patience_ns: int = _PATIENCE_NS) -> None:
        super().__init__(sources, patience_ns)
        self._span_ns = span_ns
        self._most = count
        self._last_ns: int | None = None

    def _lead(self, entry: Entry[Item]) -> None:
        insort(self._waiting, entry, key=_STAMP)

    def _is_certain(self, lead: Entry[Item]) -> bool:
        return self._others_reached(lead.stamp_ns)

    def _members(self, lead: Entry[Item]) -> list[Entry[Item]]:
        self._last_ns = lead.stamp_ns if self._last_ns is None else max(self._last_ns, lead.stamp_ns)
        return self._up_to(lead.stamp_ns)

    def _up_to(self, last_ns: int) -> list[Entry[Item]]:
        found = []
        for held in self._held:
            end = bisect_right(held, last_ns, key=attrgetter("stamp_ns"))
            begin = 0 if self._most else bisect_right(held, last_ns - self._span_ns, key=attrgetter("stamp_ns"))
            found += held[max(begin, end - self._most) if self._most else begin : end]
        return found

    def _needed_from_ns(self, source: int, log_time_ns: int) -> int | None:  # noqa: ARG002  # nothing depends on it
        last_ns = self._waiting[0].stamp_ns if self._waiting else self._last_ns
        if last_ns is None:
            return None
        if not self._most:
            return last_ns - self._span_ns + 1
        held = self._held[source]
        end = bisect_right(held, last_ns, key=attrgetter("stamp_ns"))
        return held[end - self._most].stamp_ns if end > self._most else None


class Intervals(Recent[Item]):
    """A group for each interval that has a message of the leading topic; the last of these messages leads the group.

    Parameters
    ----------
    sources
        The number of topics.
    every_ns, begin_ns
        The length of an interval, and the stamp at which one of them begins.
    span_ns, count
        As for `Recent`, counted back from the interval's end.
    """

    def __init__(self, sources: int, every_ns: int, begin_ns: int, span_ns: int = 0, count: int = 0) -> None:
        super().__init__(sources, span_ns, count, patience_ns=max(_PATIENCE_NS, 2 * every_ns))
        self._every_ns = every_ns
        self._begin_ns = begin_ns

    def _end_ns(self, stamp_ns: int) -> int:
        """Return the end of the interval that a stamp is in; the end itself is in the next interval."""
        return stamp_ns + self._every_ns - (stamp_ns - self._begin_ns) % self._every_ns

    def _lead(self, entry: Entry[Item]) -> None:
        if self._last_ns is not None and entry.stamp_ns <= self._last_ns:
            # Its interval is over.
            return
        same = [other for other in self._waiting if self._end_ns(other.stamp_ns) == self._end_ns(entry.stamp_ns)]
        if same and _STAMP(same[0]) > _STAMP(entry):
            return
        for other in same:
            self._waiting.remove(other)
        insort(self._waiting, entry, key=_STAMP)

    def _is_certain(self, lead: Entry[Item]) -> bool:
        end_ns = self._end_ns(lead.stamp_ns)
        latest_ns = self._latest_ns[0]
        return latest_ns is not None and latest_ns >= end_ns and self._others_reached(end_ns)

    def _members(self, lead: Entry[Item]) -> list[Entry[Item]]:
        last_ns = self._end_ns(lead.stamp_ns) - 1
        self._last_ns = last_ns if self._last_ns is None else max(self._last_ns, last_ns)
        return self._up_to(last_ns)

    def _needed_from_ns(self, source: int, log_time_ns: int) -> int | None:  # noqa: ARG002  # nothing depends on it
        if not self._waiting and self._last_ns is None:
            return None
        next_ns = self._end_ns(self._waiting[0].stamp_ns) if self._waiting else self._end_ns((self._last_ns or 0) + 1)
        if not self._most:
            return next_ns - self._span_ns
        held = self._held[source]
        return held[-self._most].stamp_ns if len(held) > self._most and not self._waiting else None
