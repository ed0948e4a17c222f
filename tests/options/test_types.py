"""What mypy says of right and wrong calls."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from support import ROOT
from support.tables import rows

CALLS: dict[str, str] = dict(rows(Path(__file__).with_name("types.txt"), "calls", text=True))


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
