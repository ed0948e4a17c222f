"""Scans that become clouds with each beam at its own time."""

from __future__ import annotations

import json
import math
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.bags.opening import open_recording
from pc2scan.cli.in_process import run_command
from pc2scan.messages.pointcloud2 import decode_pointcloud2
from support.scan_recordings import GOOD, STEP, scans, write

if TYPE_CHECKING:
    from pathlib import Path

#: At its sensor, ahead and behind.
FLAT = replace(GOOD, angle_min=0.0, angle_max=0.0, angle_increment=0.0, range_min=-9.0)


def reversed_in(folder: Path, frame: str) -> tuple[int, list[bytes], dict[str, Any]]:
    """The status, the clouds' x, y and z, and the report."""
    options = ("--reverse", "--deskew", "--target-frame", frame, "--only-scans", "--overwrite")
    files = ("-o", str(folder / "out.mcap"), "--report", str(folder / "report.json"))
    done = run_command(["convert", str(folder / "in.mcap"), *files, *options])
    with closing(open_recording(folder / "out.mcap")) as reader:
        clouds = [decode_pointcloud2(message.data, "cdr") for message in reader.messages()]
        points = [np.stack(cloud.xyz(), axis=1).tobytes() for cloud in clouds]
    return done.status, points, json.loads((folder / "report.json").read_text())


def test_the_scans_own_frame_is_a_target_like_others(tmp_path: Path) -> None:
    beams = np.array([-0.0, 2.0, -2.0], np.float32)
    pattern = replace(FLAT, ranges=beams)
    first, second, third = scans(3, pattern)
    # The second has no time for its last beam; without beams there is none to have a time.
    second = replace(second, time_increment=math.inf)
    third = replace(third, time_increment=math.nan, ranges=beams[:0])
    write(tmp_path / "in.mcap", first, second, third, tree=(("map", "laser"),))
    status, points, report = reversed_in(tmp_path, "laser")
    assert status == 3
    assert points == [np.array([[0, 0, 0], [2, 0, 0], [-2, 0, 0]], np.float32).tobytes(), b""]
    (skipped,) = report["skipped"]
    assert skipped["stamp_ns"] == first.stamp_ns + STEP
    assert skipped["reason"].startswith("time_increment is inf s: the last of 3 beams would be inf s after the first")
    status, points, report = reversed_in(tmp_path, "map")
    assert (status, len(points), report["skipped_count"]) == (3, 2, 1)
