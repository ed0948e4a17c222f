"""Options without an effect are refused, or draw a warning."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"
MOUNT = "base_link lidar 0 0 0.5 0 0 0"


@pytest.mark.parametrize(
    ("options", "error", "hint"),
    [
        (
            ["--node", "front"],
            "--node chooses a section of a parameter file, but no file is given",
            "--params-file FILE --node front",
        ),
        (["--tf-from", "none.bag"], "none.bag: does not exist (from --tf-from)", ""),
        (["--ros-distro", "jazzi"], "--ros-distro is 'jazzi', which is not known", "did you mean jazzy?"),
        (["--metadata-version", "9"], "--metadata-version is for rosbag2 directories", "leave it out"),
        (["--storage", "mcap"], "--storage is for rosbag2 directories", "leave it out"),
        (["--profile", "ros1"], "--profile is for .mcap files", "leave it out"),
        (["--compression", "zstd"], "--compression zstd is not possible here", ""),
        (["--kth", "2"], "kth is 2, which needs reduce kth", ""),
        (["--intensity-field", "reflectivity"], "intensity_field is 'reflectivity', which the clouds", "their fields"),
        (["--write-static-tf"], "there is no added transform to write", ""),
        (
            ["--static-tf", "lidar base_link 0 0 0.5 0 0 0", "--target-frame", "base_link"],
            "--static-tf makes lidar the parent of base_link, which is above lidar already: lidar in base_link",
            "the parent comes first; --static-tf 'base_link lidar 0 0 0.5 0 0 0' replaces the recorded transform",
        ),
        (
            ["--report", "-"],
            "the report cannot be written there: it is not written to standard output",
            "choose a name",
        ),
        (["--rebin"], "the recording has no LaserScan topic", "without --rebin they become scans"),
        (["--range-cutoff", "3"], "need --reverse", ""),
        (["--only-scans", "--keep", "/tf"], "--only-scans contradicts --keep", ""),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_refused(options: list[str], error: str, hint: str, tmp_path: Path) -> None:
    done = run("convert", HALL, "-o", "scan.bag", "--min-height=-1", *options, cwd=tmp_path)
    assert done.status == 2
    assert error in done.stderr
    assert hint in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "warning"),
    [
        (
            ["--static-tf", MOUNT],
            "--static-tf has no effect without --target-frame: every message stays in its own frame",
        ),
        (
            ["--tf-from", str(HALL), "--tf-topic", "/tf"],
            "--tf-from, --tf-topic have no effect without --target-frame: every message stays in its own frame",
        ),
        (["--transform-tolerance", "10ms"], "--transform-tolerance has no effect without --target-frame"),
        (
            ["--source-frame", "base_link", "--target-frame", "base_link"],
            "--source-frame and --target-frame are both base_link: nothing is transformed",
        ),
        (["--source-frame", "lidar"], "--source-frame has no effect: the clouds are in lidar already"),
        (["--source-frame", "Lidar"], "(the clouds are in lidar); did you mean lidar?"),
        (
            ["--static-tf", MOUNT.replace("lidar", "lidar2"), "--target-frame", "base_link"],
            "--static-tf from base_link to lidar2 has no effect: the clouds are in lidar; did you mean lidar?",
        ),
        (
            ["--static-tf", "base_link lidar 200 0 600 0 0 0", "--target-frame", "base_link"],
            "is 632 m long, and translations are metres; if these are millimetres, --static-tf 'base_link lidar 0.2 0",
        ),
        (
            ["--static-tf", "odom base_link 0 0 0 0 0 0", "--target-frame", "base_link"],
            "--static-tf replaces the transforms of base_link in odom, which move",
        ),
        (["--start", "@1700000000100"], "if it was given in milliseconds: --start @1700000000.1"),
        (["--start", "2023-11-13"], "the cut has no effect: --start is 1699833600.000000000 (2023-11-13 00:00:00 UTC)"),
        (["--scan-time", "100"], "scan_time is 100 s, and a lidar takes less than a second for a scan"),
        (
            ["--no-return", "zero"],
            "take them for obstacles at the sensor; with them beyond the limits: --range-min 0.1",
        ),
        (["--inf-epsilon", "2"], "--inf-epsilon has no effect: it is used only with --no-return range-max-plus"),
        (["--no-use-inf"], "beams without a return are inf anyway: range_max is infinite"),
        (
            ["--keep", "/points", "--keep", "/tf*"],
            "--keep /points matches only topics that are converted, and has no effect on them; --keep-clouds writes",
        ),
        (["--drop", "/imu"], "--drop /imu matches no topic"),
        (["--angle-increment", "0.5"], "28.6 degrees a beam: 13 beams; for 0.5 deg write --angle-increment 0.5deg"),
        (["--angle-min=-5", "--angle-max=5"], "is a sector of 573 degrees: beams beyond pi stay empty"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_warned_of(options: list[str], warning: str, tmp_path: Path) -> None:
    done = run("convert", HALL, "-o", "scan.bag", "--report", "r.json", "--min-height=-1", *options, cwd=tmp_path)
    assert done.status == 0
    assert f"{warning}" in done.stderr
    assert any(line.startswith("warning: ") and warning in line for line in done.stderr.splitlines())
    assert json.loads((tmp_path / "r.json").read_text())["warnings"]


def test_what_has_an_effect_draws_no_warning(tmp_path: Path) -> None:
    params = tmp_path / "params.yaml"
    params.write_text(
        "pointcloud_to_laserscan:\n  ros__parameters:\n    inf_epsilon: 1.0\n    transform_tolerance: 0.01\n"
    )
    options = [
        "--static-tf",
        MOUNT,
        "--write-static-tf",
        "--params-file",
        str(params),
        "--preset",
        "nav2",
        "--min-height=-0.3",
    ]
    assert run("convert", HALL, "-o", tmp_path / "a.bag", *options).stderr == ""
    options = ["--static-tf", MOUNT, "--target-frame", "base_link", "--preset", "gmapping", "--inf-epsilon=2"]
    done = run("convert", HALL, "-o", tmp_path / "b.bag", *options, "--min-height=0.1", "--transform-tolerance=1")
    assert done.stderr == ""


def test_overwrite_of_golden(tmp_path: Path) -> None:
    done = run("golden", ROOT / "fixtures" / "golden", "--overwrite", cwd=tmp_path)
    assert done.status == 2
    assert "--overwrite has no effect without --junit" in done.stderr
