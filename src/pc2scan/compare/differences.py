"""The differences between two recordings: text, JSON and the exit status are made from it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from pc2scan.errors import leading, stamp_text, visible
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.result import Part, Result
from pc2scan.text import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from .rules import MessageDifference


#: Maximum number of messages that are listed; all of them are counted.
_MAX_LISTED = 100


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
        if len(self.first) < _MAX_LISTED:
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
        The number of the beam or the point.
    angle
        The angle of the beam, rad; None for clouds.
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
        Beams or points, as in `pc2scan.core.tolerance.ArrayDifference`.
    """

    name: str
    messages: int = 0
    changed: int = 0
    shifted: int = 0
    worst: WorstValue | None = None

    @property
    def differing(self) -> int:
        """Beams or points beyond the tolerance."""
        return self.changed + self.shifted


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
    """

    json_names: ClassVar[tuple[str, ...]] = (
        *("topic_a", "topic_b", "msgtype", "same", "allow_beams", "messages_a", "messages_b", "matched", "differing"),
        *("elements", "missing", "extra", "moved", "changes", "values"),
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

    @property
    def name(self) -> str:
        """The topic, or both topics."""
        if self.topic_a and self.topic_b and self.topic_a != self.topic_b:
            return f"{self.topic_a} and {self.topic_b}"
        return self.topic_a or self.topic_b or ""

    def allows(self, values: ValuesFound) -> bool:
        """Whether values that differ are within the allowed share."""
        return values.differing <= self.allow_beams * self.elements

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
        self.differing += not difference.same
        for change in difference.changes:
            self.change(change.name, times, change.a, change.b)
        for name, array, beams in difference.values:
            total = self.values.setdefault(name, ValuesFound(name))
            total.messages += 1
            total.changed += array.changed
            total.shifted += array.shifted
            worst = array.worst
            if worst is not None and (total.worst is None or worst.difference > total.worst.difference):
                angle = None if beams is None else beams[0] + worst.index * beams[1]
                total.worst = WorstValue(times, worst.index, angle, worst.reference, worst.value, worst.difference)

    def change(self, name: str, times: MessageTimes, a: str, b: str) -> None:
        """Count a change; the first of its name is kept as the example."""
        self.changes.setdefault(name, ChangeFound(name, 0, times, a, b)).messages += 1


@dataclass(slots=True, repr=False)
class Difference(Result):
    """The differences between two recordings.

    Attributes
    ----------
    a, b
        Their paths.
    topics
        The compared topics.
    left_aside
        Topics that were not compared, because they are neither scans nor clouds.
    """

    kind: ClassVar[str] = "difference"
    json_names: ClassVar[tuple[str, ...]] = ("same", "a", "b", "topics", "left_aside")

    a: str
    b: str
    topics: list[TopicDifference] = field(default_factory=list)
    left_aside: int = 0

    @property
    def same(self) -> bool:
        """Whether there are no differences except allowed ones."""
        return all(topic.same for topic in self.topics)

    @property
    def exit_status(self) -> int:
        """0 same, 1 different."""
        return 0 if self.same else 1

    def text(self, names: tuple[str, str] = ("A", "B")) -> str:
        """Summarize the differences in a few lines; ``names`` are the names of the two sides."""
        return "\n".join(self._lines(names))

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the differences of each topic, and a verdict."""
        yield from self._lines(("A", "B"))

    def _lines(self, names: tuple[str, str]) -> Iterator[str]:
        for topic in self.topics:
            yield visible(f"{leading(topic.name)} ({topic.msgtype}): {'same' if topic.same else 'different'}")
            lines = list(_lines(topic, names))
            width = max(len(label) for label, _ in lines)
            yield from (visible(f"  {label:<{width}}  {text}") for label, text in lines)
        topics = counted(len(self.topics), "topic")
        if self.same:
            yield f"same: {topics}, {counted(sum(topic.matched for topic in self.topics), 'message')}"
        else:
            yield f"different: {sum(not topic.same for topic in self.topics)} of {topics}"
            yield from _advice(self.topics)
        if self.left_aside:
            yield f"not compared: {counted(self.left_aside, 'other topic')} (`all_topics`)"


#: Stamps of unpaired messages that are shown.
_SHOWN = 3
#: Longer values of changed fields are shortened.
_LONGEST = 100
#: The largest share of beams that the angles of another C library change.
_FEW = 0.25
#: The words for an element of a message, and for the message.
_WORDS = {LASERSCAN: ("beam", "scan"), **dict.fromkeys(CLOUDS, ("point", "cloud"))}


def _lines(topic: TopicDifference, names: tuple[str, str]) -> Iterator[tuple[str, str]]:
    element, message = _WORDS.get(topic.msgtype, ("element", "message"))
    absent = [name for name, own in zip(names, (topic.topic_a, topic.topic_b), strict=True) if own is None]
    total = counted(topic.matched - topic.differing, message)
    if absent:
        yield "messages", f"{topic.messages_a + topic.messages_b:,}; {absent[0]} has no such topic"
        return
    elements = f", {counted(topic.elements, element)} compared" if topic.elements else ""
    yield "messages", f"{topic.messages_a:,} in {names[0]}, {topic.messages_b:,} in {names[1]}: {total} equal{elements}"
    for label, unpaired in ((f"only in {names[0]}", topic.missing), (f"only in {names[1]}", topic.extra)):
        if unpaired.count:
            yield label, f"{counted(unpaired.count, message)}: {_unpaired_text(unpaired)}"
    if topic.moved.count:
        yield "order", f"{counted(topic.moved.count, message)} in another order: {_unpaired_text(topic.moved)}"
    for change in topic.changes.values():
        first = f", first {_times_text(change.times)}" if change.messages > 1 else f", {_times_text(change.times)}"
        where = "" if change.name == "type" else f"in {counted(change.messages, message)}{first}: "
        a, b = visible(change.a, _LONGEST), visible(change.b, _LONGEST)
        sides = f"{a} in {names[0]}, {b} in {names[1]}" if change.a else change.b
        yield change.name, f"{where}{sides}"
    for values in topic.values.values():
        yield values.name, _values(values, topic, element, message)
        if values.worst is not None:
            yield "", f"worst {_worst_text(values, element, names)}"


def _values(values: ValuesFound, topic: TopicDifference, element: str, message: str) -> str:
    parts = [
        f"{values.changed:,} changed" if values.changed else "",
        f"{values.shifted:,} one {element} over" if values.shifted else "",
    ]
    share = values.differing / topic.elements if topic.elements else 1.0
    shown = f"{share:.2%}" if share >= 0.0001 else "under 0.01%"
    differing = f"{counted(values.differing, element)} of {topic.elements:,} ({shown})"
    text = f"in {counted(values.messages, message)}: {differing}, {' and '.join(filter(None, parts))}"
    if topic.allow_beams:
        text += f"; {'within' if topic.allows(values) else 'more than'} the allowed {topic.allow_beams:.2%}"
    return text


def _worst_text(values: ValuesFound, element: str, names: tuple[str, str]) -> str:
    worst = values.worst
    assert worst is not None
    angle = "" if worst.angle is None else f" ({math.degrees(worst.angle):.2f} deg)"
    both = f"{worst.a:.9g} in {names[0]}, {worst.b:.9g} in {names[1]}"
    if not worst.difference:
        both += ": other bits of one value"
    elif math.isfinite(worst.difference):
        both += f": {worst.difference:.3g} apart"
    return f"{element} {worst.index}{angle}, {_times_text(worst.times)}: {both}"


def _advice(topics: Sequence[TopicDifference]) -> Iterator[str]:
    """Yield hints."""
    alone = [[topic for topic in topics if topic.topic_b is None], [topic for topic in topics if topic.topic_a is None]]
    if [[topic.msgtype for topic in side] for side in alone] in [[[topic.msgtype]] * 2 for topic in topics]:
        yield f"hint: the same under another name? `topics={alone[0][0].topic_a}:={alone[1][0].topic_b}`"
    if any(topic.messages_a and topic.messages_b and not topic.matched for topic in topics):
        yield "hint: no stamp is on both sides; are these of one drive?"
    if any(map(_may_be_libm, topics)):
        yield (
            "hint: returns are one beam over; if the two were made with different C libraries, convert again with the "
            "other `angle_rounding`"
        )


def _may_be_libm(topic: TopicDifference) -> bool:
    """Return whether the differences can come of another atan2f: returns that are in a neighbouring beam.

    Where the neighbour has a nearer return, only one beam is changed.
    """
    ranges = topic.values.get("ranges") if topic.msgtype == LASERSCAN else None
    if ranges is None or topic.changes.keys() - {"log_time", "seq"}:
        return False
    return ranges.differing <= _FEW * topic.elements and ranges.changed <= 2 * ranges.shifted


def _unpaired_text(unpaired: UnpairedMessages) -> str:
    shown = ", ".join(_times_text(times) for times in unpaired.first[:_SHOWN])
    return shown + (f" and {unpaired.count - _SHOWN:,} more" if unpaired.count > _SHOWN else "")


def _times_text(times: MessageTimes) -> str:
    if times.stamp_ns is None:
        return f"log time {stamp_text(times.log_time_ns)}"
    return f"stamp {stamp_text(times.stamp_ns)}"
