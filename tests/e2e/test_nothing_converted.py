"""Runs that convert nothing, or nothing of use, and how strict a run can be asked to be."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.cli.in_process import run_command
from support import sampled
from support.builders import (
    CONTENT,
    POINTS,
    SECOND,
    T0,
    TF,
    Recording,
    Stream,
    cloud,
    fixed,
    item,
    points_of,
    write_rosbag1,
)
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

    from support.command import Finished

HEIGHTS = ("--min-height", "-2", "--max-height", "2")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_rosbag1(tmp_path / "drive.bag", CONTENT)
    return tmp_path


def convert(folder: Path, *options: str | Path, status: int, source: str = "drive.bag") -> tuple[Finished, Any]:
    """Run with a report; nothing else may have appeared if it failed."""
    before = {path.name for path in folder.iterdir()} - {"report.json"}
    done = run("convert", source, "-o", "out/", "--report", "report.json", *options, cwd=folder)
    assert "Traceback" not in done.stderr
    assert done.status == status, done.stderr
    report = json.loads((folder / "report.json").read_text())
    assert report["exit_status"] == status
    after = {path.name for path in folder.iterdir()} - {"report.json"}
    assert after == before | ({"out"} if status in (0, 3, 4) else set())
    return done, report


# --- What is known beforehand ---


def in_frames(path: Path, *frame_ids: str) -> None:
    """Write a recording of clouds in these frames, and a transform of another one."""
    clouds = [
        item(POINTS, T0 + 100_000_000 * k, partial(framed, frame_id, T0 + 100_000_000 * k), k)
        for k, frame_id in enumerate(frame_ids)
    ]
    transform = fixed(Stream("/tf_static", TF, latched=True), T0, "camera", 0.5)
    write_rosbag1(path, Recording((transform.stream, POINTS), (transform, *clouds)))


def framed(frame_id: str, stamp_ns: int, ros_version: int, seq: int) -> bytes:
    return cloud(points_of(seq), ros_version, seq=seq, stamp_ns=stamp_ns, frame_id=frame_id)


@pytest.mark.parametrize("before", sampled([9, 5, 10, 0, 16], 2))
def test_a_frame_that_comes_late_is_converted(before: int, folder: Path) -> None:
    in_frames(folder / "late.bag", *["nowhere"] * before, "base_link")
    done, report = convert(
        folder, *HEIGHTS, "--target-frame", "base_link", status=3 if before else 0, source="late.bag"
    )
    (topic,) = (topic for topic in report["topics"] if topic["action"] == "converted")
    assert (topic["messages_in"], topic["messages_out"], topic["skipped"]) == (before + 1, 1, before)
    # A user can stop the conversion.
    warned = "none of the first 10 messages can be converted: /points: no transform has the source frame 'nowhere'"
    assert (warned in " ".join(done.stderr.split())) == (before >= 10)
    assert run_command(["convert", str(folder / "late.bag"), "--target-frame", "base_link", "--dry-run"]).status == 0


# --- What turns out in the end ---


def test_clouds_that_all_are_skipped(folder: Path) -> None:
    """Stamps before all transforms: known message by message only. Shown is the farthest of all, whose cure helps."""
    clouds = [
        item(POINTS, entry.log_time_ns, lambda g, s: cloud(points_of(s), g, stamp_ns=(150 - s) * SECOND), number)
        for number, entry in enumerate(CONTENT.of("/points") * 50)
    ]
    others = [entry for entry in CONTENT.items if entry.stream.topic != "/points"]
    items = sorted([*others, *clouds], key=lambda entry: entry.log_time_ns)
    write_rosbag1(folder / "early.bag", replace(CONTENT, items=tuple(items)))
    done, report = convert(folder, "--target-frame", "odom", status=1, source="early.bag")
    assert "error: no message was converted: all were skipped: the transform from" in done.stderr
    assert "is not known at 1.000000000: " in done.stderr
    assert report["errors"][0]["kind"] == "ResultError"
    assert (report["skipped_count"], len(report["skipped"])) == (150, 100)
    assert [topic["messages_out"] for topic in report["topics"] if topic["action"] == "converted"] == [0]
