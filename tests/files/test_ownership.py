"""No output of a run is one of its inputs; what is refused is in `transcripts/ownership.txt`."""

from __future__ import annotations

from pathlib import Path

import pytest

from pc2scan.files.ownership import InputPath, refuse_overlap


def test_what_has_nothing_to_do_with_each_other(tmp_path: Path) -> None:
    for name in ("bag", "bag/metadata.yaml", "bag/x_0.db3", "a.db3"):
        (tmp_path / name).mkdir() if name == "bag" else (tmp_path / name).touch()
    (tmp_path / "loop").symlink_to("loop")
    inputs = [InputPath(tmp_path / name) for name in ("bag", "a.db3", "loop", "missing", "missing/deeper")]
    outputs = [tmp_path / name for name in ("new", "bag2", "a.db", "no/where", "loop2", "bag.pc2scan-old")]
    refuse_overlap(inputs, outputs)
    refuse_overlap([InputPath(Path())], [Path("../new")])


def test_names_that_differ_in_case_may_be_two_files(tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").touch()
    if (tmp_path / "DRIVE.mcap").exists():
        pytest.skip("this file system ignores case")
    refuse_overlap([InputPath(tmp_path / "drive.mcap")], [tmp_path / "DRIVE.mcap"])
