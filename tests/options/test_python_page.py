"""The page of the library, which the site has, and the types of keywords."""

from __future__ import annotations

import inspect
import subprocess
import sys

import pytest

import pc2scan
from support import ROOT
from support.command import environment


def test_the_page_has_functions_with_their_keywords() -> None:
    script = "import sys; sys.path.insert(0, 'docs/site'); import python_page; print(python_page.page())"
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, env=environment(), capture_output=True, text=True, check=True
    )
    sections = {part.partition("\n")[0]: part for part in done.stdout.split("\n## ")[1:]}
    assert sections.keys() == set(pc2scan.__all__) - {"errors"}
    for name in ("convert", "batch", "export", "golden", "tf"):
        known = inspect.signature(getattr(pc2scan, name)).parameters
        assert all(f"    {keyword}" in sections[name] for keyword in known)
    assert "Unpack" not in done.stdout


def test_a_stamp_in_seconds_is_refused() -> None:
    tree = pc2scan.tf(ROOT / "fixtures" / "hall.bag")
    with pytest.raises(
        TypeError, match=r"stamp_ns is 1700000000\.1 \(float\), it must be a whole number of nanoseconds"
    ):
        tree.lookup("odom", "lidar", 1700000000.1)  # type: ignore[arg-type]
    assert tree.lookup("odom", "lidar", 1700000000_100000000).translation.shape == (3,)
