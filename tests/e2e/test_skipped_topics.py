"""Topics that do not reach the destination: how many messages of them there are, and what the exit status says."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from mcap.writer import IndexType
from mcap.writer import Writer as McapLibraryWriter

from support import sampled
from support.builders import CONTENT, SECOND, SOURCES, T0, write_rosbag1
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

    from support.command import Finished

HEIGHTS = ("--min-height", "-2", "--max-height", "2")
STEP = SECOND // 10

#: Ways to write an MCAP file, from counted in its statistics to counted nowhere.
FORMS: list[dict[str, Any]] = [
    {},
    {"use_statistics": False},
    {"use_chunking": False, "use_statistics": False},
    {"use_statistics": False, "index_types": IndexType.NONE},
]


def write_json(path: Path, form: dict[str, Any], *, messages: int = 40, text: str = "/text") -> Path:
    """Write /state and /log in JSON, which a bag cannot hold, /empty in JSON without messages, and a topic of ROS 1."""
    with path.open("wb") as file:
        writer = McapLibraryWriter(file, chunk_size=200, **form)
        writer.start("ros1", "tests")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        ids = [writer.register_channel(topic, "json", 0, {}) for topic in ("/state", "/log", "/empty")]
        ros1 = writer.register_channel(text, "ros1", schema, {})
        for number in range(messages):
            writer.add_message(ids[number % 4 == 0], T0 + number * STEP, b'{"n": %d}' % number, T0, number)
        for number in range(7):
            writer.add_message(ros1, T0 + (messages + number) * STEP, b"\x01\0\0\0a", T0, number)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def reported(folder: Path, *words: str | Path) -> tuple[Finished, list[dict[str, Any]]]:
    """Run a command, and return the topics of its report."""
    done = run(*words, "--report", folder / "report.json")
    return done, json.loads((folder / "report.json").read_text())["topics"]


def counts(topics: list[dict[str, Any]]) -> list[tuple[str, int, int, int]]:
    return [(entry["topic"], entry["messages_in"], entry["messages_out"], entry["skipped"]) for entry in topics]


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_messages_that_a_container_cannot_hold_are_counted(form: dict[str, Any], tmp_path: Path) -> None:
    source = write_json(tmp_path / "drive.mcap", form)
    done, topics = reported(tmp_path, "repair", source, "-o", tmp_path / "out.bag", "-q")
    assert done.status == 3
    assert sorted(counts(topics)) == [
        ("/empty", 0, 0, 0),
        ("/log", 10, 0, 10),
        ("/state", 30, 0, 30),
        ("/text", 7, 7, 0),
    ]
    (warning,) = done.stderr.splitlines()
    begin = "warning: 40 messages of 2 topics are skipped: /state (30: json messages can only be stored in"
    assert warning.startswith(begin)
    assert "/log (10:" in warning
    shown = run("repair", source, "-o", tmp_path / "again.bag")
    (row,) = [line.split() for line in shown.stdout.splitlines() if line.startswith("/state")]
    assert row[:5] == ["/state", "-", "30", "-", "30"]
    assert "more (--verbose" not in shown.stderr


def test_a_topic_without_messages_is_no_loss(tmp_path: Path) -> None:
    source = write_json(tmp_path / "drive.mcap", {}, messages=0)
    done, topics = reported(tmp_path, "repair", source, "-o", tmp_path / "out.bag", "-q")
    assert (done.status, done.stderr) == (0, "")
    assert [entry["lost"] for entry in topics if entry["topic"] == "/state"] == [True]


@pytest.mark.parametrize("form", FORMS, ids=str)
@pytest.mark.parametrize(("start", "end"), sampled([(0.3, 3.75), (1.25, None), (None, 2.0)], 1))
def test_only_messages_of_the_cut_are_counted(
    form: dict[str, Any], start: float | None, end: float | None, tmp_path: Path
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


def test_a_topic_in_two_encodings_has_two_rows(tmp_path: Path) -> None:
    source = write_json(tmp_path / "drive.mcap", {}, messages=1, text="/log")
    done, topics = reported(tmp_path, "repair", source, "-o", tmp_path / "out.bag")
    assert done.status == 3
    rows = [(entry["action"], entry["messages_out"], entry["skipped"]) for entry in topics if entry["topic"] == "/log"]
    assert sorted(rows) == [("passed", 7, 0), ("skipped", 0, 1)]


@pytest.mark.parametrize(("messages", "status"), [(0, 0), (40, 1)])
def test_on_error_fail_is_about_messages(messages: int, status: int, tmp_path: Path) -> None:
    source = write_json(tmp_path / "drive.mcap", {}, messages=messages)
    clouds = write_rosbag1(tmp_path / "clouds.bag", CONTENT)
    done = run("convert", source, clouds, "-o", tmp_path / "out.bag", "--on-error", "fail", *HEIGHTS)
    assert done.status == status
    assert ("/state" in done.stderr) == bool(messages)
