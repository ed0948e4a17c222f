"""Random streams of stamps and log times, and the groups that they have by the rules, computed from all stamps at once.

Nothing here depends on the order in which messages are logged, but for equal stamps of one topic.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.conversion.combine.rules import Interval, Nearest, Recent, Rule

if TYPE_CHECKING:
    import random

__all__ = ["MS", "SECOND", "Group", "Message", "Stream", "by_the_rule", "drawn_rule", "drawn_stream"]

MS = 1_000_000
SECOND = 1_000 * MS

#: By how much clocks jump in streams.
JUMPS = (-3600, -100, -60, 1_000, 86_400)


class Message(NamedTuple):
    """A message; ``clock`` is the number of the clock that stamped it, ``place`` its number among equal stamps."""

    source: int
    stamp_ns: int
    log_time_ns: int
    clock: int = 0
    place: int = 0

    @property
    def key(self) -> tuple[int, int]:
        """Its place in its topic."""
        return self.stamp_ns, self.place


Group = tuple[Message, tuple[Message, ...]]


@dataclass(frozen=True)
class Stream:
    """Messages in the order of their log times."""

    sources: int
    messages: tuple[Message, ...]


def placed(messages: list[Message]) -> tuple[Message, ...]:
    """Number the messages of equal stamps in each topic."""
    seen = Counter[tuple[int, int, int]]()
    found = []
    for each in messages:
        key = (each.source, each.clock, each.stamp_ns)
        found.append(each._replace(place=seen[key]))
        seen[key] += 1
    return tuple(found)


def drawn_stream(rng: random.Random, *, jumps: bool = False, wrong: int = 0) -> Stream:
    """Draw topics with periods, phases, delays, equal stamps, silence, and late starts.

    Within a topic and a clock, messages are logged in the order of their stamps, at most a second after them.

    Parameters
    ----------
    jumps
        Whether the clock of all topics jumps.
    wrong
        How many single messages have a stamp of no other message's clock.
    """
    sources = rng.randint(1, 3)
    length = rng.choice([15, 25, 40])
    jump_at = sorted(rng.sample(range(5, length), rng.choice([1, 2]))) if jumps else []
    offsets = [0]
    for _ in jump_at:
        offsets.append(offsets[-1] + rng.choice(JUMPS) * SECOND)
    messages = []
    for source in range(sources):
        period = rng.choice([3, 5, 5, 10, 20])
        jitter = rng.choice([0, 0, 1, 4])
        begin = rng.choice([0, 0, 0, rng.randrange(length)])
        end = rng.choice([length, length, length, rng.randrange(length)])
        silent = rng.randrange(length) if rng.random() < 0.3 else length
        delay, spread = rng.choice([0, 3, 50, 100]), rng.choice([0, 0, 10, 60])
        logged = 0
        steps = [begin + step + rng.randint(0, jitter) for step in range(rng.randrange(period), 10 * length, period)]
        for tick in sorted(steps):
            at = tick // 10
            if not begin <= at < end or silent <= at < silent + 20:
                continue
            clock = sum(at >= each for each in jump_at)
            late = min(100, delay + rng.randint(0, spread))
            logged = max(logged, tick + late)
            if logged > tick + 100:
                continue
            stamp_ns = tick * 10 * MS + offsets[clock]
            messages += [Message(source, stamp_ns, logged * 10 * MS, clock)] * rng.choice([1, 1, 1, 1, 2, 3])
    for number, place in enumerate(rng.sample(range(len(messages)), min(wrong, len(messages)))):
        off_ns = rng.choice([-1, 1]) * (number + 2) * 500 * SECOND
        wrongly = messages[place].stamp_ns + off_ns
        messages[place] = messages[place]._replace(stamp_ns=wrongly, clock=10 + number)
    # Of one log time, topics come in any order, and the messages of a topic in their own.
    ranks = {(each.log_time_ns, each.source): rng.random() for each in messages}
    messages.sort(key=lambda each: (each.log_time_ns, ranks[each.log_time_ns, each.source]))
    return Stream(sources, placed(messages))


def drawn_rule(rng: random.Random, sources: int) -> Rule:
    """Draw a rule, with times that are multiples of those of `drawn_stream`, so that bounds are often met."""
    every_ns = rng.choice([0, 50, 100, 250, 400]) * MS
    before_ns = rng.choice([0, 5, 25, 70]) * MS
    kind = rng.choice(["nearest", "recent", "few", "interval"])
    if kind == "nearest":
        return Nearest(windows_ns=tuple(rng.choice([0, 10, 30, 50, 110]) * MS for _ in range(sources)))
    if kind == "recent":
        return Recent(every_ns, before_ns, span_ns=rng.choice([1, 10 * MS, 100 * MS, 300 * MS, 1000 * MS]))
    if kind == "few":
        return Recent(every_ns, before_ns, count=rng.choice([1, 2, 5]))
    return Interval(every_ns or 200 * MS, before_ns)


def by_the_rule(stream: Stream, rule: Rule) -> list[Group]:
    """All groups, those of each clock by themselves."""
    found = []
    for clock in sorted({each.clock for each in stream.messages}):
        found += _of_one_clock([each for each in stream.messages if each.clock == clock], rule, stream.sources)
    return found


def _of_one_clock(messages: list[Message], rule: Rule, sources: int) -> list[Group]:
    leads = sorted((each for each in messages if each.source == 0), key=lambda each: each.key)
    topics = [sorted((e for e in messages if e.source == s), key=lambda e: e.key) for s in range(sources)]
    if isinstance(rule, Nearest):
        return _nearest(leads, topics, rule.windows_ns)

    begin_ns = min((each.stamp_ns for each in leads), default=0) - rule.begins_before_ns

    def cell(stamp_ns: int) -> int:
        return (stamp_ns - begin_ns) // rule.every_ns

    if rule.every_ns:
        last_of = {cell(each.stamp_ns): each for each in leads}
        leads = list(last_of.values())
    found = []
    for lead in leads:
        members: list[Message] = []
        for own in topics:
            if isinstance(rule, Recent) and rule.count:
                members += [each for each in own if each.key <= lead.key][-rule.count :]
            elif isinstance(rule, Recent):
                members += [e for e in own if lead.stamp_ns - rule.span_ns < e.stamp_ns and e.key <= lead.key]
            else:
                members += [each for each in own if cell(each.stamp_ns) == cell(lead.stamp_ns)]
        found.append((lead, tuple(members)))
    return found


def _nearest(leads: list[Message], topics: list[list[Message]], windows: tuple[int, ...]) -> list[Group]:
    """The closest of all pairs is in one scan, then the closest of the rest."""
    members: dict[Message, list[Message]] = {lead: [lead] for lead in leads}
    for source, own in enumerate(topics[1:], 1):
        pairs = [
            (abs(lead.stamp_ns - each.stamp_ns), lead.key, each.key, lead, each)
            for lead in leads
            for each in own
            if abs(lead.stamp_ns - each.stamp_ns) <= windows[source]
        ]
        taken = set[Message]()
        for _, _, _, lead, each in sorted(pairs):
            if not {lead, each} & taken:
                members[lead].append(each)
                taken |= {lead, each}
    return [(lead, tuple(own)) for lead, own in members.items()]
