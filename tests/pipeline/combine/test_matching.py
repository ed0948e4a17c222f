"""Which messages belong together: held to the rules, applied to all stamps at once."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pc2scan.errors import UsageError
from pc2scan.pipeline.combine import matching
from pc2scan.pipeline.combine.matching import Grouper
from pc2scan.pipeline.combine.rules import Interval, Nearest, Recent

from .streams_of_stamps import MS, SECOND, Message, by_the_rule, drawn_rule, drawn_stream

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.pipeline.combine.rules import Rule
    from pc2scan.pipeline.combine.series import Series

    from .streams_of_stamps import Group, Stream

RULES: dict[str, Rule] = {
    "nearest": Nearest(windows_ns=(0, 50 * MS, 65 * MS)),
    "recent": Recent(span_ns=300 * MS),
    "few": Recent(count=4),
    "interval": Interval(250 * MS),
    "some": Recent(250 * MS, 0, span_ns=100 * MS),
}


def groups_of(grouper: Grouper[Message], messages: Sequence[Message]) -> list[Group]:
    """All groups of messages, which are given to it in their order."""
    found = []
    for message in messages:
        found += grouper.add(message.source, message.stamp_ns, message.log_time_ns, 100, message)
    found += grouper.finish()
    return [(group.lead.item, tuple(entry.item for entry in group.members)) for group in found]


def of_stamps(*topics: Sequence[int], late: int = 0) -> list[Message]:
    """Messages with stamps in milliseconds, each logged at its stamp; those of later topics ``late`` after them."""
    found = [
        Message(source, stamp * MS, (stamp + late * source) * MS) for source, own in enumerate(topics) for stamp in own
    ]
    return sorted(found, key=lambda each: each.log_time_ns)


def stamps_in(groups: Sequence[Group]) -> list[list[int]]:
    """The stamps of groups in milliseconds."""
    return [[member.stamp_ns // MS for member in members] for _, members in groups]


def check(stream: Stream, rule: Rule, seed: int) -> None:
    """Hold the groups of a stream, their counts and what is held to the rule."""
    grouper: Grouper[Message] = Grouper(rule, stream.sources)
    expected = by_the_rule(stream, rule)
    found: list[Group] = []
    for number, message in enumerate(stream.messages):
        groups = grouper.add(message.source, message.stamp_ns, message.log_time_ns, 100, message)
        found += [(group.lead.item, tuple(entry.item for entry in group.members)) for group in groups]
        check_held(grouper, stream.messages[: number + 1], rule)
    found += groups_of(grouper, ())
    assert sorted(found) == sorted(expected), (seed, rule)
    for source, counts in enumerate(grouper.counts):
        own = [each for each in stream.messages if each.source == source]
        used = {each for _, members in expected for each in members if each.source == source}
        assert (counts.messages, counts.used, counts.unmatched) == (len(own), len(used), len(own) - len(used))
        assert counts.scans_without == sum(source not in {m.source for m in members} for _, members in expected)
    assert grouper._open == []


def check_held(grouper: Grouper[Message], messages: Sequence[Message], rule: Rule) -> None:
    """Nothing is held that no scan can need: not for longer than a second after a later stamp was logged."""
    now_ns = messages[-1].log_time_ns
    for series in grouper._open:
        own = [entry.item for held in series._held for entry in held]
        if not own or rule.every_ns:
            continue
        clock = own[0].clock
        assert {each.clock for each in own} == {clock}
        assert series.size == 100 * len(own)
        past = [m.stamp_ns for m in messages if m.clock == clock and (m.source == 0 or m.log_time_ns < now_ns - SECOND)]
        next_ns = min([lead.stamp_ns for lead in series._leads] or [max(past, default=-(1 << 80))])
        for each in own:
            later = sum(m.source == each.source and each.key < m.key and m.stamp_ns < next_ns for m in own)
            if isinstance(rule, Nearest):
                assert each.stamp_ns >= next_ns - (rule.windows_ns[each.source] if each.source else 0)
            elif isinstance(rule, Recent):
                assert later < rule.count if rule.count else each.stamp_ns > next_ns - rule.span_ns


@pytest.mark.parametrize("part", range(5))
@pytest.mark.parametrize("jumps", [False, True], ids=["one clock", "jumps"])
def test_groups_are_those_of_the_rule(part: int, *, jumps: bool) -> None:
    for seed in range(50 * part, 50 * part + 50):
        rng = random.Random(seed)
        stream = drawn_stream(rng, jumps=jumps)
        check(stream, drawn_rule(rng, stream.sources), seed)
