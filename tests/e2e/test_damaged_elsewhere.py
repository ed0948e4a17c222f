"""Commands that judge recordings do not pass over damage in silence."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"


@pytest.fixture
def scans(tmp_path: Path) -> tuple[Path, Path]:
    """Scans, and the same cut off in the last chunk."""
    sound, cut = tmp_path / "sound.mcap", tmp_path / "cut.mcap"
    arguments = ("--preset", "slam_toolbox", "--min-height", "-0.3", "--only-scans", "--compression", "none")
    assert run("convert", HALL, "-o", sound, *arguments).status == 0
    cut.write_bytes(sound.read_bytes()[:6000])
    return sound, cut


def test_check_counts_damage_as_a_defect(scans: tuple[Path, Path]) -> None:
    sound, cut = scans
    assert "defect" not in run("check", sound).stdout
    done = run("check", cut)
    assert done.status == 1
    assert "1 defect" in done.stdout
    assert "damaged:" in done.stderr
    assert json.loads(run("check", cut, "--json").stdout)["damage"]


def test_diff_does_not_compare_what_is_left(scans: tuple[Path, Path]) -> None:
    sound, cut = scans
    done = run("diff", sound, cut)
    assert done.status == 2
    assert not done.stdout
    assert "pc2scan repair" in done.stderr
    assert "Traceback" not in done.stderr
