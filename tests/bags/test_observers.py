"""Observers get what they would get by readings of their own, and share one."""

from __future__ import annotations

import random
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.bags.observers import Observer, observe
from pc2scan.bags.opening import open_recording
from pc2scan.errors import DecodeError
from pc2scan.model import Connection, RawMessage
from support.builders import CONTENT, SOURCES
from support.memory_reader import MemoryReader

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.bags.loading import Chunk

A, B = (Connection(number, topic, "std_msgs/msg/String", "cdr") for number, topic in enumerate(("/a", "/b")))


def row(message: RawMessage) -> tuple[str, int, bytes]:
    return message.connection.topic, message.log_time_ns, bytes(message.data)


@pytest.mark.parametrize("name", SOURCES)
def test_each_observer_sees_the_first_messages_of_its_own(name: str, tmp_path: Path) -> None:
    chance = random.Random(1)
    with closing(open_recording(SOURCES[name](tmp_path, CONTENT))) as reader:
        times = [message.log_time_ns for message in reader.messages()]
        observers = []
        for _ in range(30):
            chosen = chance.sample(list(reader.connections), chance.randint(1, len(reader.connections)))
            cut = sorted(chance.choices(times, k=2)) if chance.random() < 0.5 else (None, None)
            observers.append(Observer(chosen, row, chance.choice([1, 2, 3, 7, None]), *cut))
        observe((reader, observers))
        for each in observers:
            alone = reader.messages(each.connections, each.start_ns, each.stop_ns)
            assert each.found == list(map(row, islice(alone, each.most)))
            assert each.is_done


def made(order: list[tuple[int, int]], log: list[str] | None = None) -> MemoryReader:
    """A recording of connections and log times."""
    rows = [(number, time_ns, b"%d" % place) for place, (number, time_ns) in enumerate(order)]
    return MemoryReader(Path("made"), [A, B], rows, log=log)


def test_messages_that_cannot_be_decoded_count() -> None:
    def odd(message: RawMessage) -> int:
        if message.log_time_ns % 2 == 0:
            raise DecodeError("even")
        return message.log_time_ns

    observer = Observer([A], odd, 3)
    observe((made([(0, time_ns) for time_ns in range(10)]), [observer]))
    assert observer.found == [1]


def test_an_observer_may_find_that_another_one_has_enough() -> None:
    reader = made([(0, 1), (0, 2), (0, 3), (1, 4), (1, 5), (1, 6)])
    first = Observer([A, B], row, 4)
    late = [
        Observer([each], row, 2, is_needless=lambda each=each: sum(t == each.topic for t, *_ in first.found) > 1)  # type: ignore[misc]
        for each in (A, B)
    ]
    observe((reader, [first, *late]))
    assert [len(each.found) for each in (first, *late)] == [4, 0, 2]


def test_rows_of_a_database_are_read_for_each_topic_and_chunks_once() -> None:
    log: list[str] = []
    observe((made([(0, 1), (1, 2)], log), [Observer([A], row, 1), Observer([A], row, 2), Observer([B], row)]))
    assert log.count("open made") == 2


class Chunked(MemoryReader):
    """Counts how often each unit is loaded."""

    has_chunks = True

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.loaded: list[tuple[int, ...]] = []

    def chunks(self, *args: Any, **further: Any) -> Any:
        for unit in super().chunks(*args, **further):

            def load(callback: Callable[[RawMessage], Any], unit: Chunk = unit) -> Any:
                self.loaded.append(unit.place)
                return unit.load(callback)

            yield unit._replace(load=load)


def test_no_unit_is_loaded_that_nobody_wants_any_longer() -> None:
    reader = Chunked(Path("made"), [A, B], [(number % 2, number, b"") for number in range(20)])
    first, every = Observer([A], row, 2), Observer([B], row, None, 11)
    observe((reader, [first, every]))
    assert reader.loaded == [(0,), (2,), (11,), (13,), (15,), (17,), (19,)]
    assert [time_ns for _, time_ns, _ in (*first.found, *every.found)] == [0, 2, 11, 13, 15, 17, 19]
