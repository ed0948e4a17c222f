"""Scans of a robot that pitches and rolls, made level by the real command: by transforms, and by an IMU."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.core.rigid import Rigid
from support import conversions, sampled
from support.command import run
from support.worlds import moving
from support.worlds.moving import BEGIN_NS, Drive, Lidar, off_the_walls, returns_in_odom, write_world

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from support.conversions import Made

#: Three degrees, a little more than once a second.
TILTING = Drive(speed=0.5, turn=0.0, tilt=float(np.radians(3.0)))
#: Packets of 10 ms, in which little tilts.
LIDAR = Lidar(kind="packets", columns=1800)
#: How the IMU is mounted: upside down, and turned.
MOUNT = Rigid.from_rpy(np.pi, 0.0, 0.5, (0.1, 0.0, 0.2))
PARAMETERS = (
    "--target-frame", "base_link", "--min-height", "0.1", "--max-height", "2", "--angle-increment", "0.2deg",
    "--geometry", "centered", "--range-max", "30",
)  # fmt: skip


def converted(folder: Path, *sources_and_options: Any, output: str = "b.mcap") -> Made:
    return conversions.converted(folder / output, *sources_and_options, *PARAMETERS)


def far_off(made: Made) -> NDArray[np.float64]:
    """How far returns are from the walls, by a robot that does not tilt."""
    flat = replace(TILTING, tilt=0.0)
    return np.concatenate([off_the_walls(returns_in_odom(scan, flat)) for scan in made.scans])


def write_imu(path: Path, drive: Drive, **further: Any) -> Path:
    return moving.write_imu(path, drive, MOUNT, **further)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("level")
    return write_world(folder / "world.mcap", [LIDAR], TILTING)


@pytest.fixture(scope="module")
def imu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_imu(tmp_path_factory.mktemp("imu") / "imu.mcap", TILTING)


MOUNTED = ("--static-tf", "base_link imu_link " + " ".join(map(repr, MOUNT.pose)))


@pytest.mark.parametrize("deskewed", [(), ("--deskew",)], ids=str)
def test_level_by_odometry_every_return_is_on_its_wall(deskewed: tuple[str, ...], tmp_path: Path, world: Path) -> None:
    """Alone it is exact to the tilt within a cloud."""
    off = far_off(converted(tmp_path, world, "--level", *deskewed, "--fixed-frame", "odom"))
    assert len(off) > 20_000
    assert off.max() < 0.02
    if deskewed:
        # As it is, a fifth of all returns are floor.
        asis = converted(tmp_path, world, "--deskew", "--fixed-frame", "odom")
        assert {scan.frame_id for scan in asis.scans} == {"base_link"}
        far = far_off(asis)
        assert np.mean(far > 0.5) > 0.1
        assert far.max() > 3


def test_clouds_are_made_level_in_their_own_frame(tmp_path: Path, world: Path) -> None:
    own = ("--min-height", "-0.4", *PARAMETERS[4:])
    made = conversions.converted(tmp_path / "b.mcap", world, "--level", "--fixed-frame", "odom", *own)
    assert {scan.frame_id for scan in made.scans} == {"lidar_stabilized"}
    flat = replace(TILTING, tilt=0.0)
    away = np.concatenate([off_the_walls(returns_in_odom(scan, flat, LIDAR.mount)) for scan in made.scans])
    assert len(away) > 20_000
    # The sensor stands above the point about which the robot tilts, and moves by a few centimetres.
    assert away.max() < 0.1


@pytest.mark.parametrize("orientation", sampled([False, True], 1))
def test_level_by_an_imu_that_is_mounted_upside_down(tmp_path: Path, world: Path, orientation: bool) -> None:
    imu = write_imu(tmp_path / "imu.mcap", TILTING, orientation=orientation)
    made = converted(tmp_path, world, imu, "--level", "--imu", "/imu", *MOUNTED)
    off = far_off(made)
    assert off.max() < 0.02, (np.percentile(off, 99), off.max())
    how = "from the orientations of" if orientation else "estimated from gyroscope and accelerometer of"
    assert any(f"/imu: up is {'computed ' if orientation else ''}{how}" in note for note in made.report["notes"])


@pytest.mark.slow
def test_the_imu_levels_and_odometry_deskews(tmp_path: Path, world: Path, imu: Path) -> None:
    both = ("--level", "--imu", "/imu", *MOUNTED, "--deskew", "--fixed-frame", "odom")
    made = converted(tmp_path, world, imu, *both)
    assert far_off(made).max() < 0.02
    (entry,) = (topic for topic in made.report["topics"] if topic["action"] == "converted")
    assert entry["longest_gap_s"] > 0
    (tilt,) = re.findall(r"was tilted by up to (\S+) degrees", "\n".join(made.report["notes"]))
    assert float(tilt) == pytest.approx(3.0, abs=0.2)
    # Transforms may come from another recording, and so may the IMU.
    elsewhere = converted(tmp_path, world, "--tf-from", imu, *both)
    assert [scan.ranges.tobytes() for scan in elsewhere.scans] == [scan.ranges.tobytes() for scan in made.scans]


def test_the_scans_are_connected_with_the_target_frame(tmp_path: Path, world: Path) -> None:
    made = converted(tmp_path, world, "--level", "--fixed-frame", "odom")
    assert made.done.status == 0, made.done.stderr
    assert {scan.frame_id for scan in made.scans} == {"base_link_stabilized"}
    level = [(log, row) for log, row in made.transforms if row[1] == "base_link_stabilized"]
    assert [(log, row[2]) for log, row in level] == [(log, scan.stamp_ns) for log, scan in made.timed]
    flat = replace(TILTING, tilt=0.0)
    for _, (parent, _, stamp_ns, *pose) in level:
        assert parent == "base_link"
        time = (stamp_ns - BEGIN_NS) / 1e9
        placed = TILTING.pose(time).compose(Rigid.from_pose(tuple(pose)))
        np.testing.assert_allclose(placed.matrix, flat.pose(time).matrix, atol=1e-4)
        np.testing.assert_allclose(placed.translation, flat.pose(time).translation, atol=1e-9)
    (entry,) = (topic for topic in made.report["topics"] if topic["action"] == "added")
    assert (entry["topic"], entry["messages_out"]) == ("/tf", len(made.scans))
    assert any("level by odom; base_link was tilted by up to 3 degrees" in note for note in made.report["notes"])
    # Other programs place the scans by the recorded transforms alone.
    back = run("convert", tmp_path / "b.mcap", "-o", tmp_path / "c.mcap", "--reverse", "--target-frame", "odom")
    assert back.status == 0, back.stderr


def test_an_imu_whose_mount_is_not_known(tmp_path: Path, world: Path, imu: Path) -> None:
    done = converted(tmp_path, world, imu, "--level", "--imu", "/imu").done
    assert done.status != 0
    assert "nothing can be converted: the IMU of /imu: no transform has the source frame 'imu_link'" in done.stderr
    assert '--static-tf "base_link imu_link 0 0 0 ROLL PITCH YAW"' in done.stderr
    # With its mount wrong, the robot seems to drive on its head.
    wrong = ("--static-tf", "base_link imu_link 0 0 0 0 0 0")
    done = converted(tmp_path, world, imu, "--level", "--imu", "/imu", *wrong).done
    assert "base_link is tilted by 17" in done.stderr
    assert "--static-tf" in done.stderr


@pytest.mark.slow
def test_an_imu_with_a_gap_and_one_of_another_clock(tmp_path: Path, world: Path) -> None:
    imu = write_imu(tmp_path / "imu.mcap", TILTING, gap=0.5)
    made = converted(tmp_path, world, imu, "--level", "--imu", "/imu", *MOUNTED)
    assert made.done.status == 3
    (entry,) = (topic for topic in made.report["topics"] if topic["action"] == "converted")
    assert entry["skipped"] == pytest.approx(50, abs=2)
    assert "the direction of up is not known at" in made.report["skipped"][0]["reason"]
    assert far_off(made).max() < 0.05
    imu = write_imu(tmp_path / "other.mcap", TILTING, clock_ns=-BEGIN_NS + 10_000_000_000)
    done = converted(tmp_path, world, imu, "--level", "--imu", "/imu", *MOUNTED).done
    assert done.status == 1
    assert "days ahead of those of /imu" in done.stderr


def test_odometry_without_tilt_and_a_frame_of_the_same_name(tmp_path: Path) -> None:
    flat = write_world(tmp_path / "flat.mcap", [replace(LIDAR, columns=200)], replace(TILTING, tilt=0.0), seconds=0.5)
    done = converted(tmp_path, flat, "--level", "--fixed-frame", "odom").done
    assert "base_link is never tilted, so --level has no effect" in done.stderr
    again = converted(tmp_path, tmp_path / "b.mcap", "--level", "--fixed-frame", "odom", output="c.mcap").done
    assert again.status != 0


def test_scans_are_level_and_deskewed_on_the_way(tmp_path: Path, world: Path) -> None:
    made = converted(tmp_path, world, "--level", "--deskew", "--fixed-frame", "odom", "--stamp", "middle")
    scans = pc2scan.scans(
        world, level=True, deskew=True, fixed_frame="odom", stamp="middle", target_frame="base_link", min_height=0.1,
        max_height=2, angle_increment=np.radians(0.2), geometry="centered", range_max=30,
    )  # fmt: skip
    read = [(scan.log_time_ns, scan.stamp_ns, scan.frame, scan.ranges.tobytes()) for scan in scans]
    assert read == [(log, scan.stamp_ns, scan.frame_id, scan.ranges.tobytes()) for log, scan in made.timed]
    with pytest.raises(
        pc2scan.errors.UsageError, match="`deskew`, `level` and `remove` have no effect: no clouds are converted"
    ):
        pc2scan.scans(world, level=True, fixed_frame="odom")


@pytest.mark.slow
def test_a_2d_lidar_that_tilts_is_made_level(tmp_path: Path) -> None:
    lidar = Lidar("/flat", "flat", Rigid.from_rpy(0.0, 0.0, 0.0, (0.0, 0.0, 0.5)), kind="flat", columns=1800)
    flat = write_world(tmp_path / "flat.mcap", [lidar], TILTING, seconds=1.0)
    options = ("--rebin", "--topic", "/flat:=/scan", "--deskew", "--fixed-frame", "odom")
    level = converted(tmp_path, flat, *options, "--level")
    assert {scan.frame_id for scan in level.scans} == {"base_link_stabilized"}
    assert far_off(level).max() < 0.02
    assert sum(row[1] == "base_link_stabilized" for _, row in level.transforms) == len(level.scans)
