"""The progress of a run: what is reported, and how true the time left is. The oracle is a run with known speeds."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.bags.units import Extent, Unit
from pc2scan.cli.time_left import TimeLeft
from pc2scan.progress import AHEAD, Meter, Price

MB = 1 << 20
NO_FILE: Any = None


class Phase(NamedTuple):
    """A part of a run: its units, in this order, and what is done with them."""

    price: Price
    units: list[Unit]

    @property
    def work(self) -> int:
        return sum(unit.work(self.price) for unit in self.units)


def unit(size: int, messages: int, compression: str = "none") -> Unit:
    return Unit(0, (), size, lambda _callback, *, whole: [whole], messages=messages, compression=compression)


#: A second of a lidar at 10 Hz, transforms and an IMU: large clouds have chunks of their own.
TRIFLES = [unit(9_000, 31, "zstd")] * 10
LARGE = [each for small in TRIFLES for each in (small, unit(4 * MB, 1, "zstd"))]
SMALL = [unit(MB // 2, 32, "lz4")] * 10

units = st.lists(st.sampled_from([TRIFLES, LARGE, SMALL]), min_size=1, max_size=12).map(
    lambda parts: [each for part in parts for each in part] * 20
)
prices = st.builds(
    Price.of_conversion,
    threads=st.sampled_from([1, 2, 8]),
    projects=st.booleans(),
    deskews=st.booleans(),
    writes=st.sampled_from([None, "none", "zstd"]),
    reencodes=st.booleans(),
)
runs = st.tuples(st.builds(Phase, st.just(AHEAD), units) | st.just(Phase(AHEAD, [])), st.builds(Phase, prices, units))


def told(run: tuple[Phase, ...], speed: float = 1.0) -> list[tuple[int, int, float]]:
    """Run it: work takes as long as it costs, times `speed`; return what is reported, and when."""
    steps: list[tuple[int, int, float]] = []
    now = 0.0
    meter = Meter(lambda done, total, _: steps.append((done, total, now)))
    left = sum(phase.work for phase in run)
    for phase in run:
        meter.expect(left)
        for each in phase.units:
            cost = each.work(phase.price)
            now += cost * speed / 1e9
            meter.add(cost)
        left -= phase.work
    meter.finish()
    return steps


@given(runs, st.floats(0.1, 10))
def test_the_end_is_known_where_all_costs_what_it_is_said_to(run: tuple[Phase, ...], speed: float) -> None:
    steps = told(run, speed)
    left, end = TimeLeft(), steps[-1][2]
    for done, total, now in steps:
        seconds = left.seconds(done, total, now)
        if seconds is not None and now > end / 10:
            assert now + seconds == pytest.approx(end, rel=0.01)


@given(runs)
def test_work_is_reported_a_thousand_times(run: tuple[Phase, ...]) -> None:
    steps = told(run)
    dones, totals = [done for done, _, _ in steps], {total for _, total, _ in steps}
    assert totals == {sum(phase.work for phase in run)}
    assert (dones[0], dones[-1]) == (0, *totals)
    assert dones == sorted(dones)
    assert len(steps) <= 1_004
    largest = max(each.work(phase.price) for phase in run for each in phase.units)
    assert all(after - before <= steps[0][1] / 1_000 + largest for before, after in pairwise(dones))


@pytest.mark.parametrize(("expected", "reported"), [(100, [0, 60, 100, 100]), (150, [0, 60, 120, 150])])
def test_more_or_less_work_than_expected(expected: int, reported: list[int]) -> None:
    steps: list[tuple[int, int, int]] = []
    meter = Meter(lambda *step: steps.append(step))
    meter.expect(expected)
    meter.add(60)
    meter.messages = 7
    meter.add(60)
    meter.finish()
    assert [done for done, _, _ in steps] == reported
    assert [messages for _, _, messages in steps] == [0, 0, 7, 7]


def test_what_work_costs() -> None:
    one, two = (Price.of_conversion(threads=threads) for threads in (1, 2))
    cloud, trifles = unit(4 * MB, 1, "zstd"), unit(9_000, 31, "zstd")
    # A decompressed cloud takes milliseconds, passing messages on microseconds.
    assert 4e6 < cloud.work(one) < 8e6
    assert 1e5 < trifles.work(one) < 3e5
    # Reading ahead projects nothing.
    assert cloud.work(AHEAD) < cloud.work(one)
    # Threads share bytes, unless there are few.
    assert cloud.work(two) < 0.7 * cloud.work(one)
    quick = cloud._replace(is_quick=True)
    assert quick.work(two) == quick.work(one)
    # Of zeros little is stored, and noise is stored as it is: there is little to decompress.
    scanned, zeros, noise = (cloud._replace(extent=Extent(NO_FILE, 0, stored)) for stored in (2 * MB, 1_000, 4 * MB))
    assert scanned.work(one) == cloud.work(one)
    assert zeros.work(one) < 0.4 * cloud.work(one)
    assert noise.work(one) < 0.4 * cloud.work(one)
    # A row of a database takes longer than a message of a chunk.
    rows = trifles._replace(is_in_memory=True)
    assert rows.work(AHEAD) > 2 * trifles.work(AHEAD)
    # An unknown compression is an error when it is read.
    assert unit(9, 9, "rle").work(one) == unit(9, 9).work(one)
    dearer = [
        Price.of_conversion(threads=1, deskews=True),
        Price.of_conversion(threads=1, writes="none"),
        Price.of_conversion(threads=1, writes="zstd"),
        Price.of_conversion(threads=1, reencodes=True),
    ]
    assert all(unit(MB, 9).work(each) > unit(MB, 9).work(one) for each in dearer)
