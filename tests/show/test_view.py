"""``pc2scan view`` through the real command: what is written, what is refused, what a page holds."""

from __future__ import annotations

import html
import json
import re
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from support import HALL
from support.builders import write_mcap
from support.command import run
from support.scan_recordings import recording, scans

if TYPE_CHECKING:
    from pathlib import Path


def description(page: Path) -> Any:
    held = re.search(r'id="recording">(.*?)</script>', page.read_text("utf-8"), re.DOTALL)
    assert held is not None
    return json.loads(held[1])


def test_a_page_of_clouds(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    done = run("view", HALL, "-o", page, "--clouds", "3", "--min-height=-0.3", "--target-frame", "base_link")
    assert (done.status, done.stderr) == (0, "")
    assert done.stdout.startswith(f"{page}: ")
    held = description(page)
    assert (held["kind"], held["title"]) == ("clouds", "hall.bag")
    assert held["params"]["min_height"] == -0.3
    (topic,) = held["topics"]
    assert len(topic["clouds"]) == 3
    cloud = topic["clouds"][0]
    assert (cloud["frame"], cloud["targetFrame"]) == ("lidar", "base_link")
    assert cloud["mount"]["z"] == pytest.approx(0.6)  # as the fixture is made
    assert {frame["name"] for frame in cloud["frames"]} & {"lidar", "odom", "base_link"} == {"lidar", "odom"}
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


def test_a_page_opens_with_what_info_proposes(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    done = run("view", HALL, "-o", page, "--preset", "gmapping")
    assert "note: The page opens with the heights that pc2scan info proposes: 0.1 to 1.5 m in frame" in done.stdout
    (call,) = json.loads(run("info", HALL, "--json").stdout)["proposals"]
    options, held = call["options"], description(page)
    names = ("min_height", "max_height")
    assert {name: options[name] for name in names} == {name: held["params"][name] for name in names}
    assert held["targetFrame"] == options["target_frame"] == "base_link"
    assert run("view", HALL, "-o", page, "--max-height", "3").status == 0
    assert description(page)["params"]["max_height"] == 3


def test_a_page_of_scans_says_what_check_says(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "scans.mcap", recording({"/scan": scans(20)}))
    assert run("view", source, "-o", tmp_path / "page.html", "--clouds", "4").status == 0
    held = description(tmp_path / "page.html")
    assert held["kind"] == "scans"
    assert len(held["moments"]) == 4
    assert held["findings"][0]["heading"] == "pc2scan check: /scan"
    assert {"text": "slam_toolbox: accepted", "wrong": False} in held["findings"][0]["lines"]


def test_deskewing_is_shown_and_stays_in_the_command(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    done = run("view", HALL, "-o", page, "--deskew", "--fixed-frame", "odom", "--target-frame", "base_link")
    assert done.status == 0, done.stderr
    held = description(page)
    assert "deskewed" in held["notes"][1]
    assert [*held["command"][-3:]] == ["--deskew", "--fixed-frame", "odom"]
    run("view", HALL, "-o", page, "--level", "--fixed-frame", "odom", "--target-frame", "base_link")
    assert "only a conversion makes scans level" in description(page)["notes"][1]


def test_the_page_in_python_is_that_of_the_command(tmp_path: Path) -> None:
    page = pc2scan.view(HALL, clouds=3, preset="slam_toolbox", where="ring > 4")
    words = ("--clouds", "3", "--preset", "slam_toolbox", "--where", "ring > 4")
    assert run("view", HALL, "-o", tmp_path / "b.html", *words).status == 0
    same = page.save(tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    assert same
    # Notebooks show it in a frame of its own.
    (document,) = re.findall(r'^<iframe sandbox="allow-scripts" [^>]*srcdoc="([^"]*)"></iframe>$', page._repr_html_())
    assert html.unescape(document) == page.html
