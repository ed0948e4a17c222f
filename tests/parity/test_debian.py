"""Everything against Debian's own tf2, tf2_sensor_msgs and laser_geometry, live.

Stamps are those of today, to the nanosecond; results are compared to the bit.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import pairwise, permutations, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest

from parity import debian, table
from pc2scan.conversion.steps import ScanToCloud
from pc2scan.errors import MessageError
from pc2scan.messages.laserscan import LaserScan, encode_laserscan
from pc2scan.messages.pointcloud2 import decode_pointcloud2
from pc2scan.transforms.placing import Placer
from support.conversions import serialized_by
from transforms.trees import EPOCH, SECOND, built, random_pose, row

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from transforms.trees import Question, Rows


# In the quick run, golden cases and tests/transforms have recorded answers.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="session")
def oracle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if debian.why_not():
        pytest.skip(debian.why_not())
    return debian.compiled(tmp_path_factory)


def assert_same_clouds(program: Path, rows: Rows, target: str, deskewed: bool, scans: list[LaserScan]) -> int:
    """Convert scans to clouds as laser_geometry does; return how many both refuse.

    NaNs may have any sign and payload; all else, signs of zeros included, is equal.
    """
    conversion = ScanToCloud(None, Placer(target, "", built(rows), 0), deskewed=deskewed)
    convert = serialized_by(conversion, "/t", "ros1", "ros1")
    refused = 0
    answers = debian.ask(program, rows, [debian.scan_command(target, deskewed, scan) for scan in scans])
    for scan, theirs in zip(scans, answers, strict=True):
        if theirs.startswith("!"):
            refused += 1
            with pytest.raises(MessageError):
                convert(encode_laserscan(scan, "ros1"))
            continue
        seq, sec, nsec, *data = theirs.split()
        cloud = decode_pointcloud2(convert(encode_laserscan(scan, "ros1")).message, "ros1")
        assert (cloud.sequence, cloud.stamp_ns) == (int(seq), int(sec) * SECOND + int(nsec))
        ours, expected = (
            np.frombuffer(each, "<f4").reshape(-1, 4) for each in (bytes(cloud.data), bytes.fromhex("".join(data)))
        )
        known = ~np.isnan(expected[:, :3])
        assert np.isnan(ours[:, :3][~known]).all()
        assert ours[:, :3][known].tobytes() == expected[:, :3][known].tobytes()
        assert ours[:, 3].tobytes() == expected[:, 3].tobytes()
    return refused


def test_nothing_differs_from_debians_libraries(oracle: Path) -> None:
    for found in table.against_debian(oracle, np.random.default_rng(0), lookups=3000, points=100_000):
        assert found.compared > 0, found
        assert found.differing == 0, found


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
    assert assert_same_clouds(oracle, rows, target, False, odd_scans()) == 0
    assert assert_same_clouds(oracle, rows, target, True, odd_scans()) > 0


# --- Lookups of what random trees seldom have ---

HALF, TENTH = SECOND // 2, SECOND // 10


class Case(NamedTuple):
    """Transforms, questions, and how many transforms are found at least."""

    rows: Rows
    questions: list[Question]
    least: int


def poses(seed: int, links: list[tuple[str, str, int]], static: bool = False) -> Rows:
    """Transforms with any poses, of parents, children and stamps since `EPOCH`."""
    rng = np.random.default_rng(seed)
    return [(row(parent, child, EPOCH + stamp, random_pose(rng)), static) for parent, child, stamp in links]


def a_frame_on_both_topics(*order: bool) -> Case:
    links = [("a", "b", second * SECOND) for second in (4, 2, 6)]
    rows = [each for static in order for each in poses(11 + static, links, static)]
    return Case(rows, [("a", "b", EPOCH + half * HALF) for half in range(16)], 1)


def equal_stamps_and_what_they_leave_behind() -> Case:
    """The repeated one brings a parent that nothing else mentions: known, but connected to nothing."""
    stamps = [("a", 1), ("a", 2), ("ghost", 2), ("a", 1), ("a", 3), ("a", 3)]
    rows = poses(12, [(parent, "child", second * SECOND) for parent, second in stamps])
    questions = [(t, "child", EPOCH + half * HALF) for half in range(8) for t in ("a", "ghost")]
    return Case(rows, questions, 1)


def transforms_that_are_ignored() -> Case:
    nan, good = float("nan"), (1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8)
    rows = [
        (row("a", "b", EPOCH, good), False),
        (row("/a", "/b", EPOCH + SECOND, good), False),
        (row("a", "b", EPOCH + SECOND // 2, (nan, *good[1:])), False),
        (row("a", "b", EPOCH + SECOND // 3, (*good[:6], nan)), False),
        (row("a", "b", EPOCH + SECOND // 4, (*good[:3], 0.0, 0.0, 0.0, 0.0)), False),
        (row("only_nan", "c", EPOCH, (nan, *good[1:])), True),
        *((row(*names, EPOCH, good), True) for names in (("s", "s"), ("/t", "t"), ("", "d"), ("e", ""), ("e", "/"))),
    ]
    frames = ["a", "b", "c", "d", "e", "s", "t", "only_nan"]
    questions = [(t, s, EPOCH + SECOND * n // 12) for t in frames for s in frames for n in range(13)]
    return Case(rows, questions, 1)


def a_stamp_of_zero_is_the_latest_common_time() -> Case:
    rows = poses(13, [("map", "odom", tenth * TENTH) for tenth in range(0, 31, 5)])
    rows += poses(14, [("odom", "base", tenth * TENTH) for tenth in range(40)])
    rows += poses(15, [("base", "lidar", 0)], True)
    rows += poses(16, [("base", "late", 9 * SECOND), ("base", "unstamped", -EPOCH), ("base", "since_zero", -EPOCH)])
    rows += poses(17, [("base", "since_zero", 0)]) + poses(18, [("unstamped", "static", -EPOCH)], True)
    frames = ["map", "odom", "base", "lidar", "late", "unstamped", "since_zero", "static"]
    questions = [(target, source, 0) for target in frames for source in frames]
    return Case(rows, questions, 21)


def rotations_of_any_length() -> Case:
    """Around both limits of the squared norm, and some far away."""
    rng = np.random.default_rng(16)
    rows: Rows = []
    for number in range(400):
        pose = np.array(random_pose(rng))
        pose[3:] /= np.linalg.norm(pose[3:])
        squared = rng.choice([0.99, 1.01]) + rng.choice([0.0, 1e-16, -1e-16, 1e-9, -1e-9, 0.1, -0.1])
        pose[3:] *= math.sqrt(squared)
        rows.append((row("a", f"b{number}", EPOCH, tuple(pose.tolist())), True))
    questions = [("a", f"b{number}", EPOCH) for number in range(400)]
    return Case(rows, questions, 101)


def zeros_keep_their_signs() -> Case:
    """Which of them an identity turns around depends on where tf2's walks end."""
    rng = np.random.default_rng(17)
    frames = ["map", "odom", "base", "left", "right", "tip"]
    rows: Rows = []
    for number, (parent, child) in enumerate(pairwise(frames)):
        for second in range(3):
            i, j, k = rng.choice([0.0, -0.0], 3).tolist()
            pose = (*rng.choice([0.0, -0.0, 1.0], 3).tolist(), i, j, k, float(rng.choice([1.0, -1.0])))
            rows.append((row(parent, child, EPOCH + second * SECOND, pose), number % 2 == 1))
    return Case(rows, [(t, s, EPOCH + half * HALF) for t in frames for s in frames for half in range(6)], 101)


def loops_for_a_while() -> Case:
    """Odometry in both directions, at stamps of their own, above two lidars."""
    rows = [
        *poses(19, [("odom", "body", number * SECOND) for number in range(5)], False),
        *poses(20, [("body", "odom", number * SECOND) for number in range(3, 9)], False),
        *poses(21, [("body", "front", 0), ("body", "rear", 0)], True),
    ]
    frames, stamps = ("odom", "body", "front", "rear"), [0, *(EPOCH + number * SECOND // 2 for number in range(-1, 18))]
    questions = [(one, other, stamp_ns) for one, other in permutations(frames, 2) for stamp_ns in stamps]
    return Case(rows, questions, 80)


@pytest.mark.parametrize(
    "case",
    [
        partial(a_frame_on_both_topics, False, True),
        partial(a_frame_on_both_topics, True, False),
        equal_stamps_and_what_they_leave_behind,
        transforms_that_are_ignored,
        a_stamp_of_zero_is_the_latest_common_time,
        rotations_of_any_length,
        zeros_keep_their_signs,
        loops_for_a_while,
    ],
)
def test_tf2_answers_alike(case: Callable[[], Case], oracle: Path) -> None:
    rows, questions, least = case()
    known, differing = table.lookups(oracle, rows, questions)
    assert known >= least
    assert differing == 0
