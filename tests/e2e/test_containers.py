"""Every kind of source to every kind of destination, reopened by independent readers."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from mcap.reader import make_reader

import pc2scan
from support import ROOT
from support.builders import (
    BATTERY,
    CHARGE,
    CHATTER,
    CLOUD,
    CONTENT,
    IDL,
    INERTIA,
    ODOMETRY,
    SOURCES,
    Mcap,
    Stream,
    definition,
    deserialized,
    points_of,
    ros_version_of,
    serialized,
    typestore,
    write_mcap,
)
from support.command import run
from support.npm import needs_npm, node
from support.outputs import opened, physical_order

if TYPE_CHECKING:
    from support.outputs import Output

PARAMS = pc2scan.ProjectionParams(min_height=-2.0, max_height=2.0)
PASSING = (ODOMETRY, CHATTER, INERTIA, CHARGE)


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of destination: its name's ending, options, and what `pc2scan.convert` takes for them."""

    name: str
    ros_version: int
    options: dict[str, Any]

    def arguments(self) -> list[str]:
        return [part for key, value in self.options.items() for part in (f"--{key.replace('_', '-')}", str(value))]


KINDS = {
    **{f"bag-{c}": Kind("out.bag", 1, {"compression": c}) for c in ("none", "lz4", "bz2")},
    **{
        f"mcap-{profile}-{c}": Kind("out.mcap", int(profile[-1]), {"compression": c, "profile": profile})
        for profile in ("ros1", "ros2")
        for c in ("none", "lz4", "zstd")
    },
    **{f"rosbag2-mcap-v{v}": Kind("out", 2, {"metadata_version": v}) for v in (8, 9)},
    **{f"rosbag2-mcap-{c}": Kind("out", 2, {"storage": "mcap", "compression": c}) for c in ("none", "lz4")},
    **{f"rosbag2-sqlite3-{c}": Kind("out", 2, {"storage": "sqlite3", "compression": c}) for c in ("none", "zstd")},
    "rosbag2-sqlite3-v9": Kind("out", 2, {"storage": "sqlite3", "metadata_version": 9}),
}

#: Storages of before ROS 2 Iron: they hold no definitions, and the custom type's is in no message set.
WITHOUT_DEFINITIONS = {"rosbag2-sqlite3-v2", "rosbag2-sqlite3-v4", "rosbag2-sqlite3-v5"}


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {name: build(tmp_path_factory.mktemp(name), CONTENT) for name, build in SOURCES.items()}


@cache
def expected_ranges() -> list[bytes]:
    return [pc2scan.project(points_of(step), PARAMS).ranges.tobytes() for step in range(3)]


def scans_of(output: Output) -> list[tuple[int, int, str, bytes]]:
    return [
        (
            found.log_time_ns,
            scan.header.stamp.sec * 1_000_000_000 + scan.header.stamp.nanosec,
            scan.header.frame_id,
            scan.ranges.tobytes(),
        )
        for found, scan in zip(output.of("/scan"), output.scans(), strict=True)
    ]


def expected_scans() -> list[tuple[int, int, str, bytes]]:
    return [
        (item.log_time_ns, item.log_time_ns - 5_000_003, "lidar", ranges)
        for item, ranges in zip(CONTENT.of("/points"), expected_ranges(), strict=True)
    ]


def canonical(data: bytes, msgtype: str, ros_version: int) -> bytes:
    """The payload as rosbags would serialise it: padding bytes are anyone's choice."""
    return serialized(typestore(ros_version), deserialized(data, msgtype, ros_version), msgtype, ros_version)


def check_passing(stream: Stream, output: Output, source: int) -> None:
    """A topic that passed through: times, order and payloads, to the byte within one ROS version."""
    items = CONTENT.of(stream.topic)
    found = output.of(stream.topic)
    assert [message.log_time_ns for message in found] == [item.log_time_ns for item in items]
    target = output.ros_version
    expected = [item.expected(source, target) for item in items]
    data = [message.data for message in found]
    if source != target:
        data = [canonical(payload, stream.msgtype, target) for payload in data]
    assert data == expected


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SOURCES)
def test_from_any_container_to_any_container(name: str, kind: str, sources: dict[str, Path], tmp_path: Path) -> None:
    source, target = ros_version_of(name), KINDS[kind].ros_version
    destination = tmp_path / KINDS[kind].name
    report = pc2scan.convert(sources[name], destination, params=PARAMS, jobs=1, **KINDS[kind].options)
    lost = name in WITHOUT_DEFINITIONS and target == 1
    assert report.exit_status == (3 if lost else 0)
    assert [entry.topic for entry in report.topics if entry.lost] == (["/battery"] if lost else [])
    output = opened(destination)
    assert output.ros_version == target
    assert scans_of(output) == expected_scans()
    passing = [stream for stream in PASSING if not (lost and stream is CHARGE)]
    assert output.topics() == {"/scan", "/tf_static", *(stream.topic for stream in passing)}
    for stream in passing:
        check_passing(stream, output, source)
    static = CONTENT.of("/tf_static")
    found = output.of("/tf_static")
    assert [message.log_time_ns for message in found] == [item.log_time_ns for item in static]
    payloads = [canonical(message.data, static[0].stream.msgtype, target) for message in found]
    assert payloads == [item.expected(source, target) for item in static]
    check_publishers(name, source, output)


def check_publishers(name: str, source: int, output: Output) -> None:
    """Types, latching, and definitions: verbatim within one ROS version."""
    latched = {publisher.topic for publisher in output.publishers if publisher.latched}
    # Before metadata version 4 recordings do not tell.
    assert latched == (set() if name == "rosbag2-sqlite3-v2" else {"/tf_static"})
    for publisher in output.publishers:
        stream = next((s for s in CONTENT.streams if s.topic == publisher.topic), None)
        if stream is None or name in WITHOUT_DEFINITIONS:
            continue
        if source != output.ros_version:
            assert publisher.msgtype == stream.msgtype
            continue
        assert publisher.msgtype == stream.type_in(source)
        if name == "mcap-ros2idl" and stream.msgtype in IDL:
            assert (publisher.encoding, publisher.definition) == ("ros2idl", IDL[stream.msgtype])
        else:
            assert publisher.encoding == f"ros{source}msg"
            assert publisher.definition == definition(stream.type_in(source), source)


@pytest.mark.parametrize("name", ["bag-lz4", "mcap-zstd", "mcap-ros2idl", "rosbag2-sqlite3-v5", "mcap-ros1"])
@pytest.mark.parametrize("kind", ["bag-lz4", "mcap-ros2-zstd", "rosbag2-sqlite3-none"])
def test_the_command_does_the_same(name: str, kind: str, sources: dict[str, Path], tmp_path: Path) -> None:
    chosen = KINDS[kind]
    by_command, by_library = tmp_path / "command" / chosen.name, tmp_path / "library" / chosen.name
    by_command.parent.mkdir()
    by_library.parent.mkdir()
    heights = ("--min-height", "-2", "--max-height", "2")
    done = run("convert", sources[name], "-o", by_command, *heights, *chosen.arguments())
    report = pc2scan.convert(sources[name], by_library, params=PARAMS, **chosen.options)
    assert done.status == report.exit_status
    assert opened(by_command) == opened(by_library)


@pytest.mark.parametrize("kind", ["bag-lz4", "mcap-ros2-none", "rosbag2-sqlite3-none"])
@pytest.mark.parametrize("name", ["bag-lz4", "mcap-zstd", "mcap-ros2idl", "rosbag2-mcap-v8"])
def test_kept_clouds_carry_their_points(name: str, kind: str, sources: dict[str, Path], tmp_path: Path) -> None:
    source, chosen = ros_version_of(name), KINDS[kind]
    destination = tmp_path / chosen.name
    report = pc2scan.convert(sources[name], destination, params=PARAMS, keep_clouds=True, **chosen.options)
    assert report.exit_status == 0
    output = opened(destination)
    items = CONTENT.of("/points")
    found = output.of("/points")
    assert [message.log_time_ns for message in found] == [item.log_time_ns for item in items]
    data = [message.data for message in found]
    if source != output.ros_version:
        data = [canonical(payload, CLOUD, output.ros_version) for payload in data]
    assert data == [item.expected(source, output.ros_version) for item in items]


@pytest.mark.parametrize(
    ("name", "kind"),
    [("bag-lz4", "bag-bz2"), ("bag-none", "mcap-ros1-lz4"), ("mcap-ros1", "bag-lz4"), ("mcap-zstd", "mcap-ros2-lz4")],
)
def test_two_latched_publishers_stay_two(name: str, kind: str, sources: dict[str, Path], tmp_path: Path) -> None:
    destination = tmp_path / KINDS[kind].name
    pc2scan.convert(sources[name], destination, params=PARAMS, **KINDS[kind].options)
    static = [publisher for publisher in opened(destination).publishers if publisher.topic == "/tf_static"]
    assert sorted(publisher.callerid for publisher in static) == ["/body", "/mount"]
    assert all(publisher.latched for publisher in static)


@pytest.mark.parametrize("name", SOURCES)
def test_messages_of_one_log_time_keep_their_order(name: str, sources: dict[str, Path], tmp_path: Path) -> None:
    destination = tmp_path / "out.mcap"
    pc2scan.convert(sources[name], destination, params=PARAMS, jobs=3)
    renamed = {"/points": "/scan"}
    expected = [(renamed.get(i.stream.topic, i.stream.topic), i.log_time_ns) for i in CONTENT.items]
    assert physical_order(destination) == expected


ATTACHMENTS = [("map.pgm", "image/x-portable-graymap", 5, 7, bytes(range(256))), ("notes.txt", "text/plain", 9, 0, b"")]
METADATA = [("calibration", {"lidar": "2023-11-14", "by": "hand"}), ("empty", {})]


@pytest.mark.parametrize("chunked", [True, False])
def test_mcap_to_mcap_keeps_everything(tmp_path: Path, chunked: bool) -> None:
    form = Mcap(chunked=chunked, attachments=ATTACHMENTS, metadata=METADATA)
    source = write_mcap(tmp_path / "drive.mcap", CONTENT, form)
    destination = tmp_path / "out.mcap"
    done = run("convert", source, "-o", destination, "--keep-clouds")
    assert done.status == 0, done.stderr
    before, after = opened(source), opened(destination)
    # Publish times and sequence numbers are part of what is compared.
    assert [found for found in after.messages if found.topic != "/scan"] == before.messages
    scans = [(found.log_time_ns, found.publish_time_ns, found.sequence) for found in after.of("/scan")]
    assert scans == [(found.log_time_ns, found.publish_time_ns, found.sequence) for found in before.of("/points")]
    assert [publisher for publisher in after.publishers if publisher.topic != "/scan"] == before.publishers
    assert [entry for entry in physical_order(destination) if entry[0] != "/scan"] == physical_order(source)
    with source.open("rb") as old, destination.open("rb") as new:
        readers = make_reader(old), make_reader(new)
        kept = [sorted(map(repr, reader.iter_attachments())) for reader in readers]
        records = [sorted(map(repr, reader.iter_metadata())) for reader in readers]
        channels = [
            sorted((c.topic, sorted(c.metadata.items())) for c in summary.channels.values() if c.topic != "/scan")
            for reader in readers
            if (summary := reader.get_summary()) is not None
        ]
    assert len(kept[0]) == 2
    assert kept[0] == kept[1]
    assert len(records[0]) == 2
    assert records[0] == records[1]
    assert channels[0] == channels[1]


def test_what_has_no_place_for_attachments_says_so(tmp_path: Path) -> None:
    form = Mcap(attachments=ATTACHMENTS, metadata=METADATA)
    source = write_mcap(tmp_path / "drive.mcap", CONTENT, form)
    done = run("convert", source, "-o", tmp_path / "out.bag")
    assert done.status == 0, done.stderr
    assert "4 MCAP attachments and metadata records are not copied" in done.stderr


def test_a_type_without_definition_is_named_never_lost_in_silence(sources: dict[str, Path], tmp_path: Path) -> None:
    report_path = tmp_path / "report.json"
    done = run("convert", sources["rosbag2-sqlite3-v5"], "-o", tmp_path / "out.bag", "--report", report_path)
    assert done.status == 3, done.stderr
    entry = next(e for e in json.loads(report_path.read_text())["topics"] if e["topic"] == "/battery")
    assert entry["lost"]
    assert "custom_msgs" in entry["note"]
    assert "/battery" in done.stdout


def test_the_format_is_told_from_the_content(sources: dict[str, Path], tmp_path: Path) -> None:
    for name, misleading in (("bag-lz4", "drive.mcap"), ("mcap-zstd", "drive.bag"), ("db3", "drive.txt")):
        folder = tmp_path / name
        folder.mkdir()
        disguised = Path(shutil.copy(sources[name], folder / misleading))
        done = run("convert", disguised, "-o", folder / "out.mcap", "--min-height", "-2", "--max-height", "2")
        assert done.status == 0, done.stderr
        assert scans_of(opened(folder / "out.mcap")) == expected_scans()


# --- ROS 1's own reader ---

ROS1_PYTHON = Path("/usr/bin/python3")
ROSBAG = Path("/usr/bin/rosbag")
ROS1_READER = ROOT / "tests" / "support" / "rosbag1_reader.py"


def ros1(*command: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a program of the system's Python, away from this one's environment."""
    hidden = {"VIRTUAL_ENV", "PYTHONPATH", "PYTHONHOME"}
    env = {key: value for key, value in os.environ.items() if key not in hidden}
    return subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, timeout=120, env=env, check=False
    )


@cache
def has_rosbag() -> bool:
    return ROSBAG.exists() and ROS1_PYTHON.exists() and ros1(ROS1_PYTHON, "-c", "import rosbag").returncode == 0


needs_rosbag = pytest.mark.skipif(not has_rosbag(), reason="needs Debian's python3-rosbag, for /usr/bin/python3")


@needs_rosbag
@pytest.mark.parametrize("compression", ["none", "lz4", "bz2"])
@pytest.mark.parametrize("name", ["bag-bz2", "mcap-zstd", "rosbag2-sqlite3-v8"])
def test_ros1_itself_reads_every_message(name: str, compression: str, sources: dict[str, Path], tmp_path: Path) -> None:
    destination = tmp_path / "out.bag"
    pc2scan.convert(sources[name], destination, params=PARAMS, compression=compression)
    done = ros1(ROS1_PYTHON, ROS1_READER, "read", destination)
    assert done.returncode == 0, done.stderr
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    mine = [(found.topic, found.log_time_ns) for found in opened(destination).messages]
    assert Counter((row[0], row[1]) for row in rows) == Counter(mine)
    assert len(rows) == len(CONTENT.items)
    assert {row[4].get("latching") for row in rows if row[0] == "/tf_static"} == {"1"}
    info = ros1(ROSBAG, "info", "--yaml", destination)
    assert info.returncode == 0, info.stderr
    assert f"messages: {len(CONTENT.items)}" in info.stdout


@needs_rosbag
@pytest.mark.parametrize("name", ["hall.bag", "hall.mcap", "hall"])
def test_rosbag_check_has_nothing_to_migrate(name: str, tmp_path: Path) -> None:
    destination = tmp_path / "out.bag"
    done = run("convert", ROOT / "fixtures" / name, "-o", destination, "--min-height", "-0.3", "--keep-clouds")
    assert done.status == 0, done.stderr
    checked = ros1(ROSBAG, "check", destination)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert "needs migrat" not in checked.stdout.lower()


# --- The readers that web tools use ---


def digests(output: Output) -> Counter[tuple[str, int, str]]:
    return Counter(
        (found.topic, found.log_time_ns, hashlib.sha256(found.data).hexdigest()) for found in output.messages
    )


@needs_npm("@mcap/core", "@mcap/support")
@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
@pytest.mark.parametrize("name", ["mcap-unchunked", "bag-lz4", "rosbag2-sqlite3-split"])
def test_the_npm_reader_of_mcap_agrees(name: str, compression: str, sources: dict[str, Path], tmp_path: Path) -> None:
    destination = tmp_path / "out.mcap"
    pc2scan.convert(sources[name], destination, params=PARAMS, compression=compression)
    read = node(ROOT / "tests" / "bags" / "mcap_reader.mjs", destination)
    topics = {channel[0]: channel[2] for channel in read["indexed"]["channels"]}
    for messages in (read["indexed"]["messages"], read["streamed"]["messages"]):
        found = Counter((topics[channel], int(log_time), sha) for channel, _, log_time, _, sha in messages)
        assert found == digests(opened(destination))
    assert read["streamed"]["done"]


@needs_npm("@foxglove/rosbag", "@foxglove/wasm-lz4", "@foxglove/wasm-bz2")
@pytest.mark.parametrize("compression", ["none", "lz4", "bz2"])
@pytest.mark.parametrize("name", ["bag-none", "mcap-zstd"])
def test_the_npm_reader_of_rosbags_agrees(
    name: str, compression: str, sources: dict[str, Path], tmp_path: Path
) -> None:
    destination = tmp_path / "out.bag"
    pc2scan.convert(sources[name], destination, params=PARAMS, compression=compression)
    read = node(Path(__file__).with_name("rosbag_reader.mjs"), destination)
    output = opened(destination)
    assert Counter((topic, int(time), sha) for topic, time, sha in read["messages"]) == digests(output)
    types = {connection["topic"]: connection["type"] for connection in read["connections"]}
    assert types["/scan"] == "sensor_msgs/LaserScan"
    assert types["/battery"] == BATTERY.replace("/msg/", "/")
