"""The memory that a conversion, `info` and pages take, however long the recording is."""

from __future__ import annotations

import platform
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from benchmarks.clouds import CLOUD_BYTES, FORMS, write_recording, write_two
from benchmarks.long import Long, measured
from support import HALL

if TYPE_CHECKING:
    from pathlib import Path


on_glibc = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="measured with glibc")


#: What each command is measured with: a conversion, with each way to load; a page, with a database, of which rows are
#: loaded one by one; and `info`, of which a page begins, with two lidars.
_CONVERT = "convert SOURCE -o scans.mcap --keep-clouds --compression lz4 --jobs 2"
_MEASURED = [("two lidars", "info SOURCE"), ("sqlite3", "view SOURCE -o page.html")]
_MEASURED += [(source, _CONVERT) for source in ("ROS 1, lz4", "MCAP, zstd", "sqlite3", "two lidars")]


@pytest.fixture(scope="module")
def sixty_clouds(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixty clouds of 131,072 points of each lidar.

    Six times as many as are sampled and shown, far more than are read ahead; and six seconds, from which on the robot's
    own body is looked for.
    """
    folder = tmp_path_factory.mktemp("clouds")
    if request.param == "two lidars":
        return write_two(folder / "two.mcap", 60)
    return write_recording(folder, FORMS[request.param], 60 * CLOUD_BYTES)


@on_glibc
@pytest.mark.slow
@pytest.mark.parametrize(("sixty_clouds", "command"), _MEASURED, indirect=["sixty_clouds"])
def test_peak_memory_at_any_length(
    command: str, sixty_clouds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = [sixty_clouds if word == "SOURCE" else word for word in command.split()]
    assert measured(words)[0] * 1024 < 100_000_000


@on_glibc
@pytest.mark.slow
def test_a_long_recording_takes_little_more_memory(tmp_path: Path) -> None:
    # 250 MB and 1.25 GB of clouds, with transforms and an IMU between them, of which the disk holds next to nothing.
    short = Long(clouds=238, points=32_768, compression="zstd")
    peaks = []
    for recording in (short, replace(short, clouds=1190)):
        source = recording.write(tmp_path / "long.mcap")
        words = ("convert", "--min-height", "-2", "--jobs", "2", "--overwrite", source, "-o", tmp_path / "scans.mcap")
        peaks.append(measured(words)[0])
        source.unlink()
    # A short one does not even use what a start leaves free.
    assert peaks[1] - peaks[0] < 12 * 1024


@on_glibc
@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("convert", "--min-height", "-2", "--target-frame", "base_link", "--jobs", "1", "-o", "a.mcap", "--overwrite"),
        ("tf",),
    ],
    ids=lambda words: words[0],
)
def test_transforms_take_little_memory(words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A hundred thousand of ten frames, and 400,000: fifty thousand partly fill what a start leaves free.
    monkeypatch.chdir(tmp_path)
    peaks = []
    for clouds in (1_000, 4_000):
        source = Long(clouds=clouds, points=64, joints=9).write(tmp_path / "joints.mcap")
        peaks.append(measured((*words, source))[0] * 1024)
        source.unlink()
    # 68 bytes each, and what is joined meanwhile.
    assert peaks[1] - peaks[0] < 108 * 300_000


@on_glibc
@pytest.mark.slow
def test_a_trajectory_takes_little_memory(tmp_path: Path) -> None:
    # A text of fifty thousand poses, and of 200,000.
    peaks = []
    for poses in (50_000, 200_000):
        path = tmp_path / "poses.txt"
        path.write_text("".join(f"{1_700_000_000 + i / 1000:.3f} {i} 0 0 0 0 0 1\n" for i in range(poses)))
        peaks.append(measured(("tf", HALL, "--trajectory", path, "--trajectory-frames", "map:robot"))[0] * 1024)
    assert peaks[1] - peaks[0] < 300 * 150_000
