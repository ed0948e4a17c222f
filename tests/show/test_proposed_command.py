"""The command that `info` proposes, pasted: what it names, and where the returns of its scans are."""

from __future__ import annotations

import math
import shlex
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.core.rigid import Rigid
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan
from pc2scan.show.proposals import body_of
from support import RECORDINGS, ROOT, needs_shared, sampled
from support.command import run
from support.situations import hall
from support.worlds import scenes
from support.worlds.moving import Drive, Lidar, off_the_walls, returns_in_odom, write_imu, write_world

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

STANDING = Drive(speed=0.0, turn=0.0)
TILTING = Drive(speed=0.5, turn=0.2, tilt=math.radians(3.0))
ROOM = (-4.0, 5.0, -3.5, 3.5, 2.6)
FRONT = Lidar("/front", "front", columns=900)
REAR = Lidar("/rear", "rear", columns=900, mount=Rigid.from_rpy(0.0, 0.0, math.pi, (-0.2, 0.0, 0.5)), phase=0.03)


@dataclass(frozen=True)
class World:
    """A simulated recording.

    Attributes
    ----------
    lidars, drive
        See `write_world`.
    options
        The options that its command has besides heights, preset and frame, and the values that matter.
    off
        How far returns are from the walls at most, metres: of all but one in twenty, whose beam meets a wall at a
        small angle.
    """

    lidars: tuple[Lidar, ...]
    drive: Drive
    options: dict[str, Any]
    off: float = 0.05


WORLDS = {
    "stands": World((FRONT,), STANDING, {}),
    "drives": World((FRONT,), Drive(), {"deskew": True, "fixed_frame": "odom"}),
    "creeps": World((FRONT,), Drive(speed=0.05, turn=0.0), {}),
    "tilts": World((FRONT,), TILTING, {"deskew": True, "level": True, "fixed_frame": "odom"}),
    "two lidars": World(
        (FRONT, REAR),
        Drive(),
        {"topics": ("/front:=/scan", "/rear:=/scan"), "deskew": True, "fixed_frame": "odom"},
    ),
    "rosette": World(
        (replace(FRONT, kind="rosette", columns=800),),
        Drive(speed=0.3, turn=0.1),
        {"accumulate": None, "reduce": "surface", "deskew": True, "fixed_frame": "odom"},
    ),
    # Half a beam is 0.75 degrees.
    "coarse": World((replace(FRONT, columns=240),), STANDING, {}, off=0.07),
}


#: Its first cloud ends, by its stamp, where transforms begin.
HALL: dict[str, Any] = {
    "target_frame": "base_link", "deskew": True, "fixed_frame": "odom", "angle_increment": "1.5deg", "start": 0.01,
}  # fmt: skip


@pytest.mark.parametrize("name", sampled(WORLDS, 3))
def test_in_a_simulated_world_the_returns_are_on_the_walls(name: str, tmp_path: Path) -> None:
    world = WORLDS[name]
    path = write_world(tmp_path / "drive.mcap", world.lidars, world.drive, seconds=3.0)
    found = pc2scan.info(path)
    (call,) = found.proposals
    special = {key: value for key, value in call.options.items() if key not in COMMON}
    expected = {key: special.get(key) if value is None else value for key, value in world.options.items()}
    assert special == expected
    assert (call.options["target_frame"], call.options["preset"]) == ("base_link", "slam_toolbox")
    (scans,) = pasted(path)
    flat = replace(world.drive, tilt=0.0)
    off = np.concatenate([off_the_walls(returns_in_odom(scan, flat)) for scan in scans_of(scans)])
    assert len(off) > 3_000
    assert np.quantile(off, 0.95) < world.off
    (checked,) = pc2scan.check(scans).topics
    # gmapping refuses robots that tilt.
    assert {each.outcome for each in checked.consumers if each.consumer != "gmapping"} <= {"accepted", "shifted"}
    assert checked.consumers[0].outcome == "accepted"


def scans_of(path: Path) -> list[LaserScan]:
    with closing(open_recording(path)) as reader:
        flat = [each for each in reader.connections if each.ros_type == LASERSCAN and each.topic == "/scan"]
        return [decode_laserscan(each.data, each.connection.serialization) for each in reader.messages(flat)]


@pytest.mark.parametrize(
    ("known", "lidars", "reasons", "partly"),
    [
        ((-0.4, 3.5), (FRONT,), {}, 0),
        # The stamp of the third cloud is before them, within the tolerance.
        ((0.21, 3.5), (FRONT,), {"start": "transforms to odom begin 0.21 s after the first cloud"}, 0),
        # None of the first clouds, whose headers are read, has a place.
        ((2.17, 3.5), (FRONT,), {"start": "transforms to odom begin 2.2 s after the first cloud"}, 0),
        (
            (0.254, 2.654),
            (FRONT, REAR),
            {
                "start": "transforms to odom begin 0.25 s after the first cloud",
                "end": "transforms to odom end 0.31 s before the last cloud",
            },
            2,
        ),
    ],
)
def test_clouds_without_transforms_are_left_out(
    known: tuple[float, float], lidars: tuple[Lidar, ...], reasons: dict[str, str], partly: int, tmp_path: Path
) -> None:
    path = write_world(tmp_path / "drive.mcap", lidars, Drive(), seconds=3.0, known=known)
    (call,) = pc2scan.info(path).proposals
    assert {name: why for name, why in call.reasons.items() if name in {"start", "end"}} == reasons
    report = pc2scan.convert(path, tmp_path / "scans.mcap", **call.options)
    assert (report.warnings, [topic.skipped for topic in report.topics if topic.skipped]) == ([], [])
    uncut = {name: value for name, value in call.options.items() if name not in reasons}
    whole = pc2scan.convert(path, tmp_path / "whole.mcap", **uncut)
    # Nothing is cut of which transforms place more than half.
    kept, every = (sum(own.messages_out for own in each.topics if own.target == "/scan") for each in (report, whole))
    assert sum(topic.skipped for topic in whole.topics) > 0 or not reasons
    assert (every - kept, every > 5) == (partly, True)


@pytest.mark.parametrize("pitch", [0.0, 20.0])
@pytest.mark.parametrize("drive", ["stands", "pitches"])
def test_an_imu_levels_what_tilts_against_its_floor(drive: str, pitch: float, tmp_path: Path) -> None:
    place = scenes.World(ROOM, (), "32 rings", (0.2, 0.6, 0.0, pitch, 0.0), drive, odometry="")
    clouds = place.write(tmp_path / "drive.mcap")
    felt = write_imu(tmp_path / "imu.mcap", TILTING, Rigid.identity(), orientation=True, first=0.0)
    (call,) = pc2scan.info([clouds, felt], static_tf="base_link imu_link 0 0 0 0 0 0").proposals
    # On a slope, and in curves, an IMU feels what the floor does not show.
    assert call.options.get("imu") == ("/imu" if drive == "pitches" else None)


@pytest.mark.parametrize("degrees", [0.5, 2.0, 8.0])
def test_a_recorded_mount_that_is_off_is_said_and_corrected(degrees: float, tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    hall(path, mount=(0.2, 0.0, 0.6), turned=math.radians(degrees))
    found = pc2scan.info(path)
    (call,) = found.proposals
    is_off = degrees > 1.0
    assert [f" tilted by {degrees:.1f} deg" in text for text in found.warnings] == [True] * is_off
    assert (call.options["target_frame"], "static_tf" in call.options) == ("base_link", is_off)
    assert not pc2scan.convert(path, tmp_path / "scans.mcap", **call.options).warnings


#: What `info` proposes for recordings that other people made, and for the fixtures, besides preset and heights.
RECORDED: dict[str, dict[str, Any]] = {
    # Its odometry is simulated, from the year 1970.
    "luminar_highway.bag": {"odom_topic": "/base_pose_ground_truth", "time_offset": "auto", "ground": "remove"},
    "velodyne_vlp32.bag": {"angle_increment": "0.5deg"},
    "ouster_os1_32.mcap": {"angle_increment": "0.5deg", "ground": "remove"},
    # A camera's clock counts from its start.
    "d435_depth.mcap": {
        "static_tf": ...,
        "target_frame": "d435_depth_optical_frame_level",
        "time_offset": "auto",
    },
    "hall.bag": HALL,
    "hall.mcap": HALL,
    "hall": HALL,
}


@needs_shared
@pytest.mark.parametrize("name", RECORDED)
def test_real_recordings(name: str, tmp_path: Path) -> None:
    source = next(folder / name for folder in (ROOT / "fixtures", RECORDINGS) if (folder / name).exists())
    (call,) = pc2scan.info(source).proposals
    special = {key: value for key, value in call.options.items() if key not in {"preset", "min_height", "max_height"}}
    assert special == {key: special.get(key) if value is ... else value for key, value in RECORDED[name].items()}
    report = pc2scan.convert(source, tmp_path / "scans.mcap", **call.options)
    assert not any(topic.skipped for topic in report.topics)
    assert not report.warnings
    (scans,) = (each for each in pc2scan.check(tmp_path / "scans.mcap").topics if each.topic == "/scan")
    # Without odometry, most consumers cannot place scans.
    assert {each.outcome for each in scans.consumers if not each.verdict.unplaced} <= {"accepted", "shifted"}


#: The options of every command.
COMMON = {"preset", "target_frame", "min_height", "max_height", "angle_increment"}


def pasted(path: Path) -> list[Path]:
    """Paste what `info` shows last; return the recordings that are written."""
    done = run("info", path)
    assert done.status == 0, done.stderr
    lines = done.stdout.splitlines()
    commands = [shlex.split(line) for line in lines[lines.index("ready to convert:") + 1 :]]
    before = set(path.parent.iterdir())
    for program, *arguments in commands:
        assert program == "pc2scan"
        done = run(*arguments)
        assert done.status == 0, done.stderr
    return sorted(set(path.parent.iterdir()) - before)


def test_a_missing_mount_is_named_with_the_line_to_complete(tmp_path: Path) -> None:
    path = scenes.World(ROOM, (), "32 rings", has_mount=False).write(tmp_path / "drive.mcap")
    found = pc2scan.info(path)
    (text,) = (each for each in found.warnings if "no transform connects" in each)
    assert "`static_tf='base_link points X Y Z ROLL PITCH YAW'`" in text
    (call,) = found.proposals
    assert "target_frame" not in call.options
    assert "source_frame" not in str(call)
    assert run("info", path).stderr.count("--static-tf") == 1
    assert pasted(path)


def driven_through_posts(step: float, said: float | None, *, has_body: bool) -> Iterator[tuple[Any, Any]]:
    """Poses of a robot among posts, as odometry says, and its clouds; the corners of its frame may be in view."""
    random = np.random.default_rng(3)
    posts = random.uniform(-30, 30, (400, 2))
    frame = np.array([(x, y) for x in (-0.35, 0.35) for y in (-0.25, 0.25)])
    for number in range(10):
        seen = posts - [step * number, 0.0]
        seen = seen[np.hypot(*seen.T) > 1.0]
        flat = np.concatenate([seen, frame]) if has_body else seen
        place = None if said is None else Rigid.from_rpy(0, 0, 0, (said * number, 0, 0))
        yield place, np.column_stack([flat + random.normal(0, 0.005, flat.shape), np.full(len(flat), 0.5)])


@pytest.mark.parametrize("has_body", [True, False])
@pytest.mark.parametrize(
    ("step", "said", "shows"),
    # What is beside a robot that stands still may be anything, whatever its odometry says.
    [(2.0, None, False), (2.0, 2.0, True), (0.1, 0.1, True), (0.0, None, False), (0.0, 0.1, False)],
)
def test_the_body_is_what_stays(step: float, said: float | None, *, shows: bool, has_body: bool) -> None:
    box = body_of(driven_through_posts(step, said, has_body=has_body), np.zeros(3), 0.1, 1.5)
    # The cells of the corners, and 5 cm; they are so close that it is asked whether they are the body.
    assert box == (([-0.45, 0.45, -0.35, 0.35, 0.0, 1.6], shows) if has_body else ((), False))
