"""Summarizes differences as text."""

from __future__ import annotations

import math
from operator import attrgetter
from typing import TYPE_CHECKING

from pc2scan.errors import leading, stamp_text, visible
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.text import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from .topic_difference import MessageTimes, TopicDifference, UnpairedMessages, ValuesFound

#: Stamps of unpaired messages that are shown.
_SHOWN = 3
#: Longer values of changed fields are shortened.
_LONGEST = 100
#: The largest share of beams that the angles of another C library change.
_FEW = 0.25
#: The words for an element of a message, and for the message.
_WORDS = {LASERSCAN: ("beam", "scan"), **dict.fromkeys(CLOUDS, ("point", "cloud"))}


def summary(topics: Sequence[TopicDifference], left_aside: int, names: tuple[str, str] = ("A", "B")) -> Iterator[str]:
    """Yield a block of lines for each topic, and a verdict.

    Parameters
    ----------
    topics
        The compared topics.
    left_aside
        Number of topics that were not compared.
    names
        The names of the two sides.
    """
    for topic in topics:
        yield visible(f"{leading(topic.name)} ({topic.msgtype}): {'same' if topic.same else 'different'}")
        lines = list(_lines(topic, names))
        width = max(len(label) for label, _ in lines)
        yield from (visible(f"  {label:<{width}}  {text}") for label, text in lines)
    apart = [topic for topic in topics if not topic.same]
    pairs = sum(topic.matched for topic in topics)
    if apart:
        yield f"different: {len(apart)} of {counted(len(topics), 'topic')}"
        yield from _advice(topics, names)
    else:
        yield f"same: {counted(len(topics), 'topic')}, {counted(pairs, 'message')}"
    if left_aside:
        yield f"not compared: {counted(left_aside, 'other topic')} (`all_topics`)"


def _lines(topic: TopicDifference, names: tuple[str, str]) -> Iterator[tuple[str, str]]:
    element, message = _WORDS.get(topic.msgtype, ("element", "message"))
    absent = [name for name, there in zip(names, (topic.topic_a, topic.topic_b), strict=True) if there is None]
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
        there = "" if change.name == "type" else f"in {counted(change.messages, message)}{first}: "
        sides = f"{_shortened(change.a)} in {names[0]}, {_shortened(change.b)} in {names[1]}" if change.a else change.b
        yield change.name, f"{there}{sides}"
    for found in topic.values.values():
        yield found.name, _values(found, topic, element, message)
        if found.worst is not None:
            yield "", f"worst {_worst_text(found, element, names)}"
    if topic.worst is not None and topic.differing > 1:
        times, differing = topic.worst
        yield f"worst {message}", f"{_times_text(times)}: {counted(differing, element)}"


def _values(found: ValuesFound, topic: TopicDifference, element: str, message: str) -> str:
    parts = [
        f"{found.changed:,} changed" if found.changed else "",
        f"{found.shifted:,} one {element} over" if found.shifted else "",
    ]
    share = found.differing / topic.elements if topic.elements else 1.0
    shown = f"{share:.2%}" if share >= 0.0001 else "under 0.01%"
    differing = f"{counted(found.differing, element)} of {topic.elements:,} ({shown})"
    text = f"in {counted(found.messages, message)}: {differing}, {' and '.join(filter(None, parts))}"
    if found.whole_shifts:
        text += f"; {counted(found.whole_shifts, 'whole ' + message)} shifted by one {element}"
    if topic.allow_beams:
        text += f"; {'within' if topic.allows(found) else 'more than'} the allowed {topic.allow_beams:.2%}"
    return text


def _worst_text(found: ValuesFound, element: str, names: tuple[str, str]) -> str:
    worst = found.worst
    assert worst is not None
    angle = "" if worst.angle is None else f" ({math.degrees(worst.angle):.2f} deg)"
    values = f"{worst.a:.9g} in {names[0]}, {worst.b:.9g} in {names[1]}"
    if not worst.difference:
        values += ": other bits of one value"
    elif math.isfinite(worst.difference):
        values += f": {worst.difference:.3g} apart"
    return f"{element} {worst.index}{angle}, {_times_text(worst.times)}: {values}"


def _advice(topics: Sequence[TopicDifference], names: tuple[str, str]) -> Iterator[str]:
    """Yield hints."""
    topic_a, topic_b = attrgetter("topic_a"), attrgetter("topic_b")
    alone = [
        [topic for topic in topics if there(topic) is not None and other(topic) is None]
        for there, other in ((topic_a, topic_b), (topic_b, topic_a))
    ]
    if [len(side) for side in alone] == [1, 1] and alone[0][0].msgtype == alone[1][0].msgtype:
        yield f"hint: the same under another name? `topics={alone[0][0].topic_a}:={alone[1][0].topic_b}`"
    kinds = {name for topic in topics if not topic.same for name in topic.changes}
    only_changes = all(
        topic.same or (topic.matched == topic.messages_a == topic.messages_b and not topic.values) for topic in topics
    )
    if any(topic.messages_a and topic.messages_b and not topic.matched for topic in topics):
        yield "hint: no stamp is on both sides; are these of one drive?"
    if any(map(_may_be_libm, topics)):
        yield (
            "hint: returns are one beam over; if the two were made with different C libraries, convert again with the "
            "other `angle_rounding`"
        )
    if only_changes and kinds and kinds <= {"log_time", "seq"}:
        ignored = " ".join(f"`ignore={name}`" for name in sorted(kinds))
        yield f"hint: nothing else differs between {names[0]} and {names[1]}: {ignored}"


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


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
