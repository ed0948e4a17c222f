"""Several scans of one recording in Python; `tests/transcripts/several_scans.txt` has the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pc2scan
from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.mcap"
SCANS = ROOT / "tests" / "transcripts" / "files" / "four_scans.yaml"


def test_python_writes_what_the_command_writes(tmp_path: Path) -> None:
    assert run("convert", HALL, "-o", tmp_path / "typed.mcap", "--scans", SCANS, "--only-scans").status == 0
    assert pc2scan.convert(HALL, tmp_path / "called.mcap", scans=SCANS, only_scans=True).exit_status == 0
    assert (tmp_path / "called.mcap").read_bytes() == (tmp_path / "typed.mcap").read_bytes()
    # Without sources a scan has the only topic.
    assert pc2scan.convert(HALL, tmp_path / "a.mcap", scans={"/a": {"min_height": -1}}).exit_status == 0
