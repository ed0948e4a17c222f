"""Samples of many topics, against the plain way: one look-up in the recording for each sample."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.inspect.sampling import sampled
from pc2scan.model import Connection, RawMessage, Summary

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

#: Bytes of a chunk.
CHUNK = 1_000


class Recording:
    """Messages in chunks of some, each of which tells the topics in it; stands in for a reader."""

    def __init__(self, rows: list[tuple[int, str]], in_a_chunk: int, *, starts_anew: bool = False) -> None:
        self.connections = {
            name: Connection(n, name, "t", "cdr") for n, name in enumerate(sorted({r[1] for r in rows}))
        }
        rows = sorted(rows, key=lambda row: row[0])
        self.chunks = [rows[start : start + in_a_chunk] for start in range(0, len(rows), in_a_chunk)]
        self.bytes_read = self.loads = self.streams = 0
        self.starts_anew = starts_anew
        size = CHUNK * len(self.chunks)
        self.summary = Summary("mcap", "", ("none",), size, len(rows), rows[0][0], rows[-1][0])

    def messages(
        self, connections: Collection[Connection] | None = None, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        assert connections is not None
        wanted = {connection.topic for connection in connections}
        self.streams += 1
        if self.starts_anew:
            self.bytes_read = 0
        for chunk in self.chunks:
            if stop_ns is not None and chunk[0][0] >= stop_ns:
                return
            if chunk[-1][0] < (start_ns or 0) or wanted.isdisjoint(name for _, name in chunk):
                continue
            self.bytes_read += CHUNK
            self.loads += 1
            for n, (time_ns, name) in enumerate(chunk):
                if name in wanted and time_ns >= (start_ns or 0) and (stop_ns is None or time_ns < stop_ns):
                    yield RawMessage(self.connections[name], time_ns, b"%d" % n, time_ns)

    def sampled(self, samples: int) -> list[tuple[str, int, bytes]]:
        topics: dict[str, Any] = {name: [connection] for name, connection in self.connections.items()}
        start_ns, end_ns = self.summary.start_ns, self.summary.end_ns
        assert start_ns is not None
        assert end_ns is not None
        found = sampled(self, topics, samples, start_ns, end_ns)  # type: ignore[arg-type]  # all that is needed of one
        return [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in found]

    def one_by_one(self, samples: int) -> list[tuple[str, int, bytes]]:
        start_ns, end_ns = self.summary.start_ns or 0, self.summary.end_ns or 0
        taken = []
        for name, connection in self.connections.items():
            seen = start_ns - 1
            for step in range(samples):
                begin = max(start_ns + (end_ns - start_ns) * step // samples, seen + 1)
                message = next(self.messages([connection], begin), None)
                if message is None:
                    break
                seen = message.log_time_ns
                taken.append((name, seen, bytes(message.data)))
        return taken


@given(
    rows=st.lists(st.tuples(st.integers(0, 60), st.sampled_from("aaaabbcd")), min_size=1, max_size=120),
    in_a_chunk=st.integers(1, 40),
    samples=st.integers(1, 12) | st.sampled_from([1000, 10**30]),
    starts_anew=st.booleans(),
)
def test_the_same_samples_as_one_by_one(
    rows: list[tuple[int, str]], in_a_chunk: int, samples: int, starts_anew: bool
) -> None:
    recording = Recording(rows, in_a_chunk, starts_anew=starts_anew)
    found = recording.sampled(samples)
    assert found == sorted(found, key=lambda row: row[1])
    assert sorted(found) == sorted(recording.one_by_one(samples))


def test_most_of_a_long_recording_is_not_read() -> None:
    rows = [(10 * n, name) for n in range(100_000) for name in "ab"]
    recording = Recording(rows, 20)
    assert len(recording.sampled(10)) == 20
    assert recording.loads <= 20


def test_a_rare_topic_is_found_by_the_index() -> None:
    rows = [(10 * n, "common") for n in range(100_000)] + [(0, "rare"), (700_001, "rare")]
    recording = Recording(rows, 20)
    assert [row for row in recording.sampled(10) if row[0] == "rare"] == [("rare", 0, b"1"), ("rare", 700_001, b"2")]
    assert recording.loads <= 60


def test_one_chunk_is_read_a_few_times_whatever_the_topics() -> None:
    for topics in (1, 10, 1_000, 2_000):
        recording = Recording([(n, f"/{n % topics}") for n in range(2_000)], 2_000)
        assert len(recording.sampled(10)) == min(10 * topics, 2_000)
        assert recording.loads <= 4


def test_many_topics_in_many_chunks_are_read_a_few_times() -> None:
    recording = Recording([(n, f"/{n % 3_000}") for n in range(30_000)], 10)
    assert len(recording.sampled(10)) == 30_000
    assert recording.loads <= 3 * len(recording.chunks)


@pytest.mark.parametrize("samples", [10, 10_000])
def test_more_samples_than_messages_need_few_streams(samples: int) -> None:
    """Two chunks have messages of one time: a stream that begins there reads the first one again."""
    recording = Recording([(3, "b"), (6, "a"), (6, "a")], 1, starts_anew=True)
    assert recording.sampled(samples) == [("b", 3, b"0"), ("a", 6, b"0")]
    assert recording.streams <= 4
