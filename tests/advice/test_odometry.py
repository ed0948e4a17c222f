"""Odometry that fits the clouds is never doubted, whatever else is imperfect; one that does not is, by what is seen."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.advice.odometry import Odometry, odometry_of, tilts
from pc2scan.core.rigid import Rigid
from pc2scan.transforms.builder import TransformBuilder
from support import sampled
from support.worlds import moving
from support.worlds.moving import Drive, Lidar
from support.worlds.weaving import REAR, RINGS, Fault, Weaving, write_weaving

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

DRIVES = {
    "weaving": Weaving(),
    "tilting": Weaving(tilt=0.05),
    "circle": Drive(speed=0.5),
    "straight": Drive(turn=0.0),
    "standing": Drive(speed=0.0, turn=0.0),
}
LIDARS: dict[str, list[Lidar]] = {
    "rings": [RINGS],
    "packets": [replace(RINGS, kind="packets")],
    "rosette": [replace(RINGS, kind="rosette", columns=6000)],
    "two": [RINGS, replace(REAR, phase=-0.03)],
}
#: Odometry that is as good as real odometry is.
SOUND = {"exact": Fault(), "scaled": Fault(scale=0.95), "rough": Fault(metres=0.002, degrees=0.03)}


def warnings(source: Path, lidars: list[Lidar], **options: Any) -> list[str]:
    joined = {"topics": [f"{lidar.topic}:=/scan" for lidar in lidars]} if len(lidars) > 1 else {}
    words = {"target_frame": "base_link", "min_height": 0.3, "max_height": 1.9, "fixed_frame": "odom", "deskew": True}
    destination = source.with_name("scans.mcap")
    return pc2scan.convert(source, destination, overwrite=True, **{"jobs": 1, **words, **joined, **options}).warnings


#: Each drive with each lidar and with each odometry, and each lidar with each odometry.
PAIRED = [(drive, lidar, [*SOUND][(m + n) % 3]) for m, drive in enumerate(DRIVES) for n, lidar in enumerate(LIDARS)]


@pytest.mark.parametrize(("drive", "lidars", "fault"), sampled(PAIRED, 3))
def test_sound_odometry_is_not_doubted(drive: str, lidars: str, fault: str, tmp_path: Path) -> None:
    source = write_weaving(tmp_path / "drive.mcap", LIDARS[lidars], SOUND[fault], DRIVES[drive])
    assert warnings(source, LIDARS[lidars]) == []
    if lidars == "two":
        assert warnings(source, LIDARS[lidars], deskew=False) == []


def test_even_motion_shows_no_lag_in_a_narrow_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(moving, "WALLS", ((0, -5.0), (0, 6.0), (1, -2.0), (1, 4.0)))
    source = moving.write_world(tmp_path / "drive.mcap", [RINGS], Drive(0.4, -1.0), seconds=2.4)
    assert warnings(source, [RINGS]) == []


@pytest.mark.parametrize("late", [-0.1, 0.03])
def test_odometry_that_lags_is_said_with_its_lag(late: float, tmp_path: Path) -> None:
    source = write_weaving(tmp_path / "drive.mcap", fault=Fault(late=late))
    (text,) = warnings(source, [RINGS])
    # What is to type leaves nothing to say.
    assert f"`time_offset={late:.2f}s`" in text
    assert warnings(source, [RINGS], time_offset=[f"{late:.2f}s"]) == []


def test_points_at_wrong_times_say_nothing_of_odometry(tmp_path: Path) -> None:
    lidars = [RINGS, replace(REAR, time_scale=1e-3)]
    (text,) = warnings(write_weaving(tmp_path / "drive.mcap", lidars, Fault(late=0.1)), lidars)
    assert "/rear" in text
    assert "`point_time=t:us`" in text


def driven(seed: int, *, wheels: bool) -> list[Rigid]:
    """The poses of a robot for a minute: it goes ahead and back, and turns; without wheels to any side, too."""
    random = np.random.default_rng(seed)
    x, y, yaw = random.normal(0, 5, 3).tolist()
    poses = []
    for _ in range(20):
        speed, turn = random.uniform(-0.5, 1.5), random.normal(0, 0.5)
        aside = 0.0 if wheels else random.normal(0, 0.5)
        for _ in range(60):
            yaw += turn * 0.05
            x += 0.05 * (speed * math.cos(yaw) - aside * math.sin(yaw)) + random.normal(0, 1e-4)
            y += 0.05 * (speed * math.sin(yaw) + aside * math.cos(yaw)) + random.normal(0, 1e-4)
            poses.append(Rigid.from_rpy(0.0, 0.0, yaw, (x, y, 0.1)))
    return poses


def direction(poses: Sequence[Rigid], parent: str = "odom", child: str = "base_link") -> Odometry:
    """Which way round poses are, twenty a second."""
    builder = TransformBuilder()
    builder.add([(parent, child, n * 50_000_000, *pose.pose) for n, pose in enumerate(poses)], static=False)
    builder.add([("base_link", "lidar", 0, 0.3, 0.2, 0.5, 0, 0, 1, 0)], static=True)
    return odometry_of(builder.build(), "odom", "lidar")


SWAPPED = {"parent": "base_link", "child": "odom"}


def test_the_way_of_a_robot_tells_which_way_round_its_odometry_is() -> None:
    told = 0
    for seed in range(8):
        poses = driven(seed, wheels=True)
        inverse = [pose.inverse() for pose in poses]
        found = [direction(poses), direction(inverse), direction(poses, **SWAPPED), direction(inverse, **SWAPPED)]
        assert [bool(each.fault) for each in found[2:]] == [True, True]
        doubts = [bool(each.doubt) for each in found]
        if doubts == [False, False, True, True]:
            # Where it drives beside odom, its inverse is not much sideways.
            continue
        assert doubts == [False, True, True, False]
        assert all("sideways" in each.doubt for each in found[1:3])
        told += 1
    assert told >= 6


def test_a_robot_tilts_by_what_its_floor_shows_or_curves_do_not_explain() -> None:
    said = [(0.01, None, 0.0), (0.05, None, 0.0), (0.05, None, 0.04), (0.05, 0.01, 0.0), (0.05, 0.03, 0.04)]
    assert [tilts(by, [floor].pop, felt) for by, floor, felt in said] == [False, True, False, False, True]


@pytest.mark.parametrize(("clock", "deskew"), [(-0.06, True), (0.03, False)])
def test_clocks_of_two_lidars_that_differ_are_said(clock: float, deskew: bool, tmp_path: Path) -> None:
    lidars = [RINGS, replace(REAR, clock=clock)]
    source = write_weaving(tmp_path / "drive.mcap", lidars)
    found = " ".join(warnings(source, lidars, deskew=deskew))
    assert "rear was" not in " ".join(warnings(source, lidars, deskew=deskew, time_offset=[f"/rear={-clock:.2f}s"]))
    assert f"`time_offset=/rear={-clock:.2f}s`" in found
    assert (
        f"/rear was measured {1000 * abs(clock):.0f} ms {'earlier' if clock > 0 else 'later'} than its stamps" in found
    )
