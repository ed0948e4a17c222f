"""How clouds are mounted, and which heights suit them: what the real command says, and that its advice works."""

from __future__ import annotations

import json
import math
import re
import shlex
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.core.rigid import Rigid
from support import RECORDINGS, needs_shared, sampled
from support.command import run
from support.outputs import opened
from support.worlds.mounted import PLACES, cloud, mounted, write_clouds

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from pc2scan.core.rigid import TransformRow


def transform(parent: str, child: str, rpy: Sequence[float], xyz: Sequence[float]) -> TransformRow:
    """A transform with angles in degrees."""
    roll, pitch, yaw = (math.radians(angle) for angle in rpy)
    rigid = Rigid.from_rpy(roll, pitch, yaw, xyz)
    return (parent, child, 1_700_000_000_000_000_000, *rigid.pose)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Record three clouds of a robot that drives, with a sensor that is mounted so, degrees; and each only once."""

    @cache
    def written(
        roll: float = 0.0,
        pitch: float = 0.0,
        *,
        place: str = "hall",
        sensor: str = "32 rings",
        height: float = 0.6,
        tf: tuple[TransformRow, ...] = (),
        name: str = "a.mcap",
    ) -> Path:
        rotation = mounted(roll, pitch, optical="optical" in sensor)
        clouds = [cloud(PLACES[place], sensor, rotation, height, stand) for stand in range(3)]
        return write_clouds(tmp_path_factory.mktemp("mounted") / name, clouds, tf=tf)

    return written


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


TILTED = (transform("base_link", "lidar", (15, -10, 30), (0.2, 0, 0.6)),)
WRONG = (transform("base_link", "lidar", (0, 0, 0), (0.2, 0.1, 0.6)),)
MOUNTINGS: dict[str, tuple[dict[str, Any], str]] = {
    "tilted": ({"roll": 15, "pitch": -10}, "frame 'lidar' is tilted by 17.9 deg"),
    "upside down": ({"roll": 180, "sensor": "16 rings"}, "frame 'lidar' is upside down: the ground is 0.5"),
    "optical": ({"pitch": 20, "sensor": "camera, optical"}, "frame 'lidar' is an optical frame: z points forward"),
    "outdoors": ({"pitch": 25, "place": "field", "height": 1.8}, "frame 'lidar' is tilted by 25"),
    "by a wrong transform": ({"roll": 20, "tf": WRONG}, "is tilted by 20."),
}


@pytest.mark.parametrize("case", sampled(MOUNTINGS, 1))
def test_info_says_what_makes_a_frame_level(case: str, recorded: Callable[..., Path], tmp_path: Path) -> None:
    arguments, told = MOUNTINGS[case]
    source = recorded(**arguments, name="drive it.mcap")
    own = ("--target-frame", "base_link") if "tf" in arguments else ()
    done = run("info", source, *own)
    assert (done.status, told in done.stderr) == (0, True)
    if own:
        assert '--static-tf "base_link lidar 0.2 0.1 0.6 0.3' in done.stderr
    else:
        assert f"warning: /points: {told}" in done.stderr
        assert '--static-tf "lidar_level lidar 0 0 ' in done.stderr
        assert "--target-frame lidar_level makes it level, with the floor at z = 0 m" in done.stderr
    command = ready(done.stdout)
    converted = run(*command, "-o", tmp_path / "out.mcap")
    assert (converted.status, converted.stderr) == (0, "")
    assert all(np.isfinite(scan.ranges).any() for scan in opened(tmp_path / "out.mcap").scans())
    # In the frame that these options make, nothing is wrong, and the floor is where they say.
    frames = command[command.index("--static-tf") : command.index("--min-height")]
    assert run("info", source, *frames).stderr == ""
    found = mounting(source, *frames)
    assert found["ground"]["kind"] == "level"
    assert found["heights"]["floor"] == pytest.approx(0, abs=0.05)


@pytest.mark.parametrize(("roll", "height", "warned"), [(0, 1.9, False), (180, 0.4, True)])
def test_a_low_ceiling_is_told_from_the_floor_by_transforms(
    roll: float, height: float, warned: bool, recorded: Callable[..., Path], tmp_path: Path
) -> None:
    """The two clouds of a garage of 2.3 m look alike."""
    tf = (transform("base_link", "lidar", (roll, 0, 0), (0, 0, height)),)
    source = recorded(roll, place="garage", sensor="16 rings", height=height, tf=tf)
    done = run("convert", source, "-o", tmp_path / "a.mcap", "--min-height", "-0.3", "--max-height", "0.3")
    assert (done.status, "upside down according to its" in done.stderr, not done.stderr) == (0, warned, not warned)


@pytest.mark.parametrize(("roll", "parent"), [(65, "base_link"), (90, "base_link"), (20, "mast")])
def test_a_transform_says_which_plane_is_the_floor(roll: int, parent: str, recorded: Callable[..., Path]) -> None:
    tf = (transform(parent, "lidar", (roll, 0, 0), (0, 0, 0.6)),)
    found = mounting(recorded(roll, place="corridor" if roll == 90 else "hall", tf=tf))
    assert (found["target_frame"], found["fault"][:12]) == (parent, f"tilted by {roll}")


REAL = [
    ("velodyne_vlp32.bag", -0.3, ""),
    ("d435_depth.mcap", 0.0, "is an optical frame: z points forward, and up is -y"),
    ("luminar_highway.bag", -3.1, "18,333 days ahead"),
    ("ouster_os1_32.mcap", -1.85, ""),
]


@needs_shared
@pytest.mark.parametrize(("name", "floor", "warned"), sampled(REAL, 1))
def test_real_recordings_get_heights_of_their_own(name: str, floor: float, warned: str, tmp_path: Path) -> None:
    done = run("info", RECORDINGS / name)
    assert warned in done.stderr
    assert bool(done.stderr) == bool(warned)
    assert mounting(RECORDINGS / name)["heights"]["floor"] == pytest.approx(floor, abs=0.4)
    converted = run(*ready(done.stdout), "-o", tmp_path / "out.mcap", "--report", tmp_path / "report.json")
    assert converted.status == 0, converted.stderr
    (topic,) = (t for t in json.loads((tmp_path / "report.json").read_text())["topics"] if t["action"] == "converted")
    assert topic["empty_scans"] == 0
    assert topic["points"]["used"] > 0.05 * topic["points"]["total"]


WIDE = ("--min-height", "-5", "--max-height", "5")
LEVEL = '(--static-tf ".*) makes it level'

#: How the sensor is mounted, options, and what is said: in brackets the advice, which takes the place of the options.
ADVICE: list[tuple[dict[str, Any], Sequence[str], str]] = [
    *((how, WIDE, f"{told}.*{LEVEL}") for how, told in MOUNTINGS.values() if "tf" not in how),
    ({"roll": 15, "pitch": -10, "tf": TILTED}, WIDE, "tilted by 17.9 deg.* (--target-frame .*) makes it level"),
    ({"place": "field", "height": 1.8}, (), "everything at z <= 0; --min-height sets it below the sensor: (--min-.*)"),
]


@pytest.mark.parametrize(("arguments", "args", "told"), sampled(ADVICE, 2))
def test_what_convert_advises_works(
    arguments: dict[str, Any], args: Sequence[str], told: str, recorded: Callable[..., Path], tmp_path: Path
) -> None:
    source = recorded(**arguments)
    done = run("convert", source, "-o", tmp_path / "a.mcap", *args)
    assert done.status in {0, 4}
    found = re.search(told, done.stderr)
    assert found, done.stderr
    words = shlex.split(found[1])
    heights = () if "--min-height" in words else ("--min-height", "0.1", "--max-height", "1.5")
    again = run("convert", source, "-o", tmp_path / "b.mcap", *words, *heights)
    assert (again.status, again.stderr) == (0, "")


@pytest.mark.parametrize("place", sampled(PLACES, 2))
@pytest.mark.parametrize(("roll", "pitch"), [(1.5, 0.0), (-3.0, 2.0), (0.0, 6.0), (12.0, -5.0)])
def test_a_transform_that_tilts_a_level_lidar_is_reported(
    roll: float, pitch: float, place: str, recorded: Callable[..., Path], tmp_path: Path
) -> None:
    """A mount that is typed or recorded wrongly; its twin is a lidar that is tilted, with a transform that says so."""
    height = PLACES[place].heights[0]
    tf = (transform("base_link", "lidar", (roll, pitch, 25), (0.2, 0, height)),)
    words = ("--target-frame", "base_link", *WIDE)
    where: dict[str, Any] = {"place": place, "height": height, "tf": tf}
    sound = run("convert", recorded(roll, pitch, **where), "-o", tmp_path / "sound.mcap", *words)
    assert "is tilted by" not in sound.stderr
    wrong = recorded(**where)
    done = run("convert", wrong, "-o", tmp_path / "wrong.mcap", *words)
    found = re.search(r"base_link is tilted by ([\d.]+) deg", done.stderr)
    assert found is not None, done.stderr
    up = transform("", "", (roll, pitch, 0), (0, 0, 0))
    assert float(found[1]) == pytest.approx(math.degrees(2 * math.asin(math.hypot(up[6], up[7]))), abs=0.6)
    cure, *_ = re.findall('--static-tf "([^"]+)"', done.stderr)
    *_, cured_roll, cured_pitch, yaw = map(float, cure.split()[2:])
    assert (cured_roll, cured_pitch, yaw) == pytest.approx((0, 0, math.radians(25)), abs=math.radians(0.6))
