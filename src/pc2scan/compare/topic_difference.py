"""The differences between a topic of A and one of B, counted pair by pair."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, NamedTuple

if TYPE_CHECKING:
    from .messages import MessageDifference

#: Maximum number of messages that are listed; all of them are counted.
MAX_LISTED = 100


@dataclass(frozen=True, slots=True)
class MessageTimes:
    """A message's header stamp (None if it has none), and its log time in A, or in B if A lacks it."""

    stamp_ns: int | None
    log_time_ns: int


@dataclass(slots=True)
class UnpairedMessages:
    """Messages that have no partner, or are in another order: all are counted, the first ones listed."""

    count: int = 0
    first: list[MessageTimes] = field(default_factory=list)

    def add(self, times: MessageTimes) -> None:
        """Count a message."""
        self.count += 1
        if len(self.first) < MAX_LISTED:
            self.first.append(times)


@dataclass(slots=True)
class ChangeFound:
    """One kind of change: the number of messages, and the first of them."""

    name: str
    messages: int
    times: MessageTimes
    a: str
    b: str


@dataclass(frozen=True, slots=True)
class WorstValue:
    """The value that differs most, with its place and the values in A and B.

    Attributes
    ----------
    index
        Of the beam or the point.
    angle
        Of the beam, rad; None for clouds.
    difference
        Absolute; infinity if only one of the two is finite, 0 if only the bits differ.
    """

    times: MessageTimes
    index: int
    angle: float | None
    a: float
    b: float
    difference: float


@dataclass(slots=True)
class ValuesFound:
    """Differing values of one name, in all messages of a topic.

    Attributes
    ----------
    changed, shifted
        Beams or points, as in `pc2scan.core.compare.ArrayDifference`.
    whole_shifts
        Messages that are equal to the other side's if shifted by one beam.
    """

    name: str
    messages: int = 0
    changed: int = 0
    shifted: int = 0
    whole_shifts: int = 0
    worst: WorstValue | None = None

    @property
    def differing(self) -> int:
        """Beams or points beyond the tolerance."""
        return self.changed + self.shifted


class WorstPair(NamedTuple):
    """The pair of messages with the most differing beams or points, and their number."""

    times: MessageTimes
    differing: int


@dataclass(slots=True)
class TopicDifference:
    """The differences between a topic of A and one of B.

    Attributes
    ----------
    topic_a, topic_b
        None if a side has no such topic.
    msgtype
        In ROS 2's spelling.
    allow_beams
        The share of ``elements`` that may differ.
    messages_a, messages_b, matched, differing
        Numbers of messages: of either side, pairs, and pairs that are not the same.
    elements
        Beams or points of the pairs.
    missing, extra, moved
        Messages only in A; only in B; in both, but in another order.
    changes, values
        Differences within pairs, by name.
    worst
        The pair that differs most; None if all are equal.
    """

    json_names: ClassVar[tuple[str, ...]] = (
        *("topic_a", "topic_b", "msgtype", "same", "allow_beams", "messages_a", "messages_b", "matched", "differing"),
        *("elements", "missing", "extra", "moved", "changes", "values", "worst"),
    )

    topic_a: str | None
    topic_b: str | None
    msgtype: str
    allow_beams: float = 0.0
    messages_a: int = 0
    messages_b: int = 0
    matched: int = 0
    differing: int = 0
    elements: int = 0
    missing: UnpairedMessages = field(default_factory=UnpairedMessages)
    extra: UnpairedMessages = field(default_factory=UnpairedMessages)
    moved: UnpairedMessages = field(default_factory=UnpairedMessages)
    changes: dict[str, ChangeFound] = field(default_factory=dict)
    values: dict[str, ValuesFound] = field(default_factory=dict)
    worst: WorstPair | None = None
    _worst_rank: tuple[int, float] = (0, 0.0)

    @property
    def name(self) -> str:
        """The topic, or both topics."""
        if self.topic_a and self.topic_b and self.topic_a != self.topic_b:
            return f"{self.topic_a} and {self.topic_b}"
        return self.topic_a or self.topic_b or ""

    def allows(self, found: ValuesFound) -> bool:
        """Whether values that differ are within the allowed share."""
        return found.differing <= self.allow_beams * self.elements

    @property
    def same(self) -> bool:
        """Whether there are no differences except allowed ones."""
        unpaired = self.missing.count or self.extra.count or self.moved.count
        # A topic without messages is no difference.
        present = (self.topic_a is not None and self.topic_b is not None) or not (self.messages_a or self.messages_b)
        return present and not unpaired and not self.changes and all(map(self.allows, self.values.values()))

    def count_pair(self, times: MessageTimes, difference: MessageDifference) -> None:
        """Count a pair of messages."""
        self.matched += 1
        self.elements += difference.elements
        if difference.same:
            return
        self.differing += 1
        for change in difference.changes:
            self.change(change.name, times, change.a, change.b)
        rank = (0, 0.0)
        for values in difference.values:
            array = values.difference
            found = self.values.setdefault(values.name, ValuesFound(values.name))
            found.messages += 1
            found.changed += array.changed
            found.shifted += array.shifted
            found.whole_shifts += bool(array.shift)
            worst = array.worst
            if worst is not None and (found.worst is None or worst.difference > found.worst.difference):
                angle = None if values.beams is None else values.beams[0] + worst.index * values.beams[1]
                found.worst = WorstValue(times, worst.index, angle, worst.reference, worst.value, worst.difference)
            rank = max(rank, (array.differing, worst.difference if worst else 0.0))
        if rank > self._worst_rank:
            self._worst_rank = rank
            self.worst = WorstPair(times, rank[0])

    def change(self, name: str, times: MessageTimes, a: str, b: str) -> None:
        """Count a change; the first of its name is kept as the example."""
        found = self.changes.get(name)
        if found is None:
            self.changes[name] = ChangeFound(name, 1, times, a, b)
        else:
            found.messages += 1
