"""Which messages belong together: held to the rules, applied to all stamps at once."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakSet

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.conversion.combine import grouping
from pc2scan.conversion.combine.grouping import Grouper, Interval, Nearest, Recent, Rule
from pc2scan.errors import UsageError
from support import sampled
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Iterable

STAMPS = Path(__file__).with_name("stamps.txt")
MS = 1_000_000
SECOND = 1_000 * MS
RULES: dict[str, Rule] = {
    "nearest": Nearest(windows_ns=(0, 90 * MS, 50 * MS)),
    "recent": Recent(span_ns=300 * MS),
    "few": Recent(count=4),
    "interval": Interval(250 * MS),
    "some": Recent(250 * MS, 0, span_ns=100 * MS),
}


class Message(NamedTuple):
    """A message; ``place`` is its number among those of its topic with equal stamps."""

    source: int
    stamp_ns: int
    log_time_ns: int
    place: int = 0

    @property
    def key(self) -> tuple[int, int]:
        return self.stamp_ns, self.place


Group = tuple[Message, tuple[Message, ...]]


class Held:
    """What a grouper is given for a message: it is held as long as this exists."""

    def __init__(self, message: Message) -> None:
        self.message = message


class Run:
    """A grouper that is given messages; and what it holds and returns."""

    def __init__(self, rule: Rule, sources: int = 2, *, apart_ns: int = 0) -> None:
        self._grouper = Grouper(rule, sources, apart_ns=apart_ns)
        self._alive: WeakSet[Held] = WeakSet()
        self.counts = self._grouper.counts
        self.groups: list[Group] = []
        #: Of each group, how long it had waited.
        self.waits: list[int] = []
        #: The most messages that were held after one was taken.
        self.most = 0

    def all(self, messages: Iterable[Message]) -> Run:
        """Give it all messages in the order of their log times."""
        for each in sorted(messages, key=lambda each: each.log_time_ns):
            self._add(each)
        self._take(self._grouper.finish())
        assert not self._alive
        return self

    def stamps(self) -> list[list[int]]:
        """The stamps of groups in milliseconds."""
        return [[member.stamp_ns // MS for member in members] for _, members in self.groups]

    def _add(self, message: Message) -> None:
        held = Held(message)
        self._alive.add(held)
        groups = self._grouper.add(message.source, message.stamp_ns, message.log_time_ns, 100, held)
        self.waits += [message.log_time_ns - group.lead.since_ns for group in groups]
        self._take(groups)
        del held, groups
        self.most = max(self.most, len(self._alive))

    def _take(self, groups: Iterable[Any]) -> None:
        self.groups += [(g.lead.item.message, tuple(entry.item.message for entry in g.members)) for g in groups]


def of_stamps(*topics: Iterable[int], late: int = 0) -> list[Message]:
    """Messages logged at their stamps; those of later topics ``late`` after them."""
    return [Message(s, each * MS, (each + late * s) * MS) for s, own in enumerate(topics) for each in own]


def drawn_stream(rng: random.Random, sources: int) -> list[Message]:
    """Topics with jitter, pauses and equal stamps, each logged in the order of its stamps, at most a second late."""
    messages: list[Message] = []
    for source in range(sources):
        period, jitter = rng.choice([3, 5, 10, 20]), rng.choice([0, 1, 4])
        silent = rng.randrange(40) if rng.random() < 0.3 else 40
        delay, logged = rng.choice([0, 3, 50]), 0
        places = Counter[int]()
        for tick in sorted(step + rng.randint(0, jitter) for step in range(rng.randrange(100), 250, period)):
            logged = max(logged, tick + min(100, delay + rng.randint(0, 40)))
            for _ in range(0 if silent <= tick // 10 < silent + 20 else rng.choice([1, 1, 1, 2, 3])):
                messages.append(Message(source, tick * 10 * MS, logged * 10 * MS, places[tick]))
                places[tick] += 1
    # Of one log time, topics come in any order.
    ranks = {(each.log_time_ns, each.source): rng.random() for each in messages}
    return sorted(messages, key=lambda each: (each.log_time_ns, ranks[each.log_time_ns, each.source]))


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


def by_the_rule(messages: list[Message], rule: Rule, sources: int) -> list[Group]:
    """All groups, computed from all stamps at once."""
    topics = [sorted((e for e in messages if e.source == s), key=lambda e: e.key) for s in range(sources)]
    leads = topics[0]
    if isinstance(rule, Nearest):
        return nearest_messages(topics, rule.windows_ns)
    begin_ns = min((each.stamp_ns for each in leads), default=0) - rule.begins_before_ns

    def cell(message: Message) -> int:
        return (message.stamp_ns - begin_ns) // rule.every_ns

    if rule.every_ns:
        leads = list({cell(each): each for each in leads}.values())
    groups = []
    for lead in leads:
        members: list[Message] = []
        for own in topics:
            if isinstance(rule, Recent) and rule.count:
                members += [each for each in own if each.key <= lead.key][-rule.count :]
            elif isinstance(rule, Recent):
                members += [e for e in own if lead.stamp_ns - rule.span_ns < e.stamp_ns and e.key <= lead.key]
            else:
                members += [each for each in own if cell(each) == cell(lead)]
        groups.append((lead, tuple(members)))
    return groups


def nearest_messages(topics: list[list[Message]], windows: tuple[int, ...]) -> list[Group]:
    """Each leading message has the nearest message that is left, and that no later one is nearer to."""
    members: dict[Message, list[Message]] = {lead: [lead] for lead in topics[0]}
    for own, window in zip(topics[1:], windows[1:], strict=True):
        left = list(own)
        for number, lead in enumerate(topics[0]):
            near = [
                (apart_ns, each.key, each)
                for each in left
                if (apart_ns := abs(lead.stamp_ns - each.stamp_ns)) <= window
                and all(abs(later.stamp_ns - each.stamp_ns) >= apart_ns for later in topics[0][number + 1 :])
            ]
            if near:
                members[lead].append(min(near)[2])
                left.remove(min(near)[2])
    return [(lead, tuple(own)) for lead, own in members.items()]


@pytest.mark.parametrize("part", sampled(range(15), 3))
def test_groups_are_those_of_the_rule(part: int) -> None:
    for seed in range(part, 120, 15):
        rng = random.Random(seed)
        sources = rng.randint(1, 3)
        messages, rule = drawn_stream(rng, sources), drawn_rule(rng, sources)
        run, expected = Run(rule, sources).all(messages), by_the_rule(messages, rule, sources)
        assert sorted(run.groups) == sorted(expected), (seed, rule)
        for source, counts in enumerate(run.counts):
            own = [each for each in messages if each.source == source]
            used = {each for _, members in expected for each in members if each.source == source}
            assert (counts.messages, counts.used, counts.unmatched) == (len(own), len(used), len(own) - len(used))
            assert counts.scans_without == sum(source not in {m.source for m in members} for _, members in expected)


@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.integers(-(2**62), 2**62) | st.integers(0, 50), st.integers(0, 5_000)),
        max_size=60,
    ),
    st.sampled_from([
        Nearest(windows_ns=(0, 5, 2**61)), Recent(span_ns=10), Recent(count=2), Interval(7, 3), Recent(7, 2, count=3),
    ]),
)  # fmt: skip
def test_every_message_is_accounted_for(drawn: list[tuple[int, int, int]], rule: Rule) -> None:
    messages = [Message(source, stamp, log * MS) for source, stamp, log in drawn]
    run = Run(rule, 3).all(messages)
    leads = [each for each in messages if each.source == 0]
    assert len(run.groups) <= len(leads)
    assert all(at.source == 0 and at in members for at, members in run.groups)
    if not rule.every_ns:
        assert len(run.groups) == len(leads)
    for source, counts in enumerate(run.counts):
        assert counts.messages == sum(each.source == source for each in messages)
        assert counts.used + counts.unmatched == counts.messages


@pytest.mark.parametrize(("leads", "others", "window", "expected"), rows(STAMPS, "nearest"))
def test_the_nearest_messages_are_in_one_scan(
    leads: list[int], others: list[int], window: int, expected: list[list[int]]
) -> None:
    for late in (0, 300, -300):
        run = Run(Nearest(windows_ns=(0, window * MS))).all(of_stamps(leads, others, late=late))
        assert run.stamps() == expected


def test_a_scan_waits_a_second_for_a_silent_topic() -> None:
    silent = [*range(0, 2000, 100), *range(7000, 10_000, 100)]
    run = Run(Nearest(windows_ns=(0, 50 * MS))).all(of_stamps(range(0, 10_000, 100), silent))
    assert (run.most <= 13, max(run.waits)) == (True, 1_200 * MS)
    assert (run.counts[1].scans_without, run.counts[1].edges) == (50, [False, False])


@pytest.mark.parametrize(
    # A second, and what comes after the lead: twice the largest window, or the rest of the interval.
    ("kind", "wait"),
    {"nearest": 1_200, "recent": 1_050, "few": 1_050, "interval": 1_300, "some": 1_300}.items(),
)
def test_stamps_that_stand_still_are_waited_for_in_vain(kind: str, wait: int) -> None:
    run = Run(RULES[kind], 3).all(Message(number % 2, 0, number * 50 * MS, number // 2) for number in range(100))
    # Equal stamps are within any span.
    assert kind == "recent" or run.most <= 30
    assert max(run.waits) == wait * MS


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("leads", sampled([range(50_000, 60_000, 100), range(0), range(0, 2_000, 100)], 1), ids=str)
def test_what_is_held_does_not_grow_with_the_recording(kind: str, leads: range) -> None:
    rule = RULES[kind]
    run = Run(rule, 3).all(of_stamps(leads, range(0, 60_000, 50), range(0, 60_000, 70)))
    # A second of each topic, the time of a scan, and the interval.
    assert run.most <= 60
    assert len(run.groups) == len({(at - leads[0]) * MS // rule.every_ns if rule.every_ns else at for at in leads})


@pytest.mark.parametrize(("moments", "jumped", "first"), rows(STAMPS, "jumps"))
def test_a_stamp_jumps_by_far_more_than_its_log_time(
    moments: list[tuple[int, int]], jumped: int, first: tuple[int, int]
) -> None:
    run = Run(RULES["recent"], 1).all(Message(0, stamp * MS, log * MS) for stamp, log in moments)
    (counts,) = run.counts
    assert (counts.jumped, *(each // MS for each in counts.first_jump)) == (jumped, *first)
    assert counts.used == len(moments)


#: What the second of two topics has: its stamps, milliseconds, by their log times; the sizes of scans from some on.
@pytest.mark.parametrize(
    ("stamps", "sizes"),
    [
        ({at: at + 60_000 for at in range(0, 9_000, 100)}, [1] * 90),
        # It comes back.
        ({at: at + 60_000 * (2_000 < at < 5_000) for at in range(0, 9_000, 100)}, [*[2] * 21, *[1] * 29, *[2] * 40]),
    ],
)
def test_a_topic_of_another_clock_is_in_no_scan(stamps: dict[int, int], sizes: list[int]) -> None:
    own = [Message(1, stamp * MS, log * MS) for log, stamp in stamps.items()]
    run = Run(Nearest(windows_ns=(0, 10 * MS))).all([*of_stamps(range(0, 9_000, 100)), *own])
    assert [len(members) for _, members in run.groups][: len(sizes)] == sizes


@pytest.mark.parametrize(("ahead", "sizes"), [(42, [1] * 42 + [2] * 58), (-42, [2] * 58 + [1] * 42)])
def test_a_given_window_says_how_far_clocks_are_apart(ahead: int, sizes: list[int]) -> None:
    apart = [Message(s, (at + ahead * s) * SECOND, at * SECOND + s) for at in range(100) for s in (0, 1)]
    run = Run(Nearest(windows_ns=(0, 42 * SECOND)), 2, apart_ns=42 * SECOND).all(apart)
    assert [len(members) for _, members in sorted(run.groups)] == sizes
    assert [counts.jumped for counts in run.counts] == [0, 0]


def test_an_interval_that_is_over_has_no_second_scan() -> None:
    # Two that come too late, one of which begins the next interval.
    late = [Message(0, 100 * MS, 1_300 * MS), Message(0, 50 * MS, 1_310 * MS)]
    run = Run(Interval(100 * MS)).all(of_stamps([0], range(0, 1_300, 100)) + late)
    assert [lead.stamp_ns // MS for lead, _ in run.groups] == [0, 100]
    assert run.counts[0].unmatched == 1


def test_memory_has_a_limit_that_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grouping, "MAX_HELD_BYTES", 2_000)
    for rule in (Recent(span_ns=10 * SECOND), Interval(50 * MS), Recent(count=50)):
        Run(rule, 1).all(of_stamps(range(20)))
        with pytest.raises(UsageError, match="points of 21 messages") as caught:
            Run(rule, 1).all(of_stamps(range(100)))
        assert "accumulate" in str(caught.value.hint)
    # A silent topic makes no scan wait for more.
    run = Run(Nearest(windows_ns=(0, MS))).all(of_stamps(range(100), [0]))
    assert (run.most, run.stamps()) == (20, [[0, 0], *([each] for each in range(1, 100))])
