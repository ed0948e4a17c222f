"""``pc2scan map``: a simulated drive through two rooms, mapped, and read back by other people's readers."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from ruamel.yaml import YAML

import pc2scan
from pc2scan.errors import Pc2ScanError, UsageError
from support import HALL
from support.builders import T0, Item, Recording, write_mcap
from support.command import run
from support.scan_recordings import recording as recording_of
from support.scan_recordings import scans as scans_of
from support.worlds.drives import distance_to_wall, drive, drive_recording, is_inside, transform_message

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

CELL = 0.05


@pytest.fixture(scope="module")
def recording() -> Recording:
    return drive_recording()


@pytest.fixture(scope="module")
def source(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mcap(tmp_path_factory.mktemp("drive") / "drive.mcap", recording)


def centres(made: pc2scan.Map, value: int) -> list[tuple[float, float]]:
    rows, columns = np.nonzero(made.cells == value)
    x, y = made.origin[0] + (columns + 0.5) * made.resolution, made.origin[1] + (rows + 0.5) * made.resolution
    return list(zip(x.tolist(), y.tolist(), strict=True))


def test_walls_are_where_they_are(source: Path) -> None:
    made = pc2scan.map(source)
    occupied = centres(made, 100)
    assert len(occupied) > 500
    assert max(distance_to_wall(x, y) for x, y in occupied) < CELL
    free = centres(made, 0)
    assert all(is_inside(x, y) or distance_to_wall(x, y) < CELL for x, y in free)
    # The area that is free is that of the rooms, but for corners that no beam reached.
    area = len(free) * CELL**2
    assert 0.9 < area / (10.05 * 5.01 - 0.36**2) <= 1.0
    assert made.scans == {"/scan": 40}
    assert (made.exit_status, made.warnings, made.skipped) == (0, (), ())


def test_the_way_is_that_of_the_robot(source: Path) -> None:
    made = pc2scan.map(source)
    assert made.robot_frame == "base_link"
    expected = [drive(number / 5)[:2] for number in range(40)]
    np.testing.assert_allclose(made.trajectory, expected, atol=1e-9)
    steps = [math.dist(a, b) for a, b in pairwise(expected)]
    assert made.distance == pytest.approx(sum(steps))


def wrong_cells(made: pc2scan.Map) -> int:
    return sum(distance_to_wall(x, y) > 1.5 * CELL for x, y in centres(made, 100))


def test_beams_are_placed_at_their_own_times(tmp_path: Path) -> None:
    increment = 0.09 / 361
    told, untold = (
        write_mcap(tmp_path / f"{name}.mcap", drive_recording(time_increment=increment, said=said))
        for name, said in (("told", None), ("untold", 0.0))
    )
    assert wrong_cells(pc2scan.map(told)) == 0
    # The robot turns by up to 8 degrees during a scan.
    assert wrong_cells(pc2scan.map(untold)) > 100


def occupancy_of(yaml: Path) -> tuple[NDArray[Any], list[float]]:
    """Read a map by the rule of nav2's map_io and ROS 1's image_loader, with PIL and ruamel."""
    image = pytest.importorskip("PIL.Image")
    said = YAML(typ="safe").load(yaml.read_text("utf-8"))
    assert set(said) == {"image", "mode", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"}
    assert (said["mode"], said["negate"], said["resolution"]) == ("trinary", 0, 0.05)
    with image.open(yaml.parent / said["image"]) as picture:
        assert (picture.format, picture.mode) == ("PPM", "L")
        darkness = (255 - np.asarray(picture).astype(float)) / 255
    free = darkness < said["free_thresh"]
    return np.where(darkness > said["occupied_thresh"], 100, np.where(free, 0, -1))[::-1], said["origin"]


def test_other_readers_read_the_map(source: Path, tmp_path: Path) -> None:
    done = run("map", source, "-o", tmp_path / "my map.yaml")
    assert (done.status, done.stderr) == (0, "")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["my map.pgm", "my map.png", "my map.yaml"]
    cells, origin = occupancy_of(tmp_path / "my map.yaml")
    made = pc2scan.map(source)
    np.testing.assert_array_equal(cells, made.cells)
    assert origin == pytest.approx(made.origin)
    assert made.save(tmp_path / "saved.yaml").with_suffix(".pgm").read_bytes() == (tmp_path / "my map.pgm").read_bytes()


def test_the_picture_alone(source: Path, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    done = run("map", source, "-o", tmp_path / "map.png", "--json")
    assert (done.status, done.stderr) == (0, "")
    assert [path.name for path in tmp_path.iterdir()] == ["map.png"]
    assert json.loads(done.stdout)["preview"] == "by recorded odometry, no SLAM"
    with image.open(tmp_path / "map.png") as picture:
        picture.load()
        assert min(picture.size) > 500
        colours = {colour: count for count, colour in picture.convert("RGB").getcolors(1 << 20)}
    # Free, occupied, and the robot's way.
    assert all(colours[colour] > 500 for colour in ((255, 255, 255), (23, 34, 46), (209, 73, 91)))
    assert pc2scan.map(source).png == (tmp_path / "map.png").read_bytes()


def test_clouds_become_scans_on_the_way(tmp_path: Path) -> None:
    made = pc2scan.map(HALL, preset="slam_toolbox")
    assert made.converted
    pc2scan.convert(HALL, tmp_path / "scans.mcap", preset="slam_toolbox")
    of_scans = pc2scan.map(tmp_path / "scans.mcap")
    assert not of_scans.converted
    np.testing.assert_array_equal(made.cells, of_scans.cells)
    assert made.origin == of_scans.origin


def test_scans_are_drawn_unless_clouds_are_asked_for(tmp_path: Path) -> None:
    both = tmp_path / "both.mcap"
    pc2scan.convert(HALL, both, min_height=-0.4, keep_clouds=True)
    assert pc2scan.map(both).scans == {"/scan": 5}
    assert not pc2scan.map(both).converted
    assert pc2scan.map(both, min_height=-0.3).converted
    assert pc2scan.map(both, topics="/points").converted
    assert not pc2scan.map(both, topics="/scan", min_height=-0.3).converted
    with pytest.raises(UsageError, match="scans and clouds"):
        pc2scan.map(both, topics=["/scan", "/points"])


def test_scans_without_a_place_are_counted(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "late.mcap", drive_recording(beams=91, motion_from=2.0))
    done = run("map", source, "-o", tmp_path / "map.png")
    assert done.status == 3
    assert "skipped: /scan: their stamps are before the first [base_link] in [odom] (10 messages)" in done.stderr
    assert pc2scan.map(source).scans == {"/scan": 30}


def test_a_map_without_end_is_refused(tmp_path: Path) -> None:
    recording = drive_recording(seconds=1.0, beams=91)
    far = {2: transform_message("odom", "base_link", T0 + 600_000_000, drive(0.6)._replace(x=1e6, y=1e6))}
    items = [
        Item(item.stream, item.log_time_ns, far)
        if item.stream.topic == "/tf" and item.log_time_ns == T0 + 600_000_000
        else item
        for item in recording.items
    ]
    source = write_mcap(tmp_path / "jump.mcap", Recording(recording.streams, tuple(items)))
    with pytest.raises(Pc2ScanError, match="at most 67,108,864 cells are possible"):
        pc2scan.map(source)


def test_a_recording_without_transforms(tmp_path: Path) -> None:
    recording = drive_recording(seconds=1.0, beams=91)
    scans = tuple(item for item in recording.items if item.stream.topic == "/scan")
    source = write_mcap(tmp_path / "scans.mcap", Recording(recording.streams[:1], scans))
    done = run("map", source, "-o", tmp_path / "map.png")
    assert done.status == 2
    assert "the recording has no transforms" in done.stderr
    assert "--odom-frame laser draws all scans as if the robot stood still" in done.stderr
    assert run("map", source, "-o", tmp_path / "map.png", "--odom-frame", "laser").status == 0
    drive = write_mcap(tmp_path / "a.mcap", drive_recording(seconds=1.0, beams=91, odom="robot1/odom"))
    assert "hint: --odom-frame robot1/odom draws" in run("map", drive, "-o", tmp_path / "other.png").stderr
    mount = write_mcap(tmp_path / "b.mcap", recording_of({"/scan": scans_of(3)}, [("base_link", "laser")]))
    assert "--odom-topic or --trajectory adds odometry" in run("map", mount, "-o", tmp_path / "other.png").stderr
