"""Everything against Debian's own tf2, tf2_sensor_msgs and laser_geometry, live.

Stamps are those of today, to the nanosecond; results are compared to the bit.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pytest

from parity import debian, table
from pc2scan.conversion.scan_to_cloud import ScanToCloud
from pc2scan.errors import MessageError
from pc2scan.messages.laserscan import LaserScan, encode_laserscan
from pc2scan.messages.pointcloud2 import decode_pointcloud2
from pc2scan.transforms.placing import Placer
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


@pytest.mark.parametrize("seed", range(2))
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
