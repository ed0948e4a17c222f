"""``pc2scan view`` through the real command: what is written, what is refused, what a page holds."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from support import ROOT
from support.builders import CLOUD, T0, Item, Recording, Stream, cloud, write_mcap
from support.command import run
from support.scan_recordings import recording, scans

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"


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
    assert {frame["name"] for frame in cloud["frames"]} >= {"lidar", "odom"}
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


def proposed(source: Path) -> Any:
    done = run("info", source, "--json")
    (call,) = json.loads(done.stdout)["proposals"]
    return call["options"]


@pytest.mark.parametrize("words", [(), ("--target-frame", "base_link"), ("--preset", "gmapping")])
def test_a_page_opens_with_what_info_proposes(tmp_path: Path, words: tuple[str, ...]) -> None:
    page = tmp_path / "page.html"
    done = run("view", HALL, "-o", page, *words)
    assert "note: The page opens with the heights that pc2scan info proposes: 0.1 to 1.5 m in frame" in done.stdout
    options, held = proposed(HALL), description(page)
    names = ("min_height", "max_height")
    assert {name: options[name] for name in names} == {name: held["params"][name] for name in names}
    assert held["targetFrame"] == options["target_frame"] == "base_link"
    assert held["topics"][0]["heights"] == {name: options[name] for name in names}


@pytest.mark.parametrize("words", [("--max-height", "3"), ("--param", "max_height:=3"), ("--target-frame", "odom")])
def test_a_page_opens_with_what_is_asked_for(tmp_path: Path, words: tuple[str, str]) -> None:
    page = tmp_path / "page.html"
    done = run("view", HALL, "-o", page, *words)
    assert done.status == 0, done.stderr
    held = description(page)
    name = words[1] if words[0] == "--target-frame" else ""
    assert held["targetFrame"] == name
    assert held["params"]["max_height"] == 3 or name


def test_the_cut_is_the_pages_too(tmp_path: Path) -> None:
    page, scans_made = tmp_path / "page.html", tmp_path / "scans.json"
    cut = ("--start", "0.15", "--end", "0.35")
    assert run("view", HALL, "-o", page, *cut).status == 0
    (topic,) = description(page)["topics"]
    assert run("convert", HALL, "-o", tmp_path / "scans.mcap", "--report", scans_made, *cut).status == 0
    converted = next(t for t in json.loads(scans_made.read_text())["topics"] if t["action"] == "converted")
    assert 0 < len(topic["clouds"]) == converted["messages_out"] < 5


def test_a_page_of_scans_says_what_check_says(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "scans.mcap", recording({"/scan": scans(20)}))
    assert run("view", source, "-o", tmp_path / "page.html", "--clouds", "4").status == 0
    held = description(tmp_path / "page.html")
    assert held["kind"] == "scans"
    assert len(held["moments"]) == 4
    assert held["findings"][0]["heading"] == "pc2scan check: /scan"
    assert {"text": "slam_toolbox: accepted", "wrong": False} in held["findings"][0]["lines"]


@pytest.mark.slow
def test_ten_large_clouds_make_a_page_of_less_than_15_mb(tmp_path: Path) -> None:
    rng = np.random.default_rng(10)
    stream = Stream("/points", CLOUD)
    # Noise does not compress: no lidar is as bad.
    clouds = [rng.normal(0, 10, (131_072, 4)).astype(np.float32) for _ in range(10)]
    items = [
        Item(
            stream,
            T0 + n * 100_000_000,
            {2: cloud(points, 2, stamp_ns=T0 + n * 100_000_000, names=("x", "y", "z", "intensity"))},
        )
        for n, points in enumerate(clouds)
    ]
    source = write_mcap(tmp_path / "large.mcap", Recording((stream,), tuple(items)))
    page = tmp_path / "page.html"
    done = run("view", source, "-o", page)
    assert done.status == 0
    assert page.stat().st_size < 15_000_000
    assert "1 of 2 points is shown" in done.stdout
    held = description(page)
    assert "1 of 2 points is shown" in held["notes"][-1]
    (topic,) = held["topics"]
    assert [(entry["total"], entry["data"]["length"]) for entry in topic["clouds"]] == [(131_072, 65_536)] * 10
    # Fewer are shown whole.
    assert run("view", source, "-o", page, "--clouds", "4").stderr == ""


def test_deskewing_is_shown_and_stays_in_the_command(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    done = run("view", HALL, "-o", page, "--deskew", "--fixed-frame", "odom", "--target-frame", "base_link")
    assert done.status == 0, done.stderr
    held = description(page)
    assert "deskewed" in held["notes"][1]
    assert [*held["command"][-3:]] == ["--deskew", "--fixed-frame", "odom"]
    run("view", HALL, "-o", page, "--level", "--fixed-frame", "odom", "--target-frame", "base_link")
    assert "only a conversion makes scans level" in description(page)["notes"][1]
