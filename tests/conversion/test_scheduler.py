from __future__ import annotations

import time
from contextlib import nullcontext
from threading import Lock, current_thread, get_ident, main_thread
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.advice.survey import Span
from pc2scan.bags.units import Unit
from pc2scan.conversion import engine
from pc2scan.conversion.engine import AHEAD_BYTES, LARGEST_AHEAD, schedule
from pc2scan.conversion.items import Item, OpenRoute, Output
from pc2scan.conversion.report import TopicReport
from pc2scan.conversion.steps import ConvertedMessage
from pc2scan.core.rule import PointCounts
from pc2scan.model import Connection, RawMessage, StoredChunk
from pc2scan.threads import Threads

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

TOPIC = Connection(1, "/a", "a/msg/A", "cdr")


def unit(number: int, size: int = 1, *, messages: int = 1, quick: bool = False, loads: list[int] | None = None) -> Unit:
    def load(callback: Callable[[RawMessage], Any], *, whole: bool) -> list[Any] | StoredChunk:
        assert not whole
        if loads is not None:
            loads.append(number)
        data = bytes(size // messages)
        return [callback(RawMessage(TOPIC, 10 * number + place, data, 0)) for place in range(messages)]

    return Unit(10 * number, (number,), size, load, is_quick=quick)


def threads_of(jobs: int | None) -> AbstractContextManager[Threads | None]:
    return nullcontext() if jobs is None else Threads(jobs)


def times(items: Iterator[Any]) -> list[int]:
    return [item.log_time_ns for item in items]


@pytest.mark.parametrize("jobs", [None, 1, 2, 5])
def test_results_come_in_the_order_of_time(jobs: int | None) -> None:
    def work(message: RawMessage) -> RawMessage:
        time.sleep(0.002 * (message.log_time_ns % 3))
        return message

    units = [unit(number, messages=1 + number % 3, quick=number % 4 == 0) for number in range(40)]
    with threads_of(jobs) as threads:
        found = times(schedule(units, work, threads))
    assert found == [10 * number + place for number in range(40) for place in range(1 + number % 3)]


class InFlight:
    """Counts messages that were loaded, and those of them that were taken; ``most`` is the largest difference."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._loaded = self.taken = self.most = 0

    def load(self, message: RawMessage) -> RawMessage:
        with self._lock:
            self._loaded += 1
            self.most = max(self.most, self._loaded - self.taken)
        return message

    def take(self) -> None:
        with self._lock:
            self.taken += 1


@pytest.mark.parametrize("jobs", [2, 4])
@pytest.mark.parametrize("size", [1 << 10, 5 << 20, LARGEST_AHEAD])
def test_what_is_loaded_ahead_is_bounded_and_enough(size: int, jobs: int) -> None:
    """However large units are, there is one for every thread, and one more for the first that is done."""
    flight = InFlight()
    with Threads(jobs) as threads:
        for _ in schedule([unit(number, size) for number in range(40)], flight.load, threads):
            time.sleep(0.001)
            flight.take()
    bound = max(min(threads.ahead, jobs * AHEAD_BYTES // size), jobs + 1)
    assert flight.taken == 40
    # What the caller has in its hands counts too, and what it is about to take.
    assert jobs < flight.most <= bound + 2


@pytest.mark.parametrize("jobs", [1, 2, 4])
def test_one_unit_in_memory_waits_for_each_thread(jobs: int) -> None:
    listed = taken = most = 0

    def units() -> Iterator[Unit]:
        nonlocal listed, most
        for number in range(20):
            listed += 1
            most = max(most, listed - taken)
            yield unit(number, 1 << 20)._replace(is_in_memory=True)

    with Threads(jobs) as threads:
        for _ in schedule(units(), lambda message: message, threads):
            taken += 1
    assert taken == 20
    # One more is listed, and the next one is looked at to know what is due first.
    assert most <= jobs + 2


@pytest.mark.parametrize("jobs", [None, 2])
def test_an_error_is_raised_in_its_turn(jobs: int | None) -> None:
    def work(message: RawMessage) -> RawMessage:
        if message.log_time_ns == 50:
            raise ValueError("five")
        return message

    with threads_of(jobs) as threads:
        items = schedule([unit(number) for number in range(10)], work, threads)
        assert [next(items).log_time_ns for _ in range(5)] == [0, 10, 20, 30, 40]  # type: ignore[union-attr]
        with pytest.raises(ValueError, match="five"):
            next(items)


def test_leaving_early_gives_up_what_has_not_begun() -> None:
    loads: list[int] = []
    with Threads(1) as threads:
        items = schedule([unit(number, loads=loads) for number in range(100)], lambda message: message, threads)
        next(items)
        items.close()
    assert len(loads) < 6


def test_quick_units_are_loaded_by_the_caller() -> None:
    loaders: dict[int, int] = {}

    def work(message: RawMessage) -> RawMessage:
        loaders[message.log_time_ns // 10] = get_ident()
        return message

    units = [unit(number, 2 << 20, quick=number % 2 == 1) for number in range(12)]
    with Threads(2) as threads:
        assert times(schedule(units, work, threads)) == [10 * number for number in range(12)]
    assert {loaders[number] for number in range(1, 12, 2)} == {get_ident()}


def test_a_result_that_takes_more_memory_is_made_in_its_turn() -> None:
    made: list[int] = []

    def convert(data: Any) -> ConvertedMessage:
        assert current_thread() is main_thread()
        made.append(len(data))
        return ConvertedMessage(b"cloud", PointCounts(), empty=False)

    reader: Any = SimpleNamespace(
        path=None,
        summary=SimpleNamespace(size_bytes=0),
        units=lambda *_: [unit(number, messages=1) for number in range(9)],
    )
    output = Output(TopicReport("/a", "", "/cloud", "converted"), 0)
    route = OpenRoute(TOPIC, None, [convert], outputs=[output], shrinks_from=1 << 30)
    with Threads(2) as threads:
        for number, item in enumerate(engine.items_of(reader, {1: route}, Span(None, None, 0), threads)):
            assert isinstance(item, Item)
            assert len(made) == number + 1


@pytest.mark.parametrize("jobs", [None, 2])
def test_messages_of_a_large_unit_are_the_work_of_all_threads(jobs: int | None) -> None:
    large = unit(3, LARGEST_AHEAD + 8, messages=8)
    workers = set()

    def work(message: RawMessage) -> RawMessage:
        if len(message.data) > 1:
            workers.add(get_ident())
            time.sleep(0.01)
        return message._replace(data=b"")

    with threads_of(jobs) as threads:
        found = times(schedule([unit(1), unit(2), large, unit(4)], work, threads))
    assert found == [10, 20, *range(30, 38), 40]
    assert len(workers) == (jobs or 1)
