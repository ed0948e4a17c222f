"""``pc2scan.view``: the page of the command, for Python and notebooks."""

from __future__ import annotations

import html
import json
import re
from typing import TYPE_CHECKING, Any

import pc2scan
from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"


def test_the_page_is_that_of_the_command(tmp_path: Path) -> None:
    page = pc2scan.view(HALL, clouds=3, preset="slam_toolbox", min_height=-0.3, filters=[pc2scan.Where("ring > 4")])
    saved = page.save(tmp_path / "a.html")
    done = run(
        *("view", HALL, "-o", tmp_path / "b.html", "--clouds", "3", "--preset", "slam_toolbox"),
        *("--min-height=-0.3", "--where", "ring > 4"),
    )
    assert done.status == 0
    assert saved.read_text("utf-8") == (tmp_path / "b.html").read_text("utf-8")


def held_by(page: str) -> Any:
    """The description of the recording in a page."""
    return json.loads(re.search(r'id="recording">(.*?)</script>', page, re.DOTALL)[1])  # type: ignore[index]


def test_notebooks_show_it_in_a_frame_of_its_own() -> None:
    page = pc2scan.view(str(HALL), at="0.2")
    (document,) = re.findall(r'^<iframe sandbox="allow-scripts" [^>]*srcdoc="([^"]*)"></iframe>$', page._repr_html_())
    assert len(held_by(html.unescape(document))["topics"][0]["clouds"]) == 1
    assert re.fullmatch(r"<pc2scan\.Page of [\d,]+ characters>", repr(page))
    assert len(held_by(pc2scan.view(HALL, at=[0.15, "0.3"]).html)["topics"][0]["clouds"]) == 2
