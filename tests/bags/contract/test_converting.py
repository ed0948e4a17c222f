"""Recordings converted from every container to every container, and read again by others."""

from __future__ import annotations

import json
from base64 import b64decode
from collections import Counter
from functools import cache
from typing import TYPE_CHECKING, Any

import pytest
from mcap.reader import make_reader

import pc2scan
from support import sampled
from support.builders import (
    CHARGE,
    CHATTER,
    CONTENT,
    INERTIA,
    ODOMETRY,
    POINTS,
    SOURCES,
    TF,
    Mcap,
    definition,
    deserialized,
    points_of,
    ros_version_of,
    serialized,
    typestore,
    write_mcap,
)
from support.command import run
from support.containers import ATTACHMENTS, KINDS, METADATA, read
from support.outputs import opened, physical_order
from support.rosbag1_files import ROSBAG, ros1, ros1_missing, ros1_read

if TYPE_CHECKING:
    from pathlib import Path

    from support.builders import Stream
    from support.containers import Kind
    from support.outputs import Output

PARAMS = pc2scan.ProjectionParams(min_height=-2.0, max_height=2.0)
HEIGHTS = ("--min-height", "-2", "--max-height", "2")

#: Storages of before ROS 2 Iron: they hold no definitions, and the custom type's is in no message set.
WITHOUT_DEFINITIONS = {"rosbag2-sqlite3-v2", "rosbag2-sqlite3-v4", "rosbag2-sqlite3-v5"}

#: Every source with a destination; each destination has several sources.
PAIRS = [(source, list(KINDS)[7 * number % len(KINDS)]) for number, source in enumerate(SOURCES)]


@cache
def expected_ranges() -> list[bytes]:
    return [pc2scan.project(points_of(step), PARAMS).ranges.tobytes() for step in range(3)]


def check_scans(output: Output) -> None:
    clouds = CONTENT.of("/points")
    assert [found.log_time_ns for found in output.of("/scan")] == [item.log_time_ns for item in clouds]
    for scan, item, ranges in zip(output.scans(), clouds, expected_ranges(), strict=True):
        stamp = scan.header.stamp
        assert stamp.sec * 1_000_000_000 + stamp.nanosec == item.log_time_ns - 5_000_003
        assert scan.header.frame_id == "lidar"
        assert scan.ranges.tobytes() == ranges


def check_passing(stream: Stream, output: Output, source: int) -> None:
    """A topic that passed through: times, order and payloads, to the byte within one ROS version."""
    items = CONTENT.of(stream.topic)
    found = output.of(stream.topic)
    target = output.ros_version
    assert [message.log_time_ns for message in found] == [item.log_time_ns for item in items]
    data = [message.data for message in found]
    if source != target or stream.msgtype == TF:
        # As rosbags would serialise it: padding bytes are anyone's choice.
        store = typestore(target)
        data = [serialized(store, deserialized(d, stream.msgtype, target), stream.msgtype, target) for d in data]
    assert data == [item.expected(source, target) for item in items]


def check_publishers(name: str, kind: Kind, output: Output) -> None:
    """Types, latching, and definitions: verbatim within one ROS version."""
    source = ros_version_of(name)
    latched = {publisher.topic for publisher in output.publishers if publisher.latched}
    # Before metadata version 4 recordings do not have profiles; in another ROS version, static transforms are latched.
    unknown = name == "rosbag2-sqlite3-v2" and source == output.ros_version
    assert latched == (set() if unknown else {"/tf_static"})
    streams = {stream.topic: stream for stream in CONTENT.streams}
    for publisher in output.publishers:
        stream = streams.get(publisher.topic)
        if stream is None or name in WITHOUT_DEFINITIONS:
            continue
        if source != output.ros_version:
            assert publisher.msgtype == stream.msgtype
            continue
        assert publisher.msgtype == stream.type_in(source)
        assert publisher.encoding == f"ros{source}msg"
        assert publisher.definition == definition(stream.type_in(source), source)
    # rosbag2 has one row, or channel, a topic.
    static = [publisher.callerid for publisher in output.publishers if publisher.topic == "/tf_static"]
    if source == output.ros_version and name.startswith(("bag", "mcap")) and kind.container != "rosbag2":
        assert sorted(static) == ["/body", "/mount"]


@pytest.mark.parametrize(("name", "kind_name"), PAIRS)
def test_all_is_kept_from_container_to_container(name: str, kind_name: str, tmp_path: Path) -> None:
    kind, source = KINDS[kind_name], ros_version_of(name)
    path = SOURCES[name](tmp_path, CONTENT)
    destination = tmp_path / "here" / kind.name
    destination.parent.mkdir()
    number = list(SOURCES).index(name)
    clouds = number % 2 == 1
    lost = name in WITHOUT_DEFINITIONS and kind.ros_version == 1
    if number % 3:
        report = pc2scan.convert(
            path, destination, params=PARAMS, keep_clouds=clouds, jobs=number % 3, **kind.options
        ).as_dict()
    else:
        words = (*HEIGHTS, *kind.arguments(), *["--keep-clouds"] * clouds)
        done = run("convert", path, "-o", destination, "--report", tmp_path / "report.json", *words)
        report = json.loads((tmp_path / "report.json").read_text())
        assert done.status == report["exit_status"], done.stderr
    assert report["exit_status"] == (3 if lost else 0)
    assert [entry["topic"] for entry in report["topics"] if entry["lost"]] == (["/battery"] if lost else [])
    output = opened(destination)
    assert output.ros_version == kind.ros_version
    check_scans(output)
    static = CONTENT.of("/tf_static")[0].stream
    passing = {s.topic: s for s in (ODOMETRY, CHATTER, INERTIA, CHARGE, static, *[POINTS] * clouds)}
    if lost:
        del passing["/battery"]
    assert output.topics() == {"/scan", *passing}
    for stream in passing.values():
        check_passing(stream, output, source)
    check_publishers(name, kind, output)
    # Messages of one log time keep their order; rosbags keeps it within a connection only.
    mine = read(destination, strict=True)
    renamed = {} if clouds else {"/points": "/scan"}
    order = [(renamed.get(item.stream.topic, item.stream.topic), item.log_time_ns) for item in CONTENT.items]
    order = [row for row in order if row[0] in output.topics()]
    assert [row[:2] for row in mine if not (clouds and row[0] == "/scan")] == order
    if destination.suffix != ".bag":
        assert [(found.topic, found.log_time_ns, found.data) for found in output.messages] == mine
    if destination.suffix == ".mcap" and not clouds:
        assert physical_order(destination) == order


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
    scans, clouds = (
        [(found.log_time_ns, found.publish_time_ns, found.sequence) for found in found_in]
        for found_in in (after.of("/scan"), before.of("/points"))
    )
    assert scans == clouds
    assert [publisher for publisher in after.publishers if publisher.topic != "/scan"] == before.publishers
    assert [entry for entry in physical_order(destination) if entry[0] != "/scan"] == physical_order(source)
    kept: list[list[Any]] = []
    for path in (source, destination):
        with path.open("rb") as file:
            reader = make_reader(file)
            summary = reader.get_summary()
            assert summary is not None
            channels = [(c.topic, sorted(c.metadata.items())) for c in summary.channels.values() if c.topic != "/scan"]
            extras = [sorted(map(repr, found)) for found in (reader.iter_attachments(), reader.iter_metadata())]
            kept.append([sorted(channels), *extras])
    assert [len(each) for each in kept[0][1:]] == [2, 2]
    assert kept[0] == kept[1]
    # What has no place for them says so.
    done = run("convert", source, "-o", tmp_path / "out.bag")
    assert done.status == 0, done.stderr
    assert "4 MCAP attachments and metadata records are not copied" in done.stderr


# --- The reader of ROS 1 ---


@pytest.mark.skipif(bool(ros1_missing()), reason="needs ROS 1's rosbag (Debian: python3-rosbag)")
@pytest.mark.parametrize(
    ("name", "compression"),
    sampled([("bag-bz2", "none"), ("mcap-zstd", "lz4"), ("rosbag2-sqlite3-v8", "bz2")], 1),
)
def test_ros1_itself_reads_every_message(name: str, compression: Any, tmp_path: Path) -> None:
    destination = tmp_path / "out.bag"
    pc2scan.convert(SOURCES[name](tmp_path, CONTENT), destination, params=PARAMS, compression=compression)
    rows, output = ros1_read(destination), opened(destination)
    found = Counter((row[0], row[1], b64decode(row[5])) for row in rows)
    assert found == Counter((m.topic, m.log_time_ns, m.data) for m in output.messages)
    assert len(rows) == len(CONTENT.items)
    publishers = {publisher.topic: publisher for publisher in output.publishers}
    for topic, _, msgtype, digest, header, _ in rows:
        publisher = publishers[topic]
        assert publisher.msgtype == msgtype.replace("/", "/msg/")
        given = {"topic": topic, "type": msgtype, "md5sum": digest, "message_definition": publisher.definition}
        assert given.items() <= header.items()
        assert (header.get("latching") == "1") == publisher.latched
        assert ("callerid" in header) == bool(publisher.callerid)
    info = ros1(ROSBAG, "info", "--yaml", destination)
    assert f"messages: {len(rows)}\n" in info.stdout, info.stderr
    assert f"compression: {compression}\n" in info.stdout
