"""Samples of many topics, against the plain way: the first message of each part of the time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hypothesis import given
from hypothesis import strategies as st

from pc2scan.bags.loading import Chunk
from pc2scan.bags.observers import Observer, Spread, observe
from pc2scan.model import Connection, RawMessage, copied_message
from pc2scan.show.sampling import sampled
from support.memory_reader import MemoryReader

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from pc2scan.model import ChunkRule

NAMES = "abcd"
CONNECTIONS = [Connection(number, name, "t", "cdr") for number, name in enumerate(NAMES)]


class Chunks(MemoryReader):
    """Messages in chunks of some, which overlap in time; it counts how often each is loaded."""

    has_chunks = True

    def __init__(self, rows: list[tuple[int, int, bytes]], in_a_chunk: int) -> None:
        super().__init__(Path("made"), CONNECTIONS, rows)
        # Not sorted: chunks may overlap.
        self.content = [rows[begin : begin + in_a_chunk] for begin in range(0, len(rows), in_a_chunk)]
        self.loads = [0] * len(self.content)

    def chunks(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> Iterator[Chunk]:
        del rule
        held = self.is_wanted(connections, start_ns, stop_ns)

        def load(number: int) -> Any:
            def loaded(callback: Callable[[RawMessage], Any]) -> list[Any]:
                self.loads[number] += 1
                rows = filter(held, self.content[number])
                return [callback(RawMessage(CONNECTIONS[own], time, data, time)) for own, time, data in rows]

            return loaded

        listed = [number for number, chunk in enumerate(self.content) if any(map(held, chunk))]
        listed.sort(key=lambda number: min(time for _, time, _ in self.content[number]))
        for number in listed:
            times, ids = (
                [time for _, time, _ in self.content[number]],
                frozenset(own for own, _, _ in self.content[number]),
            )
            yield Chunk(min(times), (number,), 100, load(number), end_ns=max(times), connection_ids=ids)


def one_by_one(rows: list[tuple[int, int, bytes]], samples: int, stop_ns: int) -> list[tuple[int, bytes]]:
    parts = min(samples, stop_ns)
    found: list[tuple[int, bytes]] = []
    for own in range(len(NAMES)):
        first: dict[int, tuple[int, bytes]] = {}
        for _, time, data in sorted((row for row in rows if row[0] == own), key=lambda row: row[1]):
            first.setdefault(time * parts // stop_ns, (own, data))
        found += first.values()
    return sorted(found)


ROWS = st.lists(st.tuples(st.integers(0, len(NAMES) - 1), st.integers(0, 60)), min_size=1, max_size=80)


@given(times=ROWS, in_a_chunk=st.integers(1, 20), samples=st.integers(1, 12) | st.just(10**30))
def test_samples_are_the_first_messages_of_equal_parts(
    times: list[tuple[int, int]], in_a_chunk: int, samples: int
) -> None:
    rows = [(own, time, b"%d" % number) for number, (own, time) in enumerate(times)]
    topics = {each.topic: [each] for each in CONNECTIONS}
    for reader in (MemoryReader(Path("made"), CONNECTIONS, rows), Chunks(rows, in_a_chunk)):
        found = list(sampled(reader, topics, samples, 0, 61))
        assert [each.log_time_ns for each in found] == sorted(each.log_time_ns for each in found)
        assert sorted((each.connection.id, bytes(each.data)) for each in found) == one_by_one(rows, samples, 61)
        if isinstance(reader, Chunks):
            assert max(reader.loads) <= 1


def test_chunks_between_the_samples_are_not_loaded() -> None:
    rows = [(0, time, b"") for time in range(100)]
    reader = Chunks(rows, 5)
    observer = Observer(CONNECTIONS, copied_message, start_ns=0, stop_ns=100, spread=Spread(0, 100, 4))
    observe((reader, [observer]))
    assert [each.log_time_ns for each in observer.found] == [0, 25, 50, 75]
    assert sum(reader.loads) == 4


def test_all_messages_are_samples_if_there_are_no_more() -> None:
    assert Spread.of(0, 100, samples=5, messages=5) is None
    assert Spread.of(0, 100, samples=5, messages=6) == Spread(0, 100, 5)
    assert Spread.of(0, 3, samples=5) == Spread(0, 3, 3)
