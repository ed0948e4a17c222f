"""The last lines of a run: what was made, and what to type next."""

from __future__ import annotations

import shlex
import shutil
from typing import TYPE_CHECKING

import pytest

from support import ROOT
from support.command import run
from support.outputs import opened

if TYPE_CHECKING:
    from pathlib import Path

FIXTURES = ROOT / "fixtures"
HEIGHTS = ("--min-height", "-0.3")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(FIXTURES / "hall.bag", tmp_path / "drive.bag")
    shutil.copy(FIXTURES / "hall.mcap", tmp_path / "drive.mcap")
    return tmp_path


def last(text: str) -> str:
    return text.splitlines()[-1]


@pytest.mark.parametrize(
    ("source", "options", "command"),
    [
        ("drive.bag", ("-o", "x.bag"), "rosbag play --clock x.bag"),
        ("drive.bag", ("-o", "x"), "ros2 bag play x --clock"),
        ("drive.bag", ("-o", "a b"), "ros2 bag play 'a b' --clock"),
        ("drive.bag", ("-o", "./-x"), "ros2 bag play ./-x --clock"),
        ("drive.bag", ("-o", "x.mcap"), "pc2scan check x.mcap"),
        ("drive.bag", ("-o", "x.mcap", "--profile", "ros2"), "ros2 bag play -s mcap x.mcap --clock"),
        ("drive.mcap", ("-o", "x.mcap"), "ros2 bag play -s mcap x.mcap --clock"),
        ("drive.mcap", ("-o", "x", "--preset", "slam_toolbox"), "pc2scan check x --for slam_toolbox"),
        ("drive.mcap", ("-o", "x", "--min-height", "50"), "pc2scan info drive.mcap"),
    ],
)
def test_what_to_type_next(source: str, options: tuple[str, ...], command: str, folder: Path) -> None:
    heights = () if "--min-height" in options else HEIGHTS
    done = run("convert", source, *options, *heights, cwd=folder)
    assert done.status in (0, 4)
    assert last(done.stdout) == f"next: {command}"
    if command.startswith("pc2scan"):
        assert run(*shlex.split(command)[1:], cwd=folder).status in (0, 1)


def test_no_next_command_for_scripts(folder: Path) -> None:
    assert run("convert", "drive.bag", "-o", "x.bag", "-q", *HEIGHTS, cwd=folder).stdout == ""
    assert "next:" not in run("repair", "drive.bag", "--json", cwd=folder).stdout
    assert last(run("repair", "drive.bag", "-o", "y.bag", cwd=folder).stdout) == "next: pc2scan info y.bag"


def test_the_ros_version_of_an_mcap_file(folder: Path) -> None:
    one = run("convert", "drive.bag", "-o", "one.mcap", *HEIGHTS, cwd=folder)
    assert "MCAP, ROS 1 profile: --profile ros2 for ros2 tools" in one.stdout.splitlines()
    two = run("convert", "drive.bag", "-o", "two.mcap", "--profile", "ros2", *HEIGHTS, cwd=folder)
    assert "MCAP, ROS 2 profile" in two.stdout.splitlines()
    assert [(m.topic, m.log_time_ns) for m in opened(folder / "one.mcap").messages] == [
        (m.topic, m.log_time_ns) for m in opened(folder / "two.mcap").messages
    ]
    assert "profile" not in run("convert", "drive.bag", "-o", "three.bag", *HEIGHTS, cwd=folder).stdout


def test_no_time_is_0(folder: Path) -> None:
    for number in range(3):
        done = run("convert", "drive.bag", "-o", f"{number}.bag", *HEIGHTS, cwd=folder)
        (line,) = (line for line in done.stdout.splitlines() if line.startswith(f"{number}.bag: "))
        assert " kB from 366.4 kB in " in line
        assert " 0.0 s" not in line
        assert line.endswith((" ms", " s"))


def test_dates_beside_stamps(folder: Path) -> None:
    shown = run("info", "drive.bag", cwd=folder).stdout.splitlines()
    assert shown[1:4] == [
        "from 1700000000.000000000 (2023-11-14 22:13:20 UTC)",
        "to   1700000000.405000000 (2023-11-14 22:13:20 UTC)",
        "0.405 s, 11 messages",
    ]
    failed = run(
        "convert", "drive.bag", "--target-frame", "odom", "--start", "0.1", "--tf-topic", "/tf_static", cwd=folder
    )
    assert failed.status == 1
