"""Topics that do not reach the destination: how many messages of them there are, and what the exit status says."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from mcap.writer import IndexType
from mcap.writer import Writer as McapLibraryWriter

from support.builders import CONTENT, SECOND, SOURCES, T0, write_rosbag1
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

    from support.command import Finished

HEIGHTS = ("--min-height", "-2", "--max-height", "2")
STEP = SECOND // 10

#: Ways to write an MCAP file, from counted in its statistics to counted nowhere.
FORMS: dict[str, dict[str, Any]] = {
    "statistics": {},
    "message indexes": {"use_statistics": False},
    "unchunked": {"use_chunking": False, "use_statistics": False},
    "no index": {"use_statistics": False, "index_types": IndexType.NONE},
}

KINDS = ("bag-none", "bag-lz4", "mcap-zstd", "mcap-unchunked", "rosbag2-sqlite3-v8", "rosbag2-mcap-split")


def write_json(path: Path, form: dict[str, Any], *, messages: int = 40) -> Path:
    """Write /state and /log in JSON, which a bag cannot hold, /empty in JSON without messages, and /text of ROS 1."""
    with path.open("wb") as file:
        writer = McapLibraryWriter(file, chunk_size=200, **form)
        writer.start("ros1", "tests")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        ids = [writer.register_channel(topic, "json", 0, {}) for topic in ("/state", "/log", "/empty")]
        text = writer.register_channel("/text", "ros1", schema, {})
        for number in range(messages):
            writer.add_message(ids[number % 4 == 0], T0 + number * STEP, b'{"n": %d}' % number, T0, number)
        for number in range(7):
            writer.add_message(text, T0 + (messages + number) * STEP, b"\x01\0\0\0a", T0, number)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def repaired(source: Path, destination: Path, *options: str) -> tuple[Finished, dict[str, dict[str, Any]]]:
    report = destination.with_name("report.json")
    done = run("repair", source, "-o", destination, "--report", report, *options)
    assert "Traceback" not in done.stderr, done.stderr
    return done, {topic["topic"]: topic for topic in json.loads(report.read_text())["topics"]}


@pytest.mark.parametrize("form", FORMS)
def test_messages_that_a_container_cannot_hold_are_counted(form: str, tmp_path: Path) -> None:
    source = write_json(tmp_path / "drive.mcap", FORMS[form])
    done, topics = repaired(source, tmp_path / "out.bag", "-q")
    assert done.status == 3
    counts = {name: (entry["messages_in"], entry["messages_out"], entry["skipped"]) for name, entry in topics.items()}
    assert counts == {"/state": (30, 0, 30), "/log": (10, 0, 10), "/empty": (0, 0, 0), "/text": (7, 7, 0)}
    (warning,) = done.stderr.splitlines()
    assert warning.startswith(
        "warning: 40 messages of 2 topics are skipped: /state (30: json messages can only be stored in"
    )
    assert "/log (10:" in warning
    shown = run("repair", source, "-o", tmp_path / "again.bag")
    (row,) = [line.split() for line in shown.stdout.splitlines() if line.startswith("/state")]
    assert row[:5] == ["/state", "-", "30", "-", "30"]
    assert "more (--verbose" not in shown.stderr


def test_a_topic_without_messages_is_no_loss(tmp_path: Path) -> None:
    source = write_json(tmp_path / "drive.mcap", {}, messages=0)
    done, topics = repaired(source, tmp_path / "out.bag", "-q")
    assert (done.status, done.stderr) == (0, "")
    assert topics["/state"]["lost"]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("cut", [("--start", "1.25"), ("--end", "2.0"), ("--start", "0.3", "--end", "3.75")])
def test_only_messages_of_the_cut_are_counted(form: str, cut: tuple[str, ...], tmp_path: Path) -> None:
    source = tmp_path / "drive.mcap"
    (first, *_) = CONTENT.of("/points")
    items = [replace(first, log_time_ns=T0 + number * 5 * STEP) for number in range(8)]
    clouds = SOURCES["mcap-ros1"](tmp_path, replace(CONTENT, items=tuple(items)))
    clouds.rename(tmp_path / "clouds.mcap")
    write_json(source, FORMS[form])
    report = tmp_path / "report.json"
    done = run(
        "convert", source, tmp_path / "clouds.mcap", "-o", tmp_path / "out.bag", "--report", report, *cut, *HEIGHTS
    )
    bounds = dict(zip(cut[::2], map(float, cut[1::2]), strict=True))
    low, high = bounds.get("--start", 0.0), bounds.get("--end", 1e9)
    inside = [number for number in range(40) if low * 10 <= number < high * 10]
    topics = {topic["topic"]: topic for topic in json.loads(report.read_text())["topics"]}
    assert topics["/log"]["messages_in"] == sum(number % 4 == 0 for number in inside)
    assert topics["/state"]["messages_in"] == topics["/state"]["skipped"] == sum(number % 4 != 0 for number in inside)
    assert done.status == 3


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("cut", [(), ("--start", "0.1", "--end", "0.25")], ids=["whole", "cut"])
def test_dropped_topics_are_counted_and_no_loss(name: str, cut: tuple[str, ...], tmp_path: Path) -> None:
    source = SOURCES[name](tmp_path, CONTENT)
    report = tmp_path / "report.json"
    done = run("convert", source, "-o", tmp_path / "out.mcap", "--only-scans", "-q", "--report", report, *cut, *HEIGHTS)
    assert (done.status, done.stderr) == (0, "")
    low, high = (T0 + STEP, T0 + 25 * SECOND // 100) if cut else (0, 1 << 62)
    found = {topic["topic"]: topic for topic in json.loads(report.read_text())["topics"] if topic["target"] is None}
    for topic, entry in found.items():
        # Latched messages from before the cut would have been kept.
        first = 0 if topic == "/tf_static" else low
        expected = [item for item in CONTENT.of(topic) if first <= item.log_time_ns < high]
        assert (topic, entry["messages_in"]) == (topic, len(expected))
        assert (entry["messages_out"], entry["skipped"], entry["lost"]) == (0, 0, False)
    assert len(found) > 3


def test_a_topic_in_two_encodings_has_two_rows(tmp_path: Path) -> None:
    source = tmp_path / "drive.mcap"
    with source.open("wb") as file:
        writer = McapLibraryWriter(file)
        writer.start("ros1", "tests")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        for encoding, data in (("ros1", b"\x01\0\0\0a"), ("json", b"{}")):
            channel = writer.register_channel("/text", encoding, schema, {})
            writer.add_message(channel, T0, data, T0)
        writer.finish()  # type: ignore[no-untyped-call]
    report = tmp_path / "report.json"
    done = run("repair", source, "-o", tmp_path / "out.bag", "--report", report)
    assert done.status == 3
    rows = [
        (topic["action"], topic["messages_out"], topic["skipped"]) for topic in json.loads(report.read_text())["topics"]
    ]
    assert rows == [("passed", 1, 0), ("skipped", 0, 1)]


def test_on_error_fail_is_about_messages(tmp_path: Path) -> None:
    source = write_json(tmp_path / "drive.mcap", {}, messages=0)
    clouds = write_rosbag1(tmp_path / "clouds.bag", CONTENT)
    done = run("convert", source, clouds, "-o", tmp_path / "out.bag", "--on-error", "fail", *HEIGHTS)
    assert done.status == 0, done.stderr
    write_json(source, {})
    done = run("convert", source, clouds, "-o", tmp_path / "again.bag", "--on-error", "fail", *HEIGHTS)
    assert done.status == 1
    assert "/state" in done.stderr
