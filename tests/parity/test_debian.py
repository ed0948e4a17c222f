"""Everything against Debian's own tf2, tf2_sensor_msgs and laser_geometry, live.

Stamps are those of today, to the nanosecond; results are compared to the bit.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pytest

from parity import debian, table
from pc2scan.conversion.scan_to_cloud import ScanToCloud
from pc2scan.core.unproject import unproject
from pc2scan.errors import MessageError
from pc2scan.messages.laserscan import LaserScan, encode_laserscan
from pc2scan.messages.pointcloud2 import decode_pointcloud2
from pc2scan.transforms.placing import Placer
from support.compiling import folder_of_the_run
from support.conversions import serialized_by
from transforms.trees import EPOCH, SECOND, built, row

if TYPE_CHECKING:
    from pathlib import Path

    from transforms.trees import Rows


# In the quick run, tests/tf asks tf2 by its Python bindings, and has recorded answers of the others.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="session")
def oracle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if debian.why_not():
        pytest.skip(debian.why_not())
    return debian.compiled(folder_of_the_run(tmp_path_factory))


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


@pytest.mark.parametrize("seed", range(4))
def test_nothing_differs_from_debians_libraries(seed: int, oracle: Path) -> None:
    rng = np.random.default_rng(seed)
    for found in table.against_debian(oracle, rng, lookups=5000, points=200_000):
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


def test_scans_stamped_0_and_those_that_end_before_time_begins(oracle: Path) -> None:
    rng = np.random.default_rng(5000)
    rows = debian.moving_laser(rng)
    scans = [
        replace(debian.random_scan(rng), stamp_ns=stamp_ns, time_increment=float(np.float32(time_increment)))
        for stamp_ns in (0, 1, SECOND // 10)
        for time_increment in (0.0, 1e-4, -1e-4, -0.5)
    ]
    assert sum(assert_same_clouds(oracle, rows, "odom", deskewed, scans) for deskewed in (False, True)) > 10


def test_laser_geometry_keeps_directions_by_the_ends_alone(oracle: Path) -> None:
    # docs/exactness.md: of scans that differ in their increments alone, the later ones get the directions of the first.
    ranges = np.arange(1, 6, dtype=np.float32)
    asked = [(-1.0, 1.0, 0.5), (-1.0, 1.0, 0.25), (-1.0, 1.5, 0.25), (-1.0, 1.0, 0.25)]
    commands = [f"P {' '.join(value.hex() for value in numbers)} {debian.hexadecimal(ranges)}" for numbers in asked]
    ours = [
        unproject(ranges, ranges[:0], angle_min=low, angle_increment=step, range_min=0.0, range_max=100.0)
        for low, _, step in asked
    ]
    theirs = [bytes.fromhex(answer) for answer in debian.ask(oracle, [], commands)]
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
        known, differing = table.lookups(oracle, rows, questions)
        assert not differing
        found += known
    assert found > 500
