"""The pictures of the README can be made again, and are those that are made today."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

from support import ROOT
from support.command import environment

if TYPE_CHECKING:
    from pathlib import Path

PICTURES = ROOT / "docs" / "pictures"


@pytest.mark.slow
def test_pictures_are_made_again(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("matplotlib")
    script: list[str | Path] = [sys.executable, PICTURES / "make.py", tmp_path]
    done = subprocess.run(script, capture_output=True, text=True, check=False, env=environment(), timeout=300)
    assert done.returncode == 0, done.stderr
    made = sorted(path.name for path in tmp_path.iterdir())
    assert made == sorted(path.name for path in PICTURES.glob("*.png"))
    readme = (ROOT / "README.md").read_text("utf-8")
    for name in made:
        assert f"docs/pictures/{name}" in readme
        assert (PICTURES / name).stat().st_size < 150_000
        with image.open(tmp_path / name) as now, image.open(PICTURES / name) as then:
            assert now.size == then.size
            # matplotlib's versions draw a little differently.
            if name == "map.png":
                np.testing.assert_array_equal(np.asarray(now), np.asarray(then))
