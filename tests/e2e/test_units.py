"""Degrees, millimetres and milliseconds: accepted where they are written, refused where they are only meant."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"


@pytest.mark.parametrize(
    ("options", "file"),
    [
        (
            ["--angle-min=-90deg", "--angle-max=deg(90)", "--angle-increment=pi/180", "--min-height=-30cm"],
            "range_max: 30.0\nscan_time: 0.1",
        ),
        (
            ["-p", "angle_min:=-pi/2", "-p", "angle_max:=90deg", "-p", "min_height:=-300mm", "--start=0ms"],
            "range_max: 30m\nscan_time: 100ms",
        ),
        (
            ["--end", "3600s", "--range-max", "3000 cm"],
            "angle_min: -90deg\nangle_max: 'deg(90)'\nmin_height: -0.3 m\nscan_time: 1/10",
        ),
    ],
)
def test_units_are_the_same_as_plain_numbers(tmp_path: Path, options: list[str], file: str) -> None:
    plain = ["--angle-min=-1.5707963267948966", "--angle-max=1.5707963267948966", "--min-height=-0.3"]
    made = run("convert", HALL, "-o", tmp_path / "plain.mcap", *plain, "--range-max=30", "--scan-time=0.1")
    assert made.status == 0
    params = tmp_path / "params.yaml"
    params.write_text(
        "pointcloud_to_laserscan:\n  ros__parameters:\n" + "".join(f"    {x}\n" for x in file.split("\n"))
    )
    done = run("convert", HALL, "-o", tmp_path / "units.mcap", *options, "--params-file", params)
    assert done.status == 0, done.stderr
    assert run("diff", tmp_path / "plain.mcap", tmp_path / "units.mcap", "--all-topics").status == 0


@pytest.mark.parametrize(
    ("options", "error", "hint"),
    [
        (
            ["--angle-min=-180", "--angle-max=180"],
            "error: angle_min is -180.0 rad and angle_max is 180.0 rad, more than a full turn (2 pi is 6.28319 rad) (",
            "hint: for degrees write --angle-min -180deg, --angle-max 180deg, which is -3.14159, 3.14159 rad",
        ),
        (
            ["-p", "angle_max:=90"],
            "error: angle_max is 90.0 rad, more than a full turn (2 pi is 6.28319 rad) (from --param angle_max:=90)",
            "hint: for degrees write --param angle_max:=90deg, which is 1.5708 rad",
        ),
        (
            ["--angle-max=400deg"],
            "error: angle_max is 6.981317007977318 rad, more than a full turn (360 degrees are 6.28319 rad) (",
            "hint: a full circle is --angle-min -180deg, --angle-max 180deg",
        ),
        (
            ["--preset=slam_toolbox", "--angle-min=-5", "--angle-max=5"],
            "error: angle_min -5.0 to angle_max 5.0 rad is a sector of 10 rad, more than a full turn",
            "hint: for degrees write --angle-min -5deg, --angle-max 5deg, which is -0.0872665, 0.0872665 rad",
        ),
        (
            ["--target-frame=base_link", "--static-tf", "base_link lidar 0 0 0.5 0 45 0"],
            "error: static transform from base_link to lidar: pitch is 45 rad, more than a full turn",
            "hint: for degrees write --static-tf 'base_link lidar 0 0 0.5 0 45deg 0', which is 0 0.785398 0 rad",
        ),
        (["--range-max=30deg"], "error: range_max: expected a number, got '30deg'", "hint: write metres (0.5, 0.5m)"),
        (["--reverse", "--range-cutoff=far"], "error: --range-cutoff: 'far' is not a number", "hint: write metres"),
    ],
)
def test_degrees_without_their_name_are_refused(tmp_path: Path, options: list[str], error: str, hint: str) -> None:
    done = run("convert", HALL, "-o", tmp_path / "scan.mcap", *options)
    assert done.status == 2
    first, second = done.stderr.splitlines()
    assert first.startswith(error)
    assert second.startswith(hint)
    assert list(tmp_path.iterdir()) == []


def test_a_preset_keeps_the_sector(tmp_path: Path) -> None:
    made = tmp_path / "scan.mcap"
    sector = ["--angle-min=-90deg", "--angle-max=90deg"]
    assert run("convert", HALL, "-o", made, "--preset=slam_toolbox", "--min-height=-0.3", *sector).status == 0
    assert "angles -1.5708 to 1.5708 rad" in run("check", made, "--for", "slam_toolbox").stdout
