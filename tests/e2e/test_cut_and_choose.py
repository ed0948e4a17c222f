"""What of a recording is converted, where it goes, and what the report says; the words are in `tests/transcripts`."""

from __future__ import annotations

import json
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pc2scan
from support import sampled
from support.builders import (
    CHATTER,
    CLOUD,
    CONTENT,
    POINTS,
    SCAN,
    SECOND,
    SOURCES,
    T0,
    Item,
    Recording,
    Stream,
    cloud,
    item,
    points_of,
    scan,
    write_mcap,
    write_rosbag1,
)
from support.command import run
from support.outputs import opened

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

HEIGHTS = ("--min-height", "-2", "--max-height", "2")
EVERYTHING = {"/scan", "/tf_static", "/tf", "/chatter", "/imu", "/battery"}
STEP = SECOND // 10


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_rosbag1(tmp_path / "drive.bag", CONTENT)


def left(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def report_of(*args: str | Path, folder: Path, status: int = 0) -> dict[str, Any]:
    """Run a conversion, and return its report."""
    heights = () if "--reverse" in args else HEIGHTS
    done = run("convert", *args, *heights, "--report", folder / "report.json")
    assert done.status == status, done.stderr
    found: dict[str, Any] = json.loads((folder / "report.json").read_text())
    assert found["exit_status"] == status
    return found


# --- Times ---


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


# --- Topics ---


@pytest.mark.parametrize(
    ("options", "topics"),
    [
        ("", EVERYTHING),
        ("--keep-clouds", EVERYTHING | {"/points"}),
        ("--only-scans", {"/scan"}),
        ("--keep /tf*", {"/scan", "/tf", "/tf_static"}),
        ("--keep /imu --keep battery", {"/scan", "/imu", "/battery"}),
        ("--drop /tf*", EVERYTHING - {"/tf", "/tf_static"}),
        ("--keep /tf* --drop /tf", {"/scan", "/tf_static"}),
        ("--topic /points:=/front", EVERYTHING - {"/scan"} | {"/front"}),
        ("--topic points", EVERYTHING),
    ],
)
def test_topics_are_kept_dropped_and_renamed(options: str, topics: set[str], bag: Path, tmp_path: Path) -> None:
    report_of(bag, "-o", tmp_path / "out.bag", *options.split(), folder=tmp_path)
    assert opened(tmp_path / "out.bag").topics() == topics


def test_several_cloud_topics_become_scans_under_their_names(tmp_path: Path) -> None:
    rear = Stream("/rear/points", CLOUD)
    more = item(rear, T0 + 9, lambda g, s: cloud(points_of(9), g, seq=s))
    both = Recording((*CONTENT.streams, rear), (*CONTENT.items, more))
    source, made = write_rosbag1(tmp_path / "drive.bag", both), tmp_path / "out.bag"
    for options, topics in (
        ([], EVERYTHING - {"/scan"} | {"/points/scan", "/rear/points/scan"}),
        (["--topic", "/rear/points"], EVERYTHING | {"/points"}),
    ):
        report_of(source, "-o", made, "--overwrite", *options, folder=tmp_path)
        assert opened(made).topics() == topics


@pytest.mark.parametrize("name", sampled(["out.bag", "out.mcap", "out"], 1))
def test_a_cloud_becomes_every_scan_that_is_asked_for(bag: Path, name: str, tmp_path: Path) -> None:
    asked = ["--topic", "/points:=/a", "--topic", "/points:=/b"]
    report = report_of(bag, "-o", tmp_path / name, *asked, folder=tmp_path)
    one, other = ([(m.log_time_ns, m.data) for m in opened(tmp_path / name).of(topic)] for topic in ("/a", "/b"))
    assert one == other
    entries = [entry for entry in report["topics"] if entry["topic"] == "/points"]
    assert [(entry["target"], entry["messages_out"]) for entry in entries] == [("/a", 3), ("/b", 3)]
    # What was read once counts once.
    assert report["messages_read"] == report["messages_declared"]


# --- Sources and destinations ---


@pytest.mark.parametrize("kind", sampled(["bag-none", "mcap-zstd", "db3", "rosbag2-sqlite3-v8"], 2))
def test_two_halves_are_the_whole(kind: str, tmp_path: Path) -> None:
    first, second = CONTENT.halves()
    places = {}
    for name, content in (("both", CONTENT), ("later", second), ("earlier", first)):
        (tmp_path / name).mkdir()
        places[name] = SOURCES[kind](tmp_path / name, content)
    suffix = {"bag-none": ".bag", "mcap-zstd": ".mcap"}.get(kind, "")
    whole, merged = tmp_path / f"whole{suffix}", tmp_path / f"merged{suffix}"
    report_of(places["both"], "-o", whole, folder=tmp_path)
    # The order in which they are given is no difference.
    report_of(places["later"], places["earlier"], "-o", merged, folder=tmp_path)
    one, two = opened(whole), opened(merged)
    assert [(m.topic, m.log_time_ns, m.data) for m in one.messages] == [
        (m.topic, m.log_time_ns, m.data) for m in two.messages
    ]
    assert sorted(one.publishers) == sorted(two.publishers)


@pytest.mark.parametrize(
    ("source", "destination", "storage"),
    sampled(
        [
            ("mcap-ros1", "drive_scan.mcap", ""),
            ("bag-bz2", "drive_scan.bag", ""),
            ("db3", "drive_scan", ".db3"),
            ("mcap-lz4", "drive_scan.mcap", ""),
            ("rosbag2-mcap-v8", "drive_scan", ".mcap"),
            ("rosbag2-sqlite3-v8", "drive_scan", ".db3"),
        ],
        3,
    ),
)
def test_the_destination_has_the_form_of_its_source(
    source: str, destination: str, storage: str, tmp_path: Path
) -> None:
    path = SOURCES[source](tmp_path, CONTENT)
    report_of(path, folder=tmp_path)
    assert left(tmp_path) == {path.name, destination, "report.json"}
    output = opened(tmp_path / destination)
    assert output.topics() == EVERYTHING
    assert output.ros_version == (1 if source in {"bag-bz2", "mcap-ros1"} else 2)
    if storage:
        assert left(tmp_path / destination) == {"metadata.yaml", f"{destination}_0{storage}"}


@pytest.mark.parametrize("name", sampled(["out.bag", "out", "sqlite3", "out.mcap"], 2))
def test_the_output_does_not_depend_on_the_threads(name: str, tmp_path: Path) -> None:
    items = [
        entry
        for step in range(40)
        for entry in (
            item(POINTS, T0 + step * 1000, lambda g, s: cloud(points_of(s, 500 * (s % 3)), g, seq=s), step),
            item(CHATTER, T0 + step * 1000 + 7, lambda g, s: CONTENT.of("/chatter")[s % 3].data[g], step),
        )
    ]
    source = write_rosbag1(tmp_path / "drive.bag", Recording((POINTS, CHATTER), tuple(items)), "lz4")
    storage = ("--storage", "sqlite3") if name == "sqlite3" else ()
    contents = []
    for jobs in ("1", "2", "5"):
        destination = tmp_path / jobs / name
        destination.parent.mkdir()
        report_of(source, "-o", destination, "--jobs", jobs, "--queue-size", "3", *storage, folder=tmp_path)
        files = sorted(destination.iterdir()) if destination.is_dir() else [destination]
        contents.append([(file.name, file.read_bytes()) for file in files])
    assert contents[0] == contents[1] == contents[2]


# --- Messages that cannot be converted ---


STAMP = T0 + STEP
STAMP_TEXT = f"{STAMP // SECOND}.{STAMP % SECOND:09d}"


def damaged(make: Callable[[int, int], bytes]) -> Recording:
    """The common content, the second cloud replaced."""
    second = CONTENT.of("/points")[1]
    bad = item(POINTS, second.log_time_ns, make, seq=1)
    return Recording(CONTENT.streams, tuple(bad if entry is second else entry for entry in CONTENT.items))


DAMAGES: dict[str, tuple[Recording, tuple[str, ...]]] = {
    "a field is missing": (
        damaged(lambda g, s: cloud(points_of(1), g, seq=s, stamp_ns=STAMP, names=("x", "y", "intensity"))),
        ("z", "intensity"),
    ),
    "its data is short": (damaged(lambda g, s: cloud(points_of(1), g, seq=s, stamp_ns=STAMP, cut=100)), ("620", "720")),
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", sampled(["out.bag", "out.mcap", "out"], 1))
def test_a_cloud_that_cannot_be_converted_is_skipped_and_told(damage: str, name: str, tmp_path: Path) -> None:
    content, words = DAMAGES[damage]
    write = write_mcap if name == "out.mcap" else write_rosbag1
    source = write(tmp_path / ("drive.mcap" if name == "out.mcap" else "drive.bag"), content)
    done = run("convert", source, "-o", tmp_path / name, "--report", tmp_path / "report.json", *HEIGHTS)
    assert done.status == 3
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("skipped: ")]
    assert all(word in line for word in ("/points", STAMP_TEXT, *words)), line
    found = json.loads((tmp_path / "report.json").read_text())
    assert (found["exit_status"], found["skipped_count"]) == (3, 1)
    (entry,) = found["skipped"]
    assert (entry["topic"], entry["stamp_ns"], entry["log_time_ns"]) == ("/points", STAMP, STAMP + 5_000_003)
    assert all(word in entry["reason"] for word in words)
    (points,) = (topic for topic in found["topics"] if topic["topic"] == "/points")
    assert (points["messages_in"], points["messages_out"], points["skipped"]) == (3, 2, 1)
    assert len(opened(tmp_path / name).of("/scan")) == 2
    # Unless a message that cannot be converted is an error: then nothing is left.
    before = left(tmp_path)
    done = run("convert", source, "-o", tmp_path / f"again_{name}", "--on-error", "fail", *HEIGHTS)
    assert done.status == 1
    assert all(word in done.stderr for word in ("/points", STAMP_TEXT, *words)), done.stderr
    assert left(tmp_path) == before


def test_scans_that_cannot_be_converted_back_are_skipped(tmp_path: Path) -> None:
    stream = Stream("/base_scan", SCAN)
    ranges = np.full(31, 2.0, np.float32)
    good = [item(stream, T0 + step, lambda g, s: scan(ranges, g, seq=s), step) for step in range(2)]
    short = Item(stream, T0 + 5, {1: good[0].data[1][:-40]})
    source = write_rosbag1(tmp_path / "drive.bag", Recording((stream,), (*good, short)))
    report = report_of(source, "-o", tmp_path / "out.bag", "--reverse", folder=tmp_path, status=3)
    assert report["skipped"][0]["topic"] == "/base_scan"
    assert len(opened(tmp_path / "out.bag").of("/cloud")) == 2


def test_more_skipped_messages_than_are_listed(tmp_path: Path) -> None:
    def made(step: int) -> Item:
        names = ("x", "y", "z" if step == 150 else "i")
        return item(POINTS, T0 + step, lambda g, s: cloud(points_of(0, 5), g, seq=s, names=names), step)

    source = write_rosbag1(tmp_path / "drive.bag", Recording((POINTS,), tuple(map(made, range(151)))))
    done = run("convert", source, "-o", tmp_path / "out.bag", "--report", tmp_path / "report.json")
    assert done.status == 3
    found = json.loads((tmp_path / "report.json").read_text())
    assert (found["skipped_count"], len(found["skipped"])) == (150, 100)
    # They are alike: one line has what is listed, another the number of further ones.
    assert "99 more" in done.stderr
    assert "50 more" in done.stderr


def test_the_report_has_what_was_read_and_written(bag: Path, tmp_path: Path) -> None:
    found = report_of(bag, "-o", tmp_path / "out.bag", folder=tmp_path)
    assert (found["sources"], found["destination"]) == ([str(bag)], str(tmp_path / "out.bag"))
    assert found["bytes_read"] == bag.stat().st_size
    assert found["bytes_written"] == (tmp_path / "out.bag").stat().st_size
    assert (found["params"]["min_height"], found["param_origins"]["min_height"]) == (-2.0, "--min-height")
    topics = {entry["topic"]: entry for entry in found["topics"]}
    assert topics.keys() == EVERYTHING - {"/scan"} | {"/points"}
    points = topics.pop("/points")["points"]
    assert {entry["action"] for entry in topics.values()} == {"passed"}
    assert (points.pop("total"), points["nan"]) == (180, 3) == (sum(points.values()), 3)
    assert topics["/chatter"]["messages_in"] == topics["/chatter"]["messages_out"] == len(CONTENT.of("/chatter"))
