"""``pc2scan diff --view`` through the real command."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from look.browser import needs_chromium
from look.test_view import description
from support.builders import write_mcap
from support.command import run
from support.scan_recordings import GOOD, recording, scans

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def two(tmp_path: Path) -> tuple[Path, Path]:
    """Thirty scans, and the same with one more differing beam in each later one, up to nine."""
    changed = []
    for number, scan in enumerate(scans(30)):
        ranges = GOOD.ranges.copy()
        ranges[: min(number, 9)] += np.float32(0.5)
        changed.append(replace(scan, ranges=ranges))
    return (
        write_mcap(tmp_path / "a.mcap", recording({"/scan": scans(30)})),
        write_mcap(tmp_path / "b.mcap", recording({"/scan": changed})),
    )


def test_the_worst_moments_are_shown_with_their_beams(tmp_path: Path, two: tuple[Path, Path]) -> None:
    done = run("diff", *two, "--view", tmp_path / "page.html")
    assert done.status == 1, done.stderr
    held = description(tmp_path / "page.html")
    assert held["kind"] == "diff"
    assert len(held["moments"]) == 20
    # All with nine, the first ones of them, in the order of time.
    assert [len(m["layers"][0]["differing"]) for m in held["moments"]] == [9] * 20
    assert [m["layers"][1]["name"] for m in held["moments"][:1]] == ["B: b.mcap"]
    assert any("ranges" in line["text"] for line in held["findings"][0]["lines"])


def test_tolerances_count(tmp_path: Path, two: tuple[Path, Path]) -> None:
    assert run("diff", *two, "--atol", "1", "--view", tmp_path / "page.html").status == 0
    held = description(tmp_path / "page.html")
    assert [m["layers"][0]["differing"] for m in held["moments"]] == [[]] * 20


@pytest.mark.slow
@needs_chromium
def test_the_page_marks_what_differs(browser: Any, tmp_path: Path, two: tuple[Path, Path]) -> None:
    run("diff", *two, "--view", tmp_path / "page.html")
    tab = browser()
    tab.open(tmp_path / "page.html")
    assert "9 differ" in tab.page.inner_text("#panel")
    tab.assert_quiet()
    tab.page.close()
