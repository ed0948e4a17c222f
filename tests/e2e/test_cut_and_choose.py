"""What of a recording is converted, where it goes, and what the report says; the words are in `tests/transcripts`."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import pc2scan
from support.builders import CONTENT, POINTS, SECOND, SOURCES, T0
from support.outputs import opened

if TYPE_CHECKING:
    from pathlib import Path


@cache
def sources(folder: Path) -> list[Path]:
    kinds = ("bag-lz4", "rosbag2-sqlite3-v8", "rosbag2-mcap-v9", "mcap-lz4", "mcap-unchunked", "mcap-ros1", "db3")
    places = {name: folder / name for name in kinds}
    for place in places.values():
        place.mkdir()
    return [SOURCES[name](place, CONTENT) for name, place in places.items()]


#: Times around those of messages, nanoseconds from the beginning.
TIMES = st.sampled_from(sorted({entry.log_time_ns - T0 + by for entry in CONTENT.items for by in (-1, 0, 1)} - {-1}))


@given(st.integers(0, 6), st.none() | TIMES, st.none() | TIMES)
def test_a_cut_has_its_messages_and_what_is_latched(
    tmp_path_factory: pytest.TempPathFactory, kind: int, start: int | None, end: int | None
) -> None:
    """From the start on and before the end, from every container; transforms from before, at the start."""
    folder = tmp_path_factory.getbasetemp() / "cuts"
    folder.mkdir(exist_ok=True)
    first, last = T0 + (start or 0), T0 + (SECOND if end is None else end)
    expected = [
        ("/scan" if entry.stream == POINTS else entry.stream.topic, entry.log_time_ns)
        for entry in CONTENT.items
        if first <= entry.log_time_ns < last
    ]
    latched = [entry for entry in CONTENT.of("/tf_static") if entry.log_time_ns < first]
    bounds = {
        name: f"@{(T0 + bound) // SECOND}.{(T0 + bound) % SECOND:09d}"
        for name, bound in (("start", start), ("end", end))
        if bound is not None
    }
    asked: dict[str, Any] = {"min_height": -2, "max_height": 2, "overwrite": True, **bounds}
    source, made = sources(folder)[kind], folder / "cut.mcap"
    if last <= first or not any(name == "/scan" for name, _ in expected):
        with pytest.raises(pc2scan.Pc2ScanError):
            pc2scan.convert(source, made, **asked)
        return
    assert pc2scan.convert(source, made, **asked).exit_status == 0
    found = [(message.topic, message.log_time_ns) for message in opened(made).messages]
    assert sorted(found) == sorted([("/tf_static", first)] * len(latched) + expected)
