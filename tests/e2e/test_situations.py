"""Real recordings draw no false alarm; what mistakes are told is in `tests/transcripts/mistakes.txt`."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

import pytest

from support import RECORDINGS, ROOT, needs_shared
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path


#: What real recordings and fixtures may be told, and should be: the depth camera's frame is an optical one.
REAL = [
    *(
        RECORDINGS / name
        for name in ("luminar_highway.bag", "velodyne_vlp32.bag", "ouster_os1_32.mcap", "jarvis_two_lasers.bag")
    ),
    *(ROOT / "fixtures" / name for name in ("hall.bag", "hall.mcap", "hall")),
]


@needs_shared
@pytest.mark.parametrize("source", REAL, ids=lambda path: path.name)
def test_no_false_alarm_on_real_recordings(source: Path, tmp_path: Path) -> None:
    """With the commands that `info` proposes, and with odometry where there is any."""
    shown = run("info", source)
    # The highway's clouds are indeed stamped fifty years after its other messages; beacons hang above the robot.
    true = ("18,333 days ahead", "beacons_scan: no point is between 0.10 and 1.50 m")
    told = [line for line in shown.stderr.splitlines() if "warning" in line and not any(each in line for each in true)]
    assert (shown.status, told) == (0, [])
    lines = [line.split("#")[0] for line in shown.stdout.splitlines() if line.strip().startswith("pc2scan convert")]
    # Where a 2D lidar was recorded, points of landmarks are not its.
    assert lines or source.name == "jarvis_two_lasers.bag"
    for number, line in enumerate(lines):
        _, _, _, *words = shlex.split(line)
        words = [word for word in words if word != source.name]
        made = run("convert", source, *words, "-o", tmp_path / f"{number}.mcap")
        assert (made.status, "warning" in made.stderr) == (0, False), made.stderr
