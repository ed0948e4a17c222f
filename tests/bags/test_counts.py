"""Messages counted by an index, which agrees with reading them, or is silent."""

from __future__ import annotations

import random
from collections import Counter
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.opening import open_recording
from support.builders import CONTENT, SOURCES
from support.mcap_files import LIBRARY_OPTIONS, SAMPLE, library_file

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.reader import Reader

#: Options of the library's writer without anything to count by for a part of the time.
SILENT = {
    "unchunked",
    "unchunked without summary",
    "no indexes",
    "only chunk indexes",
    "no message indexes",
    "no summary",
}


def compare(reader: Reader, *, silent: bool = False) -> None:
    """Count in cuts at random, and with messages at their bounds."""
    times = [message.log_time_ns for message in reader.messages()]
    rng = random.Random(1)
    cuts: list[tuple[int | None, int | None]] = [
        (None, None),
        (min(times), max(times)),
        (min(times) + 1, None),
        (None, max(times) + 1),
    ]
    cuts += [(min(pair), max(pair)) for pair in (rng.choices(times, k=2) for _ in range(10))]
    chosen = reader.connections[::2]
    for start_ns, stop_ns in cuts:
        counted = reader.counts(chosen, start_ns, stop_ns)
        found = Counter(message.connection.id for message in reader.messages(chosen, start_ns, stop_ns))
        assert not counted.keys() - {connection.id for connection in chosen}
        assert all(number == found[connection_id] for connection_id, number in counted.items())
        if not silent:
            assert counted.keys() == {connection.id for connection in chosen}


@pytest.mark.parametrize("name", SOURCES)
def test_counts_are_those_of_the_messages(name: str, tmp_path: Path) -> None:
    with closing(open_recording(SOURCES[name](tmp_path, CONTENT))) as reader:
        compare(reader, silent="unchunked" in name)


@pytest.mark.parametrize("name", LIBRARY_OPTIONS)
def test_counts_of_mcap_files_with_and_without_indexes(name: str, tmp_path: Path) -> None:
    with closing(
        open_recording(library_file(tmp_path / "a.mcap", SAMPLE, chunk_size=300, **LIBRARY_OPTIONS[name]))
    ) as reader:
        compare(reader, silent=name in SILENT)


def test_nothing_is_read_to_count(tmp_path: Path) -> None:
    for name in ("bag-lz4", "mcap-zstd"):
        with closing(open_recording(SOURCES[name](tmp_path, CONTENT))) as reader:
            times = [item.log_time_ns for item in CONTENT.items]
            assert sum(reader.counts(reader.connections, min(times) + 1, max(times)).values()) > 10
            assert reader.bytes_read == 0
