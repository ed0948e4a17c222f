"""JUnit XML of check and diff."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING

import pytest

import pc2scan
from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    pc2scan.convert(HALL, tmp_path / "scans.bag", min_height=-0.3)
    pc2scan.convert(HALL, tmp_path / "other.bag", min_height=-0.2, keep_clouds=True)
    return tmp_path


SLAM = {"/scan for slam_toolbox": "passed", "/scan for nav2": "failure"}


@pytest.mark.parametrize(
    ("words", "status", "expected"),
    [
        ("check scans.bag", 1, SLAM),
        ("check scans.bag --for amcl", 0, {"/scan for amcl": "passed", "/scan: defects": "passed"}),
        ("diff scans.bag other.bag", 1, {"/points": "failure", "/scan": "failure"}),
        ("diff scans.bag scans.bag -q", 0, {"/scan": "passed"}),
    ],
)
def test_each_consumer_or_topic_is_a_case(words: str, status: int, expected: dict[str, str], folder: Path) -> None:
    assert run(*words.split(), "--junit", "r.xml", cwd=folder).status == status
    (suite,) = ET.fromstring((folder / "r.xml").read_text("utf-8"))
    bad = {"failure", "error"}
    found = {str(case.get("name")): next((part.tag for part in case if part.tag in bad), "passed") for case in suite}
    if expected is SLAM:
        assert {"/scan for gmapping", "/scan for mrpt", "/scan: defects"} <= found.keys()
        found = {name: outcome for name, outcome in found.items() if name in expected}
    assert found == expected


@pytest.mark.parametrize("words", ["check scans.bag", "diff scans.bag other.bag"])
def test_a_recording_is_not_written_over(words: str, folder: Path) -> None:
    before = (folder / "scans.bag").read_bytes()
    assert run(*words.split(), "--junit", "scans.bag", "--overwrite", cwd=folder).status == 2
    assert (folder / "scans.bag").read_bytes() == before
    assert run(*words.split(), "--overwrite", cwd=folder).status == 2
