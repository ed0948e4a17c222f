"""A batch whose outputs are split."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pc2scan
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path


def test_each_output_is_a_directory_of_several_files_and_is_known_the_next_time(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("a.bag", "b.bag"):
        shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path / "in" / name)
    outcomes = []
    for split in ("0.2s", "0.2s", "0.1s"):
        done = pc2scan.batch(tmp_path / "in", tmp_path / "out", min_height=-0.3, split=split, to="rosbag2")
        assert done.exit_status == 0
        files = {path.name: len(list(path.glob("*.mcap"))) for path in (tmp_path / "out").iterdir() if path.is_dir()}
        outcomes.append((files, [path.stat().st_ino for path in sorted((tmp_path / "out").glob("*_scan"))]))
    assert [files for files, _ in outcomes] == [
        {"a_scan": 3, "b_scan": 3},
        {"a_scan": 3, "b_scan": 3},
        {"a_scan": 5, "b_scan": 5},
    ]
    # The second time nothing was to be done, the third time both.
    assert outcomes[0][1] == outcomes[1][1]
