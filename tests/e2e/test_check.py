"""``pc2scan check`` as its users see it, and the warning of ``pc2scan convert``."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pc2scan.core.consumers import CONSUMERS
from pc2scan.options.table import options_of
from support import GOLDEN, ROOT
from support.command import run
from support.consumer_rules import mrpt_2_5, mrpt_ros_bridge_3_2
from support.scan_recordings import GOOD, scans, write
from support.tables import rows

TABLES = Path(__file__).with_name("check.txt")
HALL = ROOT / "fixtures" / "hall.bag"


def test_the_choices_are_the_consumers() -> None:
    assert options_of("check")["consumers"].value.words == tuple(CONSUMERS)


def test_good_scans(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", *scans(5))
    done = run("check", path)
    assert (done.status, done.stderr) == (0, "")
    assert "/scan: 5 scans of 9 beams" in done.stdout
    assert done.stdout.count("accepted\n") == len(CONSUMERS) - 1
    assert done.stdout.splitlines()[-1] == "ok; shifted: gmapping"
    done = run("check", path, "--for", "slam_toolbox", "--for", "cartographer")
    assert done.stdout.splitlines()[-1] == "ok: accepted by slam_toolbox, cartographer"


def test_good_scans_for_gmapping(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", *scans(5))
    done = run("check", path, "--for", "gmapping")
    assert (done.status, done.stdout.splitlines()[-1]) == (1, "not ok; shifted: gmapping")
    assert "cure  advertise angle_max = angle_min + 9 * angle_increment: pc2scan convert --preset" in done.stdout


def test_scans_without_transforms_are_not_ok(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", *scans(5), tree=())
    done = run("check", path, "--for", "slam_toolbox")
    assert done.status == 1
    assert "slam_toolbox  ignored" in done.stdout
    assert "here  the recording has no transforms; allowed: transforms at the scan's stamp" in done.stdout
    assert "--tf-from reads them from another recording" in done.stdout


@pytest.mark.parametrize(("change", "consumer", "outcome", "told"), rows(TABLES, "changes of a good scan"))
def test_what_was_accepted_and_is_not(
    change: dict[str, Any], consumer: str, outcome: str, told: str, tmp_path: Path
) -> None:
    change = {name: np.array(value, np.float32) if name == "ranges" else value for name, value in change.items()}
    path = write(tmp_path / "a.mcap", *scans(3, replace(GOOD, **change)))
    done = run("check", path, "--for", consumer)
    assert done.status == 1
    assert f"{consumer:<14}{outcome}\n" in done.stdout
    assert told in done.stdout


def test_optical_frames_and_scans_without_returns_are_defects(tmp_path: Path) -> None:
    degrees = replace(GOOD, angle_min=-180.0, angle_max=180.0, angle_increment=45.0)
    path = write(tmp_path / "degrees.mcap", *scans(3, degrees))
    done = run("check", path, "--for", "amcl")
    assert done.status == 1
    assert "defect: 3 of 3 scans cover more than a full circle" in done.stdout
    optical = replace(GOOD, frame_id="camera_optical_frame")
    path = write(tmp_path / "optical.mcap", *scans(3, optical), tree=(("odom", "base_link"),))
    done = run("check", path, "--for", "cartographer")
    assert done.status == 1
    assert "defect: the frame 'camera_optical_frame' is an optical frame, judging by its name" in done.stdout
    empty = write(tmp_path / "empty.mcap", *scans(3, replace(GOOD, ranges=np.full(9, math.inf, np.float32))))
    done = run("check", empty, "--for", "nav2")
    assert done.status == 1
    assert "defect: 3 of 3 scans have no return at all" in done.stdout


@pytest.mark.parametrize("angle", ["1.5707963", "1.5707963267948966"])
def test_mrpt_reads_each_beam_of_half_a_circle(angle: str, tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    options = ("--beams", "181", "--angle-min", f"-{angle}", "--angle-max", angle, "--min-height", "-0.3")
    assert run("convert", HALL, "-o", path, "--preset", "mrpt", *options, "--quiet").status == 0
    done = run("check", path, "--for", "mrpt", "--json")
    (topic,) = json.loads(done.stdout)["topics"]
    assert (done.status, topic["first"]["beams"]) == (0, 181)
    for reads in mrpt_2_5, mrpt_ros_bridge_3_2:
        assert reads(topic["first"]["angle_min"], topic["first"]["angle_max"], 181) == list(range(181))


def test_beams_that_mrpt_misreads_are_counted(tmp_path: Path) -> None:
    angles = {"angle_min": -1.5707964897155762, "angle_max": 1.570796251296997, "angle_increment": 0.01745329238474369}
    misread = replace(GOOD, **angles, ranges=np.ones(181, np.float32))  # type: ignore[arg-type]
    done = run("check", write(tmp_path / "a.mcap", *scans(3, misread)), "--for", "mrpt")
    assert done.status == 1
    assert "mrpt          shifted\n" in done.stdout
    assert "71 of 181 beams off by up to 1 deg (1 of an increment)" in done.stdout
    assert "allowed: angle_min -1.57079768, angle_max 1.5707953\n" in done.stdout


def test_what_upstream_wrote_for_its_defaults_and_its_sample() -> None:
    """Of the nodes' own outputs, which have a last beam that is not angle_max; the recordings have no transforms."""
    for name, wrong in (
        ("defaults", {"cartographer": "misplaced", "gmapping": "aborts", "nav2": "misplaced", "mrpt": "misplaced"}),
        ("launch_sample", {"gmapping": "shifted", "mrpt": "misplaced"}),
    ):
        expected = GOLDEN / name / "expected.bag"
        found = json.loads(run("check", expected, "--json", "--base-frame", "lidar", "--odom-frame", "lidar").stdout)
        outcomes = {c["consumer"]: c["outcome"] for topic in found["topics"] for c in topic["consumers"]}
        assert outcomes == dict.fromkeys(CONSUMERS, "accepted") | wrong, name
