from __future__ import annotations

import random
from itertools import groupby, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.show.scan_stamps import ScanStamps
from support.scan_recordings import START

SECOND = 1_000_000_000


@given(st.integers(0, 10**9), st.integers(1, 4), st.integers(2, 200))
def test_intervals_and_jumps_are_those_of_each_clock(seed: int, clocks: int, number: int) -> None:
    """Several clocks, minutes to decades apart, now and then one for some time; steps of 10 ms to 2 s."""
    rng = random.Random(seed)
    offsets = rng.sample([0, -START + 5 * SECOND, 3600 * SECOND, -7200 * SECOND, 10**18 - 1], clocks)
    log_time_ns, current = START, 0
    stamps, read = ScanStamps(), []
    for _ in range(number):
        log_time_ns += rng.randint(10_000_000, 2 * SECOND)
        current = rng.randrange(clocks) if rng.random() < rng.choice([0.05, 0.9]) else current
        stamp_ns = log_time_ns + offsets[current] - rng.randint(0, 4_000_000)
        stamps.add(stamp_ns, log_time_ns)
        read.append((current, stamp_ns))
    intervals = sorted(
        later - earlier
        for clock in range(clocks)
        for earlier, later in pairwise(stamp_ns for of, stamp_ns in read if of == clock)
    )
    if not intervals:
        assert stamps.interval_ns is None
    else:
        assert stamps.interval_ns == pytest.approx(intervals[(len(intervals) - 1) // 2], rel=0.01)
    jumps = sum(1 for _ in groupby(read, key=lambda entry: entry[0])) - 1
    found = {finding.kind: finding for finding in stamps.findings(0.0)}
    assert (found["clocks"].count if jumps else 0) == jumps
    assert ("clocks" in found) == (jumps > 0)


def test_stamps_without_any_order_are_read_in_bounded_memory() -> None:
    rng = random.Random(1)
    stamps = ScanStamps()
    for number in range(20_000):
        stamps.add(rng.randrange(1, 2**62), START + number)
    assert stamps.interval_ns is None or stamps.interval_ns > 0
    found = {finding.kind: finding for finding in stamps.findings(0.1)}
    assert found["clocks"].count > 19_000
