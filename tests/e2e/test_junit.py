"""JUnit XML of check and diff, through the real command."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING

from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"


def cases(path: Path) -> dict[str, str]:
    """Outcomes by name: the element within the case, or ``passed``."""
    (suite,) = ET.fromstring(path.read_text("utf-8"))
    bad = {"failure", "error"}
    return {str(case.get("name")): next((child.tag for child in case if child.tag in bad), "passed") for case in suite}


def test_check_has_a_case_for_each_consumer(tmp_path: Path) -> None:
    scans, report = tmp_path / "scans.bag", tmp_path / "check.xml"
    assert run("convert", HALL, "-o", scans, "--min-height", "-0.3").status == 0
    done = run("check", scans, "--junit", report)
    assert done.status == 1
    found = cases(report)
    assert found["/scan for slam_toolbox"] == "passed"
    assert found["/scan for nav2"] == "failure"
    assert {"/scan for gmapping", "/scan for mrpt", "/scan: defects"} <= found.keys()
    assert run("check", scans, "--for", "amcl", "--junit", report).status == 0
    assert cases(report) == {"/scan for amcl": "passed", "/scan: defects": "passed"}


def test_diff_has_a_case_for_each_topic(tmp_path: Path) -> None:
    one, other, report = tmp_path / "one.bag", tmp_path / "other.bag", tmp_path / "diff.xml"
    assert run("convert", HALL, "-o", one, "--min-height", "-0.3").status == 0
    assert run("convert", HALL, "-o", other, "--min-height", "-0.2", "--keep-clouds").status == 0
    assert run("diff", one, other, "--junit", report).status == 1
    assert cases(report) == {"/points": "failure", "/scan": "failure"}
    assert run("diff", one, one, "--junit", report, "-q").status == 0
    assert cases(report) == {"/scan": "passed"}


def test_a_recording_is_not_written_over(tmp_path: Path) -> None:
    scans = tmp_path / "scans.bag"
    assert run("convert", HALL, "-o", scans, "--min-height", "-0.3").status == 0
    before = scans.read_bytes()
    for words in (("check", scans), ("diff", scans, HALL)):
        done = run(*words, "--junit", scans, "--overwrite")
        assert done.status == 2, done.stderr
        assert scans.read_bytes() == before
        assert run(*words, "--overwrite").status == 2
