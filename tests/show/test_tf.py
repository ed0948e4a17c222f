"""The tree of frames; the command is in `transcripts/frames.txt`."""

from __future__ import annotations

import json

import pytest

from support import ROOT
from support.command import run

HALL = ROOT / "fixtures" / "hall.bag"


def test_a_transform_is_looked_up() -> None:
    found = run("tf", HALL, "--lookup", "odom", "lidar", "--at", "1700000000.2", "--json")
    looked_up = json.loads(found.stdout)
    assert looked_up["stamp_ns"] == 1700000000200000000
    assert looked_up["translation"] == pytest.approx([0.16, 0, 0.6])
    assert looked_up["rpy"][2] == pytest.approx(0.08)
