"""What of a recording is converted, where it goes, and how the command reports what happened."""

from __future__ import annotations

import json
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from support.builders import (
    CHATTER,
    CLOUD,
    CONTENT,
    POINTS,
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
    write_db3,
    write_mcap,
    write_rosbag1,
    write_rosbag2,
)
from support.command import run
from support.outputs import Found, opened

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from support.command import Finished

HEIGHTS = ("--min-height", "-2", "--max-height", "2")
EVERYTHING = {"/scan", "/tf_static", "/tf", "/chatter", "/imu", "/battery"}


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_rosbag1(tmp_path / "drive.bag", CONTENT)


def convert(*args: str | Path) -> Finished:
    heights = () if "--reverse" in args else HEIGHTS
    done = run("convert", *args, *heights)
    assert "Traceback" not in done.stderr, done.stderr
    return done


def written(*args: str | Path, destination: Path) -> list[Found]:
    done = convert(*args, "-o", destination)
    assert done.status == 0, done.stderr
    return opened(destination).messages


def left(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


# --- Time ---


def targets(since_ns: int, until_ns: int) -> list[tuple[str, int]]:
    found = [
        ("/scan" if entry.stream.topic == "/points" else entry.stream.topic, entry.log_time_ns)
        for entry in CONTENT.items
        if since_ns <= entry.log_time_ns < until_ns
    ]
    return sorted(found, key=lambda row: row[1])


STEP = SECOND // 10
#: Two publishers, at the beginning of a cut.
LATCHED = [("/tf_static", T0 + STEP)] * 2
ISO = datetime.fromtimestamp((T0 + STEP) // 1000 / 1e6, timezone.utc).isoformat()


@pytest.mark.parametrize(
    "start",
    ["0.1", f"@{(T0 + STEP) // SECOND}.{(T0 + STEP) % SECOND:09d}", f"{(T0 + STEP)}", ISO],
    ids=["relative", "seconds", "nanoseconds", "iso"],
)
@pytest.mark.parametrize("suffix", [".bag", ".mcap", ""])
def test_start_keeps_what_is_latched(start: str, suffix: str, bag: Path, tmp_path: Path) -> None:
    found = written(bag, "--start", start, destination=tmp_path / f"cut{suffix}")
    # Times of day have microseconds.
    start_ns = T0 + STEP - (T0 % 1000 if start == ISO else 0)
    expected = [("/tf_static", start_ns)] * 2 + targets(start_ns, T0 + 10 * SECOND)
    assert sorted((m.topic, m.log_time_ns) for m in found) == sorted(expected)


def test_latched_messages_before_the_cut_are_kept_from_every_container(tmp_path: Path) -> None:
    for name in ("rosbag2-sqlite3-v8", "rosbag2-mcap-v9", "mcap-lz4", "mcap-unchunked", "mcap-ros1", "db3"):
        folder = tmp_path / name
        folder.mkdir()
        found = written(SOURCES[name](folder, CONTENT), "--start", "0.1", destination=folder / "cut.mcap")
        expected = LATCHED + targets(T0 + STEP, T0 + 10 * SECOND)
        assert sorted((m.topic, m.log_time_ns) for m in found) == sorted(expected)


def test_end_is_not_part_of_the_cut(bag: Path, tmp_path: Path) -> None:
    # The second /tf is recorded 2 ns after 0.1 s.
    early = written(bag, "--end", "0.100000002", destination=tmp_path / "early.bag")
    late = written(bag, "--end", "0.100000003", destination=tmp_path / "late.bag")
    assert [(m.topic, m.log_time_ns) for m in late if m not in early] == [("/tf", T0 + STEP + 2)]
    assert sorted((m.topic, m.log_time_ns) for m in early) == sorted(targets(T0, T0 + STEP + 2))


def test_a_cut_in_the_middle(bag: Path, tmp_path: Path) -> None:
    found = written(bag, "--start", "0.1", "--end", "0.2", destination=tmp_path / "cut.bag")
    expected = LATCHED + targets(T0 + STEP, T0 + 2 * STEP)
    assert sorted((m.topic, m.log_time_ns) for m in found) == sorted(expected)


@pytest.mark.parametrize("bounds", [("--start", "0.2", "--end", "0.2"), ("--start", "0.2", "--end", "0.1")])
def test_a_cut_that_cannot_hold_anything_is_refused(bounds: tuple[str, ...], bag: Path, tmp_path: Path) -> None:
    done = convert(bag, "-o", tmp_path / "cut.bag", *bounds)
    assert done.status == 2
    assert "empty" in done.stderr
    assert left(tmp_path) == {"drive.bag"}


def test_a_cut_after_the_end_has_nothing_to_convert(bag: Path, tmp_path: Path) -> None:
    done = convert(bag, "--start", "3600", "-o", tmp_path / "cut.bag")
    assert done.status == 2
    assert "the cut is outside of the recording" in done.stderr
    assert left(tmp_path) == {"drive.bag"}


def test_not_a_time(bag: Path, tmp_path: Path) -> None:
    done = convert(bag, "-o", tmp_path / "cut.bag", "--start", "noon")
    assert done.status == 2
    assert "'noon'" in done.stderr


# --- Topics ---


@pytest.mark.parametrize(
    ("options", "topics"),
    [
        ((), EVERYTHING),
        (("--keep-clouds",), EVERYTHING | {"/points"}),
        (("--only-scans",), {"/scan"}),
        (("--keep", "/tf*"), {"/scan", "/tf", "/tf_static"}),
        (("--keep", "/imu", "--keep", "battery"), {"/scan", "/imu", "/battery"}),
        (("--drop", "/tf*"), EVERYTHING - {"/tf", "/tf_static"}),
        (("--keep", "/tf*", "--drop", "/tf"), {"/scan", "/tf_static"}),
        (("--topic", "/points:=/front"), EVERYTHING - {"/scan"} | {"/front"}),
        (("--topic", "points"), EVERYTHING),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_topics(options: tuple[str, ...], topics: set[str], bag: Path, tmp_path: Path) -> None:
    assert {m.topic for m in written(bag, *options, destination=tmp_path / "out.bag")} == topics


def with_second_lidar() -> Recording:
    rear = Stream("/rear/points", CLOUD)
    more = item(rear, T0 + 9, lambda g, s: cloud(points_of(9), g, seq=s))
    return Recording((*CONTENT.streams, rear), (*CONTENT.items, more))


def test_several_cloud_topics_become_scans_under_their_names(tmp_path: Path) -> None:
    source = write_rosbag1(tmp_path / "drive.bag", with_second_lidar())
    found = {m.topic for m in written(source, destination=tmp_path / "out.bag")}
    assert found == EVERYTHING - {"/scan"} | {"/points/scan", "/rear/points/scan"}
    found = {m.topic for m in written(source, "--topic", "/rear/points", destination=tmp_path / "rear.bag")}
    assert found == EVERYTHING | {"/points"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--topic", "/pionts"), ("no topic /pionts", "/points")),
        (("--topic", "/chatter"), ("/chatter is std_msgs/msg/String", "/points")),
        (("--topic", "/points:=/chatter"), ("/chatter", "--topic /points:=/points/chatter")),
        (("--topic", "/points:=/points", "--keep-clouds"), ("/points", "--topic /points:=")),
        (("--drop", "/points"), ("dropped", "/points")),
        (("--reverse",), ("no LaserScan topic", "/points")),
    ],
    ids=" ".join,
)
def test_topics_that_cannot_be(options: tuple[str, ...], words: tuple[str, ...], bag: Path, tmp_path: Path) -> None:
    done = convert(bag, "-o", tmp_path / "out.bag", *options)
    assert done.status == 2
    assert all(word in done.stderr for word in words), done.stderr
    assert done.stdout == ""
    assert left(tmp_path) == {"drive.bag"}


def test_the_name_proposed_is_free(tmp_path: Path) -> None:
    taken = [Stream(name, "std_msgs/msg/String") for name in ("/scan", "/points/scan")]
    more = tuple(item(stream, T0 + 9, lambda g, _: CONTENT.of("/chatter")[0].data[g]) for stream in taken)
    content = Recording((*CONTENT.streams, *taken), (*CONTENT.items, *more))
    source = write_rosbag1(tmp_path / "drive.bag", content)
    done = convert(source, "-o", tmp_path / "out.bag")
    assert done.status == 2
    proposed = done.stderr.split("--topic ")[1].split(",")[0].split()[0]
    assert proposed.startswith("/points:=")
    assert proposed not in {"/points:=/scan", "/points:=/points/scan"}
    found = {m.topic for m in written(source, "--topic", proposed, destination=tmp_path / "out.bag")}
    assert proposed.removeprefix("/points:=") in found


def test_a_pattern_that_matches_nothing_is_told(bag: Path, tmp_path: Path) -> None:
    done = convert(bag, "-o", tmp_path / "out.bag", "--drop", "/odometri")
    assert done.status == 0
    assert "/odometri" in done.stderr


# --- Sources ---


@pytest.mark.parametrize("kind", ["bag", "mcap", "db3", "rosbag2"])
def test_two_halves_are_the_whole(kind: str, tmp_path: Path) -> None:
    def put(name: str, recording: Recording) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        match kind:
            case "bag":
                return write_rosbag1(folder / "a.bag", recording)
            case "mcap":
                return write_mcap(folder / "a.mcap", recording)
            case "db3":
                return write_db3(folder / "a.db3", recording)
        return write_rosbag2(folder / "a", recording)

    first, second = CONTENT.halves()
    suffix = {"bag": ".bag", "mcap": ".mcap"}.get(kind, "")
    whole, merged = tmp_path / f"whole{suffix}", tmp_path / f"merged{suffix}"
    written(put("both", CONTENT), destination=whole)
    # The order in which they are given is no difference.
    written(put("later", second), put("earlier", first), destination=merged)
    one, two = opened(whole), opened(merged)
    assert [(m.topic, m.log_time_ns, m.data) for m in one.messages] == [
        (m.topic, m.log_time_ns, m.data) for m in two.messages
    ]
    assert sorted(one.publishers) == sorted(two.publishers)


def test_ros1_and_ros2_do_not_mix(bag: Path, tmp_path: Path) -> None:
    other = write_mcap(tmp_path / "other.mcap", CONTENT)
    done = convert(bag, other, "-o", tmp_path / "out.bag")
    assert done.status == 2
    assert "ROS 1" in done.stderr
    assert "ROS 2" in done.stderr
    assert left(tmp_path) == {"drive.bag", "other.mcap"}


def test_the_same_source_twice_is_refused(bag: Path, tmp_path: Path) -> None:
    done = convert(bag, bag, "-o", tmp_path / "out.bag")
    assert done.status == 2
    assert "twice" in done.stderr


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("absent.bag", None, "does not exist"),
        ("text.bag", b"hello", "not a recording"),
        ("empty.mcap", b"", "empty"),
    ],
)
def test_what_is_no_recording(name: str, content: bytes | None, word: str, tmp_path: Path) -> None:
    source = tmp_path / name
    if content is not None:
        source.write_bytes(content)
    before = left(tmp_path)
    done = convert(source, "-o", tmp_path / "out.bag")
    assert done.status == (2 if content is None else 1)
    assert word in done.stderr
    assert str(source) in done.stderr
    assert left(tmp_path) == before


# --- Destinations ---


@pytest.mark.parametrize(
    ("source", "destination", "storage"),
    [
        ("bag-bz2", "drive_scan.bag", ""),
        ("mcap-lz4", "drive_scan.mcap", ""),
        ("mcap-ros1", "drive_scan.mcap", ""),
        ("rosbag2-sqlite3-v8", "drive_scan", ".db3"),
        ("rosbag2-mcap-v8", "drive_scan", ".mcap"),
        ("db3", "drive_scan", ".db3"),
    ],
)
def test_default_destination(source: str, destination: str, storage: str, tmp_path: Path) -> None:
    path = SOURCES[source](tmp_path, CONTENT)
    done = convert(path)
    assert done.status == 0, done.stderr
    assert left(tmp_path) == {path.name, destination}
    output = opened(tmp_path / destination)
    assert output.topics() == EVERYTHING
    assert output.ros_version == (1 if source in {"bag-bz2", "mcap-ros1"} else 2)
    if storage:
        assert left(tmp_path / destination) == {"metadata.yaml", f"{destination}_0{storage}"}


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "out"])
def test_overwrite(name: str, bag: Path, tmp_path: Path) -> None:
    destination = tmp_path / name
    written(bag, destination=destination)
    refused = convert(bag, "-o", destination, "--only-scans")
    assert refused.status == 2
    assert "exists" in refused.stderr
    assert "--overwrite" in refused.stderr
    assert opened(destination).topics() == EVERYTHING
    assert {m.topic for m in written(bag, "--only-scans", "--overwrite", destination=destination)} == {"/scan"}
    assert left(tmp_path) == {"drive.bag", name}


def test_a_directory_of_recordings_is_not_overwritten(bag: Path, tmp_path: Path) -> None:
    folder = tmp_path / "drives"
    folder.mkdir()
    for name in ("monday.mcap", "tuesday.mcap"):
        written(bag, destination=folder / name)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    done = convert(bag, "-o", folder, "--overwrite")
    assert done.status == 2
    assert "it has no metadata.yaml" in done.stderr
    assert "hint: choose another name" in done.stderr
    # One of them has been recorded with a metadata.yaml; the other is still not a part of it.
    assert convert(bag, "-o", tmp_path / "wednesday").status == 0
    for path in (tmp_path / "wednesday").iterdir():
        path.rename(folder / path.name)
        before[path.name] = (folder / path.name).read_bytes()
    done = convert(bag, "-o", folder, "--overwrite")
    assert done.status == 2
    assert "its metadata.yaml does not name monday.mcap" in done.stderr
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)])
def test_a_source_is_never_the_destination(overwrite: tuple[str, ...], bag: Path, tmp_path: Path) -> None:
    before = bag.read_bytes()
    (tmp_path / "link.bag").symlink_to(bag)
    for name in ("drive.bag", "link.bag"):
        done = convert(bag, "-o", tmp_path / name, *overwrite)
        assert done.status == 2
        assert bag.read_bytes() == before
    folder = write_rosbag2(tmp_path / "drive", CONTENT)
    files = left(folder)
    done = convert(folder, "-o", folder / "inside.mcap", *overwrite)
    assert done.status == 2
    assert left(folder) == files


@pytest.mark.parametrize(
    "options",
    [
        ("-o", "out.bag", "--storage", "mcap"),
        ("-o", "out.bag", "--compression", "zstd"),
        ("-o", "out.bag", "--profile", "ros1"),
        ("-o", "out.mcap", "--compression", "bz2"),
        ("-o", "out", "--storage", "sqlite3", "--compression", "lz4"),
        (
            "-o",
            "out.db3",
        ),
        (
            "-o",
            "absent/out.bag",
        ),
        ("-o", "out", "--metadata-version", "7"),
        ("-o", "out.bag", "--only-scans", "--keep", "/tf"),
        ("-o", "out.bag", "--deskew"),
        ("-o", "out.bag", "--jobs", "-1"),
        ("-o", "out.bag", "--nonsense"),
    ],
    ids=" ".join,
)
def test_wrong_usage(options: tuple[str, ...], bag: Path, tmp_path: Path) -> None:
    done = run("convert", bag, *options, cwd=tmp_path)
    assert done.status == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert left(tmp_path) == {"drive.bag"}


# --- Messages that cannot be converted ---


def damaged(make: Callable[[int, int], bytes]) -> Recording:
    """The common content, the second cloud replaced."""
    bad = item(POINTS, CONTENT.of("/points")[1].log_time_ns, make, seq=1)
    second = CONTENT.of("/points")[1]
    items: list[Item] = [bad if entry is second else entry for entry in CONTENT.items]
    return Recording(CONTENT.streams, tuple(items))


STAMP = T0 + STEP
DAMAGES: dict[str, tuple[Recording, tuple[str, ...]]] = {
    "a field is missing": (
        damaged(lambda g, s: cloud(points_of(1), g, seq=s, stamp_ns=STAMP, names=("x", "y", "intensity"))),
        ("z", "intensity"),
    ),
    "its data is short": (
        damaged(lambda g, s: cloud(points_of(1), g, seq=s, stamp_ns=STAMP, cut=100)),
        ("620", "720"),
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_message_that_cannot_be_converted_is_skipped_and_told(damage: str, kind: str, tmp_path: Path) -> None:
    content, words = DAMAGES[damage]
    source = (
        write_rosbag1(tmp_path / "drive.bag", content)
        if kind == "bag"
        else write_mcap(tmp_path / "drive.mcap", content)
    )
    report = tmp_path / "report.json"
    done = convert(source, "-o", tmp_path / "out.bag", "--report", report)
    assert done.status == 3, done.stderr
    stamp = f"{STAMP // SECOND}.{STAMP % SECOND:09d}"
    line = next(line for line in done.stderr.splitlines() if line.startswith("skipped: "))
    assert all(word in line for word in ("/points", stamp, *words)), line
    found = json.loads(report.read_text())
    assert found["exit_status"] == 3
    assert found["skipped_count"] == 1
    (entry,) = found["skipped"]
    assert (entry["topic"], entry["stamp_ns"], entry["log_time_ns"]) == ("/points", STAMP, STAMP + 5_000_003)
    assert all(word in entry["reason"] for word in words)
    points = next(topic for topic in found["topics"] if topic["topic"] == "/points")
    assert (points["messages_in"], points["messages_out"], points["skipped"]) == (3, 2, 1)
    assert len(opened(tmp_path / "out.bag").of("/scan")) == 2


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "out"])
def test_on_error_fail_leaves_nothing(damage: str, name: str, tmp_path: Path) -> None:
    content, words = DAMAGES[damage]
    source = write_rosbag1(tmp_path / "drive.bag", content)
    done = convert(source, "-o", tmp_path / name, "--on-error", "fail", "--report", tmp_path / "report.json")
    assert done.status == 1
    stamp = f"{STAMP // SECOND}.{STAMP % SECOND:09d}"
    assert all(word in done.stderr for word in ("/points", stamp, *words)), done.stderr
    assert left(tmp_path) == {"drive.bag", "report.json"}


def test_scans_that_cannot_be_converted_back(tmp_path: Path) -> None:
    stream = Stream("/base_scan", "sensor_msgs/msg/LaserScan")
    good = [
        item(stream, T0 + step, lambda g, s: scan(np.full(31, 2.0, np.float32), g, seq=s), step) for step in range(2)
    ]
    whole = good[0].data[1]
    short = Item(stream, T0 + 5, {1: whole[:-40], 2: whole})
    source = write_rosbag1(tmp_path / "drive.bag", Recording((stream,), (*good, short)))
    done = run("convert", source, "-o", tmp_path / "out.bag", "--reverse")
    assert done.status == 3, done.stderr
    assert "/base_scan" in done.stderr
    assert len(opened(tmp_path / "out.bag").of("/cloud")) == 2


def test_more_skipped_messages_than_are_listed(tmp_path: Path) -> None:
    items = [
        item(POINTS, T0 + step, lambda g, s: cloud(points_of(0, 5), g, seq=s, names=("x", "y", "i")), step)
        for step in range(150)
    ]
    items.append(item(POINTS, T0 + 150, lambda g, s: cloud(points_of(0, 5), g, seq=s), 150))
    source = write_rosbag1(tmp_path / "drive.bag", Recording((POINTS,), tuple(items)))
    report = tmp_path / "report.json"
    done = convert(source, "-o", tmp_path / "out.bag", "--report", report)
    assert done.status == 3
    found = json.loads(report.read_text())
    assert (found["skipped_count"], len(found["skipped"])) == (150, 100)
    # They are alike: one line has what is listed, another the number of further ones.
    assert "99 more" in done.stderr
    assert "50 more" in done.stderr


# --- What the command prints ---


def test_a_pipe_gets_no_progress_and_no_escapes(bag: Path, tmp_path: Path) -> None:
    done = convert(bag, "-o", tmp_path / "out.bag")
    for text in (done.stdout, done.stderr):
        assert "\x1b" not in text
        assert "\r" not in text
        assert "━" not in text
    assert "%" not in done.stderr.replace("% of", "")
    lines = [line.split() for line in done.stdout.splitlines()]
    assert ["/points", "/scan", "3", "3", "-", "converted"] in lines
    assert next(line for line in lines if line[:1] == ["/scan"])[1] == "180"


def test_quiet_prints_nothing(bag: Path, tmp_path: Path) -> None:
    done = convert(bag, "-o", tmp_path / "out.bag", "--quiet")
    assert (done.status, done.stdout, done.stderr) == (0, "", "")


def test_quiet_still_warns(bag: Path, tmp_path: Path) -> None:
    done = run("convert", bag, "-o", tmp_path / "out.bag", "--quiet")
    assert (done.status, done.stdout) == (0, "")
    assert "min_height" in done.stderr
    assert "--min-height" in done.stderr


def test_scans_without_returns_name_the_parameter(bag: Path, tmp_path: Path) -> None:
    for options, blamed in (
        (("--min-height", "50"), "min_height"),
        (("--range-min", "500", "--min-height", "-9"), "range_min"),
        (("--angle-min", "3.0", "--angle-max", "3.0001", "--min-height", "-9"), "angle_min"),
    ):
        done = run("convert", bag, "-o", tmp_path / "out.bag", "--overwrite", *options)
        assert done.status == 4, done.stderr
        assert "have no return" in done.stderr
        assert blamed in done.stderr


def test_verbose_tells_where_parameters_come_from(bag: Path, tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("/**:\n  ros__parameters:\n    range_max: 25.0\n    scan_time: 0.5\n    range_min: 0.5\n")
    settings = ("--param", "scan_time:=0.25", "--param", "range_min:=0.3", "--range-min", "0.2")
    done = convert(bag, "-o", tmp_path / "out.bag", "-v", "--params-file", file, *settings)
    assert done.status == 0, done.stderr
    values = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines() if line.strip()}
    assert values["range_max"][0] == "25.0"
    assert values["scan_time"][0] == "0.25"
    assert values["range_min"][0] == "0.2"
    assert "params.yaml" in " ".join(values["range_max"])
    assert "--param" in " ".join(values["scan_time"])
    assert "--range-min" in " ".join(values["range_min"])
    scans = opened(tmp_path / "out.bag").scans()
    assert all((s.range_max, s.scan_time, s.range_min) == (25.0, 0.25, np.float32(0.2)) for s in scans)


def test_report(bag: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    done = convert(bag, "-o", tmp_path / "out.bag", "--report", report)
    assert done.status == 0, done.stderr
    found: dict[str, Any] = json.loads(report.read_text())
    assert found["exit_status"] == 0
    assert found["sources"] == [str(bag)]
    assert found["destination"] == str(tmp_path / "out.bag")
    assert found["bytes_read"] == bag.stat().st_size
    assert found["bytes_written"] == (tmp_path / "out.bag").stat().st_size
    assert found["params"]["min_height"] == -2.0
    assert found["param_origins"]["min_height"] == "--min-height"
    topics = {entry["topic"]: entry for entry in found["topics"]}
    assert topics.keys() == EVERYTHING - {"/scan"} | {"/points"}
    assert {entry["action"] for topic, entry in topics.items() if topic != "/points"} == {"passed"}
    points = topics["/points"]["points"]
    assert points["total"] == 180
    assert points["nan"] == 3
    assert points["total"] == sum(count for name, count in points.items() if name != "total")
    assert topics["/chatter"]["messages_in"] == topics["/chatter"]["messages_out"] == len(CONTENT.of(CHATTER.topic))


def test_a_report_that_cannot_be_written_fails_before_anything_is(bag: Path, tmp_path: Path) -> None:
    # Status 1 means that nothing was written.
    done = convert(bag, "-o", tmp_path / "out.bag", "--report", tmp_path / "absent" / "report.json")
    assert done.status == 2
    assert "report" in done.stderr
    assert left(tmp_path) == {"drive.bag"}


# --- Threads ---


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "out", "sqlite3"])
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
        done = convert(source, "-o", destination, "--jobs", jobs, "--queue-size", "3", *storage)
        assert done.status == 0, done.stderr
        files = sorted(destination.iterdir()) if destination.is_dir() else [destination]
        contents.append([(file.name, file.read_bytes()) for file in files])
    assert contents[0] == contents[1] == contents[2]


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ""])
def test_a_cloud_becomes_every_scan_that_is_asked_for(bag: Path, suffix: str, tmp_path: Path) -> None:
    """The first of two was dropped without a word."""
    target = tmp_path / f"out{suffix}"
    done = convert(
        bag, "-o", target, "--topic", "/points:=/a", "--topic", "/points:=/b", "--report", tmp_path / "r.json"
    )
    assert done.status == 0, done.stderr
    scans = {topic: [m for m in opened(target).messages if m.topic == topic] for topic in ("/a", "/b")}
    assert scans["/a"]
    assert [(m.log_time_ns, m.data) for m in scans["/a"]] == [(m.log_time_ns, m.data) for m in scans["/b"]]
    report = json.loads((tmp_path / "r.json").read_text("utf-8"))
    entries = [entry for entry in report["topics"] if entry["topic"] == "/points"]
    assert [(entry["target"], entry["messages_out"]) for entry in entries] == [(t, len(scans[t])) for t in ("/a", "/b")]
    # What was read once counts once.
    assert report["messages_read"] == report["messages_declared"]
