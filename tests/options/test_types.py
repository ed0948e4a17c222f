"""What mypy says of right and wrong calls."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path

#: Calls, and what mypy finds wrong with each; empty: nothing.
CALLS = {
    'pc2scan.convert("a", min_height=1, max_height="50cm")': "",
    'pc2scan.convert("a", "b.mcap", target_frame="base_link", angle_min="-90deg", scan_time="auto")': "",
    'pc2scan.convert(["a", Path("b")], topics=["/points:=/scan"], keep="/tf*", start=datetime.now(timezone.utc))': "",
    'pc2scan.convert("a", where=["ring < 8"], static_tf=pc2scan.StaticTransform.parse("a b 0 0 0 0 0 0"))': "",
    'pc2scan.scans("a", topics="/points", preset="nav2", deskew=True, fixed_frame="odom")': "",
    'pc2scan.batch("a/", "b/", min_height=0.1, jobs=2, dask=True, format="npz", pose_frame="odom")': "",
    'pc2scan.export("a", "b.npz", pose_frame="odom", min_height=0.1, format="npz")': "",
    'pc2scan.view("a", clouds=3, at=["1", 2.5], reduce="median").save("page.html")': "",
    'pc2scan.scans("a", reduce="kth")': 'Argument "reduce" to "scans" has incompatible type "Literal[\'kth\']"',
    'pc2scan.check("a", consumers=["nav2"], tf_from="b")': "",
    'pc2scan.diff("a", "b", rtol=1e-5, atol={"ranges": 1e-3}, ignore=["seq"])': "",
    'pc2scan.convert("a", min_hieght=1)': 'Unexpected keyword argument "min_hieght" for "convert"; did you mean',
    'pc2scan.convert("a", min_height=["x"])': 'Argument "min_height" to "convert" has incompatible type "list[str]"',
    'pc2scan.convert("a", overwrite="no")': 'Argument "overwrite" to "convert" has incompatible type "str"',
    'pc2scan.map("a", "map.yaml")': 'Too many positional arguments for "map"',
    'pc2scan.info("a", min_height=1)': 'Unexpected keyword argument "min_height" for "info"',
    "pc2scan.convert(5)": 'Argument 1 to "convert" has incompatible type "int"',
    'pc2scan.convert("a").nothing': '"Report" has no attribute "nothing"',
}


@pytest.mark.slow
def test_right_calls_are_right_and_wrong_ones_are_wrong(tmp_path: Path) -> None:
    head = "from datetime import datetime, timedelta, timezone\nfrom pathlib import Path\nimport numpy as np, pc2scan\n"
    file = tmp_path / "calls.py"
    file.write_text(head + "\n".join(CALLS) + "\n")
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(ROOT / ".mypy_cache"), str(file)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=600, check=False)
    first = head.count("\n") + 1
    said: dict[str, str] = dict.fromkeys(CALLS, "")
    for line, text in re.findall(r"^\S*calls\.py:(\d+): error: (.*)$", done.stdout, re.MULTILINE):
        said[list(CALLS)[int(line) - first]] += text
    assert done.stderr == ""
    for call, expected in CALLS.items():
        assert said[call].startswith(expected) if expected else not said[call], (call, said[call])
