"""How clouds are mounted, and which heights suit them: what the real command says, and that its advice works."""

from __future__ import annotations

import json
import math
import shlex
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.core.params import ProjectionParams
from pc2scan.core.rigid import Rigid
from pc2scan.pipeline.options import ConvertOptions
from pc2scan.pipeline.run import OutputOptions
from pc2scan.pipeline.run import run as convert
from pc2scan.pipeline.scan_spec import ScanSpec
from support import RECORDINGS, ROOT, needs_shared, sampled
from support.command import run
from support.outputs import opened
from support.worlds.mounted import PLACES, cloud, mounted, write_clouds

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from pc2scan.core.rigid import TransformRow

HALL = ROOT / "fixtures" / "hall.bag"


def recorded(
    path: Path,
    roll: float = 0.0,
    pitch: float = 0.0,
    *,
    place: str = "hall",
    sensor: str = "32 rings",
    height: float = 0.6,
    tf: Sequence[TransformRow] = (),
) -> Path:
    """Three clouds of a robot that drives, with a sensor that is mounted so, degrees."""
    rotation = mounted(roll, pitch, optical="optical" in sensor)
    clouds = [cloud(PLACES[place], sensor, rotation, height, stand) for stand in range(3)]
    return write_clouds(path, clouds, tf=tf)


def transform(parent: str, child: str, rpy: Sequence[float], xyz: Sequence[float]) -> TransformRow:
    """A transform with angles in degrees."""
    roll, pitch, yaw = (math.radians(angle) for angle in rpy)
    rigid = Rigid.from_rpy(roll, pitch, yaw, xyz)
    return (parent, child, 1_700_000_000_000_000_000, *rigid.pose)


def mounting(*args: str | Path) -> dict[str, Any]:
    done = run("info", *args, "--json")
    assert done.status == 0, done.stderr
    (found,) = json.loads(done.stdout)["clouds"]
    return dict(found["mounting"])


def ready(stdout: str) -> list[str]:
    """The command that `info` shows, as a shell splits it."""
    lines = stdout.splitlines()
    (line,) = lines[lines.index("ready to convert:") + 1 :]
    words = shlex.split(line)
    assert words[:2] == ["pc2scan", "convert"]
    return words[1:]


MOUNTINGS: dict[str, tuple[dict[str, Any], str]] = {
    "tilted": ({"roll": 15, "pitch": -10}, "frame 'lidar' is tilted by 17.9 deg"),
    "upside down": ({"roll": 180, "sensor": "16 rings"}, "frame 'lidar' is upside down: the ground is 0.5"),
    "optical": ({"pitch": 20, "sensor": "camera, optical"}, "frame 'lidar' is an optical frame: z points forward"),
    "outdoors": ({"pitch": 25, "place": "field", "height": 1.8}, "frame 'lidar' is tilted by 25"),
}


@pytest.mark.parametrize("case", sampled(MOUNTINGS, 1))
def test_a_frame_that_is_not_level_is_reported_with_what_makes_it_level(case: str, tmp_path: Path) -> None:
    arguments, told = MOUNTINGS[case]
    source = recorded(tmp_path / "drive it.mcap", **arguments)
    done = run("info", source)
    assert done.status == 0
    assert f"warning: /points: {told}" in done.stderr
    assert "--static-tf 'lidar_level lidar 0 0 " in done.stderr
    assert "--target-frame lidar_level makes it level, with the floor at z = 0 m" in done.stderr
    command = ready(done.stdout)
    converted = run(*command, "-o", tmp_path / "out.mcap")
    assert (converted.status, converted.stderr) == (0, "")
    assert all(np.isfinite(scan.ranges).any() for scan in opened(tmp_path / "out.mcap").scans())
    # In the frame that these options make, nothing is wrong, and the floor is where they say.
    frames = command[command.index("--static-tf") : command.index("--min-height")]
    again = run("info", source, *frames)
    assert again.stderr == ""
    found = mounting(source, *frames)
    assert found["ground"]["kind"] == "level"
    assert found["heights"]["floor"] == pytest.approx(0, abs=0.05)


def test_a_frame_of_the_transforms_that_is_level_is_the_cure(tmp_path: Path) -> None:
    tf = [transform("base_link", "lidar", (15, -10, 30), (0.2, 0, 0.6))]
    source = recorded(tmp_path / "a.mcap", 15, -10, tf=tf)
    done = run("info", source)
    assert "frame 'lidar' is tilted by 17.9 deg" in done.stderr
    assert done.stderr.endswith(". --target-frame base_link makes it level\n")
    command = ready(done.stdout)
    assert command[-6:] == ["--target-frame", "base_link", "--min-height", "0.1", "--max-height", "1.5"]
    assert run(*command, "-o", tmp_path / "out.mcap").stderr == ""
    assert "heights (z) in base_link" in run("info", source, "--target-frame", "base_link").stdout


def test_a_transform_that_is_wrong_is_replaced_where_the_sensor_is(tmp_path: Path) -> None:
    tf = [transform("base_link", "lidar", (0, 0, 0), (0.2, 0.1, 0.6))]
    source = recorded(tmp_path / "a.mcap", 20, 0, tf=tf)
    for args in ((), ("--target-frame", "base_link")):
        done = run("info", source, *args)
        assert "is tilted by 20." in done.stderr
        assert "--static-tf 'base_link lidar 0.2 0.1 0.6 0.3" in done.stderr
        command = ready(done.stdout)
        frames = command[command.index("--static-tf") : command.index("--min-height")]
        assert run("info", source, *frames).stderr == ""
        assert mounting(source, *frames)["heights"]["floor"] == pytest.approx(0, abs=0.05)


def test_what_transforms_tell_where_clouds_cannot(tmp_path: Path) -> None:
    # Floor and ceiling are both in view: upside down is as likely as not.
    source = recorded(tmp_path / "a.mcap", 180, sensor="128 rings")
    assert run("info", source).stderr == ""
    tf = [transform("base_footprint", "lidar", (180, 0, 0), (0, 0, 0.6))]
    done = run("info", recorded(tmp_path / "b.mcap", 180, sensor="128 rings", tf=tf))
    assert "frame 'lidar' is upside down according to its transform to 'base_footprint'" in done.stderr
    assert "floor at z = 0.00 m in frame 'base_footprint', ceiling at 3.00 m" in done.stdout


def test_level_clouds_are_not_warned_of(tmp_path: Path) -> None:
    done = run("info", HALL)
    assert done.stderr == ""
    assert "floor at z = 0.01 m in frame 'base_link'; the sensor is 0.59 m above the floor" in done.stdout
    assert ready(done.stdout)[1:4] == [str(HALL), "--target-frame", "base_link"]
    source = recorded(tmp_path / "a.mcap", sensor="128 rings")
    done = run("info", source)
    assert done.stderr == ""
    assert "floor at z = -0.60 m in frame 'lidar', ceiling at 2.40 m; the sensor is 0.60 m above" in done.stdout
    assert ready(done.stdout) == ["convert", str(source), "--min-height", "-0.5", "--max-height", "0.9"]


def test_a_topic_that_is_taken_is_avoided_and_several_are_named(tmp_path: Path) -> None:
    source = recorded(tmp_path / "a.mcap")
    first = run("convert", source, "-o", tmp_path / "b.mcap", "--keep-clouds", "--min-height", "-0.5")
    assert first.status == 0
    command = ready(run("info", tmp_path / "b.mcap").stdout)
    assert command[2:4] == ["--topic", "/points:=/points/scan"]
    done = run(*command, "-o", tmp_path / "c.mcap")
    assert done.status == 0, done.stderr


@needs_shared
@pytest.mark.parametrize(
    ("name", "floor", "warned"),
    sampled(
        [
            ("velodyne_vlp32.bag", -0.3, ""),
            ("d435_depth.mcap", 0.0, "is an optical frame: z points forward, and up is -y"),
            ("luminar_highway.bag", -3.7, ""),
            ("ouster_os1_32.mcap", -1.85, ""),
        ],
        1,
    ),
)
def test_real_recordings(name: str, floor: float, warned: str, tmp_path: Path) -> None:
    done = run("info", RECORDINGS / name)
    assert warned in done.stderr
    assert bool(done.stderr) == bool(warned)
    found = mounting(RECORDINGS / name)
    assert found["heights"]["floor"] == pytest.approx(floor, abs=0.4)
    converted = run(*ready(done.stdout), "-o", tmp_path / "out.mcap", "--report", tmp_path / "report.json")
    assert converted.status == 0, converted.stderr
    (topic,) = [t for t in json.loads((tmp_path / "report.json").read_text())["topics"] if t["action"] == "converted"]
    assert topic["empty_scans"] == 0
    assert topic["points"]["used"] > 0.05 * topic["points"]["total"]


@pytest.mark.parametrize("case", sampled(reversed(MOUNTINGS), 1))
def test_convert_says_what_makes_a_frame_level(case: str, tmp_path: Path) -> None:
    arguments, told = MOUNTINGS[case]
    source = recorded(tmp_path / "a.mcap", **arguments)
    done = run("convert", source, "-o", tmp_path / "b.mcap", "--min-height", "-5", "--max-height", "5")
    assert f"warning: /points: {told}" in done.stderr
    cure = done.stderr.split("normal (0, 0, 1). ")[-1].split("z up. ")[-1].split("expected (0, 0, 1). ")[-1]
    options = shlex.split(cure.split(" makes it level")[0])
    assert options[0] == "--static-tf"
    again = run("convert", source, "-o", tmp_path / "c.mcap", *options, "--min-height", "0.1", "--max-height", "1.5")
    assert (again.status, again.stderr) == (0, "")
    # In a target frame that is not level itself, it is that one which is judged.
    wrong = ("--static-tf", "base_link lidar 0 0 0.5 0 0 0", "--target-frame", "base_link")
    third = run("convert", source, "-o", tmp_path / "d.mcap", *wrong, "--min-height", "-5", "--max-height", "5")
    assert "frame 'base_link' is " in third.stderr
    assert "--static-tf 'base_link lidar 0 0 0.5 " in third.stderr


def test_convert_finds_the_frame_that_is_level(tmp_path: Path) -> None:
    tf = [transform("base_link", "lidar", (15, -10, 30), (0.2, 0, 0.6))]
    source = recorded(tmp_path / "a.mcap", 15, -10, tf=tf)
    done = run("convert", source, "-o", tmp_path / "b.mcap", "--min-height", "-0.5")
    assert "tilted by 17.9 deg" in done.stderr
    assert "--target-frame base_link makes it level" in done.stderr
    assert "--static-tf" not in done.stderr
    frames = ("--target-frame", "base_link", "--min-height", "0.1")
    assert run("convert", source, "-o", tmp_path / "c.mcap", *frames).stderr == ""


def test_heights_that_suit_the_clouds_are_computed_from_them(tmp_path: Path) -> None:
    source = recorded(tmp_path / "a.mcap", place="field", height=1.8)
    done = run("convert", source, "-o", tmp_path / "b.mcap")
    assert "drops everything at z <= 0; --min-height sets it below the sensor: --min-height -1.5" in done.stderr
    words = shlex.split(done.stderr.rsplit("below the sensor: ", 1)[1])
    heights = run("convert", source, "-o", tmp_path / "c.mcap", *words)
    assert (heights.status, heights.stderr) == (0, "")
    preset = run("convert", source, "-o", tmp_path / "d.mcap", "--preset", "slam_toolbox")
    assert "note: /points: no heights are given, presets leave them to you" in preset.stdout
    assert f"these suit the clouds: {shlex.join(words)}" in preset.stdout
    quiet = run("convert", source, "-o", tmp_path / "e.mcap", "--preset", "slam_toolbox", *words)
    assert "no heights are given" not in quiet.stdout


@pytest.mark.parametrize(
    "options",
    [("--exclude-box", "base_link -0.4 0.4 -0.3 0.3 0 1"), ("--every", "0.1", "--fixed-frame", "odom")],
    ids=lambda options: options[0],
)
def test_heights_are_advised_with_the_frame_that_they_are_in(options: Sequence[str], tmp_path: Path) -> None:
    """Transforms that something else needs tell where the body is: its heights do not suit the lidar's frame."""
    told = run("convert", HALL, "-o", tmp_path / "a.mcap", *options)
    words = shlex.split(told.stderr.rsplit("below the sensor: ", 1)[1])
    assert words == ["--target-frame", "base_link", "--min-height", "0.1", "--max-height", "1.5"]
    done = run("convert", HALL, "-o", tmp_path / "b.mcap", *options, *words)
    assert (done.status, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("args", "told"),
    [
        (
            ("--min-height", "3", "--max-height", "9"),
            "of the first 3 clouds are used; min_height is 3 m and max_height 9 m, but z in 'lidar' is -0.6",
        ),
        (
            ("--min-height", "-0.3", "--range-min", "50"),
            "range_min is 50 m and range_max without limit, but the range is ",
        ),
        (
            ("--min-height", "300", "--max-height", "1500"),
            "min_height is 300 m and max_height is 1500 m, but z on /points is -0.6",
        ),
        (
            ("--min-height", "-300", "--max-height", "500"),
            "heights are metres; if these are millimetres, --min-height -0.3 --max-height 0.5",
        ),
    ],
)
def test_limits_that_do_not_suit_the_clouds(args: Sequence[str], told: str, tmp_path: Path) -> None:
    done = run("convert", recorded(tmp_path / "a.mcap"), "-o", tmp_path / "b.mcap", *args)
    assert told in done.stderr


@pytest.mark.parametrize("limit", sampled(["1000", "100", "999"], 1))
def test_no_limit_is_no_mistaken_unit(limit: str, tmp_path: Path) -> None:
    args = ("--min-height", f"-{limit}", "--max-height", limit)
    assert "metres" not in run("convert", recorded(tmp_path / "a.mcap"), "-o", tmp_path / "b.mcap", *args).stderr


@pytest.mark.parametrize(
    ("args", "warning"),
    [
        (("--min-height", "-1"), "the floor is within the heights: it is at z = -0.60 m in 'lidar', and min_height"),
        (("--target-frame", "base_link"), "it is at z = 0.00 m in 'base_link', and min_height is above 0 m; 53% of"),
        (("--min-height", "-1", "--ground", "remove"), ""),
        (("--min-height", "-0.5"), ""),
        (("--min-height", "-1", "--max-height", "-0.7"), ""),
    ],
)
def test_a_floor_within_the_heights(args: Sequence[str], warning: str, tmp_path: Path) -> None:
    done = run("convert", HALL, "-o", tmp_path / "a.mcap", *args)
    assert done.status in {0, 4}
    assert warning in done.stderr
    assert ("the floor is within the heights" in done.stderr) is bool(warning)
    if warning:
        words = shlex.split(done.stderr.rsplit("; without it: ", 1)[1])
        assert run("convert", HALL, "-o", tmp_path / "b.mcap", *args, *words).stderr == ""


@pytest.mark.parametrize("place", sampled(PLACES, 2))
def test_the_advised_heights_draw_no_warning_of_a_floor(place: str, tmp_path: Path) -> None:
    for height in PLACES[place].heights:
        source = recorded(tmp_path / f"{height}.mcap", place=place, height=height)
        (found,) = pc2scan.info(source).clouds
        if found.mounting is None or found.mounting.fault or found.mounting.heights is None:
            continue
        low, high = found.mounting.heights[:2]
        report = pc2scan.convert(source, tmp_path / f"{height}_scan.mcap", min_height=low, max_height=high)
        assert not [text for text in report.warnings if "the floor" in text]


def test_scans_of_a_frame_that_the_robot_moves_in(tmp_path: Path) -> None:
    args = ("--min-height", "0.1", "--target-frame")
    done = run("convert", HALL, "-o", tmp_path / "a.mcap", *args, "odom")
    assert "warning: --target-frame is odom, in which base_link moves (by 0.32 m): the scans are meas" in done.stderr
    words = shlex.split(done.stderr.rsplit("expect; ", 1)[1])
    assert words == ["--target-frame", "base_link"]
    assert run("convert", HALL, "-o", tmp_path / "b.mcap", *args[:2], *words).stderr == ""
    done = run("convert", HALL, "-o", tmp_path / "c.mcap", *args, "odom", "--deskew", "--fixed-frame", "odom")
    assert "warning: --target-frame is odom" in done.stderr
    assert "no transform that moves" not in done.stderr


@needs_shared
@pytest.mark.parametrize(
    ("name", "frame", "height"),
    sampled([("velodyne_vlp32.bag", "velodyne_front", "0.3"), ("ouster_os1_32.mcap", "os_lidar", "1.8")], 1),
)
def test_a_static_transform_in_the_wrong_order(name: str, frame: str, height: str, tmp_path: Path) -> None:
    args = ("--target-frame", "base_link", "--min-height", "0.1", "--static-tf")
    done = run("convert", RECORDINGS / name, "-o", tmp_path / "a.mcap", *args, f"{frame} base_link 0 0 {height} 0 0 0")
    warning = f"--static-tf from {frame} to base_link puts the sensor {float(height):.2f} m below base_link, and"
    assert warning in done.stderr
    words = shlex.split(done.stderr.split("the parent comes first: ")[1].split(" puts")[0])
    assert words == ["--static-tf", f"base_link {frame} 0 0 {height} 0 0 0"]
    done = run("convert", RECORDINGS / name, "-o", tmp_path / "b.mcap", *args[:-1], *words)
    assert done.status == 0
    assert "static" not in done.stderr


@pytest.mark.parametrize("tf", [(), (("base_link", "lidar", (0, 0, 90), (0.3, 0.1, 0.6)),)], ids=["own", "moved"])
def test_points_at_the_sensor(tf: Sequence[Any], tmp_path: Path) -> None:
    """Drivers write (0, 0, 0) for no return: without a word it would be an obstacle."""
    points = cloud(PLACES["hall"], "32 rings", mounted(0, 0), 0.6)
    points[::50] = 0
    source = write_clouds(tmp_path / "a.mcap", [points], tf=[transform(*each) for each in tf])
    args = ("--target-frame", "base_link", "--min-height", "0.2") if tf else ("--min-height", "-0.4")
    done = run("convert", source, "-o", tmp_path / "b.mcap", *args)
    number = len(points[::50])
    at = "0.32 m in 'base_link'" if tf else "0.00 m in 'lidar'"
    assert f"/points: {number:,} of {len(points):,} points of a cloud are at (0, 0, 0), as drivers" in done.stderr
    assert f"at a range of {at}; " in done.stderr
    words = shlex.split(done.stderr.split(f"{at}; ")[1].split(" excludes them")[0])
    again = run("convert", source, "-o", tmp_path / "c.mcap", *args, *words)
    assert (again.status, again.stderr) == (0, "")
    # The command that `info` proposes excludes them, too, and counts them in any frame.
    shown = run("info", source, *args[: 2 if tf else 0]).stdout
    assert "(0, 0, 0) 2.0%" in shown
    assert shown.endswith(f"{shlex.join(words)}\n")


def test_the_warning_comes_after_the_first_clouds(tmp_path: Path) -> None:
    tilted = cloud(PLACES["hall"], "32 rings", mounted(20, 0), 0.6)
    level = cloud(PLACES["hall"], "32 rings", mounted(0, 0), 0.6)
    source = write_clouds(tmp_path / "a.mcap", [tilted] * 4 + [level] * 150)
    told: list[tuple[str, int]] = []
    read = [0]

    def progress(done: int, total: int, messages: int) -> None:
        assert done <= total
        read[0] = messages

    options = ConvertOptions(scans=(ScanSpec(params=ProjectionParams(min_height=-0.5)),))
    report = convert(
        [source],
        tmp_path / "b.mcap",
        options,
        OutputOptions(),
        progress=progress,
        warn=lambda text: told.append((text, read[0])),
    )
    ((text, after),) = told
    assert "tilted by 20" in text
    assert after < 100
    assert text in report.warnings
    # Whatever the number of threads.
    for jobs in (1, 4):
        again = run("convert", source, "-o", tmp_path / f"{jobs}.mcap", "--min-height", "-0.5", "-j", str(jobs))
        assert again.stderr.count("tilted by 20") == 1


@needs_shared
@pytest.mark.parametrize(
    ("name", "heights"),
    sampled(
        [
            ("velodyne_vlp32.bag", (-0.2, 1.2)),
            ("luminar_highway.bag", (-4.2, -1.5)),
            ("ouster_os1_32.mcap", (-1.7, 0.5)),
        ],
        1,
    ),
)
def test_real_recordings_get_heights_of_their_own(name: str, heights: tuple[float, float], tmp_path: Path) -> None:
    done = run("convert", RECORDINGS / name, "-o", tmp_path / "a.mcap")
    assert "tilted" not in done.stderr
    assert "upside down" not in done.stderr
    words = shlex.split(done.stderr.rsplit("below the sensor: ", 1)[1])
    low, high = float(words[1]), float(words[3])
    assert heights[0] <= low < high <= heights[1]
    done = run("convert", RECORDINGS / name, "-o", tmp_path / "b.mcap", *words)
    assert (done.status, done.stderr) == (0, "")


def test_check_finds_scans_in_a_frame_that_is_not_level(tmp_path: Path) -> None:
    source = recorded(tmp_path / "a.mcap", 20, 0)
    common = ("--keep-clouds", "--preset", "slam_toolbox", "--min-height")
    assert run("convert", source, "-o", tmp_path / "b.mcap", *common, "-0.3").status == 0
    done = run("check", tmp_path / "b.mcap")
    assert "defect: the scan's frame 'lidar' is tilted by 20." in done.stdout
    assert "pc2scan convert with --static-tf 'lidar_level lidar 0 0 0." in done.stdout
    frames = ("--static-tf", "lidar_level lidar 0 0 0.6 0.349 0 0", "--target-frame", "lidar_level")
    done = run("convert", source, "-o", tmp_path / "c.mcap", *common, "0.1", *frames, "--write-static-tf")
    assert done.status == 0
    assert "tilted" not in run("check", tmp_path / "c.mcap").stdout
