"""Recordings in several files: where they are cut, and what is repeated."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.bags import splitting
from pc2scan.bags.splitting import Cut, RecordingPart, SplitWriter, narrow_rule
from pc2scan.errors import UnwritableError, UsageError
from pc2scan.model import ChunkRule, Connection, StoredChunk
from support.rosbag1_files import connection

if TYPE_CHECKING:
    from collections.abc import Callable

#: Handle, log time and data.
Row = tuple[int, int, bytes]

MAP, STATIC, PLAIN = (
    replace(connection(name), latching=latching)
    for name, latching in (("/map", True), ("/x/tf_static", False), ("/a", False))
)
UNWRITABLE = 1 << 63


class Written:
    """A writer that records its calls."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(b"")
        self.rows: list[Row] = []
        self.calls: list[object] = []
        self.keep_ids = self.compress_ahead = self.add_attachment = self.add_metadata = self.calls.append

    def add_connection(self, each: Connection) -> int:
        self.calls.append(each)
        return sum(isinstance(call, Connection) for call in self.calls) - 1

    def write(self, handle: int, log_time_ns: int, data: bytes, *_: int) -> None:
        if log_time_ns >= UNWRITABLE:
            raise UnwritableError("too late")
        self.rows.append((handle, log_time_ns, bytes(data)))

    def write_chunk(self, chunk: StoredChunk) -> None:
        self.rows += ((handle, time_ns, b"chunk") for handle, entries in chunk.index.items() for time_ns, _ in entries)

    def finish(self) -> None:
        self.calls.append("finished")

    abort = finish


class Files:
    """A split writer, and the writers of its parts."""

    def __init__(self, folder: Path, cut: Cut, *connections: Connection) -> None:
        self.writers: list[Written] = []
        self.finishing: list[int] = []

        def open_part(path: Path) -> tuple[Written, Callable[[RecordingPart], None]]:
            self.writers.append(Written(path))
            return self.writers[-1], lambda part: self.finishing.append(sum(part.counts.values()))

        self.split = SplitWriter(lambda number: folder / f"{number}", open_part, cut)  # type: ignore[arg-type]
        for each in connections:
            self.split.add_connection(each)

    def write(self, *rows: Row) -> list[list[Row]]:
        for handle, time_ns, data in rows:
            self.split.write(handle, time_ns, data, time_ns)
        self.split.finish()
        return [writer.rows for writer in self.writers]


def expected_parts(rows: list[Row], cut: Cut) -> list[list[Row]]:
    """Where each message belongs: forty bytes of each are counted too, and what lasts comes first in every part."""
    parts: list[list[Row]] = [[]]
    size = cell = own = 0
    lasting: dict[tuple[int, bytes], bytes] = {}
    for handle, time_ns, data in rows:
        now = max((time_ns - cut.begin_ns) // cut.duration_ns, 0) if cut.duration_ns else 0
        if own and (now > cell or (cut.size and size + len(data) + 40 > cut.size)):
            # Of a latched topic the last message, of static transforms all that differ, the latest last.
            repeated = sorted((handle, number) for number, (handle, _) in enumerate(lasting))
            parts.append([(handle, time_ns, [*lasting.values()][number]) for handle, number in repeated])
            size, own = sum(len(row[2]) + 40 for row in parts[-1]), 0
        parts[-1].append((handle, time_ns, data))
        size, own, cell = size + len(data) + 40, own + 1, max(cell, now)
        if cut.repeats and handle < 2:
            name = (handle, data if handle == 1 else b"")
            lasting.pop(name, None)
            lasting[name] = data
    return parts


@given(
    rows=st.lists(st.tuples(st.integers(0, 2), st.integers(-5, 60), st.sampled_from([b"x", b"y" * 30, b"z" * 200]))),
    cut=st.builds(
        Cut, duration_ns=st.sampled_from([0, 7, 20]), size=st.sampled_from([0, 1, 250, 900]), repeats=st.booleans(),
        begin_ns=st.integers(0, 3),
    ),
)  # fmt: skip
def test_each_message_is_in_the_part_it_belongs_to(rows: list[Row], cut: Cut) -> None:
    expected = expected_parts(rows, cut)
    with tempfile.TemporaryDirectory() as folder:
        files = Files(Path(folder), cut, MAP, STATIC, PLAIN)
        assert files.write(*rows) == expected
    assert files.finishing == [len(part) for part in expected]
    parts = files.split.parts
    assert [sum(part.counts.values()) for part in parts] == files.finishing
    assert sum(part.own for part in parts) == len(rows)
    times = [[row[1] for row in part] for part in expected]
    assert [part.span_ns for part in parts] == [(min(each), max(each)) if each else None for each in times]
    assert [writer.calls.count("finished") for writer in files.writers] == [1] * len(expected)


def test_of_very_many_static_transforms_the_last_are_repeated(tmp_path: Path) -> None:
    files = Files(tmp_path, Cut(duration_ns=10, repeats=True), STATIC)
    _, second = files.write(*((0, 0, b"%d" % number) for number in range(1_005)), (0, 10, b"new"))
    assert [row[2] for row in second] == [*(b"%d" % number for number in range(5, 1_005)), b"new"]


def test_every_part_has_connections_ids_and_threads(tmp_path: Path) -> None:
    files = Files(tmp_path, Cut(duration_ns=10))
    files.split.keep_ids([MAP, PLAIN])
    for each in (MAP, PLAIN):
        files.split.add_connection(each)
    files.split.compress_ahead("threads")  # type: ignore[arg-type]
    files.split.add_attachment("file")  # type: ignore[arg-type]
    files.split.add_metadata("record")  # type: ignore[arg-type]
    files.write((1, 0, b"data"), (1, 10, b"data"))
    every = [[MAP, PLAIN], MAP, PLAIN, "threads"]
    assert [writer.calls for writer in files.writers] == [[*every, "file", "record", "finished"], [*every, "finished"]]


def chunk(first_ns: int, last_ns: int) -> StoredChunk:
    return StoredChunk("none", bytes(100), 100, 0, {0: [(first_ns, 0), (last_ns, 50)]})


@pytest.mark.parametrize(
    ("cut", "starts", "expected"),
    [
        (Cut(duration_ns=10), (0, 5, 10, 31), [[0, 4, 5, 9], [10, 14], [31, 35]]),
        (Cut(size=250), (0, 5, 10), [[0, 4, 5, 9], [10, 14]]),
    ],
)
def test_chunks_go_where_their_messages_do(
    cut: Cut, starts: tuple[int, ...], expected: list[list[int]], tmp_path: Path
) -> None:
    files = Files(tmp_path, cut, PLAIN)
    for first_ns in starts:
        files.split.write_chunk(chunk(first_ns, first_ns + 4))
    assert [[row[1] for row in part] for part in files.write()] == expected
    assert [part.counts for part in files.split.parts] == [{0: len(part)} for part in expected]


def test_chunks_that_a_part_ends_in_are_not_whole() -> None:
    rule = ChunkRule("mcap", frozenset(), frozenset({1, 2, 3}))
    connections = [replace(each, id=number) for number, each in enumerate((PLAIN, MAP, replace(PLAIN, topic="/b")), 1)]
    cut = Cut(duration_ns=10, begin_ns=100)
    by_time = narrow_rule(rule, cut, connections)
    assert by_time.connection_ids == rule.connection_ids
    spans = {(50, 109): False, (100, 110): True, (110, 119): False, (119, 120): True, (90, 111): True}
    assert {span: by_time.is_cut(*span) for span in spans} == spans
    assert not narrow_rule(rule, Cut(size=5), connections).is_cut(0, 1000)
    assert narrow_rule(rule, replace(cut, repeats=True), connections).connection_ids == {1, 3}


@pytest.mark.parametrize("latching", [False, True])
def test_an_unwritable_message_leaves_no_empty_part(latching: bool, tmp_path: Path) -> None:
    for follows in (False, True):
        files = Files(tmp_path, Cut(duration_ns=10, repeats=latching), replace(PLAIN, latching=latching))
        files.split.write(0, 0, b"data", 0)
        with pytest.raises(UnwritableError):
            files.split.write(0, UNWRITABLE, b"data", 0)
        # What follows goes into the part that was begun, if anything does.
        found = files.write(*[(0, 11, b"data")] * follows)
        assert [[row[1] for row in part] for part in found] == [[0], [11] * follows]
        assert [part.path.name for part in files.split.parts] == ["0", "1"][: 1 + follows]
        assert sorted(entry.name for entry in tmp_path.iterdir()) == ["0", "1"][: 1 + follows]


def test_a_unit_that_was_mistaken_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(splitting, "_MOST_PARTS", 10)
    files = Files(tmp_path, Cut(duration_ns=1), PLAIN)
    with pytest.raises(UsageError, match="more than 10 files"):
        files.write(*((0, time_ns, b"") for time_ns in range(20)))
    assert len(files.writers) == 10
