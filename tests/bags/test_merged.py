"""Several recordings as one."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.bags.merged import MergedReader, merge_summaries
from pc2scan.errors import UsageError
from pc2scan.model import Connection, Definition, Summary
from support.memory_reader import MemoryReader

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


def connection(number: int, topic: str = "/a", count: int | None = 1) -> Connection:
    return Connection(number, topic, "a/msg/A", "cdr", Definition("ros2msg", b"x"), message_count=count)


def source(
    folder: Path,
    name: str,
    rows: Sequence[tuple[int, int, bytes]] = (),
    connections: Sequence[Connection] = (connection(1),),
    log: list[str] | None = None,
) -> MemoryReader:
    (folder / name).touch()
    return MemoryReader(folder / name, connections, rows, log=log)


TIMES = st.lists(st.integers(0, 6), max_size=8)
CUT = st.none() | st.integers(0, 6)


@given(sources=st.lists(st.tuples(TIMES, st.booleans()), min_size=1, max_size=5), start=CUT, stop=CUT)
def test_the_order_is_that_of_a_stable_sort(
    tmp_path_factory: pytest.TempPathFactory,
    sources: list[tuple[list[int], bool]],
    start: int | None,
    stop: int | None,
) -> None:
    folder = tmp_path_factory.getbasetemp()
    readers = []
    for index, (times, knows_times) in enumerate(sources):
        rows = [(1 + number % 2, time_ns, f"{index}:{number}".encode()) for number, time_ns in enumerate(times)]
        (folder / str(index)).touch()
        topics = [connection(1), connection(2, f"/own{index}")]
        readers.append(MemoryReader(folder / str(index), topics, rows, knows_times=knows_times))
    expected = [
        (time_ns, index, data)
        for index, reader in enumerate(readers)
        for _, time_ns, data in reader.rows
        if (start is None or time_ns >= start) and (stop is None or time_ns < stop)
    ]
    found = [m.data for m in MergedReader(readers).messages(None, start, stop)]
    assert found == [data for _, _, data in sorted(expected, key=lambda row: row[:2])]


def test_recordings_that_cannot_be_merged_are_refused(tmp_path: Path) -> None:
    one = source(tmp_path, "one", connections=[replace(connection(1), serialization="ros1")])
    two = source(tmp_path, "two")
    with pytest.raises(UsageError, match=r"one is a ROS 1 recording and .*two is a ROS 2 recording"):
        MergedReader([two, one])
    (tmp_path / "link").symlink_to(tmp_path / "two")
    for again in (two, source(tmp_path, "link")):
        with pytest.raises(UsageError, match="given twice"):
            MergedReader([two, again])


def test_summaries_add_up() -> None:
    one = Summary("rosbag2", "mcap", ("none", "zstd"), 10, 4, 100, 200, "ros2")
    other = Summary("rosbag2", "sqlite3", ("lz4",), 5, 2, 50, 150, "")
    assert merge_summaries([one, other]) == Summary("rosbag2", "", ("lz4", "none", "zstd"), 15, 6, 50, 200, "")
    empty = other._replace(message_count=0, start_ns=None, end_ns=None)
    assert merge_summaries([one, empty]).start_ns == 100
    assert merge_summaries([empty]).start_ns is None
    unknown = other._replace(container="mcap", message_count=None, start_ns=None, end_ns=None)
    both = merge_summaries([one, unknown])
    assert (both.container, both.message_count, both.start_ns, both.end_ns) == ("mixed", None, None, None)
