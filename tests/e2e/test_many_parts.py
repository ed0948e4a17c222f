"""Recordings with more parts than a process may have open files."""

from __future__ import annotations

import resource
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from support import sampled
from support.builders import POINTS, SECOND, T0, Recording, points, write_db3, write_mcap, write_rosbag1

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

PARTS = 90
OPEN_FILES = 72


@pytest.fixture
def few_open_files() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (OPEN_FILES, hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.parametrize(
    ("write", "suffix", "is_folder"),
    sampled([(write_rosbag1, ".bag", False), (write_mcap, ".mcap", True), (write_db3, ".db3", True)], 2),
)
@pytest.mark.usefixtures("few_open_files")
def test_parts_are_open_while_they_are_due(write: Any, suffix: str, is_folder: bool, tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    folder.mkdir()
    parts, times = [], []
    for number in range(PARTS):
        # Each begins before the one before it ends.
        stamps = [T0 + number * SECOND, T0 + number * SECOND + SECOND * 6 // 5]
        recording = Recording((POINTS,), tuple(points(stamp, stamp, number) for stamp in stamps))
        parts.append(write(folder / f"drive_{number}{suffix}", recording))
        times += stamps
    report = pc2scan.convert(folder if is_folder else parts[::-1], tmp_path / "scans.mcap", target_frame="")
    assert report.messages_read == len(times)
    assert [scan.log_time_ns for scan in pc2scan.scans(tmp_path / "scans.mcap")] == sorted(times)
