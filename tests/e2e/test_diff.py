"""``pc2scan diff``: nothing between forms of one content, everything between contents."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from typer.testing import CliRunner

import pc2scan
from pc2scan.cli.app import application
from support import RECORDINGS, ROOT, needs_shared
from support.builders import (
    BATTERY,
    CHATTER,
    CONTENT,
    ODOMETRY,
    POINTS,
    SCAN,
    SECOND,
    SOURCES,
    T0,
    Item,
    Mcap,
    Recording,
    Stream,
    cloud,
    item,
    points_of,
    scan,
    string,
    write_mcap,
    write_rosbag1,
)
from support.command import Finished, run

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

SCANS = Stream("/scan", SCAN, "/scanner")
BEAMS = 181
Ranges = np.ndarray[Any, np.dtype[np.float32]]


def ranges(step: int) -> Ranges:
    values = np.random.default_rng(step).uniform(0.5, 29, BEAMS).astype(np.float32)
    values[::7] = np.inf
    return values


def scan_item(values: Ranges, log_time_ns: int = T0, *, stream: Stream = SCANS, **header: Any) -> Item:
    return item(stream, log_time_ns, lambda ros_version, _: scan(values, ros_version, **header))


def stamp_of(step: int) -> int:
    return T0 - 77 + step * SECOND // 10


def recording(values: Sequence[Ranges], stamps: Sequence[int] | None = None, stream: Stream = SCANS) -> Recording:
    """Scans a tenth of a second apart; ``stamps`` says whose header each has."""
    items = [
        scan_item(v, T0 + step * SECOND // 10, stream=stream, seq=step, stamp_ns=stamp_of(stamp))
        for step, (v, stamp) in enumerate(zip(values, stamps or range(len(values)), strict=True))
    ]
    return Recording((stream,), tuple(items))


TEN = [ranges(step) for step in range(10)]


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mcap(tmp_path_factory.mktemp("reference") / "a.mcap", recording(TEN))


def run_here(*arguments: str | Path) -> Finished:
    """The command in this process: most of what a process of its own takes is its start."""
    done = CliRunner().invoke(application(), [str(argument) for argument in arguments])
    return Finished(done.exit_code, done.stdout, done.stderr)


def compared(a: Path, b: Path, *options: str) -> tuple[int, dict[str, Any]]:
    done = run_here("diff", a, b, "--json", *options)
    assert done.stderr == ""
    found = json.loads(done.stdout)
    assert found["exit_status"] == done.status
    return done.status, found


def only_topic(found: dict[str, Any]) -> dict[str, Any]:
    (topic,) = found["topics"]
    assert isinstance(topic, dict)
    return topic


# --- nothing ---


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {name: build(tmp_path_factory.mktemp(name), CONTENT) for name, build in SOURCES.items()}


@pytest.mark.parametrize(
    ("name", "against"),
    [
        *((name, "bag-lz4") for name in SOURCES),
        *((name, "mcap-zstd") for name in ("mcap-none", "mcap-ros1", "mcap-ros2idl", "rosbag2-sqlite3-split")),
    ],
)
def test_the_form_makes_no_difference(name: str, against: str, sources: dict[str, Path]) -> None:
    found = pc2scan.diff(sources[against], sources[name], all_topics=True)
    # Storages of before ROS 2 Iron do not define the custom type: between ROS versions its bytes cannot be compared.
    unknown = name in {f"rosbag2-sqlite3-v{version}" for version in (2, 4, 5)} and against == "bag-lz4"
    assert [topic.name for topic in found.topics if not topic.same] == (["/battery"] if unknown else []), str(found)
    assert {topic.name for topic in found.topics} == {stream.topic for stream in CONTENT.streams}
    assert sum(topic.matched for topic in found.topics) == len(CONTENT.items)
    if unknown:
        assert "not decoded" in str(found)


@pytest.mark.parametrize("ros_versions", [(1, 1), (1, 2), (2, 2)])
def test_scans_are_the_same_in_every_form(ros_versions: tuple[int, int], tmp_path: Path) -> None:
    paths = []
    for side, ros_version in enumerate(ros_versions):
        path = tmp_path / f"{side}.mcap"
        form = Mcap(ros_version=ros_version, profile=f"ros{ros_version}", compression=("lz4", "none")[side])
        paths.append(write_mcap(path, recording(TEN), form))
    status, found = compared(paths[0], paths[1])
    assert status == 0
    assert only_topic(found)["elements"] == 10 * BEAMS


# --- everything ---


def test_a_single_bit(reference: Path, tmp_path: Path) -> None:
    values = [v.copy() for v in TEN]
    values[4].view(np.uint32)[90] ^= 1
    other = write_mcap(tmp_path / "b.mcap", recording(values))
    status, found = compared(reference, other)
    assert status == 1
    topic = only_topic(found)
    (only,) = topic["values"]
    assert (only["name"], only["messages"], only["changed"], only["shifted"]) == ("ranges", 1, 1, 0)
    assert only["worst"]["index"] == 90
    assert only["worst"]["stamp_ns"] == stamp_of(4)
    assert only["worst"]["angle"] == pytest.approx(0.0, abs=1e-6)
    assert topic["differing"] == 1
    text = run("diff", reference, other).stdout
    assert "1 beam of 1,810" in text
    assert "beam 90 (0.00 deg)" in text
    assert "different: 1 of 1 topic" in text
    assert compared(reference, other, "--rtol", "1e-6")[0] == 0


def test_a_shifted_beam_is_told_from_a_changed_one(reference: Path, tmp_path: Path) -> None:
    values = [v.copy() for v in TEN]
    values[2][70], values[2][69] = values[2][69], np.inf  # beam 70 had no return and takes its neighbour's
    values[3][50] += 1
    assert np.isinf(TEN[2][70])
    status, found = compared(reference, write_mcap(tmp_path / "b.mcap", recording(values)))
    (only,) = only_topic(found)["values"]
    assert status == 1
    assert (only["changed"], only["shifted"], only["whole_shifts"]) == (1, 2, 0)


def test_a_whole_scan_one_beam_over(reference: Path, tmp_path: Path) -> None:
    values = [np.roll(v, 1) if step == 6 else v for step, v in enumerate(TEN)]
    other = write_mcap(tmp_path / "b.mcap", recording(values))
    (only,) = only_topic(compared(reference, other)[1])["values"]
    assert only["whole_shifts"] == 1
    assert "1 whole scan shifted by one beam" in run_here("diff", reference, other).stdout


@pytest.mark.parametrize("dropped", [0, 5, 9])
def test_a_dropped_message(dropped: int, reference: Path, tmp_path: Path) -> None:
    kept = recording(TEN)
    kept = Recording(kept.streams, (*kept.items[:dropped], *kept.items[dropped + 1 :]))
    other = write_mcap(tmp_path / "b.mcap", kept)
    for a, b, side in ((reference, other, "missing"), (other, reference, "extra")):
        status, found = compared(a, b)
        topic = only_topic(found)
        assert status == 1
        assert topic["matched"] == 9
        assert topic["differing"] == 0
        assert topic[side]["count"] == 1
        assert topic[side]["first"][0]["stamp_ns"] == stamp_of(dropped)


def test_a_swapped_pair(reference: Path, tmp_path: Path) -> None:
    order = [0, 1, 2, 4, 3, 5, 6, 7, 8, 9]
    other = write_mcap(tmp_path / "b.mcap", recording([TEN[k] for k in order], order))
    status, found = compared(reference, other)
    topic = only_topic(found)
    assert status == 1
    assert topic["moved"]["count"] == 1
    assert [change["name"] for change in topic["changes"]] == ["log_time"]
    assert topic["values"] == []
    assert compared(reference, other, "--ignore", "order", "--ignore", "log_time")[0] == 0
    # Only the contents change places: both scans differ.
    other = write_mcap(tmp_path / "c.mcap", recording([TEN[k] for k in order]))
    topic = only_topic(compared(reference, other)[1])
    assert (topic["moved"]["count"], topic["differing"]) == (0, 2)


def test_the_allowed_share_is_of_all_beams(reference: Path, tmp_path: Path) -> None:
    values = [v.copy() for v in TEN]
    values[1][1:3] += 1
    values[7][1] += 5
    other = write_mcap(tmp_path / "b.mcap", recording(values))
    assert compared(reference, other, "--allow-beams", str(2.9 / 1810))[0] == 1
    status, found = compared(reference, other, "--allow-beams", str(3 / 1810))
    assert status == 0
    assert only_topic(found)["values"][0]["allowed"]
    # The worst scan has the most beams that differ, the worst beam differs most.
    assert only_topic(found)["worst"]["stamp_ns"] == stamp_of(1)
    assert only_topic(found)["values"][0]["worst"]["index"] == 1
    assert "within the allowed" in run_here("diff", reference, other, "--allow-beams", "0.01").stdout


def test_a_recording_with_an_unset_clock(tmp_path: Path) -> None:
    items = tuple(scan_item(v, T0 + step, stamp_ns=0) for step, v in enumerate(TEN))
    one = write_mcap(tmp_path / "a.mcap", Recording((SCANS,), items))
    other = write_mcap(tmp_path / "b.mcap", Recording((SCANS,), (*items[:2], *items[3:])))
    topic = only_topic(compared(one, other)[1])
    assert (topic["missing"]["count"], topic["matched"], topic["differing"]) == (1, 9, 0)


def test_two_topics_of_one_recording(tmp_path: Path) -> None:
    second = Stream("/scan2", SCAN)
    items = recording([TEN[0], TEN[1] + np.float32(0.25), TEN[2]], stream=second).items
    path = write_mcap(tmp_path / "a.mcap", Recording((SCANS, second), (*recording(TEN[:3]).items, *items)))
    done = run_here("diff", path, "--topic", "/scan:=/scan2")
    assert done.status == 1
    assert "/scan and /scan2" in done.stdout
    assert run_here("diff", path, "--topic", "/scan:=/scan2", "--atol", "0.2501").status == 0
    for options in ((), ("--topic", "/scan")):
        done = run_here("diff", path, *options)
        assert done.status == 2
        assert "--topic /scan:=/scan2" in done.stderr


def test_a_topic_under_another_name_is_suspected(reference: Path, tmp_path: Path) -> None:
    renamed = Stream("/front/scan", SCAN)
    path = write_mcap(tmp_path / "b.mcap", recording(TEN, stream=renamed))
    done = run_here("diff", reference, path)
    assert done.status == 1
    assert "hint: the same under another name? --topic /scan:=/front/scan" in done.stdout
    assert run_here("diff", reference, path, "--topic", "/scan:=/front/scan").status == 0


def test_what_a_new_recording_changes_is_pointed_out(reference: Path, tmp_path: Path) -> None:
    items = [scan_item(v, T0 + 5 + step * SECOND // 10, stamp_ns=stamp_of(step)) for step, v in enumerate(TEN)]
    later = Recording((SCANS,), tuple(items))
    other = write_mcap(tmp_path / "b.mcap", later)
    done = run_here("diff", reference, other)
    assert done.status == 1
    assert "--ignore log_time" in done.stdout
    assert compared(reference, other, "--ignore", "log_time")[0] == 0


def changed_content(topic: str, ros_version: int, data: bytes) -> Recording:
    items = list(CONTENT.items)
    place = max(k for k, entry in enumerate(items) if entry.stream.topic == topic)
    items[place] = item(items[place].stream, items[place].log_time_ns, lambda g, _: data if g == ros_version else b"")
    return Recording(CONTENT.streams, tuple(items))


@pytest.mark.parametrize("against", ["bag-none", "mcap-zstd"])
def test_other_topics_by_bytes(against: str, sources: dict[str, Path], tmp_path: Path) -> None:
    other = write_mcap(tmp_path / "b.mcap", changed_content("/chatter", 2, string("hello 3", 2)))
    assert pc2scan.diff(sources[against], other).same
    found = pc2scan.diff(sources[against], other, all_topics=True)
    assert [topic.name for topic in found.topics if not topic.same] == [CHATTER.topic]
    (chatter,) = [topic for topic in found.topics if topic.name == CHATTER.topic]
    assert (chatter.matched, chatter.differing) == (3, 1)
    # By name, without the others.
    assert [topic.name for topic in pc2scan.diff(sources[against], other, topics=["/tf"]).topics] == [ODOMETRY.topic]


def test_named_topics_and_all_others(sources: dict[str, Path]) -> None:
    a, b = sources["bag-lz4"], sources["mcap-zstd"]
    # One topic of A against two of B, and against one of another type.
    found = pc2scan.diff(a, b, topics=["/imu", "/imu:=/battery", "/chatter:=/chatter", "/points"])
    assert [(topic.name, topic.same) for topic in found.topics] == [
        ("/imu", True),
        ("/imu and /battery", False),
        ("/chatter", True),
        ("/points", True),
    ]
    assert list(found.topics[1].changes) == ["type"]
    assert [topic.matched for topic in found.topics] == [3, 0, 3, 3]
    found = pc2scan.diff(a, b, topics=["/points", "/imu"], all_topics=True)
    assert [topic.name for topic in found.topics] == ["/points", "/imu", "/battery", "/chatter", "/tf", "/tf_static"]
    assert found.same


def test_recordings_of_two_drives(reference: Path, tmp_path: Path) -> None:
    items = [scan_item(v, T0 + step, stamp_ns=T0 + step) for step, v in enumerate(TEN)]
    done = run_here("diff", reference, write_mcap(tmp_path / "b.mcap", Recording((SCANS,), tuple(items))))
    assert done.status == 1
    assert "only in A  10 scans: " in done.stdout
    assert " and 7 more" in done.stdout
    assert "hint: no stamp is on both sides" in done.stdout


def test_dropped_messages_of_other_topics(sources: dict[str, Path], tmp_path: Path) -> None:
    items = [
        entry for entry in CONTENT.items if entry.stream.msgtype != BATTERY or entry.log_time_ns < T0 + SECOND // 10
    ]
    other = write_mcap(tmp_path / "b.mcap", Recording(CONTENT.streams, tuple(items)))
    found = pc2scan.diff(sources["mcap-zstd"], other, all_topics=True)
    (battery,) = [topic for topic in found.topics if not topic.same]
    assert (battery.name, battery.missing.count, battery.matched) == ("/battery", 2, 1)


def test_clouds(sources: dict[str, Path], tmp_path: Path) -> None:
    points = points_of(2)
    points[11, 2] += np.float32(0.5)
    data = cloud(points, 2, seq=2, stamp_ns=T0 + 2 * SECOND // 10)
    other = write_mcap(tmp_path / "b.mcap", changed_content(POINTS.topic, 2, data))
    status, found = compared(sources["bag-lz4"], other)
    (only,) = only_topic(found)["values"]
    assert status == 1
    assert (only["name"], only["changed"], only["worst"]["index"]) == ("z", 1, 11)
    assert only["worst"]["difference"] == pytest.approx(0.5, abs=1e-6)


def test_a_topic_of_another_type(reference: Path, tmp_path: Path) -> None:
    stream = Stream("/scan", POINTS.msgtype)
    clouds = Recording((stream,), (item(stream, T0, lambda g, s: cloud(points_of(s), g)),))
    done = run_here("diff", reference, write_mcap(tmp_path / "b.mcap", clouds))
    assert done.status == 1
    assert "sensor_msgs/msg/LaserScan in A, sensor_msgs/msg/PointCloud2 in B" in done.stdout


def test_seq_counts_between_ros1_recordings_only(tmp_path: Path) -> None:
    numbered, plain = (Recording((SCANS,), (scan_item(TEN[0], seq=seq),)) for seq in (9, 0))
    a = write_rosbag1(tmp_path / "a.bag", numbered)
    assert compared(a, write_rosbag1(tmp_path / "b.bag", plain))[0] == 1
    assert compared(a, tmp_path / "b.bag", "--ignore", "seq")[0] == 0
    assert compared(a, write_mcap(tmp_path / "b.mcap", plain))[0] == 0


# --- unusable ---


def test_what_cannot_be_compared_ends_with_2(reference: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(reference.read_bytes()[:300])
    text = Recording((CHATTER,), (item(CHATTER, T0, lambda g, _: string("hello", g)),))
    talk = write_mcap(tmp_path / "talk.mcap", text)
    for arguments, told in (
        ((reference, tmp_path / "nowhere.bag"), "does not exist"),
        ((reference, broken), "broken.mcap"),
        ((talk, talk), "--all-topics"),
        ((reference, reference, "--topic", "/scam"), "/scan"),
        ((reference, reference, "--topic", "/scan:="), "is not a topic"),
        ((reference, reference, "--atol", "x"), "not a tolerance"),
        ((reference, reference, "--rtol", "-1"), "at least 0"),
        ((reference, reference, "--allow-beams", "3"), "from 0 to 1"),
        ((reference, reference, "--ignore", "everything"), "log_time"),
        ((reference, reference, "--nonsense"), "--nonsense"),
        ((), "A"),
    ):
        done = (run if "--rtol" in arguments else run_here)("diff", *arguments)
        assert done.status == 2, (arguments, done)
        assert done.stdout == ""
        assert told in done.stderr
        assert "Traceback" not in done.stderr


def test_quiet_tells_by_the_status_alone(reference: Path, tmp_path: Path) -> None:
    other = write_mcap(tmp_path / "b.mcap", recording(TEN[1:]))
    for path, status in ((reference, 0), (other, 1)):
        done = run_here("diff", reference, path, "--quiet")
        assert (done.status, done.stdout, done.stderr) == (status, "", "")


def test_names_from_a_recording_are_escaped(tmp_path: Path) -> None:
    paths = []
    for side, frame in enumerate(("a\x1b[2J", "b")):
        made = Recording((SCANS,), (scan_item(TEN[0], frame_id=frame),))
        paths.append(write_mcap(tmp_path / f"{side}.mcap", made))
    done = run_here("diff", *paths)
    assert done.status == 1
    assert "\x1b" not in done.stdout


def test_conversions_of_every_kind_are_the_same(tmp_path: Path) -> None:
    outputs = []
    for name, options in (("a.bag", ()), ("b.mcap", ("--jobs", "1")), ("c", ("--storage", "sqlite3"))):
        done = run("convert", ROOT / "fixtures" / "hall.bag", "-o", tmp_path / name, "--min-height", "-0.3", *options)
        assert done.status == 0, done.stderr
        outputs.append(tmp_path / name)
    for other in outputs[1:]:
        assert run_here("diff", outputs[0], other, "--all-topics").status == 0


@needs_shared
def test_a_real_recording_and_its_copy_in_ros2(tmp_path: Path) -> None:
    source, copy = RECORDINGS / "luminar_highway.bag", tmp_path / "b.mcap"
    done = run("convert", source, "-o", copy, "-t", "/luminar_pointcloud", "--keep-clouds", "--profile", "ros2")
    assert done.status == 0, done.stderr
    found = pc2scan.diff(source, copy, all_topics=True)
    assert {topic.name for topic in found.topics if not topic.same} == {"/scan"}
    clouds = next(topic for topic in found.topics if topic.name == "/luminar_pointcloud")
    assert clouds.matched == 5
    assert clouds.elements > 150_000
