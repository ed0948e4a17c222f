"""``pc2scan check`` as its users see it, and the warning of ``pc2scan convert``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pc2scan.core.consumers import CONSUMERS
from pc2scan.options.table import options_of
from support import GOLDEN, ROOT
from support.command import run
from support.scan_recordings import GOOD, scans, write
from support.tables import rows

TABLES = Path(__file__).with_name("check.txt")
HALL = ROOT / "fixtures" / "hall.bag"


def test_the_choices_are_the_consumers() -> None:
    assert options_of("check")["consumers"].value.words == tuple(CONSUMERS)


@pytest.mark.parametrize(("change", "options", "status", "told"), rows(TABLES, "scans"))
def test_scans_are_judged(change: dict[str, Any], options: str, status: int, told: list[str], tmp_path: Path) -> None:
    tree = {"tree": change["tree"]} if "tree" in change else {}
    changes: dict[str, Any] = {
        name: np.array(value, np.float32) if name == "ranges" else value for name, value in change.items()
    }
    changes.pop("tree", None)
    done = run("check", write(tmp_path / "a.mcap", *scans(3, replace(GOOD, **changes)), **tree), *options.split())
    assert done.status == status
    assert status or not done.stderr
    assert [text for text in told if text not in done.stdout] == []


@pytest.mark.parametrize("angle", ["1.5707963", "1.5707963267948966"])
def test_mrpt_reads_each_beam_of_half_a_circle(angle: str, tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    options = ("--beams", "181", "--angle-min", f"-{angle}", "--angle-max", angle, "--min-height", "-0.3")
    assert run("convert", HALL, "-o", path, "--preset", "mrpt", *options, "--quiet").status == 0
    done = run("check", path, "--for", "mrpt", "--json")
    (topic,) = json.loads(done.stdout)["topics"]
    assert (done.status, topic["first"]["beams"]) == (0, 181)


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
