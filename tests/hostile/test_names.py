"""Names that a terminal would act upon, that are not text, or that another encoding cannot show."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import unicodedata
from typing import TYPE_CHECKING

import pytest

from support import rosbag1_files
from support.bounded import run_bounded
from support.builders import (
    CHATTER,
    POINTS,
    T0,
    Recording,
    Stream,
    cloud,
    item,
    points_of,
    string,
    transforms,
    write_mcap,
)
from support.command import COMMAND, environment

if TYPE_CHECKING:
    from pathlib import Path

#: Clears the screen, sets the title, rings, goes back to overwrite, reverses the direction of writing, splits lines.
EVIL = "\x1b[2J\x1b]0;owned\x07\r\b\x9b31m\u202e\u2066\u2028\u200b"

DESTINATIONS = {
    "bag": ("out.bag",),
    "mcap": ("out.mcap",),
    "rosbag2": ("out",),
    "sqlite3": ("out", "--storage", "sqlite3"),
}


def assert_harmless(text: str) -> None:
    """No control, format or separator character but the line's end (and no surrogate, or it were no text)."""
    found = {c for c in text if unicodedata.category(c) in {"Cc", "Cf", "Zl", "Zp", "Cs"}} - {"\n"}
    assert not found, found


@pytest.fixture
def evil(tmp_path: Path) -> Path:
    """Every name in it is evil, and so is its own."""
    points = Stream(f"/points{EVIL}", POINTS.msgtype, f"/lidar{EVIL}")
    chatter = Stream(f"/chatter{EVIL}", CHATTER.msgtype)
    frames = Stream("/tf", "tf2_msgs/msg/TFMessage")
    items = (
        item(frames, T0, lambda g, s: transforms([(f"odom{EVIL}", f"base{EVIL}", T0, (0.0, 0.0, 1.0))], g, s)),
        item(
            points, T0 + 1, lambda g, _: cloud(points_of(1), g, frame_id=f"lidar{EVIL}", names=("x", "y", f"z{EVIL}"))
        ),
        item(points, T0 + 2, lambda g, _: cloud(points_of(1), g, frame_id=f"lidar{EVIL}")),
        item(chatter, T0 + 3, lambda g, _: string(EVIL, g)),
    )
    return write_mcap(tmp_path / f"evil{EVIL}.mcap", Recording((points, chatter, frames), items))


@pytest.mark.parametrize("command", [("info",), ("tf",), ("convert",), ("convert", "--verbose"), ("convert", "-q")])
def test_a_terminal_gets_no_orders(command: tuple[str, ...], evil: Path, tmp_path: Path) -> None:
    done = run_bounded(tmp_path, command[0], evil, *command[1:])
    assert done.status in (0, 3), done.stderr
    assert_harmless(done.stdout + done.stderr)


@pytest.mark.parametrize(
    "args",
    [
        ("convert", "--target-frame", "map"),
        ("convert", "--topic", "/missing"),
        ("convert", "--on-error", "fail"),
        ("convert", "-o", "missing/folder.bag"),
        ("tf", "--lookup", "a", "b"),
    ],
)
def test_errors_give_a_terminal_no_orders(args: tuple[str, ...], evil: Path, tmp_path: Path) -> None:
    done = run_bounded(tmp_path, args[0], evil, *args[1:])
    assert done.status
    assert_harmless(done.stdout + done.stderr)


@pytest.mark.parametrize("command", ["info", "tf"])
def test_json_is_escaped(command: str, evil: Path, tmp_path: Path) -> None:
    done = run_bounded(tmp_path, command, evil, "--json")
    assert done.status == 0
    assert_harmless(done.stdout)
    assert done.stdout.isascii()
    assert EVIL in json.dumps(json.loads(done.stdout), ensure_ascii=False).encode().decode(
        "unicode_escape", "ignore"
    ) or ("\\u202e" in done.stdout)


def test_the_report_is_escaped(evil: Path, tmp_path: Path) -> None:
    done = run_bounded(tmp_path, "convert", evil, "-o", tmp_path / "out.mcap", "--report", tmp_path / "report.json")
    assert done.status == 3
    text = (tmp_path / "report.json").read_text()
    assert_harmless(text)
    assert f"/points{EVIL}" in {topic["topic"] for topic in json.loads(text)["topics"]}


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp437"])
def test_what_an_encoding_cannot_show_is_escaped(encoding: str, tmp_path: Path) -> None:
    stream = Stream("/läser_点", POINTS.msgtype)
    source = write_mcap(
        tmp_path / "点.mcap", Recording((stream,), (item(stream, T0, lambda g, _: cloud(points_of(1), g)),))
    )
    for command in ("info", "convert"):
        done = subprocess.run(
            [*COMMAND, command, str(source)],
            capture_output=True,
            env={**environment(), "PYTHONIOENCODING": encoding},
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert b"\\u70b9" in done.stdout


@pytest.fixture
def bytes_for_names(tmp_path: Path) -> Path:
    """A bag whose topics, types, callers and definitions are bytes that are no text."""
    inner = {"md5sum": b"*", "callerid": b"/\xff", "message_definition": b"# \xff\nuint8 a\n", "x": b"\xfe"}
    kinds = {b"/cl\xff\xfe": b"sensor_msgs/PointCloud2", b"/s\xff": b"std_msgs/String", b"/t": b"st\xff_msgs/\xfe"}
    connections = [
        rosbag1_files.record(
            rosbag1_files.header(topic=topic, type=kind, **inner)[4:],
            op=b"\x07",
            conn=rosbag1_files.uint32(number),
            topic=topic,
        )
        for number, (topic, kind) in enumerate(kinds.items())
    ]
    payload = rosbag1_files.message(5, cloud(points_of(1), 1)) + rosbag1_files.message(6, string("a", 1), 1)
    return rosbag1_files.simple_bag(tmp_path / "bytes.bag", payload, counts={0: 1, 1: 1, 2: 0}, connections=connections)


@pytest.mark.parametrize("kind", DESTINATIONS)
def test_bytes_that_are_no_text(kind: str, bytes_for_names: Path, tmp_path: Path) -> None:
    name, *options = DESTINATIONS[kind]
    done = run_bounded(tmp_path, "convert", bytes_for_names, "-o", tmp_path / name, "--keep-clouds", *options)
    # Between the ROS versions a type that is no name cannot be carried over, and with it its only cloud.
    if kind not in ("bag", "mcap"):
        assert (done.status, (tmp_path / name).exists()) == (1, False), done.stderr
        assert "cannot be re-encoded" in done.stderr
        return
    assert done.status == 0, done.stderr
    again = run_bounded(tmp_path, "info", tmp_path / name, "--json")
    assert again.status == 0, again.stderr
    topics = {topic["topic"] for topic in json.loads(again.stdout)["topics"]}
    assert "/scan" in topics
    # A bag keeps the bytes; MCAP has replacement characters for them.
    kept = {"bag": "/cl\udcff\udcfe", "mcap": "/cl\ufffd\ufffd"}
    assert kept[kind] in topics


@pytest.mark.skipif(sys.platform != "linux", reason="file names that are no text are Linux's")
def test_a_file_name_that_is_no_text(tmp_path: Path) -> None:
    recording = Recording((POINTS,), (item(POINTS, T0, lambda g, _: cloud(points_of(1), g)),))
    source = write_mcap(tmp_path / os.fsdecode(b"a\xff.mcap"), recording)
    for command in ("info", "convert"):
        done = run_bounded(tmp_path, command, source)
        assert done.status == 0, done.stderr
        assert "\\udcff" in done.stdout
