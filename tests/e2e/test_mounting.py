"""How clouds are mounted, and which heights suit them: what the real command says, and that its advice works."""

from __future__ import annotations

import json
import math
import shlex
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from e2e.command import run
from e2e.outputs import opened
from mounted_worlds import PLACES, cloud, mounted, write_clouds
from pc2scan.core.rigid import Rigid
from support import RECORDINGS, ROOT, needs_shared

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


@pytest.mark.parametrize("case", MOUNTINGS)
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
    [
        ("d435_depth.mcap", 0.0, "is an optical frame: z points forward, and up is -y"),
        ("luminar_highway.bag", -3.7, ""),
        ("ouster_os1_32.mcap", -1.85, ""),
        ("velodyne_vlp32.bag", -0.3, ""),
    ],
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
