"""The golden cases: what the upstream nodes returned, against what the command writes."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from builders import CLOUD, SCAN, deserialized
from e2e.command import run
from e2e.outputs import opened
from support import GOLDEN

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from e2e.outputs import Found

CASES = sorted(path.name for path in GOLDEN.iterdir() if path.is_dir())
TRANSFORMED = {"tf_static", "tf_dynamic", "scan_tf"}
EXACT = [name for name in CASES if name not in TRANSFORMED]


def test_every_kind_of_case_is_there() -> None:
    assert set(CASES) > TRANSFORMED
    assert len(EXACT) >= 13


@cache
def expected(name: str) -> list[Found]:
    found = opened(GOLDEN / name / "expected.bag")
    assert found.messages
    return found.messages


def converted(name: str, destination: Path, *options: str) -> None:
    case = GOLDEN / name
    done = run(
        "convert", case / "input.bag", "-o", destination, "--params-file", case / "params.yaml", "--quiet", *options
    )
    assert done.status == 0, done.stderr


def is_reverse(name: str) -> bool:
    return "laserscan_to_pointcloud" in YAML(typ="safe").load(GOLDEN / name / "params.yaml")


@pytest.mark.parametrize("name", EXACT)
def test_equal_to_the_byte(name: str, tmp_path: Path) -> None:
    destination = tmp_path / "out.bag"
    converted(name, destination, "--only-scans")
    assert opened(destination).messages == expected(name)


FIELDS = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")


def parts_of(data: bytes, msgtype: str, generation: int) -> dict[str, Any]:
    """Everything but ``seq``, which ROS 2 does not have; arrays as their bytes, so that NaN equals NaN."""
    message = deserialized(data, msgtype, generation)
    stamp = message.header.stamp
    parts = {"stamp": (stamp.sec, stamp.nanosec), "frame_id": message.header.frame_id}
    if msgtype == SCAN:
        parts |= {name: getattr(message, name) for name in FIELDS}
        return parts | {"ranges": message.ranges.tobytes(), "intensities": message.intensities.tobytes()}
    fields = [(field.name, field.offset, field.datatype, field.count) for field in message.fields]
    shape = (message.height, message.width, message.point_step, message.row_step)
    flags = (message.is_bigendian, message.is_dense)
    return parts | {"fields": fields, "shape": shape, "flags": flags, "data": message.data.tobytes()}


@pytest.mark.parametrize("name", ["fine_full_circle", "nan_and_inf_points", "scan_intensity"])
@pytest.mark.parametrize("options", [(), ("--storage", "sqlite3"), ("--profile", "ros2")], ids=str)
def test_equal_to_the_bit_in_ros2_containers(name: str, options: tuple[str, ...], tmp_path: Path) -> None:
    if name not in CASES:
        pytest.skip(f"{name} is not among the golden cases")
    destination = tmp_path / ("out.mcap" if "--profile" in options else "out")
    converted(name, destination, "--only-scans", *options)
    output = opened(destination)
    msgtype = CLOUD if is_reverse(name) else SCAN
    assert output.generation == 2
    assert [(found.topic, found.log_time_ns) for found in output.messages] == [
        (found.topic, found.log_time_ns) for found in expected(name)
    ]
    for found, reference in zip(output.messages, expected(name), strict=True):
        assert parts_of(found.data, msgtype, 2) == parts_of(reference.data, msgtype, 1)


def moved_bins(ours: NDArray[np.float32], theirs: NDArray[np.float32]) -> int:
    """Beams that differ by more than 1e-5, relative; infinities are equal to themselves only."""
    same = ours == theirs
    finite = np.isfinite(ours) & np.isfinite(theirs)
    near = np.zeros(len(ours), bool)
    near[finite] = np.abs(ours[finite] - theirs[finite]) <= 1e-5 * np.abs(theirs[finite])
    return int(np.count_nonzero(~(same | near)))


@pytest.mark.parametrize("name", ["tf_static", "tf_dynamic"])
def test_transformed_scans(name: str, tmp_path: Path) -> None:
    destination = tmp_path / "out.bag"
    converted(name, destination)
    output = opened(destination)
    ours, theirs = output.scans(), [deserialized(found.data, SCAN, 1) for found in expected(name)]
    assert [found.log_time_ns for found in output.of("/scan")] == [found.log_time_ns for found in expected(name)]
    moved = beams = 0
    for scan, reference in zip(ours, theirs, strict=True):
        assert scan.header == reference.header
        assert [getattr(scan, field) for field in FIELDS] == [getattr(reference, field) for field in FIELDS]
        assert len(scan.ranges) == len(reference.ranges)
        moved += moved_bins(scan.ranges, reference.ranges)
        beams += len(scan.ranges)
    assert moved <= beams // 1000


def test_transformed_clouds(tmp_path: Path) -> None:
    destination = tmp_path / "out.bag"
    converted("scan_tf", destination)
    output = opened(destination)
    reference = [deserialized(found.data, CLOUD, 1) for found in expected("scan_tf")]
    assert [found.log_time_ns for found in output.of("/cloud")] == [found.log_time_ns for found in expected("scan_tf")]
    worst = 0.0
    for ours, theirs in zip(output.clouds(), reference, strict=True):
        assert (ours.header.stamp, ours.header.frame_id) == (theirs.header.stamp, theirs.header.frame_id)
        assert ours.fields == theirs.fields
        assert (ours.height, ours.width, ours.point_step) == (theirs.height, theirs.width, theirs.point_step)
        assert (ours.is_dense, ours.is_bigendian) == (theirs.is_dense, theirs.is_bigendian)
        mine, other = (message.data.reshape(-1, ours.point_step) for message in (ours, theirs))
        # Beyond x, y, z nothing is transformed.
        assert mine[:, 12:].tobytes() == other[:, 12:].tobytes()
        difference = mine[:, :12].copy().view("<f4") - other[:, :12].copy().view("<f4")
        worst = max(worst, float(np.abs(difference).max()))
    assert worst <= 2e-6


def test_transformed_clouds_are_numbered_as_upstream_does(tmp_path: Path) -> None:
    # tf2 gives a transformed cloud the transform's header, whose sequence number is 0.
    destination = tmp_path / "out.bag"
    converted("scan_tf", destination)
    reference = [deserialized(found.data, CLOUD, 1) for found in expected("scan_tf")]
    assert [m.header.seq for m in opened(destination).clouds()] == [m.header.seq for m in reference]
