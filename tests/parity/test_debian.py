"""Lookups, transformed clouds and the way back against Debian's own tf2, tf2_sensor_msgs and laser_geometry, live.

``oracle.cpp`` is compiled against them. Stamps are those of today, to the nanosecond; results are compared to the bit.
"""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.core.params import ProjectionParams
from pc2scan.core.project import Projector
from pc2scan.core.rigid import Rigid
from pc2scan.core.unproject import unproject
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


pytestmark = pytest.mark.slow


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


def assert_same_floats(ours: NDArray[np.float32], expected: NDArray[np.float32]) -> None:
    """NaNs may have any sign and payload; all else, signs of zeros included, is equal."""
    np.testing.assert_array_equal(ours, expected)
    known = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(ours[known]), np.signbit(expected[known]))


@pytest.mark.parametrize("seed", range(8))
def test_clouds(seed: int, oracle: Path) -> None:
    rng = np.random.default_rng(2000 + seed)
    points, pose = points_of_all_kinds(rng), random_pose(rng)
    expected = moved_by(oracle, pose, points)
    rigid = Rigid(np.array(pose[3:]), np.array(pose[:3]))
    assert_same_floats(rigid.apply(points), expected)
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


#: Signs of zeros in a link of identity: translation, then quaternion.
IDENTITIES = [
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    (-0.0, -0.0, -0.0, 0.0, 0.0, 0.0, 1.0),
    (-0.0, 0.0, -0.0, -0.0, -0.0, -0.0, -1.0),
]
#: Beams at the limits of what is kept, with a range of -inf, whose product with a matrix is NaN.
ODD_RANGES = np.array([-0.0, 0.0, 1.0, -1.0, 1e-45, -np.inf, np.inf, np.nan, 5.0], np.float32)


def odd_scans() -> list[LaserScan]:
    """Scans with zeros of both signs, times of all kinds, and without beams."""
    kinds = product([0.0, -0.0, 3.0], [0.0, -0.0, 0.5, -0.5], [0.0, -0.0, 1e-4, np.inf, -np.inf, np.nan, 1e30])
    found = []
    for angle_min, angle_increment, time_increment in kinds:
        # With its first angles, which are 0, laser_geometry asserts that a scan has beams.
        for ranges in (ODD_RANGES, ODD_RANGES[:2], ODD_RANGES[:0])[: 3 if angle_min else 2]:
            numbers = (angle_min, 0.0, angle_increment, float(np.float32(time_increment)), 0.0, -np.inf, 10.0)
            found.append(LaserScan(3, EPOCH + 5 * SECOND, "laser", *numbers, ranges))
    return found


@pytest.mark.parametrize("target", ["laser", "base_link"])
@pytest.mark.parametrize("pose", IDENTITIES, ids=str)
@pytest.mark.parametrize("up", [True, False], ids=["laser in base_link", "base_link in laser"])
def test_zeros_and_times_that_are_not_finite(up: bool, pose: tuple[float, ...], target: str, oracle: Path) -> None:
    frames = ("base_link", "laser") if up else ("laser", "base_link")
    rows: Rows = [(row(*frames, 0, pose), True)]
    scans = odd_scans()
    for deskewed in (False, True):
        conversion = ScanToCloud(None, Frames(target, "", built(rows), 0), deskewed=deskewed)
        convert = conversion.for_topic("/t", "ros1", "ros1")
        refused = 0
        for scan, theirs in zip(
            scans, ask(oracle, rows, [scan_command(target, deskewed, scan) for scan in scans]), strict=True
        ):
            if theirs.startswith("!"):
                refused += 1
                with pytest.raises(MessageError, match="time_increment"):
                    convert(encode_laserscan(scan, "ros1"))
                continue
            cloud = decode_pointcloud2(convert(encode_laserscan(scan, "ros1")).data, "ros1")
            found, expected = (
                np.frombuffer(data, "<f4").reshape(-1, 4)
                for data in (bytes(cloud.data), bytes.fromhex("".join(theirs.split()[3:])))
            )
            assert_same_floats(found[:, :3], expected[:, :3])
            assert found[:, 3].tobytes() == expected[:, 3].tobytes()
        assert (refused > 0) == deskewed


def test_laser_geometry_keeps_directions_by_the_ends_alone(oracle: Path) -> None:
    # docs/exactness.md: of scans that differ in their increments alone, the later ones get the directions of the first.
    ranges = np.arange(1, 6, dtype=np.float32)
    asked = [(-1.0, 1.0, 0.5), (-1.0, 1.0, 0.25), (-1.0, 1.5, 0.25), (-1.0, 1.0, 0.25)]
    commands = [f"P {' '.join(value.hex() for value in numbers)} {hexadecimal(ranges)}" for numbers in asked]
    ours = [
        unproject(ranges, ranges[:0], angle_min=low, angle_increment=step, range_min=0.0, range_max=100.0)
        for low, _, step in asked
    ]
    theirs = [bytes.fromhex(answer) for answer in ask(oracle, [], commands)]
    assert theirs == [ours[k].points.tobytes() for k in (0, 0, 2, 3)]


@pytest.mark.parametrize("seed", range(3))
def test_signs_of_zeros_in_lookups(seed: int, oracle: Path) -> None:
    rng = np.random.default_rng(9000 + seed)
    zeros, found = [0.0, -0.0], 0
    for _ in range(60):
        rows: Rows = []
        frames = [f"f{number}" for number in range(int(rng.integers(2, 6)))]
        for number, child in enumerate(frames[1:], 1):
            static = bool(rng.random() < 0.5)
            for stamp_ns in [0] if static else sorted({EPOCH + int(s) * SECOND for s in rng.integers(0, 6, 3)}):
                pose = (*rng.choice([*zeros, 1.0, -0.3], 3, p=[0.4, 0.4, 0.1, 0.1]), *rng.choice(zeros, 3))
                entry = row(frames[rng.integers(0, number)], child, stamp_ns, (*pose, rng.choice([1.0, -1.0])))
                rows.append((entry, static))
        questions = [(a, b, s) for a in frames for b in frames for s in (0, EPOCH + SECOND, EPOCH + 5 * SECOND // 2)]
        found += assert_lookups_agree(oracle, rows, questions)
    assert found > 500


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
