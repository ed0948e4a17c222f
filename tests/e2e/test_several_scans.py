"""Several scans of one recording in Python; `tests/transcripts/several_scans.txt` has the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pc2scan
from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.mcap"
NODES = ROOT / "tests" / "transcripts" / "files" / "two_nodes.yaml"


def test_python_writes_what_the_command_writes(tmp_path: Path) -> None:
    words: list[str | Path] = ["--params-file", NODES, "--only-scans", "--where", "ring > 1"]
    assert run("convert", HALL, "-o", tmp_path / "typed.mcap", *words).status == 0
    report = pc2scan.convert(HALL, tmp_path / "called.mcap", params_file=NODES, only_scans=True, where="ring > 1")
    assert (tmp_path / "called.mcap").read_bytes() == (tmp_path / "typed.mcap").read_bytes()
    nodes = ["/front/pointcloud_to_laserscan", "/rear/pointcloud_to_laserscan"]
    assert [spec.place for spec in report.scans] == [f"{NODES}, {node}" for node in nodes]
    # Without sources a scan has the only topic.
    assert pc2scan.convert(HALL, tmp_path / "a.mcap", scans={"/a": {"min_height": -1}}).exit_status == 0
