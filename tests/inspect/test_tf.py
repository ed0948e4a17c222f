from __future__ import annotations

import json
import subprocess
import sys

import pytest

from pc2scan.inspect.tf import frame_tree
from pc2scan.tf.options import FrameOptions
from pc2scan.tf.static import StaticTransform
from support import ROOT

HALL = ROOT / "fixtures" / "hall.bag"


def command(*args: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "pc2scan", "tf", str(HALL), *args], capture_output=True, text=True, check=False
    )


def test_the_tree_of_the_fixture() -> None:
    tree = frame_tree([HALL])
    assert [(f.child, f.parents, f.static, f.transforms) for f in tree.frames] == [
        ("base_link", ("odom",), False, 5),
        ("lidar", ("base_link",), True, 1),
    ]
    (part,) = tree.trees
    assert (part.roots, part.frames) == (("odom",), ("base_link", "lidar", "odom"))
    assert tree.frames[0].rate_hz == pytest.approx(10)
    json.dumps(tree.as_dict(), allow_nan=False)


def test_disconnected_parts_are_told() -> None:
    added = FrameOptions(static=(StaticTransform.parse("map marker 1 0 0 0 0 0"),))
    assert len(frame_tree([HALL], added).trees) == 2
    shown = command("--static-tf", "map marker 1 0 0 0 0 0")
    assert "part 2 of 2, not connected" in shown.stdout


def test_the_command_draws_the_tree_and_looks_up() -> None:
    shown = command()
    assert shown.returncode == 0
    assert "odom\n  base_link\n    lidar (static)\n" in shown.stdout
    found = command("--lookup", "odom", "lidar", "--at", "1700000000.2", "--json")
    looked_up = json.loads(found.stdout)
    assert looked_up["stamp_ns"] == 1700000000200000000
    assert looked_up["translation"] == pytest.approx([0.16, 0, 0.6])
    assert looked_up["rpy"][2] == pytest.approx(0.08)


def test_a_frame_that_is_not_there_is_an_error_that_names_those_that_are() -> None:
    failed = command("--lookup", "odom", "camera")
    assert failed.returncode == 1
    assert "'camera'" in failed.stderr
    assert "base_link, lidar, odom" in failed.stderr
    assert failed.stdout == ""


def test_a_time_without_frames_is_wrong_usage() -> None:
    assert command("--at", "5").returncode == 2
