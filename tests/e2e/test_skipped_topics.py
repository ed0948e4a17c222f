"""Topics that do not reach the destination: how many messages of them there are, and what the exit status says."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from support import sampled
from support.builders import CONTENT, SECOND, SOURCES, T0
from support.command import run
from support.made import FORMS, write_json

if TYPE_CHECKING:
    from pathlib import Path

    from support.command import Finished

HEIGHTS = ("--min-height", "-2", "--max-height", "2")
STEP = SECOND // 10


def reported(folder: Path, *words: str | Path) -> tuple[Finished, list[dict[str, Any]]]:
    """Run a command, and return the topics of its report."""
    done = run(*words, "--report", folder / "report.json")
    return done, json.loads((folder / "report.json").read_text())["topics"]


def counts(topics: list[dict[str, Any]]) -> list[tuple[str, int, int, int]]:
    return [(entry["topic"], entry["messages_in"], entry["messages_out"], entry["skipped"]) for entry in topics]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("start", "end"), sampled([(0.3, 3.75), (1.25, None), (None, 2.0)], 1))
def test_only_messages_of_the_cut_are_counted(
    form: str, start: float | None, end: float | None, tmp_path: Path
) -> None:
    (first, *_) = CONTENT.of("/points")
    items = [replace(first, log_time_ns=T0 + number * 5 * STEP) for number in range(8)]
    clouds = SOURCES["mcap-ros1"](tmp_path, replace(CONTENT, items=tuple(items)))
    source = write_json(tmp_path / "states.mcap", form)
    cut = [f"--{name}={bound}" for name, bound in (("start", start), ("end", end)) if bound is not None]
    done, topics = reported(tmp_path, "convert", source, clouds, "-o", tmp_path / "out.bag", *cut, *HEIGHTS)
    assert done.status == 3
    inside = [number for number in range(40) if (start or 0) * 10 <= number < (end or 9) * 10]
    states, logs = ([n for n in inside if (n % 4 == 0) == logged] for logged in (False, True))
    expected = {("/log", len(logs), 0, len(logs)), ("/state", len(states), 0, len(states))}
    assert expected <= set(counts(topics))


@pytest.mark.parametrize(
    ("name", "cut"),
    sampled(
        (
            (name, cut)
            for name in (
                *("mcap-unchunked", "bag-none", "rosbag2-sqlite3-v8"),
                *("rosbag2-mcap-split", "mcap-zstd", "bag-lz4"),
            )
            for cut in (True, False)
        ),
        4,
    ),
)
def test_dropped_topics_are_counted_and_no_loss(name: str, cut: bool, tmp_path: Path) -> None:
    source = SOURCES[name](tmp_path, CONTENT)
    words: list[str | Path] = ["convert", source, "-o", tmp_path / "out.mcap", "--only-scans", "-q", *HEIGHTS]
    done, topics = reported(tmp_path, *words, *(["--start", "0.1", "--end", "0.25"] if cut else []))
    assert (done.status, done.stderr) == (0, "")
    low, high = (T0 + STEP, T0 + 25 * SECOND // 100) if cut else (0, 1 << 62)
    dropped = [entry for entry in topics if entry["target"] is None]
    assert len(dropped) > 3
    assert not any(entry["lost"] for entry in dropped)
    # Latched messages from before the cut would have been kept.
    lows = {entry["topic"]: 0 if entry["topic"] == "/tf_static" else low for entry in dropped}
    assert counts(dropped) == [
        (topic, sum(first <= item.log_time_ns < high for item in CONTENT.of(topic)), 0, 0)
        for topic, first in lows.items()
    ]
