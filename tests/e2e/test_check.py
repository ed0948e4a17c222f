"""``pc2scan check`` as its users see it, and the warning of ``pc2scan convert``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from e2e.command import run
from pc2scan.cli.check import Consumer
from pc2scan.core.consumers import CONSUMERS
from scan_recordings import scans, write
from support import GOLDEN, ROOT

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"
#: 180 beams where slam_toolbox expects 181.
HALF = ("--min-height", "-0.3", "--angle-min", "-1.57", "--angle-max", "1.57", "--range-max", "30")


def test_the_choices_are_the_consumers() -> None:
    assert [consumer.value for consumer in Consumer] == list(CONSUMERS)


def test_good_scans(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", *scans(5))
    done = run("check", path)
    assert (done.status, done.stderr) == (0, "")
    assert "/scan: 5 scans of 9 beams" in done.stdout
    assert done.stdout.count("accepted\n") == len(CONSUMERS)
    assert done.stdout.splitlines()[-1].startswith("ok: accepted by slam_toolbox, cartographer")


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "out"])
def test_convert_warns_and_check_says_why(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    done = run("convert", HALL, "-o", path, *HALF, "--report", tmp_path / "report.json")
    assert done.status == 0
    (warning,) = done.stderr.splitlines()
    assert warning.startswith("warning: /scan: slam_toolbox would refuse these scans: 180 ranges where it allows 181")
    assert "--geometry centered" in warning
    assert json.loads((tmp_path / "report.json").read_text())["warnings"] == [warning.removeprefix("warning: ")]

    done = run("check", path, "--for", "slam_toolbox")
    assert done.status == 1
    assert "slam_toolbox  ignored" in done.stdout
    assert "here  180 ranges; allowed: 181 ranges" in done.stdout
    assert "cure  advertise angle_max 1.55413" in done.stdout
    assert "cartographer" not in done.stdout
    assert done.stdout.splitlines()[-1] == "not ok; ignored: slam_toolbox"

    done = run("check", path, "--for", "cartographer", "--for", "nav2")
    assert done.status == 0
    found = run("check", path, "--json")
    (topic,) = json.loads(found.stdout)["topics"]
    assert {c["consumer"]: c["outcome"] for c in topic["consumers"]} == {
        "slam_toolbox": "ignored",
        "cartographer": "accepted",
        "gmapping": "accepted",
        "amcl": "accepted",
        "nav2": "accepted",
        "mrpt": "misplaced",
    }
    assert json.loads(found.stdout)["exit_status"] == found.status == 1


def test_what_upstream_wrote_for_its_defaults_and_its_sample() -> None:
    """Of the nodes' own outputs: both are taken by slam_toolbox, and both have a last beam that is not angle_max."""
    for name, misplaced in (("defaults", {"cartographer", "gmapping", "nav2", "mrpt"}), ("launch_sample", {"mrpt"})):
        found = json.loads(run("check", GOLDEN / name / "expected.bag", "--json").stdout)
        outcomes = {c["consumer"]: c["outcome"] for topic in found["topics"] for c in topic["consumers"]}
        assert outcomes == {c: "misplaced" if c in misplaced else "accepted" for c in CONSUMERS}, name


def test_nothing_is_warned_of_where_nobody_refuses(tmp_path: Path) -> None:
    done = run("convert", HALL, "-o", tmp_path / "out.bag", "--min-height", "-0.3")
    assert (done.status, done.stderr) == (0, "")
    done = run("convert", tmp_path / "out.bag", "-o", tmp_path / "back.bag", "--reverse", "--quiet")
    assert (done.status, done.stderr) == (0, "")


def test_wrong_usage(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", *scans(2))
    unknown = run("check", path, "--for", "hector")
    assert unknown.status == 2
    assert "slam_toolbox" in unknown.stderr
    assert run("check").status == 2
    missing = run("check", path, "--topic", "/scam")
    assert missing.status == 2
    assert "did you mean /scan?" in missing.stderr
    clouds = run("check", HALL)
    assert clouds.status == 2
    assert "pc2scan convert" in clouds.stderr
    gone = run("check", tmp_path / "gone.bag")
    assert (gone.status, "Traceback" in gone.stderr) == (1, False)
