"""Which messages belong together: held to the rules, applied to all stamps at once."""

from __future__ import annotations

import random
from itertools import groupby
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.errors import UsageError
from pc2scan.pipeline.combine import matching
from pc2scan.pipeline.combine.counts import NO_RUN, SourceCounts
from pc2scan.pipeline.combine.matching import Grouper
from pc2scan.pipeline.combine.rules import Entry, Interval, Nearest, Recent
from support import sampled

from .streams_of_stamps import MS, SECOND, Message, by_the_rule, drawn_rule, drawn_stream

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pc2scan.pipeline.combine.rules import Rule

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
        lacking = {lead: source not in {m.source for m in members} for lead, members in expected}
        assert counts.scans_without == sum(lacking.values())
        assert counts.silence.number == longest_row(lacking)
        if rule.gathers:
            # The others let go of messages as soon as they are in a scan, so not quite in the order of the stamps.
            assert counts.left.number == longest_row({each: each not in used for each in own})
    assert grouper._open == []


def longest_row(which: Mapping[Message, bool]) -> int:
    """The most messages in a row, of one clock and by their stamps, that something is true of."""
    ordered = sorted(which, key=lambda each: (each.clock, each.key))
    rows = groupby(ordered, key=lambda each: (each.clock, which[each]))
    return max((len(list(row)) for (_, is_true), row in rows if is_true), default=0)


def check_held(grouper: Grouper[Message], messages: Sequence[Message], rule: Rule) -> None:
    """Nothing is held that no scan can need: not for longer than a second after a later stamp was logged."""
    now_ns = messages[-1].log_time_ns
    for series in grouper._open:
        own = [entry.item for held in series._held for entry in held]
        if not own:
            continue
        clock = own[0].clock
        assert {each.clock for each in own} == {clock}
        assert series.size == 100 * len(own)
        past = [m.stamp_ns for m in messages if m.clock == clock and (m.source == 0 or m.log_time_ns < now_ns - SECOND)]
        first = min([lead.key for lead in series._leads] or [(max(past, default=-(1 << 80)), 0)])
        begin_ns = min((m.stamp_ns for m in messages if m.clock == clock and m.source == 0), default=first[0])
        for each in own:
            later = sum(m.source == each.source and each.key < m.key <= first for m in own)
            if isinstance(rule, Nearest):
                assert each.stamp_ns >= first[0] - (rule.windows_ns[each.source] if each.source else 0)
            elif isinstance(rule, Recent):
                assert later < rule.count if rule.count else each.stamp_ns > first[0] - rule.span_ns
            else:
                phase_ns = (first[0] - begin_ns + rule.begins_before_ns) % rule.every_ns
                assert each.stamp_ns >= first[0] - phase_ns


@pytest.mark.parametrize("part", sampled(range(12), 1))
@pytest.mark.parametrize(
    "clocks", [{}, {"jumps": True}, {"wrong": 2}], ids=["one clock", "jumps of all", "single wrong stamps"]
)
def test_groups_are_those_of_the_rule(part: int, clocks: dict[str, Any]) -> None:
    for seed in range(part, 120, 12):
        rng = random.Random(seed)
        stream = drawn_stream(rng, **clocks)
        check(stream, drawn_rule(rng, stream.sources), seed)


@pytest.mark.parametrize(
    ("leads", "others", "window", "expected"),
    [
        # The nearest lead, not the first one that the message is near enough to.
        ([500, 500, 570], [550], 60, [[500], [500], [570, 550]]),
        # No lead goes without while one is left.
        ([0, 100], [40, 45], 60, [[0, 40], [100, 45]]),
        ([0, 100], [40, 45], 54, [[0, 40], [100]]),
        ([500, 500], [500, 505], 60, [[500, 500], [500, 505]]),
        ([500, 500], [500], 60, [[500, 500], [500]]),
        # Of two equally close leads the earlier one, of two equally close messages the earlier one.
        ([0, 100], [50], 60, [[0, 50], [100]]),
        ([100], [50, 150], 60, [[100, 50]]),
        # The window itself is within it.
        ([100], [160], 60, [[100, 160]]),
        ([100], [40], 60, [[100, 40]]),
        ([100], [39, 161], 60, [[100]]),
        # One message is another lead's, but that lead has a closer one.
        ([0, 100], [55, 140, 150], 60, [[0, 55], [100, 140]]),
        # A lead loses a message to a closer one, and has another instead.
        ([0, 60], [50, 90], 60, [[0], [60, 50]]),
        ([0, 60], [-40, 50], 60, [[0, -40], [60, 50]]),
    ],
)
def test_the_closest_pairs_are_in_one_scan(
    leads: list[int], others: list[int], window: int, expected: list[list[int]]
) -> None:
    for late in (0, 300, -300):
        grouper: Grouper[Message] = Grouper(Nearest(windows_ns=(0, window * MS)), 2)
        assert stamps_in(groups_of(grouper, of_stamps(leads, others, late=late))) == expected


def test_a_scan_waits_a_second_for_a_silent_topic() -> None:
    messages = of_stamps(range(0, 10_000, 100), [*range(0, 2000, 100), *range(7000, 10_000, 100)])
    grouper: Grouper[Message] = Grouper(Nearest(windows_ns=(0, 50 * MS)), 2)
    most, waits = 0, []
    for message in messages:
        groups = grouper.add(message.source, message.stamp_ns, message.log_time_ns, 100, message)
        waits += [message.log_time_ns - group.lead.since_ns for group in groups]
        most = max(most, grouper._open[0].held)
    assert most <= 13
    assert max(waits) == 1_200 * MS
    # A message with the lead's own stamp shows that no more of them come.
    assert {
        message.log_time_ns - group.lead.since_ns
        for recent in [Grouper[Message](Recent(span_ns=SECOND), 2)]
        for message in of_stamps(range(0, 3_000, 100))
        for group in recent.add(0, message.stamp_ns, message.log_time_ns, 100, message)
    } == {1_100 * MS}
    grouper.finish()
    assert grouper.counts[1].silence == (2000 * MS, 6900 * MS, 50)
    assert grouper.counts[1].scans_without == 50


def test_a_scan_follows_the_message_that_makes_it_certain() -> None:
    def completed(rule: Rule, *topics: Sequence[int]) -> list[tuple[int, int]]:
        """The stamp of each scan, and that of the message that completed it."""
        grouper: Grouper[Message] = Grouper(rule, len(topics))
        return [
            (group.lead.stamp_ns // MS, each.stamp_ns // MS)
            for each in of_stamps(*topics)
            for group in grouper.add(each.source, each.stamp_ns, each.log_time_ns, 100, each)
        ]

    both = range(0, 500, 100)
    assert completed(Recent(span_ns=200 * MS), both) == [(each, each) for each in both]
    assert completed(Recent(span_ns=200 * MS), both, both) == [(each, each) for each in both]
    twice = [0, 0, 100, 100]
    assert completed(Recent(span_ns=200 * MS), twice, twice) == [(each, each) for each in twice]
    assert completed(Recent(span_ns=MS), both, range(30, 500, 100)) == [(at, at + 30) for at in both]
    assert completed(Interval(100 * MS), both) == [(each, each + 100) for each in both[:-1]]
    # Messages of equal stamps cannot have closer ones; a later lead cannot be closer than one that came.
    assert completed(Nearest(windows_ns=(0, 50 * MS)), both, both) == [(each, each) for each in both]
    assert completed(Nearest(windows_ns=(0, 50 * MS)), both, range(30, 500, 100)) == [
        (at, at + 100) for at in both[:-1]
    ]
    assert completed(Nearest(windows_ns=(0, 50 * MS)), both, range(-30, 470, 100)) == [
        (at, at + 70) for at in both[:-1]
    ]


@pytest.mark.parametrize("rule", [Interval(100), Recent(100, span_ns=1), Recent(100, count=1)])
def test_an_interval_is_certain_when_its_end_may_come_next(rule: Rule) -> None:
    lead: Entry[str] = Entry(0, (30, 0), 0, 100, "lead", end_ns=100)
    assert rule.members([lead], [[lead]], [(100, 0)]) == [lead]
    assert rule.members([lead], [[lead]], [(99, 1)]) is None


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("leads", [range(0), range(0, 2_000, 100), range(50_000, 60_000, 100)], ids=str)
def test_what_is_held_does_not_grow_with_the_recording(kind: str, leads: range) -> None:
    grouper: Grouper[Message] = Grouper(RULES[kind], 3)
    most = 0
    found = 0
    for each in of_stamps(leads, range(0, 60_000, 50), range(0, 60_000, 70)):
        found += len(grouper.add(each.source, each.stamp_ns, each.log_time_ns, 100, each))
        most = max(most, grouper._open[0].held)
    # A second of each topic, the time of a scan, and the interval.
    assert most <= 60
    assert found + len(grouper.finish()) == sum(len(by_cell) for by_cell in [cells(leads, RULES[kind])])


def cells(leads: range, rule: Rule) -> set[int]:
    """The scans that leading messages have."""
    return {(each - leads[0]) * MS // rule.every_ns if rule.every_ns else each for each in leads}


@pytest.mark.parametrize(
    # A second, and what comes after the lead: twice the largest window, or the rest of the interval.
    ("kind", "wait"),
    {"nearest": 1_150, "recent": 1_050, "few": 1_050, "interval": 1_300, "some": 1_300}.items(),
)
def test_stamps_that_stand_still_are_waited_for_only_so_long(kind: str, wait: int) -> None:
    grouper: Grouper[Message] = Grouper(RULES[kind], 3)
    messages = [Message(number % 2, 0, number * 50 * MS, 0, number // 2) for number in range(100)]
    waits = []
    for each in messages:
        groups = grouper.add(each.source, 0, each.log_time_ns, 100, each)
        waits += [each.log_time_ns - group.lead.since_ns for group in groups]
        # Equal stamps are within any span.
        assert kind == "recent" or grouper._open[0].held <= 30
    assert max(waits) == wait * MS
    assert kind in {"recent", "few"} or set(waits) == {wait * MS}


@pytest.mark.parametrize(
    ("moments", "jumps"),
    [
        # Out of order by up to a second, and more.
        ([(0, 0), (1000, 10), (0, 20), (1000, 30)], []),
        ([(0, 0), (1001, 10), (0, 20)], [(0, -1011)]),
        # Ahead by two seconds more than ten times as far as the log times, and more.
        ([(0, 0), (3000, 100)], []),
        ([(0, 0), (3001, 100)], [(3001, 2901)]),
        # The recorder stood still, or its clock was set; it records what is played ten times as fast.
        ([(0, 0), (100, 60_000), (200, 60_000)], []),
        ([(0, 0), (60_000, 6_000), (120_000, 12_000)], []),
        ([(0, 0), (60_000, 60_000)], []),
        # Away and back again.
        ([(0, 0), (90_000, 100), (200, 200)], [(90_000, 89_900), (200, -89_900)]),
    ],
)
def test_a_stamp_jumps_by_far_more_than_its_log_time(
    moments: list[tuple[int, int]], jumps: list[tuple[int, int]]
) -> None:
    grouper: Grouper[Message] = Grouper(RULES["recent"], 1)
    for stamp, log in moments:
        grouper.add(0, stamp * MS, log * MS, 100, Message(0, stamp * MS, log * MS))
    found = [(jump.stamp_ns // MS, jump.by_ns // MS) for jump in grouper.counts[0].jumps]
    assert found == jumps
    assert len(grouper._open) == (2 if jumps else 1)


@pytest.mark.parametrize("late", [0, 10])
def test_topics_of_one_clock_may_be_delayed_differently(late: int) -> None:
    for behind, are_one in ((2000, True), (2001, False)):
        messages = [*of_stamps([0, 100]), Message(1, (100 - behind) * MS, (100 + late) * MS), Message(1, 0, 150 * MS)]
        grouper: Grouper[Message] = Grouper(RULES["recent"], 2)
        for each in messages:
            grouper.add(each.source, each.stamp_ns, each.log_time_ns, 100, each)
        assert (len(grouper._open) == 1) is are_one


@pytest.mark.parametrize(("ahead", "sizes"), [(42, [1] * 42 + [2] * 58), (-42, [2] * 58 + [1] * 42)])
def test_a_given_window_says_how_far_clocks_are_apart(ahead: int, sizes: list[int]) -> None:
    apart = [
        Message(source, (at + ahead * source) * SECOND, at * SECOND + source) for at in range(100) for source in (0, 1)
    ]
    grouper: Grouper[Message] = Grouper(Nearest(windows_ns=(0, 42 * SECOND)), 2, apart_ns=42 * SECOND)
    assert [len(members) for _, members in groups_of(grouper, apart)] == sizes
    assert [counts.jumped for counts in grouper.counts] == [0, 0]


@pytest.mark.parametrize(
    "stamp_of",
    [
        # It lags behind more and more.
        lambda at: at // 2,
        # Its messages wait for three seconds, and only the first of them and the new ones come.
        lambda at: 3_000 + (at - 6_000) // 100 if 3_000 <= at < 6_000 else at,
    ],
    ids=["it lags", "it stalls"],
)
def test_a_topic_goes_on_with_its_own_stamps_or_with_others(stamp_of: Callable[[int], int]) -> None:
    messages = [Message(0, at * MS, at * MS) for at in range(0, 10_000, 100)]
    messages += [
        Message(1, stamp_of(at) * MS, (max(at, 5_990) if at > 3_000 else at) * MS) for at in range(0, 9_900, 90)
    ]
    grouper: Grouper[Message] = Grouper(RULES["recent"], 2)
    for each in sorted(messages, key=lambda each: each.log_time_ns):
        grouper.add(each.source, each.stamp_ns, each.log_time_ns, 100, each)
    assert len(grouper._open) == 1
    assert [counts.jumped for counts in grouper.counts] == [0, 0]


def test_a_topic_whose_clock_is_set_comes_back_to_the_leads() -> None:
    messages = of_stamps(range(0, 10_000, 100))
    messages += [Message(1, (at + (600 if at < 3_000 else -600)) * MS, at * MS) for at in range(0, 10_000, 10)]
    messages.sort(key=lambda each: each.log_time_ns)
    grouper: Grouper[Message] = Grouper(Recent(span_ns=100 * MS), 2)
    found = groups_of(grouper, messages)
    assert [len(members) for _, members in found[7:25]] == [11] * 18
    assert [len(members) for _, members in found[40:90]] == [11] * 50
    assert grouper.counts[1].jumped == 1


def test_a_topic_whose_clock_is_set_joins_the_leads() -> None:
    # It is 2.5 s behind, and then 0.8 s: within 2 s of its own stamps before, and of those of the leading topic.
    messages = [Message(1, (at - (2_500 if at < 5_000 else 800)) * MS, at * MS) for at in range(0, 10_000, 100)]
    messages += [Message(0, at * MS, at * MS) for at in range(1_000, 10_000, 100)]
    grouper: Grouper[Message] = Grouper(Recent(span_ns=100 * MS), 2)
    found = groups_of(grouper, sorted(messages, key=lambda each: each.log_time_ns))
    assert [len(members) for _, members in sorted(found)] == [1] * 32 + [2] * 50 + [1] * 8


def test_a_topic_that_lags_stays_with_the_leads() -> None:
    # The third topic, 3 s behind, is nearer to it in the end, but it goes on with its own stamps.
    messages = [Message(0, at * MS, at * MS) for at in range(0, 30_000, 100)]
    messages += [Message(1, at * 9 // 10 * MS, at * MS) for at in range(50, 30_000, 100)]
    messages += [Message(2, (at - 3_000) * MS, at * MS) for at in range(0, 30_000, 100)]
    grouper: Grouper[Message] = Grouper(RULES["few"], 3)
    for each in sorted(messages, key=lambda each: each.log_time_ns):
        grouper.add(each.source, each.stamp_ns, each.log_time_ns, 100, each)
        assert grouper._series[1] in {None, grouper._series[0]}
    assert len(grouper._open) == 2


def test_topics_that_are_played_fast_are_of_one_clock() -> None:
    # Ten times as fast, and one topic pauses.
    messages = [Message(0, 10 * at * MS, at * MS) for at in range(0, 1_000, 100)]
    messages += [Message(1, -300 * MS, 0), Message(1, 11_900 * MS, 1_000 * MS)]
    grouper: Grouper[Message] = Grouper(RULES["recent"], 2)
    for each in sorted(messages, key=lambda each: each.log_time_ns):
        grouper.add(each.source, each.stamp_ns, each.log_time_ns, 100, each)
    assert len(grouper._open) == 1


def test_another_clock_does_not_join_silent_leads() -> None:
    # It jumps by 8 s while the leading topic is silent, which its stamps might reach in this time.
    messages = [Message(1, (at + 8_000 * (at >= 1_000)) * MS, at * MS) for at in range(50, 3_000, 100)]
    messages += [Message(0, at * MS, at * MS) for at in [*range(0, 1_000, 100), *range(2_500, 12_000, 100)]]
    grouper: Grouper[Message] = Grouper(Recent(span_ns=100 * MS), 2)
    found = groups_of(grouper, sorted(messages, key=lambda each: each.log_time_ns))
    assert [len(members) for _, members in found] == [1] + [2] * 9 + [1] * 95


def test_a_message_out_of_order_makes_no_scan_wait() -> None:
    grouper: Grouper[Message] = Grouper(Recent(span_ns=SECOND), 2)
    found = []
    for source, stamp, log in ((1, 100, 100), (1, 50, 101), (0, 100, 102)):
        found += grouper.add(source, stamp * MS, log * MS, 100, Message(source, stamp * MS, log * MS))
    assert [[each.stamp_ns // MS for each in group.members] for group in found] == [[100, 50, 100]]


def test_a_jump_while_the_leading_topic_is_silent() -> None:
    jump = 60 * SECOND
    messages = [Message(0, at * MS, at * MS) for at in range(0, 1_000, 100)]
    messages += [Message(1, at * MS + jump * (at >= 1_000), at * MS) for at in range(50, 10_000, 100)]
    messages += [Message(0, at * MS + jump, at * MS) for at in range(9_000, 10_000, 100)]
    grouper: Grouper[Message] = Grouper(Recent(span_ns=100 * MS), 2)
    found = groups_of(grouper, sorted(messages, key=lambda each: each.log_time_ns))
    assert [len(members) for _, members in found] == [1] + [2] * 19


def test_an_interval_that_is_over_has_no_second_scan() -> None:
    messages = of_stamps([0], range(0, 1_300, 100))
    # Two that come too late, one of which begins the next interval.
    messages += [Message(0, 100 * MS, 1_300 * MS), Message(0, 50 * MS, 1_310 * MS)]
    grouper: Grouper[Message] = Grouper(Interval(100 * MS), 2)
    found = groups_of(grouper, messages)
    assert [lead.stamp_ns // MS for lead, _ in found] == [0, 100]
    assert grouper.counts[0].unmatched == 1


def test_the_first_interval_begins_before_its_first_lead() -> None:
    messages = [Message(1, at * MS, at * MS) for at in range(0, 400, 10)]
    messages += [Message(0, at * MS, (at + 1_000) * MS) for at in (60, 160)]
    messages += [Message(1, at * MS, at * MS) for at in range(900, 2_000, 10)]
    grouper: Grouper[Message] = Grouper(Interval(100 * MS, 50 * MS), 2)
    found = groups_of(grouper, sorted(messages, key=lambda each: each.log_time_ns))
    assert stamps_in(found) == [[60, *range(10, 110, 10)], [160, *range(110, 210, 10)]]


def test_stamps_may_go_on_more_slowly_than_log_times() -> None:
    slow = [Message(0, at * MS, 10 * at * MS) for at in range(0, 10_000, 100)]
    grouper: Grouper[Message] = Grouper(Interval(SECOND), 1)
    assert [len(members) for _, members in groups_of(grouper, slow)] == [10] * 10


def test_of_two_equal_silences_the_first_is_the_longest() -> None:
    counts = SourceCounts()
    for stamps in ((0, 1), (3, 4), (6,)):
        silence, left = NO_RUN, NO_RUN
        for stamp_ns in stamps:
            silence, left = counts.lack(stamp_ns, silence), counts.leave(stamp_ns, left)
    assert counts.silence == counts.left == (0, 1, 2)
    assert counts.scans_without == counts.unmatched == 5


def test_a_series_that_nothing_continues_ends() -> None:
    grouper: Grouper[Message] = Grouper(Recent(span_ns=5 * SECOND), 1)
    for at in range(0, 1_000, 100):
        grouper.add(0, at * MS, at * MS, 100, Message(0, at * MS, at * MS))
    held = []
    for at in range(1_000, 13_000, 100):
        grouper.add(0, at * MS - 3600 * SECOND, at * MS, 100, Message(0, at * MS, at * MS))
        held.append(grouper._open[0].held)
    # Ten seconds after the last message.
    assert held[:100] == [10] * 100
    assert held[100] == 50
    assert len(grouper._open) == 1


def test_of_many_series_the_most_silent_ones_end() -> None:
    grouper: Grouper[Message] = Grouper(Recent(span_ns=5 * SECOND), 1)
    for number in range(200):
        at = number * 10 * MS
        # Every second stamp is of another clock.
        stamp_ns = at if number % 2 == 0 else at + number * 100 * SECOND
        grouper.add(0, stamp_ns, at, 100, Message(0, stamp_ns, at))
        assert len(grouper._open) == min(4, 1 + (number + 1) // 2)
    assert grouper._open[0].held == 100
    grouper.finish()
    assert grouper.counts[0].jumped == 199
    assert grouper.counts[0].used == 200


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
    grouper: Grouper[Message] = Grouper(rule, 3)
    messages = [Message(source, stamp, log * MS) for source, stamp, log in sorted(drawn, key=lambda each: each[2])]
    found = groups_of(grouper, messages)
    leads = [each for each in messages if each.source == 0]
    assert len(found) <= len(leads)
    assert all(at.source == 0 and at in members for at, members in found)
    if not rule.every_ns:
        assert len(found) == len(leads)
    if not isinstance(rule, Recent):
        assert sum(len(members) for _, members in found) == sum(counts.used for counts in grouper.counts)
    for source, counts in enumerate(grouper.counts):
        assert counts.messages == sum(each.source == source for each in messages)
        assert counts.used + counts.unmatched == counts.messages


def test_memory_has_a_limit_that_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matching, "MAX_HELD_BYTES", 2_000)
    packets = of_stamps(range(100))
    for rule in (Recent(span_ns=10 * SECOND), Interval(50 * MS), Recent(count=50)):
        with pytest.raises(UsageError, match="points of 21 messages") as caught:
            groups_of(Grouper(rule, 1), packets)
        assert "accumulate" in str(caught.value.hint)


def test_a_silent_topic_makes_no_scan_wait_beyond_that_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matching, "MAX_HELD_BYTES", 2_000)
    grouper: Grouper[Message] = Grouper(Nearest(windows_ns=(0, MS)), 2)
    messages = of_stamps(range(100), [0])
    found = []
    for number, each in enumerate(messages):
        found += grouper.add(each.source, each.stamp_ns, each.log_time_ns, 100, each)
        assert grouper._open[0].held <= 20
        assert grouper._open[0].held >= 19 or number < 20
    found += grouper.finish()
    assert [group.lead.stamp_ns // MS for group in found] == [*range(100)]
    # Messages that no lead is there for are forgotten at once.
    others = of_stamps([], range(100))
    assert groups_of(Grouper(Nearest(windows_ns=(0, MS)), 2), others) == []


def test_an_old_series_gives_its_memory_to_the_new_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matching, "MAX_HELD_BYTES", 2_000)
    old, new = range(0, 150, 10), range(1_000_000, 1_000_150, 10)
    messages = [Message(0, at * MS, number * 10 * MS) for number, at in enumerate([*old, *new])]
    grouper: Grouper[Message] = Grouper(Recent(span_ns=SECOND), 1)
    found = groups_of(grouper, messages)
    assert [len(members) for _, members in found] == [*range(1, 16), *range(1, 16)]
