"""Lookups, transformed clouds and the way back against Debian's own tf2, tf2_sensor_msgs and laser_geometry, live.

``oracle.cpp`` is compiled against them. Stamps are those of today, to the nanosecond; results are compared to the bit.
"""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.core.params import ProjectionParams
from pc2scan.core.project import Projector
from pc2scan.core.rigid import Rigid
from pc2scan.errors import MessageError, TransformError
from pc2scan.messages.laserscan import LaserScan, encode_laserscan
from pc2scan.messages.pointcloud2 import decode_pointcloud2
from pc2scan.pipeline.scan_to_cloud import ScanToCloud
from pc2scan.tf.placing import Frames
from tf.through import assert_close, found, random_drive, random_throughs
from tf.trees import EPOCH, SECOND, built, changing_tree, random_pose, random_questions, random_tree, row

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from tf.through import Through
    from tf.trees import Question, Rows

SOURCE = Path(__file__).with_name("oracle.cpp")
PACKAGES = {
    "laser_geometry/laser_geometry.h": "liblaser-geometry-dev",
    "tf2/buffer_core.h": "libtf2-dev",
    "tf2_sensor_msgs/tf2_sensor_msgs.h": "libtf2-sensor-msgs-dev",
    "eigen3/Eigen/Geometry": "libeigen3-dev",
}


def why_not() -> str:
    """Why the program cannot be built here; empty if it can."""
    missing = ["g++"] if shutil.which("g++") is None else []
    missing += [package for header, package in PACKAGES.items() if not Path("/usr/include", header).exists()]
    return f"Debian's ROS is not here: apt-get install {' '.join(missing)}" if missing else ""


def compiled(folder: Path) -> Path:
    """Compile the program into a folder."""
    program = folder / "oracle"
    # As Debian builds its packages: tf2_sensor_msgs is a header, and without fused operations only without -march.
    command = ["g++", "-O2", "-I/usr/include/eigen3", "-o", str(program), str(SOURCE)]
    subprocess.run([*command, "-ltf2", "-llaser_geometry", "-lrostime"], check=True)
    return program


@pytest.fixture(scope="session")
def oracle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if why_not():
        pytest.skip(why_not())
    return compiled(tmp_path_factory.mktemp("parity"))


def time_of(stamp_ns: int) -> str:
    return "{} {}".format(*divmod(stamp_ns, SECOND))


def hexadecimal(values: NDArray[np.float32]) -> str:
    return " ".join(float(value).hex() for value in values.ravel())


def transforms(rows: Rows) -> list[str]:
    return [
        f"T {parent} {child} {time_of(stamp_ns)} {' '.join(float(value).hex() for value in pose)} {static:d}"
        for (parent, child, stamp_ns, *pose), static in rows
    ]


def ask(program: Path, rows: Rows, commands: list[str]) -> list[str]:
    lines = "\n".join(transforms(rows) + commands) + "\n"
    run = subprocess.run([str(program)], input=lines, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr[-1000:]
    answers = run.stdout.splitlines()
    assert len(answers) == len(commands)
    return answers


def assert_lookups_agree(program: Path, rows: Rows, questions: list[Question]) -> int:
    """Compare them to the bit, with their stamps; return how many were found."""
    buffer = built(rows)
    answers = ask(program, rows, [f"L {target} {source} {time_of(stamp_ns)}" for target, source, stamp_ns in questions])
    found = 0
    for (target, source, stamp_ns), theirs in zip(questions, answers, strict=True):
        if theirs.startswith("!"):
            with pytest.raises(TransformError):
                buffer.lookup(target, source, stamp_ns)
            continue
        found += 1
        ours = buffer.lookup(target, source, stamp_ns)
        sec, nsec, *pose = theirs.split()
        expected = np.array([float.fromhex(value) for value in pose])
        assert np.array(ours.pose).tobytes() == expected.tobytes(), (target, source, stamp_ns, ours.pose, expected)
        if target != source:
            stamped = stamp_ns or buffer.latest_common_ns(target, source)
            assert stamped == int(sec) * SECOND + int(nsec)
    return found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("make", [random_tree, changing_tree])
def test_lookups(make: Callable[[np.random.Generator], tuple[Rows, list[str]]], seed: int, oracle: Path) -> None:
    rng = np.random.default_rng(1000 + seed)
    rows, frames = make(rng)
    questions = random_questions(rng, frames, [entry[2] for entry, _ in rows], 3000)
    assert assert_lookups_agree(oracle, rows, questions) > 200


def through_command(question: Through) -> str:
    target, target_ns, source, source_ns, fixed = question
    return f"F {target} {time_of(target_ns)} {source} {time_of(source_ns)} {fixed}"


def pose_in(answer: str) -> list[float] | None:
    """The pose of an answer; None if tf2 refuses."""
    return None if answer.startswith("!") else [float.fromhex(value) for value in answer.split()[2:]]


@pytest.mark.parametrize("seed", range(3))
def test_lookups_with_two_times(seed: int, oracle: Path) -> None:
    rng = np.random.default_rng(7000 + seed)
    rows, frames = random_drive(rng)
    questions = random_throughs(rng, frames, 10_000)
    buffer = built(rows)
    agreed = 0
    for question, theirs in zip(questions, ask(oracle, rows, [*map(through_command, questions)]), strict=True):
        pose = pose_in(theirs)
        if pose is None:
            with pytest.raises(TransformError):
                found(buffer, question)
        else:
            assert_close(found(buffer, question), np.array(pose), question)
            agreed += 1
    assert 8_000 < agreed < 10_000


def points_of_all_kinds(rng: np.random.Generator) -> NDArray[np.float32]:
    kinds = [
        rng.normal(scale=20, size=(3000, 3)),
        rng.integers(-9, 10, (1000, 3)),
        rng.normal(size=(500, 3)) * 10.0 ** rng.uniform(-45, 38, (500, 3)),
        rng.choice([0.0, -0.0, 1.0, -1.0, 1e-45, 3.4e38, np.inf, -np.inf, np.nan], (500, 3)),
    ]
    with np.errstate(over="ignore"):
        return np.concatenate(kinds).astype(np.float32)


def moved_by(program: Path, pose: tuple[float, ...], points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Points as tf2_sensor_msgs transforms them."""
    rows = [(row("base", "lidar", 0, pose), True)]
    (answer,) = ask(program, rows, [f"C base lidar 0 0 {hexadecimal(points)}"])
    return np.frombuffer(bytes.fromhex(answer), np.float32).reshape(-1, 3)


@pytest.mark.parametrize("seed", range(8))
def test_clouds(seed: int, oracle: Path) -> None:
    rng = np.random.default_rng(2000 + seed)
    points, pose = points_of_all_kinds(rng), random_pose(rng)
    expected = moved_by(oracle, pose, points)
    rigid = Rigid(np.array(pose[3:]), np.array(pose[:3]))
    # NaNs may have any sign and payload; all else, signs of zeros included, is equal.
    ours = rigid.apply(points)
    np.testing.assert_array_equal(ours, expected)
    known = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(ours[known]), np.signbit(expected[known]))
    # The loops over points transform what they project.
    project = Projector(ProjectionParams(min_height=-50.0, max_height=50.0, angle_increment=1e-3))
    (x, y, z), moved = points.T, rigid.as_float32()
    here, there = project(x, y, z, moved), project(*expected.T)
    np.testing.assert_array_equal(here.ranges, there.ranges)
    assert here.counts == there.counts


def random_scan(rng: np.random.Generator) -> LaserScan:
    count = int(rng.integers(2, 400))
    ranges = rng.uniform(0.0, 12.0, count)
    ranges[rng.random(count) < 0.1] = rng.choice([np.nan, np.inf, -1.0, 30.0])
    # Up to 0.2 s, forwards or backwards.
    time_increment = rng.choice([0.2, -0.2, 0.0], p=[0.6, 0.3, 0.1]) * rng.random() / count
    return LaserScan(
        sequence=int(rng.integers(1000)),
        stamp_ns=EPOCH + int(rng.integers(SECOND, 9 * SECOND)),
        frame_id="laser",
        angle_min=float(np.float32(rng.uniform(-3, 0))),
        angle_max=0.0,
        angle_increment=float(np.float32(rng.uniform(-0.02, 0.02))),
        time_increment=float(np.float32(time_increment)),
        scan_time=0.0,
        range_min=float(np.float32(0.1)),
        range_max=float(np.float32(11.5)),
        ranges=ranges.astype(np.float32),
    )


def scan_command(target: str, deskewed: bool, scan: LaserScan) -> str:
    numbers = (scan.angle_min, scan.angle_increment, scan.time_increment, scan.range_min, scan.range_max)
    head = f"S {target} {deskewed:d} {time_of(scan.stamp_ns)} {scan.sequence}"
    return f"{head} {' '.join(value.hex() for value in numbers)} {hexadecimal(scan.ranges)}"


def moving_laser(rng: np.random.Generator) -> Rows:
    """odom to base_link 50 times a second, tilting as it goes; the laser's mount as people type it."""
    rows: Rows = []
    steps = rng.normal(scale=0.05, size=(500, 6)).cumsum(axis=0)
    for number, (x, y, z, roll, pitch, yaw) in enumerate(steps.tolist()):
        pose = Rigid.from_rpy(roll, pitch, yaw, (x, y, z)).pose
        rows.append((row("odom", "base_link", EPOCH + number * SECOND // 50 + int(rng.integers(1000)), pose), False))
    mount = Rigid.from_rpy(0.03, -0.2, 1.0, (0.2, 0.1, 0.4)).pose
    return [*rows, (row("base_link", "laser", 0, tuple(round(value, 4) for value in mount)), True)]


@pytest.mark.parametrize("deskewed", [False, True])
@pytest.mark.parametrize("target", ["laser", "base_link", "odom"])
def test_the_way_back(target: str, deskewed: bool, oracle: Path) -> None:
    rng = np.random.default_rng(4000)
    rows = moving_laser(rng)
    scans = [random_scan(rng) for _ in range(150)]
    conversion = ScanToCloud(None, Frames(target, "", built(rows), 0), deskewed=deskewed).for_topic(
        "/t", "ros1", "ros1"
    )
    answers = ask(oracle, rows, [scan_command(target, deskewed, scan) for scan in scans])
    for scan, theirs in zip(scans, answers, strict=True):
        seq, sec, nsec, *data = theirs.split()
        cloud = decode_pointcloud2(conversion(encode_laserscan(scan, "ros1")).data, "ros1")
        assert (cloud.sequence, cloud.stamp_ns) == (int(seq), int(sec) * SECOND + int(nsec))
        assert bytes(cloud.data).hex() == "".join(data)


def test_scans_stamped_0_and_those_that_end_before_time_begins(oracle: Path) -> None:
    rng = np.random.default_rng(5000)
    rows = moving_laser(rng)
    known = Frames("odom", "", built(rows), 0)
    refused = 0
    for stamp_ns in (0, 1, SECOND // 10):
        for time_increment in (0.0, 1e-4, -1e-4, -0.5):
            scan = replace(random_scan(rng), stamp_ns=stamp_ns, time_increment=float(np.float32(time_increment)))
            for deskewed in (False, True):
                (theirs,) = ask(oracle, rows, [scan_command("odom", deskewed, scan)])
                conversion = ScanToCloud(None, known, deskewed=deskewed).for_topic("/t", "ros1", "ros1")
                if theirs.startswith("!"):
                    refused += 1
                    with pytest.raises(MessageError):
                        conversion(encode_laserscan(scan, "ros1"))
                    continue
                cloud = decode_pointcloud2(conversion(encode_laserscan(scan, "ros1")).data, "ros1")
                seq, sec, nsec, *data = theirs.split()
                assert (cloud.sequence, cloud.stamp_ns) == (int(seq), int(sec) * SECOND + int(nsec))
                assert bytes(cloud.data).hex() == "".join(data)
    assert refused > 10
