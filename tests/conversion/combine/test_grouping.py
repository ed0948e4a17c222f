"""Which messages belong together: held to the rules, applied to all stamps at once."""

from __future__ import annotations

import random
from collections import defaultdict
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.conversion.combine import grouping
from pc2scan.conversion.combine.counts import NO_RUN, SourceCounts
from pc2scan.conversion.combine.grouping import Grouper
from pc2scan.conversion.combine.rules import Interval, Nearest, Recent, SourceMessage
from pc2scan.errors import UsageError
from support import sampled
from support.tables import rows

from .streams_of_stamps import MS, SECOND, Message, by_the_rule, drawn_rule, drawn_stream

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from pc2scan.conversion.combine.rules import Rule

    from .streams_of_stamps import Group, Stream

STAMPS = Path(__file__).with_name("stamps.txt")
RULES: dict[str, Rule] = {
    "nearest": Nearest(windows_ns=(0, 90 * MS, 50 * MS)),
    "recent": Recent(span_ns=300 * MS),
    "few": Recent(count=4),
    "interval": Interval(250 * MS),
    "some": Recent(250 * MS, 0, span_ns=100 * MS),
}
SHORT = Recent(span_ns=100 * MS)


class Held:
    """What a grouper is given for a message: it is held as long as this exists."""

    def __init__(self, message: Message) -> None:
        self.message = message


class Run:
    """A grouper that is given messages; and what it holds and returns."""

    def __init__(self, rule: Rule, sources: int = 2, *, apart_ns: int = 0) -> None:
        self._grouper: Grouper[Held] = Grouper(rule, sources, apart_ns=apart_ns)
        self._alive: WeakSet[Held] = WeakSet()
        self.counts = self._grouper.counts
        self.groups: list[Group] = []
        #: Of each group, the message with which it was complete, and how long it had waited.
        self.completed: list[Message] = []
        self.waits: list[int] = []
        #: The most messages that were held after one was taken.
        self.most = 0

    def add(self, message: Message) -> None:
        held = Held(message)
        self._alive.add(held)
        groups = self._grouper.add(message.source, message.stamp_ns, message.log_time_ns, 100, held)
        self.waits += [message.log_time_ns - group.lead.since_ns for group in groups]
        self.completed += [message] * len(groups)
        self._take(groups)
        del held, groups
        self.most = max(self.most, len(self._alive))

    def finish(self) -> None:
        self._take(self._grouper.finish())
        assert not self._alive
        assert self.series == 0

    def all(self, messages: Iterable[Message]) -> Run:
        """Give it all messages in the order of their log times."""
        for each in sorted(messages, key=lambda each: each.log_time_ns):
            self.add(each)
        self.finish()
        return self

    @property
    def held(self) -> list[Message]:
        return [each.message for each in self._alive]

    @property
    def series(self) -> int:
        """How many clocks there seem to be."""
        return len(self._grouper._open)

    @property
    def sizes(self) -> list[int]:
        return [len(members) for _, members in sorted(self.groups)]

    def stamps(self) -> list[list[int]]:
        """The stamps of groups in milliseconds."""
        return [[member.stamp_ns // MS for member in members] for _, members in self.groups]

    def _take(self, groups: Iterable[Any]) -> None:
        self.groups += [(g.lead.item.message, tuple(entry.item.message for entry in g.members)) for g in groups]


def topic(source: int, at: Iterable[int], stamp: Callable[[int], int] = lambda at: at) -> list[Message]:
    """Messages logged at these milliseconds, and their stamps, in milliseconds too."""
    return [Message(source, stamp(each) * MS, each * MS) for each in at]


def of_stamps(*topics: Sequence[int], late: int = 0) -> list[Message]:
    """Messages logged at their stamps; those of later topics ``late`` after them."""
    found = [Message(s, each * MS, (each + late * s) * MS) for s, own in enumerate(topics) for each in own]
    return sorted(found, key=lambda each: each.log_time_ns)


def check(stream: Stream, rule: Rule, seed: int) -> None:
    """Hold the groups of a stream, their counts and what is held to the rule."""
    run = Run(rule, stream.sources)
    expected = by_the_rule(stream, rule)
    for number, message in enumerate(stream.messages, 1):
        run.add(message)
        if number % 5 == 0:
            check_held(run, stream.messages[:number], rule)
    run.finish()
    assert sorted(run.groups) == sorted(expected), (seed, rule)
    for source, counts in enumerate(run.counts):
        own = [each for each in stream.messages if each.source == source]
        used = {each for _, members in expected for each in members if each.source == source}
        assert (counts.messages, counts.used, counts.unmatched) == (len(own), len(used), len(own) - len(used))
        lacking = {lead: source not in {m.source for m in members} for lead, members in expected}
        assert counts.scans_without == sum(lacking.values())
        assert counts.silence.number == longest_row(lacking)
        if rule.gathers:
            # The others let go of messages as soon as they are in a scan, so not quite in the order of the stamps.
            assert counts.left.number == longest_row({each: each not in used for each in own})


def longest_row(which: Mapping[Message, bool]) -> int:
    """The most messages in a row, of one clock and by their stamps, that something is true of."""
    ordered = sorted(which, key=lambda each: (each.clock, each.key))
    rows = groupby(ordered, key=lambda each: (each.clock, which[each]))
    return max((len(list(row)) for (_, is_true), row in rows if is_true), default=0)


def check_held(run: Run, messages: Sequence[Message], rule: Rule) -> None:
    """Nothing is held that no scan can need: not for longer than a second after a later stamp was logged."""
    now_ns = messages[-1].log_time_ns
    by_clock: dict[int, list[Message]] = defaultdict(list)
    for each in run.held:
        by_clock[each.clock].append(each)
    for clock, own in by_clock.items():
        seen = [each for each in messages if each.clock == clock]
        leads = [each for each in seen if each.source == 0]
        begin_ns = min((each.stamp_ns for each in leads), default=0) - rule.begins_before_ns

        def scan(lead: Message, begin_ns: int = begin_ns) -> Any:
            return (lead.stamp_ns - begin_ns) // rule.every_ns if rule.every_ns else lead.key

        made = {scan(lead) for lead, _ in run.groups if lead.clock == clock}
        last = {scan(lead): lead.key for lead in sorted(leads, key=lambda each: each.key)}
        past = [m.stamp_ns for m in seen if m.source == 0 or m.log_time_ns < now_ns - SECOND]
        waiting = [key for number, key in last.items() if number not in made]
        first = min(waiting or [(max(past, default=-(1 << 80)), 0)])
        for each in own:
            if isinstance(rule, Nearest):
                assert each.stamp_ns >= first[0] - (rule.windows_ns[each.source] if each.source else 0)
            elif isinstance(rule, Recent) and rule.count:
                assert sum(m.source == each.source and each.key < m.key <= first for m in own) < rule.count
            elif isinstance(rule, Recent):
                assert each.stamp_ns > first[0] - rule.span_ns
            else:
                origin_ns = begin_ns if leads else first[0] - rule.begins_before_ns
                assert each.stamp_ns >= first[0] - (first[0] - origin_ns) % rule.every_ns


@pytest.mark.parametrize("part", sampled(range(15), 3))
@pytest.mark.parametrize(
    "clocks", [{}, {"jumps": True}, {"wrong": 2}], ids=["one clock", "jumps of all", "single wrong stamps"]
)
def test_groups_are_those_of_the_rule(part: int, clocks: dict[str, Any]) -> None:
    for seed in range(part, 120, 15):
        rng = random.Random(seed)
        stream = drawn_stream(rng, **clocks)
        check(stream, drawn_rule(rng, stream.sources), seed)


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
    if not isinstance(rule, Recent):
        assert sum(run.sizes) == sum(counts.used for counts in run.counts)
    for source, counts in enumerate(run.counts):
        assert counts.messages == sum(each.source == source for each in messages)
        assert counts.used + counts.unmatched == counts.messages


@pytest.mark.parametrize(("leads", "others", "window", "expected"), rows(STAMPS, "closest pairs"))
def test_the_closest_pairs_are_in_one_scan(
    leads: list[int], others: list[int], window: int, expected: list[list[int]]
) -> None:
    for late in (0, 300, -300):
        run = Run(Nearest(windows_ns=(0, window * MS))).all(of_stamps(leads, others, late=late))
        assert run.stamps() == expected


# When a scan is made


NEAR = Nearest(windows_ns=(0, 50 * MS))
LEADS = range(0, 500, 100)


@pytest.mark.parametrize(
    ("rule", "topics", "expected"),
    [
        (Recent(span_ns=200 * MS), [LEADS], [(at, at) for at in LEADS]),
        (Recent(span_ns=200 * MS), [LEADS, LEADS], [(at, at) for at in LEADS]),
        (Recent(span_ns=200 * MS), [[0, 0, 100, 100]] * 2, [(at, at) for at in (0, 0, 100, 100)]),
        (Recent(span_ns=MS), [LEADS, range(30, 500, 100)], [(at, at + 30) for at in LEADS]),
        (Interval(100 * MS), [LEADS], [(at, at + 100) for at in LEADS[:-1]]),
        # Messages of equal stamps cannot have closer ones; a later lead cannot be closer than one that came.
        (NEAR, [LEADS, LEADS], [(at, at) for at in LEADS]),
        (NEAR, [LEADS, range(30, 500, 100)], [(at, at + 100) for at in LEADS[:-1]]),
        (NEAR, [LEADS, range(-30, 470, 100)], [(at, at + 70) for at in LEADS[:-1]]),
    ],
)
def test_a_scan_is_made_as_soon_as_it_is_certain(rule: Rule, topics: Any, expected: list[tuple[int, int]]) -> None:
    run = Run(rule, len(topics)).all(of_stamps(*topics))
    pairs = zip(run.groups, run.completed, strict=False)
    assert [(lead.stamp_ns // MS, each.stamp_ns // MS) for (lead, _), each in pairs] == expected


@pytest.mark.parametrize("rule", [Interval(100), Recent(100, span_ns=1), Recent(100, count=1)])
def test_an_interval_is_certain_when_its_end_may_come(rule: Rule) -> None:
    lead: SourceMessage[str] = SourceMessage(0, (30, 0), 0, 100, "lead", end_ns=100)
    assert rule.members([lead], [[lead]], [(100, 0)]) == [lead]
    assert rule.members([lead], [[lead]], [(99, 1)]) is None


def test_a_scan_waits_a_second_for_a_silent_topic() -> None:
    silent = [*range(0, 2000, 100), *range(7000, 10_000, 100)]
    run = Run(NEAR).all(of_stamps(range(0, 10_000, 100), silent))
    assert (run.most <= 13, max(run.waits)) == (True, 1_200 * MS)
    assert run.counts[1].silence == (2000 * MS, 6900 * MS, 50)
    assert run.counts[1].scans_without == 50
    # A message with the lead's own stamp shows that no more of them come.
    assert set(Run(Recent(span_ns=SECOND)).all(of_stamps(range(0, 3_000, 100))).waits) == {1_100 * MS}


@pytest.mark.parametrize(
    # A second, and what comes after the lead: twice the largest window, or the rest of the interval.
    ("kind", "wait"),
    {"nearest": 1_200, "recent": 1_050, "few": 1_050, "interval": 1_300, "some": 1_300}.items(),
)
def test_stamps_that_stand_still_are_waited_for_in_vain(kind: str, wait: int) -> None:
    run = Run(RULES[kind], 3).all(Message(number % 2, 0, number * 50 * MS, 0, number // 2) for number in range(100))
    # Equal stamps are within any span.
    assert kind == "recent" or run.most <= 30
    assert max(run.waits) == wait * MS
    assert kind in {"recent", "few"} or set(run.waits) == {wait * MS}


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("leads", sampled([range(50_000, 60_000, 100), range(0), range(0, 2_000, 100)], 1), ids=str)
def test_what_is_held_does_not_grow_with_the_recording(kind: str, leads: range) -> None:
    rule = RULES[kind]
    run = Run(rule, 3).all(of_stamps(leads, range(0, 60_000, 50), range(0, 60_000, 70)))
    # A second of each topic, the time of a scan, and the interval.
    assert run.most <= 60
    assert len(run.groups) == len({(at - leads[0]) * MS // rule.every_ns if rule.every_ns else at for at in leads})


# Clocks


@pytest.mark.parametrize(("moments", "jumps"), rows(STAMPS, "jumps"))
def test_a_stamp_jumps_by_far_more_than_its_log_time(
    moments: list[tuple[int, int]], jumps: list[tuple[int, int]]
) -> None:
    run = Run(RULES["recent"], 1)
    for stamp, log in moments:
        run.add(Message(0, stamp * MS, log * MS))
    assert [(jump.stamp_ns // MS, jump.by_ns // MS) for jump in run.counts[0].jumps] == jumps
    assert run.series == (2 if jumps else 1)


def played(own: Sequence[int], stalls: Callable[[int], int]) -> list[Message]:
    return topic(0, range(0, 10_000, 100)) + topic(1, own, stalls)


#: Messages of topics whose clocks are one all the time.
ONE_CLOCK: dict[str, list[Message]] = {
    "stamps go on slowly": topic(0, range(0, 100_000, 1_000), lambda at: at // 10),
    "a topic lags behind more and more": played(range(0, 9_900, 90), lambda at: at // 2),
    "a topic stalls, and its first and new messages come": [
        *topic(0, range(0, 10_000, 100)),
        *(
            Message(
                1, (3_000 + (at - 6_000) // 100 if 3_000 <= at < 6_000 else at) * MS, max(at, at > 3_000 and 5_990) * MS
            )
            for at in range(0, 9_900, 90)
        ),
    ],
    "played ten times as fast, and a topic pauses": [
        *topic(0, range(0, 1_000, 100), lambda at: 10 * at),
        *topic(1, [0, 1_000], lambda at: 12_200 * at // 1000 - 300),
    ],
    "delayed by 2 s": [*of_stamps([0, 100]), *topic(1, [100], lambda at: at - 2000), *topic(1, [150], lambda _: 0)],
    "delayed, too late": [*of_stamps([0, 100]), *topic(1, [110], lambda at: at - 2010), *topic(1, [150], lambda _: 0)],
}


@pytest.mark.parametrize("name", ONE_CLOCK)
def test_topics_of_one_clock_are_one_series(name: str) -> None:
    run = Run(RULES["recent"])
    for each in sorted(ONE_CLOCK[name], key=lambda each: each.log_time_ns):
        run.add(each)
        assert run.series == 1
    assert [counts.jumped for counts in run.counts] == [0, 0]


@pytest.mark.parametrize("late", [0, 10])
def test_a_topic_delayed_by_more_is_of_another_clock(late: int) -> None:
    run = Run(RULES["recent"])
    for each in [*of_stamps([0, 100]), Message(1, -1901 * MS, (100 + late) * MS)]:
        run.add(each)
    assert run.series == 2


def set_back(at: int) -> int:
    return at + (600 if at < 3_000 else -600)


JUMP = 60_000
#: A rule, messages, the sizes of scans by their numbers, and how often the second topic's stamps jump.
CLOCKS_SET: dict[str, tuple[Rule, list[Message], dict[tuple[int, int | None], list[int]], int]] = {
    "its clock is set, and it comes back to the leads": (
        SHORT,
        topic(0, range(0, 10_000, 100)) + topic(1, range(0, 10_000, 10), set_back),
        {(7, 25): [11] * 18, (40, 90): [11] * 50},
        1,
    ),
    # 2.5 s behind, and then 0.8 s: within 2 s of its own stamps before, and of those of the leading topic.
    "its clock is set, and it joins the leads": (
        SHORT,
        topic(0, range(1_000, 10_000, 100))
        + topic(1, range(0, 10_000, 100), lambda at: at - (2_500 if at < 5_000 else 800)),
        {(0, None): [1] * 32 + [2] * 50 + [1] * 8},
        0,
    ),
    # By 8 s while the leading topic is silent, which its stamps might reach in this time.
    "it jumps while the leads are silent": (
        SHORT,
        topic(0, [*range(0, 1_000, 100), *range(2_500, 12_000, 100)])
        + topic(1, range(50, 3_000, 100), lambda at: at + 8_000 * (at >= 1_000)),
        {(0, None): [1] + [2] * 9 + [1] * 95},
        1,
    ),
    "both jump, the leads later": (
        SHORT,
        topic(0, range(0, 1_000, 100))
        + topic(1, range(50, 10_000, 100), lambda at: at + JUMP * (at >= 1_000))
        + topic(0, range(9_000, 10_000, 100), lambda at: at + JUMP),
        {(0, None): [1] + [2] * 19},
        1,
    ),
    "a message is out of order": (
        Recent(span_ns=SECOND),
        [*topic(1, [100, 101], lambda at: 100 - 50 * (at - 100)), Message(0, 100 * MS, 102 * MS)],
        {(0, None): [3]},
        0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CLOCKS_SET)
def test_a_topic_whose_clock_is_set_joins_its_own_clock(name: str) -> None:
    rule, messages, sizes, jumps = CLOCKS_SET[name]
    run = Run(rule).all(messages)
    assert {which: run.sizes[slice(*which)] for which in sizes} == sizes
    assert run.counts[1].jumped == jumps


def test_a_topic_that_lags_stays_with_the_leads() -> None:
    # The third topic, 3 s behind, is nearer to it in the end, but it goes on with its own stamps.
    messages = topic(0, range(0, 30_000, 100)) + topic(1, range(50, 30_000, 100), lambda at: at * 9 // 10)
    messages += topic(2, range(0, 30_000, 100), lambda at: at - 3_000)
    run = Run(RULES["few"], 3)
    for each in sorted(messages, key=lambda each: each.log_time_ns):
        run.add(each)
        assert run._grouper._series[1] in {None, run._grouper._series[0]}
    assert run.series == 2


@pytest.mark.parametrize(("ahead", "sizes"), [(42, [1] * 42 + [2] * 58), (-42, [2] * 58 + [1] * 42)])
def test_a_given_window_says_how_far_clocks_are_apart(ahead: int, sizes: list[int]) -> None:
    apart = [Message(s, (at + ahead * s) * SECOND, at * SECOND + s) for at in range(100) for s in (0, 1)]
    run = Run(Nearest(windows_ns=(0, 42 * SECOND)), 2, apart_ns=42 * SECOND).all(apart)
    assert run.sizes == sizes
    assert [counts.jumped for counts in run.counts] == [0, 0]


# Intervals


def test_an_interval_that_is_over_has_no_second_scan() -> None:
    # Two that come too late, one of which begins the next interval.
    late = [Message(0, 100 * MS, 1_300 * MS), Message(0, 50 * MS, 1_310 * MS)]
    run = Run(Interval(100 * MS)).all(of_stamps([0], range(0, 1_300, 100)) + late)
    assert [lead.stamp_ns // MS for lead, _ in run.groups] == [0, 100]
    assert run.counts[0].unmatched == 1


def test_the_first_interval_begins_before_its_first_lead() -> None:
    messages = topic(1, [*range(0, 400, 10), *range(900, 2_000, 10)])
    messages += topic(0, [1_060, 1_160], lambda at: at - 1_000)
    run = Run(Interval(100 * MS, 50 * MS)).all(messages)
    assert run.stamps() == [[60, *range(10, 110, 10)], [160, *range(110, 210, 10)]]


def test_of_two_equal_silences_the_first_is_the_longest() -> None:
    counts = SourceCounts()
    for stamps in ((0, 1), (3, 4), (6,)):
        silence, left = NO_RUN, NO_RUN
        for stamp_ns in stamps:
            silence, left = counts.lack(stamp_ns, silence), counts.leave(stamp_ns, left)
    assert counts.silence == counts.left == (0, 1, 2)
    assert counts.scans_without == counts.unmatched == 5


# The end of a series, and memory


def test_a_series_that_nothing_continues_ends() -> None:
    run = Run(Recent(span_ns=5 * SECOND), 1)
    held = []
    for at in range(0, 13_000, 100):
        run.add(Message(0, (at - 3_600_000 * (at >= 1_000)) * MS, at * MS))
        held.append(sum(each.log_time_ns < SECOND for each in run.held))
    # Ten seconds after the last message.
    assert held[9:110] == [10] * 101
    assert not any(held[110:])
    assert run.series == 1


def test_of_many_series_the_most_silent_ones_end() -> None:
    run = Run(Recent(span_ns=5 * SECOND), 1)
    for number in range(200):
        at = number * 10 * MS
        # Every second stamp is of another clock.
        run.add(Message(0, at + (number * 100 * SECOND if number % 2 else 0), at))
        assert run.series == min(4, 1 + (number + 1) // 2)
        others = sorted(each.log_time_ns // MS for each in run.held if each.stamp_ns != each.log_time_ns)
        assert others == [10 * each for each in range(1, number + 1, 2)][-3:]
    assert len(run.held) == 103
    run.finish()
    assert (run.counts[0].jumped, run.counts[0].used) == (199, 200)


def test_memory_has_a_limit_that_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grouping, "MAX_HELD_BYTES", 2_000)
    for rule in (Recent(span_ns=10 * SECOND), Interval(50 * MS), Recent(count=50)):
        Run(rule, 1).all(of_stamps(range(20)))
        with pytest.raises(UsageError, match="points of 21 messages") as caught:
            Run(rule, 1).all(of_stamps(range(100)))
        assert "accumulate" in str(caught.value.hint)


def test_a_silent_topic_makes_no_scan_wait_for_more_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grouping, "MAX_HELD_BYTES", 2_000)
    rule = Nearest(windows_ns=(0, MS))
    run = Run(rule)
    held = []
    for each in of_stamps(range(100), [0]):
        run.add(each)
        held.append(len(run.held))
    # The first two are one scan.
    assert held == [1, 0, *range(1, 20), *[20] * 80]
    run.finish()
    assert run.stamps() == [[0, 0], *([each] for each in range(1, 100))]
    # Messages that no lead is there for are forgotten at once.
    lonely = Run(rule).all(of_stamps([], range(100)))
    assert (lonely.groups, lonely.counts[1].unmatched) == ([], 100)


@pytest.mark.parametrize("old", [15, 1])
def test_an_old_series_gives_its_memory_to_the_new_one(old: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grouping, "MAX_HELD_BYTES", 2_000)
    new = 35 - old if old > 1 else 20
    stamps = [*range(0, 10 * old, 10), *range(1_000_000, 1_000_000 + 10 * new, 10)]
    run = Run(Recent(span_ns=SECOND), 1)
    most = []
    for number, stamp in enumerate(stamps):
        run.add(Message(0, stamp * MS, number * 10 * MS))
        most.append(len(run.held))
    assert most == [*range(1, 21), *range(21 - old, new + 1)]
    assert run.series == 1
    run.finish()
    assert run.sizes == [*range(1, old + 1), *range(1, new + 1)]


def test_an_old_series_that_is_full_ends_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grouping, "MAX_HELD_BYTES", 2_000)
    # Each of two clocks takes a half, and nothing is lost.
    run = Run(Nearest(windows_ns=(0, MS)))
    for number in range(30):
        run.add(Message(0, number * MS + (number % 2) * 900 * SECOND, number * MS))
        assert len(run.held) <= 20
    run.finish()
    assert len(run.groups) == 30
