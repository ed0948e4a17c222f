from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.compare import held as module
from pc2scan.compare.held import held
from pc2scan.model import Connection, RawMessage

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    import pytest

TOPICS = [Connection(number, f"/t{number}", "a/msg/A", "cdr") for number in range(3)]


class OpenRecording:
    """A recording that counts how often it is read."""

    path = Path("source")
    connections = TOPICS
    reads = 0

    def messages(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[RawMessage]:
        self.reads += 1
        for number in (2, 0, 1, 0, 2, 1):
            message = RawMessage(TOPICS[number], 5, memoryview(b"data"), 5, number)
            in_time = (start_ns or 0) <= 5 and (stop_ns is None or stop_ns > 5)
            if in_time and (connections is None or message.connection in connections):
                yield message

    def close(self) -> None:
        """Nothing to release."""


def test_a_recording_is_read_once_for_all_its_topics() -> None:
    source = OpenRecording()
    copy = held(source, TOPICS[:2])
    assert source.reads == 1
    for chosen in (TOPICS[:1], TOPICS[1:2], TOPICS[:2]):
        assert list(copy.messages(chosen)) == list(OpenRecording().messages(chosen))
    assert source.reads == 1
    assert list(copy.messages(TOPICS[:2], 5, 6)) == list(copy.messages(TOPICS[:2]))
    assert list(copy.messages(TOPICS[:2], 6)) == list(copy.messages(TOPICS[:2], None, 5)) == []


def test_what_takes_too_much_memory_is_read_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MAX_BYTES", 1000)
    source = OpenRecording()
    assert held(source, TOPICS) is source
