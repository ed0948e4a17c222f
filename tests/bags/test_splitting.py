"""Recordings in several files: where they are cut, and what is repeated."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.splitting import Cut, Part, SplitWriter, narrowed
from pc2scan.errors import UnwritableError, UsageError
from pc2scan.files.numbered import part_name
from pc2scan.model import ChunkRule, Connection, StoredChunk
from support.rosbag1_files import connection

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SECOND = 1_000_000_000


class Written:
    """A writer that records its calls."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(b"")
        self.messages: list[tuple[int, int, bytes]] = []
        self.connections: list[Connection] = []
        self.state = "open"
        self.last_ns = 1 << 62

    def keep_ids(self, connections: object) -> None:
        self.kept = connections

    def add_connection(self, each: Connection) -> int:
        self.connections.append(each)
        return len(self.connections) - 1

    def declarations(self) -> frozenset[bytes]:
        return frozenset()

    def compress_ahead(self, pool: object) -> None:
        self.pool = pool

    def write(self, handle: int, log_time_ns: int, data: bytes, *_: int) -> None:
        if log_time_ns > self.last_ns:
            raise UnwritableError("too late")
        self.messages.append((handle, log_time_ns, bytes(data)))

    def write_chunk(self, chunk: StoredChunk) -> None:
        self.messages += ((handle, time, b"chunk") for handle, entries in chunk.index.items() for time, _ in entries)

    def add_attachment(self, _: object) -> None:
        self.messages.append((-1, 0, b"attachment"))

    add_metadata = add_attachment

    def finish(self) -> None:
        self.state = "finished"

    def abort(self) -> None:
        self.state = "aborted"


class Files:
    """A split writer, and the writers of its parts."""

    def __init__(self, folder: Path, cut: Cut) -> None:
        self.writers: list[Written] = []
        self.finishing: list[int] = []

        def open_part(path: Path) -> tuple[Written, Callable[[Part], None]]:
            self.writers.append(Written(path))
            return self.writers[-1], lambda part: self.finishing.append(sum(part.counts.values()))

        self.split = SplitWriter(lambda number: folder / f"{number}", open_part, cut)  # type: ignore[arg-type]

    @property
    def times(self) -> list[list[int]]:
        return [[time for _, time, _ in writer.messages] for writer in self.writers]


def topic(name: str, *, latching: bool = False) -> Connection:
    return replace(connection(name), latching=latching)


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ([0, 5, 9, 10, 19, 20], [[0, 5, 9], [10, 19], [20]]),
        # Counted from the beginning, and no file for a time without messages.
        ([1, 9, 35, 39, 40], [[1, 9], [35, 39], [40]]),
        # What comes late stays in the file that is written; what is from before the beginning is in the first.
        ([-5, 0, 12, 8, 13, 21], [[-5, 0], [12, 8, 13], [21]]),
        ([], [[]]),
    ],
)
def test_by_time(times: list[int], expected: list[list[int]], tmp_path: Path) -> None:
    files = Files(tmp_path, Cut(duration_ns=10))
    handle = files.split.add_connection(topic("/a"))
    for time in times:
        files.split.write(handle, time, b"data", time)
    files.split.finish()
    assert files.times == expected
    assert [writer.state for writer in files.writers] == ["finished"] * len(expected)
    assert [len(part) for part in expected] == files.finishing
    assert [sum(part.counts.values()) for part in files.split.parts] == files.finishing
    assert [part.span_ns for part in files.split.parts] == [
        (min(part), max(part)) if part else None for part in expected
    ]


def test_by_size_no_file_has_more(tmp_path: Path) -> None:
    files = Files(tmp_path, Cut(size=1000))
    handle = files.split.add_connection(topic("/a"))
    for time, size in enumerate([400, 400, 100, 2000, 10, 900]):
        files.split.write(handle, time, bytes(size), time)
    files.split.finish()
    # Forty bytes of each message are counted too; one that is larger than a file has a file of its own.
    assert files.times == [[0, 1], [2], [3], [4, 5]]


def test_every_part_has_the_connections_the_ids_and_the_threads(tmp_path: Path) -> None:
    files = Files(tmp_path, Cut(duration_ns=10))
    connections = [topic("/a"), topic("/b")]
    files.split.keep_ids(connections)
    handles = [files.split.add_connection(each) for each in connections]
    files.split.compress_ahead("threads")  # type: ignore[arg-type]
    files.split.add_attachment("file")  # type: ignore[arg-type]
    for time in (0, 10):
        files.split.write(handles[1], time, b"data", time)
    files.split.finish()
    for writer in files.writers:
        assert (writer.connections, writer.kept, writer.pool) == (connections, connections, "threads")
    assert [(-1, 0, b"attachment") in writer.messages for writer in files.writers] == [True, False]


def test_what_lasts_is_repeated_at_the_time_of_the_part(tmp_path: Path) -> None:
    files = Files(tmp_path, Cut(duration_ns=10, repeats=True))
    map_, static, plain = (
        files.split.add_connection(each) for each in (topic("/map", latching=True), topic("/x/tf_static"), topic("/a"))
    )
    for time, handle, data in (
        (0, map_, b"first map"),
        (1, static, b"left"),
        (2, static, b"right"),
        (3, map_, b"second map"),
        (4, static, b"left"),
        (12, plain, b"data"),
        (25, map_, b"third map"),
        (31, plain, b"data"),
    ):
        files.split.write(handle, time, data, time)
    files.split.finish()
    # Of a latched topic the last message, of static transforms all that differ, the latest last.
    assert files.writers[1].messages == [
        (map_, 12, b"second map"),
        (static, 12, b"right"),
        (static, 12, b"left"),
        (plain, 12, b"data"),
    ]
    assert files.writers[3].messages[0] == (map_, 31, b"third map")
    assert files.split.parts[1].counts == {map_: 1, static: 2, plain: 1}
    assert files.split.parts[1].own == 1


def test_repeated_messages_do_not_fill_a_part(tmp_path: Path) -> None:
    files = Files(tmp_path, Cut(size=1000, repeats=True))
    map_, plain = (files.split.add_connection(each) for each in (topic("/map", latching=True), topic("/a")))
    files.split.write(map_, 0, bytes(950), 0)
    for time in (1, 2):
        files.split.write(plain, time, bytes(10), time)
    files.split.finish()
    assert files.times == [[0], [1, 1], [2, 2]]


def chunk(first_ns: int, last_ns: int, size: int = 100) -> StoredChunk:
    return StoredChunk("none", bytes(size), size, 0, {0: [(first_ns, 0), (last_ns, 50)]})


def test_chunks_go_where_their_messages_do(tmp_path: Path) -> None:
    files = Files(tmp_path, Cut(duration_ns=10))
    files.split.add_connection(topic("/a"))
    for first_ns in (0, 5, 10, 31):
        files.split.write_chunk(chunk(first_ns, first_ns + 4))
    files.split.finish()
    assert files.times == [[0, 4, 5, 9], [10, 14], [31, 35]]
    assert [part.counts for part in files.split.parts] == [{0: 4}, {0: 2}, {0: 2}]
    files = Files(tmp_path / "..", Cut(size=250))
    files.split.add_connection(topic("/a"))
    for first_ns in (0, 5, 10):
        files.split.write_chunk(chunk(first_ns, first_ns + 4))
    files.split.finish()
    assert files.times == [[0, 4, 5, 9], [10, 14]]


def test_chunks_that_a_part_ends_in_or_that_are_repeated_are_not_whole() -> None:
    rule = ChunkRule("mcap", frozenset(), frozenset({1, 2, 3}))
    connections = [replace(topic("/a"), id=1), replace(topic("/map", latching=True), id=2), replace(topic("/b"), id=3)]
    cut = Cut(duration_ns=10, begin_ns=100)
    by_time = narrowed(rule, cut, connections)
    assert by_time.connection_ids == rule.connection_ids
    assert [by_time.is_cut(*span) for span in ((50, 109), (100, 110), (110, 119), (119, 120), (90, 111))] == [
        False,
        True,
        False,
        True,
        True,
    ]
    assert not narrowed(rule, Cut(size=5), connections).is_cut(0, 1000)
    assert narrowed(rule, replace(cut, repeats=True), connections).connection_ids == {1, 3}


def test_a_message_that_cannot_be_written_leaves_no_empty_part(tmp_path: Path) -> None:
    files = Files(tmp_path, Cut(duration_ns=10))
    handle = files.split.add_connection(topic("/a"))
    files.split.write(handle, 0, b"data", 0)
    with pytest.raises(UnwritableError):
        files.split.write(handle, 1 << 63, b"data", 0)
    files.split.finish()
    assert files.times == [[0], []]
    assert [part.path.name for part in files.split.parts] == ["0"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["0"]
    # And what follows goes into it, if anything does.
    files = Files(tmp_path, Cut(duration_ns=10, repeats=True))
    handle = files.split.add_connection(topic("/a", latching=True))
    files.split.write(handle, 0, b"data", 0)
    with pytest.raises(UnwritableError):
        files.split.write(handle, 1 << 63, b"data", 0)
    files.split.write(handle, 11, b"data", 0)
    files.split.finish()
    assert files.times == [[0], [11]]


def test_a_unit_that_was_mistaken(tmp_path: Path) -> None:
    files = Files(tmp_path, Cut(duration_ns=1))
    handle = files.split.add_connection(topic("/a"))
    with pytest.raises(UsageError, match="more than 10,000 files"):  # noqa: PT012  # which one it is does not matter
        for time in range(20_000):
            files.split.write(handle, time, b"", time)


def test_names_of_parts() -> None:
    assert [part_name(name, 3) for name in ("drive.bag", "a.b.mcap", "drive")] == [
        "drive_3.bag",
        "a.b_3.mcap",
        "drive_3",
    ]
