"""The page in a real browser: what a user sees and does, and what a hostile recording cannot do."""

from __future__ import annotations

import shlex
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.bags.opening import open_recording
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan
from show.browser import needs_chromium
from support import HALL
from support.builders import CLOUD, T0, Item, Recording, Stream, cloud, write_mcap
from support.command import run
from support.scan_recordings import GOOD, recording, scans

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from show.browser import Tab

pytestmark = [needs_chromium, pytest.mark.slow]


@pytest.fixture
def opened(browser: Any, tmp_path: Path) -> Iterator[Callable[..., Tab]]:
    """Returns the page of a recording, with options; at the end nothing may have gone wrong in it."""
    tabs: list[Tab] = []

    def view(source: Path, *words: str, window: tuple[Any, ...] = ()) -> Tab:
        assert run("view", source, "-o", tmp_path / "page.html", *words).status == 0
        tabs.append(browser(*window))
        tabs[-1].open(tmp_path / "page.html")
        return tabs[-1]

    yield view
    for tab in tabs:
        tab.assert_quiet()
        tab.page.close()


@pytest.fixture
def hall(opened: Callable[..., Tab]) -> Tab:
    return opened(HALL, "--min-height=-0.3", "--max-height=1")


def first_scan(path: Path) -> LaserScan:
    with closing(open_recording(path)) as reader:
        message = next(m for m in reader.messages() if m.connection.ros_type == LASERSCAN)
        return decode_laserscan(message.data, message.connection.serialization)


def ranges(tab: Tab) -> Any:
    found: list[str] = tab.call("window.pc2scan.scan().ranges")
    return np.array([float(text.replace("Infinity", "inf")) for text in found], np.float32)


def command_to(tab: Tab, destination: Path) -> list[str]:
    """The command line that the page hands back, with another destination."""
    words = shlex.split(tab.call("window.pc2scan.command()"))
    words[words.index("-o") + 1] = str(destination)
    return words


def test_the_command_line_makes_what_the_page_shows(hall: Tab, tmp_path: Path) -> None:
    hall.page.fill("#param-max_height", "0.5")
    hall.page.fill("#param-beams", "90")
    hall.page.select_option("#param-geometry", "centered")
    hall.page.fill("#mount-z", "0.75")
    hall.page.fill("#mount-pitch", "2")
    words = command_to(hall, tmp_path / "scans.mcap")
    assert words[:3] == ["pc2scan", "convert", str(HALL)]
    shown = ranges(hall)
    done = run(*words[1:], "--only-scans", "--overwrite")
    assert done.status in (0, 3), done.stderr
    first = first_scan(tmp_path / "scans.mcap")
    assert len(shown) == 90
    assert np.array_equal(first.ranges, shown, equal_nan=True)
    assert first.frame_id == "base_link"


@pytest.mark.parametrize("ros", [1, 2])
def test_the_parameter_files_mean_what_the_page_shows(hall: Tab, tmp_path: Path, ros: int) -> None:
    hall.page.select_option("#param-preset", "gmapping")
    hall.page.fill("#param-range_max", "3.5")
    (tmp_path / "params.yaml").write_text(hall.call("(ros) => window.pc2scan.file(ros)", ros))
    done = run("convert", HALL, "-o", tmp_path / "s.mcap", "--only-scans", "--params-file", tmp_path / "params.yaml")
    assert done.status == 0, done.stderr
    shown = ranges(hall)
    assert np.array_equal(first_scan(tmp_path / "s.mcap").ranges, shown, equal_nan=True)


def test_nothing_overflows_in_a_small_window(opened: Callable[..., Tab]) -> None:
    tab = opened(HALL, window=(420, 800, "dark"))
    assert tab.call("document.documentElement.scrollWidth") <= 420
    assert tab.call("getComputedStyle(document.body).color") == "rgb(228, 234, 240)"
    # Something is drawn in every view: a canvas is not of one colour.
    for name in ("top", "side", "orbit"):
        assert tab.call(COLOURS, name) >= 3


COLOURS = """(name) => {
  const canvas = document.querySelector(`#${name} canvas`);
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  return new Set(new Uint32Array(data.buffer)).size;
}"""


HOSTILE = (
    '"></script><script>document.title="taken"</script><img src=x onerror="document.title=\'taken\'">\u202e\x1b[31m'
)


def test_a_hostile_recording_runs_nothing(opened: Callable[..., Tab], tmp_path: Path) -> None:
    topic = "/" + HOSTILE
    stream = Stream(topic, CLOUD)
    points = np.array([[1, 3e38, 0, 1], [2, 3e38, 1, 2], [np.nan, 0, 0, 3], [np.inf, 0, 0, 4]], np.float32)
    names = ("x", "y", "z", HOSTILE)
    data = {version: cloud(points, version, frame_id=HOSTILE, names=names) for version in (1, 2)}
    source = write_mcap(tmp_path / "hostile.mcap", Recording((stream,), (Item(stream, T0, data),)))
    tab = opened(source)
    assert "taken" not in tab.page.title()
    assert tab.call("document.querySelectorAll('script').length") == 3
    assert tab.call("document.querySelectorAll('img').length") == 0
    tab.page.select_option("#colour", index=2)
    tab.page.mouse.move(200, 300)


def test_scans_are_read_back_as_recorded(opened: Callable[..., Tab], tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "scans.mcap", recording({"/scan": scans(3), "/other": scans(3)}))
    tab = opened(source)
    found = tab.call("window.pc2scan.layers()")
    assert [layer["name"] for layer in found] == ["/other (laser)", "/scan (laser)"]
    assert [float(text) for text in found[0]["ranges"]] == GOOD.ranges.tolist()
    assert "accepted" in tab.page.inner_text("#panel")


def test_filters_are_counted_and_coloured_and_in_the_command(opened: Callable[..., Tab], tmp_path: Path) -> None:
    filters = ["--where", "ring > 4", "--exclude-box", "lidar -1 6 0 4 -1 1", "--min-height-slope", "0.1"]
    tab = opened(HALL, "--min-height=-0.3", *filters)
    shown = ranges(tab)
    words = command_to(tab, tmp_path / "scans.mcap")
    done = run(*words[1:], "--only-scans", "--report", tmp_path / "report.json")
    assert done.status == 0, done.stderr
    assert np.array_equal(first_scan(tmp_path / "scans.mcap").ranges, shown, equal_nan=True)
    assert tab.call("window.pc2scan.scan().counts[6]") > 100
    assert "rejected by filters" in tab.page.inner_text("#panel")
