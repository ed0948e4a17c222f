"""``pc2scan plot`` through the real command."""

from __future__ import annotations

import re
import sys
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np
import pytest

from support import HALL, sampled
from support.builders import CLOUD, T0, Item, Recording, Stream, cloud, write_mcap
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path


needs_matplotlib = pytest.mark.skipif(find_spec("matplotlib") is None, reason="needs matplotlib")


@pytest.mark.slow
@needs_matplotlib
@pytest.mark.parametrize("suffix", sampled(["svg", "png", "PDF"], 1))
def test_a_figure_is_the_same_every_time(tmp_path: Path, suffix: str) -> None:
    figures = [tmp_path / f"{name}.{suffix}" for name in "ab"]
    for figure in figures:
        assert run("plot", HALL, "-o", figure, "--min-height=-0.3", "--max-height", "1").status == 0
    assert figures[0].read_bytes() == figures[1].read_bytes()


@needs_matplotlib
def test_what_is_drawn_depends_on_the_options(tmp_path: Path) -> None:
    figures = set()
    deskew = ("--deskew", "--fixed-frame", "odom")
    for words in ((), deskew, (*deskew, "--level", "--target-frame", "base_link")):
        figure = tmp_path / f"{len(words)}.png"
        assert run("plot", HALL, "-o", figure, "--at", "0.2", *words).status == 0
        figures.add(figure.read_bytes())
    assert len(figures) == 3


#: What a filter rejects is not rejected by its height as well.
REJECTED = {
    "z < 9": {"height"},
    "abs(z) < 0.5": {"range, sector, filters"},
    "ring > 2": {"height", "range, sector, filters"},
}


@needs_matplotlib
@pytest.mark.parametrize("kept", sampled(REJECTED, 1))
def test_points_are_coloured_by_why_they_are_rejected(kept: str, tmp_path: Path) -> None:
    words = ("--where", kept, "--min-height=-0.5", "--max-height=0.5")
    assert run("plot", HALL, "-o", tmp_path / "figure.svg", *words).status == 0
    # matplotlib writes each text as a comment, too.
    told = re.findall("<!-- rejected: (.+) -->", (tmp_path / "figure.svg").read_text("utf-8"))
    assert set(told) == REJECTED[kept]


@needs_matplotlib
def test_names_are_text_and_odd_points_no_trouble(tmp_path: Path) -> None:
    stream = Stream("/$\\frac{1}{0}$\u70b9", CLOUD)
    points = np.array([[np.nan, 0, 0], [np.inf, 1, 1], [1e38, 1, 1], [-1e38, -1e38, 2]], np.float32)
    data = {2: cloud(points, 2, frame_id="$x")}
    source = write_mcap(tmp_path / "odd.mcap", Recording((stream,), (Item(stream, T0, data),)))
    done = run("plot", source, "-o", tmp_path / "figure.png")
    assert (done.status, done.stderr) == (0, "")


def test_without_matplotlib_the_error_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    done = run("plot", HALL, "-o", tmp_path / "figure.png")
    assert (done.status, 'hint: pip install "pc2scan[plot]"' in done.stderr) == (2, True)
    assert list(tmp_path.iterdir()) == []
