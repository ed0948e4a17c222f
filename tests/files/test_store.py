"""Transfers that are too slow to finish, and slow ones that are not; the clock is a number."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from random import Random
from threading import Lock
from time import sleep
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.errors import RecordingError
from pc2scan.files.store import LEAST_BYTES, Pace, RangeFile, StoredObject, TooSlowError

if TYPE_CHECKING:
    from collections.abc import Callable


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
    monkeypatch.setattr("pc2scan.files.store.monotonic", clock)
    return clock


def fetched(link: Link) -> bytes:
    file = RangeFile(link, StoredObject(len(link.data), "1"))  # type: ignore[arg-type]
    file.fetch(0, len(link.data))
    with file.open() as opened:
        return opened.read()


DATA = bytes(range(251)) * 40_000


@pytest.mark.parametrize("speed", [1_500, 20_000, 300_000, 1e7, 1e9])
def test_ranges_arrive_on_a_link_of_any_honest_speed(speed: float, clock: Clock) -> None:
    link = Link(DATA, clock, lambda _: speed)
    assert fetched(link) == DATA
    # The first request is as long as on a fast link; after it none is so long that it takes a minute.
    assert all(arrives for _, arrives in link.asked[1:])
    if speed >= 1e7:
        assert len(link.asked) == 1


def test_ranges_arrive_on_a_link_that_becomes_slow(clock: Clock) -> None:
    link = Link(DATA * 8, clock, lambda seconds: 1e8 if seconds < 0.5 else 30_000)
    assert fetched(link) == DATA * 8
    assert [arrives for _, arrives in link.asked].count(False) == 1


def test_a_link_below_a_kilobyte_a_second_is_an_error(clock: Clock) -> None:
    link = Link(DATA * 8, clock, lambda seconds: 1e7 if seconds < 5 else 0.2)
    with pytest.raises(RecordingError, match="too slow to finish"):
        fetched(link)
    assert clock.now <= 1000 + 5 + 2 * 60 + 60


class Counted:
    """A file whose ranges arrive at once; what was asked for is noted."""

    shown = "memory://a.mcap"

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.asked: list[tuple[int, int]] = []
        self.lock = Lock()

    def bytes_at(self, start: int, stop: int) -> bytes:
        with self.lock:
            self.asked.append((start, stop))
        sleep(0.001)
        return self.data[start:stop]


def test_many_threads_fetch_each_byte_once() -> None:
    place = Counted(DATA)
    file = RangeFile(place, StoredObject(len(DATA), "1"))  # type: ignore[arg-type]
    random = Random(1)
    places = [(offset := random.randrange(len(DATA)), random.randrange(len(DATA) - offset)) for _ in range(200)]

    def read(place: tuple[int, int]) -> bool:
        offset, length = place
        with file.open() as opened:
            opened.seek(offset)
            return opened.read(length) == DATA[offset : offset + length]

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(read, places))
    assert sum(stop - start for start, stop in place.asked) <= len(DATA)


def test_what_failed_is_fetched_again() -> None:
    place = Counted(DATA)
    file = RangeFile(place, StoredObject(len(DATA), "1"))  # type: ignore[arg-type]
    bytes_at = place.bytes_at

    def refuse(*_: int) -> bytes:
        raise RecordingError("gone", path=place.shown)

    place.bytes_at = refuse  # type: ignore[method-assign, assignment]
    with pytest.raises(RecordingError, match="gone"):
        file.fetch(0, 10)
    place.bytes_at = bytes_at  # type: ignore[method-assign]
    file.fetch(0, 10)
    assert place.asked == [(0, LEAST_BYTES)]
