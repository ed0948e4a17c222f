"""Several recordings as one."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.bags.merged import MergedReader, merged_summary, unified
from pc2scan.bags.reader import Reader
from pc2scan.bags.units import Unit
from pc2scan.errors import UsageError
from pc2scan.model import Attachment, Connection, Definition, Metadata, RawMessage, Summary

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.model import ChunkRule


def _load(message: RawMessage, callback: Callable[[RawMessage], Any], *, whole: bool) -> list[Any]:
    assert not whole
    return [callback(message)]


class FakeReader(Reader):
    """A recording in memory that notes when it is read."""

    connections: Sequence[Connection] = ()
    summary: Summary = Summary("", "", (), 0, None, None, None)
    bytes_read: int = 0
    damage: Sequence[Damage] = ()

    def __init__(
        self,
        path: Path,
        topics: Sequence[Connection],
        messages: Sequence[tuple[int, int, bytes]],
        *,
        knows_start: bool = True,
        log: list[str] | None = None,
    ) -> None:
        self._path = path
        path.touch()
        self.connections = topics
        self._messages = messages
        self._log = [] if log is None else log
        times = [time_ns for _, time_ns, _ in messages]
        self.summary = Summary(
            container="mcap",
            storage="",
            compression=("none",),
            size_bytes=10,
            message_count=len(messages),
            start_ns=min(times, default=None) if knows_start else None,
            end_ns=max(times, default=None) if knows_start else None,
        )
        self.bytes_read = 3
        self.closed = False

    @property
    def path(self) -> Path:
        return self._path

    def units(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> Iterator[Unit]:
        """One for each message."""
        assert rule is None
        self._log.append(f"open {self.path.name}")
        try:
            by_id = {connection.id: connection for connection in self.connections}
            in_order = sorted(self._messages, key=lambda message: message[1])
            for place, (number, time_ns, data) in enumerate(in_order):
                if connections is not None and by_id[number] not in connections:
                    continue
                if (start_ns is None or time_ns >= start_ns) and (stop_ns is None or time_ns < stop_ns):
                    message = RawMessage(by_id[number], time_ns, data, time_ns, 7)
                    yield Unit(time_ns, (place,), len(data), partial(_load, message))
        finally:
            self._log.append(f"close {self.path.name}")

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        found = dict.fromkeys((c.id for c in connections if c.message_count is not None), 0)
        for message in self.messages(connections, start_ns, stop_ns):
            if message.connection.id in found:
                found[message.connection.id] += 1
        return found

    def attachments(self) -> Iterator[Attachment]:
        yield Attachment(self.path.name, "", 0, 0, b"")

    def metadata(self) -> Iterator[Metadata]:
        yield Metadata(self.path.name, {})

    def close(self) -> None:
        self.closed = True


def connection(number: int, topic: str = "/a", count: int | None = 1) -> Connection:
    return Connection(number, topic, "a/msg/A", "cdr", Definition("ros2msg", b"x"), message_count=count)


def test_messages_are_merged_and_renumbered(tmp_path: Path) -> None:
    first = FakeReader(tmp_path / "1", [connection(5), connection(6, "/b")], [(5, 1, b"p"), (6, 3, b"q"), (5, 5, b"r")])
    second = FakeReader(tmp_path / "2", [connection(1, "/b"), connection(2, "/c")], [(1, 3, b"s"), (2, 4, b"t")])
    reader = MergedReader([first, second])
    assert [(c.id, c.topic, c.message_count) for c in reader.connections] == [
        (1, "/a", 1),
        (2, "/b", 2),
        (3, "/c", 1),
    ]
    messages = list(reader.messages())
    assert [(m.connection.id, m.log_time_ns, m.data, m.sequence) for m in messages] == [
        (1, 1, b"p", 7),
        (2, 3, b"q", 7),
        (2, 3, b"s", 7),
        (3, 4, b"t", 7),
        (1, 5, b"r", 7),
    ]
    assert all(m.connection is reader.connections[m.connection.id - 1] for m in messages)
    assert [m.data for m in reader.messages([reader.connections[1]])] == [b"q", b"s"]
    assert [m.data for m in reader.messages(start_ns=3, stop_ns=5)] == [b"q", b"s", b"t"]
    assert reader.path == tmp_path / "1"
    assert reader.bytes_read == 6
    assert [a.name for a in reader.attachments()] == ["1", "2"]
    assert [m.name for m in reader.metadata()] == ["1", "2"]
    reader.close()
    assert first.closed
    assert second.closed


def test_callbacks_are_given_messages_under_the_unified_connections(tmp_path: Path) -> None:
    sources = [
        FakeReader(tmp_path / "1", [connection(5)], []),
        FakeReader(tmp_path / "2", [connection(1, "/b")], [(1, 2, b"data")]),
    ]
    reader = MergedReader(sources)
    (unit,) = reader.units()
    assert unit.load(lambda message: message, whole=False) == [
        RawMessage(reader.connections[1], 2, b"data", 2, 7),
    ]


def test_a_single_source_passes_through(tmp_path: Path) -> None:
    source = FakeReader(tmp_path / "1", [connection(5)], [(5, 1, b"p")])
    reader = MergedReader([source])
    assert list(reader.connections) == source.connections
    (message,) = reader.messages()
    assert message.connection is source.connections[0]
    assert reader.summary == source.summary


def test_equal_connections_of_one_source_stay_two() -> None:
    merged, ids = unified(
        [
            [connection(1), connection(2)],
            [connection(7), connection(8), connection(9, count=None)],
            [connection(1)],
        ]
    )
    assert [(c.id, c.message_count) for c in merged] == [(1, 3), (2, 2), (3, None)]
    assert ids == [{1: 1, 2: 2}, {7: 1, 8: 2, 9: 3}, {1: 1}]


@pytest.mark.parametrize(
    "other",
    [
        {"topic": "/z"},
        {"msgtype": "z/msg/Z"},
        {"serialization": "json"},
        {"definition": Definition("ros2msg", b"y")},
        {"digest": "z"},
        {"callerid": "/z"},
        {"latching": True},
        {"qos": "z"},
        {"metadata": {"z": "z"}},
    ],
)
def test_connections_that_differ_in_anything_stay_apart(other: dict[str, object]) -> None:
    merged, _ = unified([[connection(1)], [replace(connection(1), **other)]])  # type: ignore[arg-type]
    assert len(merged) == 2


def test_a_source_is_not_read_before_its_time(tmp_path: Path) -> None:
    log: list[str] = []
    late = FakeReader(tmp_path / "late", [connection(1)], [(1, 100, b"l")], log=log)
    early = FakeReader(tmp_path / "early", [connection(1)], [(1, n, b"e") for n in range(5)], log=log)
    reader = MergedReader([late, early])
    messages = reader.messages()
    # One unit more is asked for, to know how long this one goes on.
    assert [next(messages).log_time_ns for _ in range(3)] == [0, 1, 2]
    assert log == ["open early"]
    assert [next(messages).log_time_ns for _ in range(2)] == [3, 4]
    assert next(messages).data == b"l"
    assert next(messages, None) is None
    assert log == ["open early", "close early", "open late", "close late"]
    log.clear()
    assert len(list(reader.messages(stop_ns=100))) == 5
    assert log == ["open early", "close early"]


def test_sources_are_closed_with_the_generator(tmp_path: Path) -> None:
    log: list[str] = []
    readers = [FakeReader(tmp_path / name, [connection(1)], [(1, 1, b""), (1, 2, b"")], log=log) for name in "ab"]
    messages = MergedReader(readers).messages()
    next(messages)
    messages.close()
    assert sorted(log) == ["close a", "close b", "open a", "open b"]


TIMES = st.lists(st.integers(0, 6), max_size=8)


@given(sources=st.lists(st.tuples(TIMES, st.booleans()), min_size=1, max_size=5), start=st.none() | st.integers(0, 6), stop=st.none() | st.integers(0, 6))  # fmt: skip  # noqa: E501
def test_the_order_is_that_of_a_stable_sort(
    tmp_path_factory: pytest.TempPathFactory,
    sources: list[tuple[list[int], bool]],
    start: int | None,
    stop: int | None,
) -> None:
    folder = tmp_path_factory.getbasetemp()
    readers = []
    for index, (times, knows_start) in enumerate(sources):
        messages = [(1 + number % 2, time, f"{index}:{number}".encode()) for number, time in enumerate(times)]
        topics = [connection(1), connection(2, f"/own{index}")]
        readers.append(FakeReader(folder / str(index), topics, messages, knows_start=knows_start))
    everything = [
        (message[1], index, message[2])
        for index, reader in enumerate(readers)
        for message in sorted(reader._messages, key=lambda message: message[1])
        if (start is None or message[1] >= start) and (stop is None or message[1] < stop)
    ]
    expected = [data for _, _, data in sorted(everything, key=lambda entry: entry[:2])]
    assert [m.data for m in MergedReader(readers).messages(None, start, stop)] == expected


def test_ros_versions_do_not_mix(tmp_path: Path) -> None:
    one = FakeReader(tmp_path / "one", [replace(connection(1), serialization="ros1")], [])
    two = FakeReader(tmp_path / "two", [connection(1)], [])
    with pytest.raises(UsageError, match=r"one is a ROS 1 recording and .*two is a ROS 2 recording"):
        MergedReader([two, one])


def test_a_file_given_twice(tmp_path: Path) -> None:
    readers = [FakeReader(tmp_path / "one", [connection(1)], []) for _ in range(2)]
    with pytest.raises(UsageError, match="given twice"):
        MergedReader(readers)
    (tmp_path / "link").symlink_to(tmp_path / "one")
    readers[1]._path = tmp_path / "link"
    with pytest.raises(UsageError, match="given twice"):
        MergedReader(readers)


def test_nothing_given() -> None:
    with pytest.raises(UsageError, match="no recording"):
        MergedReader([])


def test_summaries_add_up() -> None:
    one = Summary("rosbag2", "mcap", ("none", "zstd"), 10, 4, 100, 200, "ros2")
    other = Summary("rosbag2", "sqlite3", ("lz4",), 5, 2, 50, 150, "")
    assert merged_summary([one, other]) == Summary("rosbag2", "", ("lz4", "none", "zstd"), 15, 6, 50, 200, "")
    empty = other._replace(message_count=0, start_ns=None, end_ns=None)
    assert merged_summary([one, empty]).start_ns == 100
    assert merged_summary([empty]).start_ns is None
    unknown = other._replace(container="mcap", message_count=None, start_ns=None, end_ns=None)
    both = merged_summary([one, unknown])
    assert (both.container, both.message_count, both.start_ns, both.end_ns) == ("mixed", None, None, None)
