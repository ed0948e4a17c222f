"""Which messages belong together: held to the rule, applied to all stamps at once."""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pc2scan.errors import UsageError
from pc2scan.pipeline.combine import matching
from pc2scan.pipeline.combine.matching import Grouper, Intervals, Nearest, Recent

MS = 1_000_000

Message = tuple[int, int, int]  # source, stamp, log time


def groups_of(grouper: Grouper[Message], messages: list[Message]) -> list[tuple[Message, list[Message]]]:
    """All groups of messages, which are given to it by log time."""
    found = []
    for message in sorted(messages, key=lambda each: each[2]):
        found += grouper.add(message[0], message[1], message[2], 100, message)
    found += grouper.finish()
    return [(group.lead.item, [entry.item for entry in group.members]) for group in found]


def by_the_rule(messages: list[Message], windows: list[int]) -> list[tuple[Message, list[Message]]]:
    """Each message belongs to the nearest leading one; the nearest of each topic is in its group."""
    leads = sorted((m for m in messages if m[0] == 0), key=lambda m: m[1])
    found = []
    for lead in leads:
        members = [lead]
        for source in range(1, len(windows)):
            own = []
            for m in messages:
                if m[0] != source or abs(m[1] - lead[1]) > windows[source]:
                    continue
                if min(leads, key=lambda other: (abs(other[1] - m[1]), other[1])) == lead:
                    own.append(m)
            if own:
                members.append(min(own, key=lambda m: (abs(m[1] - lead[1]), m[1])))
        found.append((lead, members))
    return found


@st.composite
def recordings(draw: st.DrawFn) -> list[Message]:
    found = []
    for source in range(draw(st.integers(1, 3))):
        period = draw(st.sampled_from([20, 50, 100]))
        phase = draw(st.integers(0, 99))
        stamps = [phase + number * period + draw(st.integers(0, 9)) for number in range(draw(st.integers(1, 12)))]
        late = draw(st.integers(0, 60))
        found += [
            (source, stamp * MS, (stamp + late + draw(st.integers(0, 30))) * MS) for stamp in dict.fromkeys(stamps)
        ]
    return found


@settings(deadline=None, max_examples=300)
@given(recordings())
def test_the_nearest_of_each_topic_is_in_the_group_whatever_the_log_times(messages: list[Message]) -> None:
    sources = 1 + max(m[0] for m in messages)
    windows = [50 * MS] * sources
    grouper: Nearest[Message] = Nearest(windows)
    # Within a topic, messages are logged in the order of their stamps.
    ordered = []
    for source in range(sources):
        own = sorted(m for m in messages if m[0] == source)
        logged = sorted(m[2] for m in own)
        ordered += [(source, m[1], log) for m, log in zip(own, logged, strict=True)]
    found = groups_of(grouper, ordered)
    assert found == by_the_rule(ordered, windows)
    for source, counts in enumerate(grouper.counts):
        assert counts.messages == sum(m[0] == source for m in ordered)
        assert counts.used == sum(m[0] == source for _, members in found for m in members)
        assert counts.used + counts.unmatched == counts.messages
        assert counts.scans_without == sum(source not in {m[0] for m in members} for _, members in found)


def test_two_leads_do_not_share_a_message() -> None:
    fast = [(0, t * MS, t * MS) for t in range(0, 1000, 50)]
    slow = [(1, t * MS + 5 * MS, t * MS + 7 * MS) for t in range(0, 1000, 100)]
    grouper: Nearest[Message] = Nearest([0, 50 * MS])
    found = groups_of(grouper, fast + slow)
    assert [len(members) for _, members in found] == [2, 1] * 10
    assert grouper.counts[1].unmatched == 0
    assert grouper.counts[1].scans_without == 10


def test_a_silent_topic_is_waited_for_only_so_long_and_its_silence_is_known() -> None:
    lead = [(0, t * MS, t * MS) for t in range(0, 10_000, 100)]
    other = [(1, t * MS, t * MS) for t in [*range(0, 2000, 100), *range(7000, 10_000, 100)]]
    grouper: Nearest[Message] = Nearest([0, 50 * MS])
    most = 0
    waits = []
    for message in sorted(lead + other, key=lambda each: (each[2], each[0])):
        groups = grouper.add(message[0], message[1], message[2], 100, message)
        waits += [message[2] - group.lead.log_time_ns for group in groups]
        most = max(most, len(grouper._waiting))  # what is held is what memory is
    assert most <= 12
    assert max(waits) <= 1_100 * MS
    grouper.finish()
    assert grouper.counts[1].silence == (2000 * MS, 6900 * MS, 50)
    assert grouper.counts[1].scans_without == 50


def test_the_last_seconds_of_every_topic() -> None:
    lead = [(0, t * MS, t * MS) for t in range(0, 1000, 100)]
    other = [(1, t * MS, (t + 30) * MS) for t in range(0, 1000, 70)]
    grouper: Recent[Message] = Recent(2, 250 * MS)
    found = groups_of(grouper, lead + other)
    assert [group[0] for group in found] == lead
    for at, members in found:
        wanted = [m for m in lead + other if at[1] - 250 * MS < m[1] <= at[1]]
        assert sorted(members) == sorted(wanted)
    after = sum(m[1] > lead[-1][1] for m in other)
    assert [counts.unmatched for counts in grouper.counts] == [0, after]


def test_the_last_few_clouds() -> None:
    grouper: Recent[Message] = Recent(1, count=3)
    found = groups_of(grouper, [(0, t * MS, t * MS) for t in range(6)])
    assert [[m[1] // MS for m in members] for _, members in found] == [
        [0], [0, 1], [0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 5],
    ]  # fmt: skip


def test_each_message_is_in_the_scan_of_its_interval() -> None:
    packets = [(0, t * MS, (t + 3) * MS) for t in range(0, 1000, 10)]
    grouper: Intervals[Message] = Intervals(1, 100 * MS, -5 * MS, 100 * MS)
    found = groups_of(grouper, packets)
    assert [len(members) for _, members in found] == [10] * 10
    assert [at[1] // MS for at, _ in found] == list(range(90, 1000, 100))
    assert grouper.counts[0].unmatched == 0


def test_what_is_between_intervals_is_unmatched() -> None:
    packets = [(0, t * MS, t * MS) for t in range(0, 1000, 10)]
    grouper: Intervals[Message] = Intervals(1, 200 * MS, 0, 50 * MS)
    found = groups_of(grouper, packets)
    assert [len(members) for _, members in found] == [5] * 5
    assert grouper.counts[0].unmatched == 75


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 10_000), st.sampled_from(["nearest", "recent", "few", "intervals"]))
def test_the_order_of_log_times_between_topics_makes_no_difference(seed: int, kind: str) -> None:
    rng = random.Random(seed)
    stamps = [
        (source, (t + rng.randrange(-3, 4)) * MS)
        for source, period in ((0, 100), (1, 70), (2, 130))
        for t in range(100, 3000, period)
    ]

    def new() -> Grouper[Message]:
        made: dict[str, Any] = {
            "nearest": lambda: Nearest([0, 50 * MS, 65 * MS]),
            "recent": lambda: Recent(3, 300 * MS),
            "few": lambda: Recent(3, count=4),
            "intervals": lambda: Intervals(3, 250 * MS, 0, 250 * MS),
        }
        grouper: Grouper[Message] = made[kind]()
        return grouper

    def seen(delay: int) -> list[Any]:
        latencies = [rng.randrange(delay) for _ in range(3)]
        messages = [(source, stamp, stamp + latencies[source] * MS + source) for source, stamp in stamps]
        return [(at[:2], [m[:2] for m in members]) for at, members in groups_of(new(), messages)]

    assert seen(1) == seen(90) == seen(400)


@settings(deadline=None, max_examples=200)
@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.integers(-(2**62), 2**62) | st.integers(0, 50), st.integers(0, 5_000)),
        max_size=60,
    ),
    st.sampled_from(["nearest", "recent", "few", "intervals"]),
)
def test_whatever_the_stamps_are_every_message_is_accounted_for(drawn: list[Message], kind: str) -> None:
    made: dict[str, Any] = {
        "nearest": lambda: Nearest([0, 5, 2**61]),
        "recent": lambda: Recent(3, 10),
        "few": lambda: Recent(3, count=2),
        "intervals": lambda: Intervals(3, 7, 3, 20),
    }
    grouper: Grouper[Message] = made[kind]()
    found = groups_of(grouper, [(source, stamp, log * MS) for source, stamp, log in drawn])
    leads = [each for each in drawn if each[0] == 0]
    assert len(found) <= len(leads)
    assert all(at[0] == 0 for at, _ in found)
    if kind == "nearest":
        assert len(found) == len(leads)
        members = [m for _, group in found for m in group if m[0]]
        assert len(members) == sum(counts.used for counts in grouper.counts[1:])
    for source, counts in enumerate(grouper.counts):
        assert counts.messages == sum(m[0] == source for m in drawn)
        assert counts.used + counts.unmatched == counts.messages
    assert grouper._bytes == 0  # nothing is held in the end


def test_memory_has_a_limit_that_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matching, "MAX_HELD_BYTES", 2_000)
    packets = [(0, t * MS, t * MS) for t in range(100)]
    for grouper in (Recent[Message](1, 10_000 * MS), Intervals[Message](1, 50 * MS, 0, 50 * MS)):
        with pytest.raises(UsageError, match="points of 21 messages") as caught:
            groups_of(grouper, packets)
        assert "accumulate" in str(caught.value.hint)


def test_a_silent_topic_makes_no_scan_wait_beyond_that_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matching, "MAX_HELD_BYTES", 2_000)
    lead = [(0, t * MS, t * MS) for t in range(100)]
    found = groups_of(Nearest[Message]([0, MS]), [*lead, (1, 0, 0)])
    assert [at for at, _ in found] == lead
