"""Transfers that are too slow to finish, and slow ones that are not; the clock is a number."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.errors import RecordingError
from pc2scan.files.source import on_demand
from pc2scan.remote.ranges import add_stand_in
from pc2scan.remote.store import LEAST_BYTES, Pace, TooSlowError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


class Clock:
    """Seconds that pass only when a test says so."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@given(st.lists(st.tuples(st.floats(0.01, 40), st.integers(0, 3 * LEAST_BYTES)), max_size=30))
def test_a_minute_without_64_kib_ends_a_transfer(arrivals: list[tuple[float, int]]) -> None:
    clock = Clock()
    pace = Pace(clock)
    begin, counted, total = clock.now, 0, 0
    for seconds, size in arrivals:
        clock.now += seconds
        if clock.now - begin >= 60:
            with pytest.raises(TooSlowError, match="fewer than 65,536 bytes arrived in 60 seconds"):
                pace.seconds_left()
            return
        assert pace.seconds_left() == pytest.approx(60 - (clock.now - begin))
        total += size
        pace.note_arrival(total)
        if total - counted >= LEAST_BYTES:
            begin, counted = clock.now, total


@pytest.mark.parametrize(
    ("size", "seconds", "ends"), [(1, 5, True), (1000, 1, True), (1200, 1, False), (70, 0.05, False)]
)
def test_a_slow_link_is_slow_and_goes_on(size: int, seconds: float, ends: bool) -> None:
    clock = Clock()
    pace = Pace(clock)

    def transfer() -> None:
        for number in range(1, 5000):
            clock.now += seconds
            pace.seconds_left()
            pace.note_arrival(number * size)

    if ends:
        with pytest.raises(TooSlowError):
            transfer()
        assert clock.now <= 1000 + 2 * 60 + seconds
    else:
        transfer()


class Link:
    """A remote file behind a network of a certain speed; what takes longer than a minute does not arrive."""

    shown = "http://h/a.mcap"

    def __init__(self, data: bytes, clock: Clock, speed: Callable[[float], float]) -> None:
        self.data = data
        self.clock = clock
        self.speed = speed
        self.asked: list[tuple[int, bool]] = []

    def bytes_at(self, start: int, stop: int) -> bytes | None:
        seconds = 0.05 + (stop - start) / self.speed(self.clock.now - 1000)
        arrives = seconds < 60
        self.asked.append((stop - start, arrives))
        self.clock.now += min(seconds, 60)
        if not arrives and stop - start <= LEAST_BYTES:
            raise RecordingError("the transfer is too slow to finish", path=self.shown)
        return self.data[start:stop] if arrives else None


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("pc2scan.remote.ranges.monotonic", clock)
    return clock


def fetched(link: Link, target: Path) -> bytes:
    add_stand_in(link, target, len(link.data))  # type: ignore[arg-type]
    try:
        on_demand[target](0, len(link.data))
    finally:
        del on_demand[target]
    return target.read_bytes()


DATA = bytes(range(251)) * 40_000


@pytest.mark.parametrize("speed", [1_500, 20_000, 300_000, 1e7, 1e9])
def test_ranges_arrive_on_a_link_of_any_honest_speed(speed: float, clock: Clock, tmp_path: Path) -> None:
    link = Link(DATA, clock, lambda _: speed)
    assert fetched(link, tmp_path / "a") == DATA
    # The first request is as long as on a fast link; after it none is so long that it takes a minute.
    assert all(arrives for _, arrives in link.asked[1:])
    if speed >= 1e7:
        assert len(link.asked) == 1


def test_ranges_arrive_on_a_link_that_becomes_slow(clock: Clock, tmp_path: Path) -> None:
    link = Link(DATA * 8, clock, lambda seconds: 1e8 if seconds < 0.5 else 30_000)
    assert fetched(link, tmp_path / "a") == DATA * 8
    assert [arrives for _, arrives in link.asked].count(False) == 1


def test_a_link_below_a_kilobyte_a_second_is_an_error(clock: Clock, tmp_path: Path) -> None:
    link = Link(DATA * 8, clock, lambda seconds: 1e7 if seconds < 5 else 0.2)
    with pytest.raises(RecordingError, match="too slow to finish"):
        fetched(link, tmp_path / "a")
    assert clock.now <= 1000 + 5 + 2 * 60 + 60
