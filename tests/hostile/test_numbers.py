"""Stamps and values that cannot be, and frame trees that no robot has."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.messages.pointcloud2 import PointField, encode_pointcloud2
from support import sampled
from support.bounded import run_bounded
from support.builders import (
    MOUNT,
    POINTS,
    T0,
    Item,
    Recording,
    Stream,
    cloud,
    item,
    points_of,
    scan,
    write_mcap,
    write_rosbag1,
)
from support.outputs import opened

if TYPE_CHECKING:
    from collections.abc import Iterator

FILES = Path(__file__).with_name("files")


def links(count: int, *, loop: bool = False) -> Iterator[bytes]:
    """ROS 1's TFMessages of a thousand transforms each: a chain of frames, or a loop."""
    for begin in range(0, count, 1_000):
        rows = []
        for number in range(begin, begin + 1_000):
            parent, child = b"f%d" % number, b"f%d" % ((number + 1) % count if loop else number + 1)
            head = struct.pack("<4I", 0, 5, 0, len(parent)) + parent + struct.pack("<I", len(child)) + child
            rows.append(head + struct.pack("<7d", 1, 0, 0, 0, 0, 0, 1))
        yield struct.pack("<I", 1_000) + b"".join(rows)


def tree(path: Path, count: int, *, loop: bool = False) -> Path:
    items = [Item(MOUNT, T0 + n, {1: data}) for n, data in enumerate(links(count, loop=loop))]
    last = cloud(points_of(1), 1, frame_id=f"f{count // 2 if loop else count}")
    return write_rosbag1(path, Recording((MOUNT, POINTS), (*items, Item(POINTS, T0 + len(items), {1: last}))), "lz4")


@pytest.mark.parametrize(
    ("count", "command"), sampled([(101_000, "convert"), (1_000_000, "tf"), (1_000_000, "convert")], 1)
)
def test_a_frame_tree_of_very_many_nodes(count: int, command: str, tmp_path: Path) -> None:
    options = ("--target-frame", "f0") if command == "convert" else ()
    done = run_bounded(command, tree(tmp_path / "a.bag", count), *options)
    assert done.status == 1
    assert "more than 100,000 frames" in done.stderr


@pytest.mark.parametrize("count", sampled([5_000, 50_000], 1))
def test_a_long_chain_of_frames(count: int, tmp_path: Path) -> None:
    done = run_bounded("tf", tree(tmp_path / "a.bag", count), "--lookup", "f0", f"f{count}")
    assert done.status == 0
    assert f"x {count}.000000" in done.stdout


@pytest.mark.parametrize("count", sampled([2_000, 20_000], 1))
def test_frames_that_form_a_loop(count: int, tmp_path: Path) -> None:
    source = tree(tmp_path / "a.bag", count, loop=True)
    # The walk up from the cloud's frame ends at f3, as in tf2.
    assert run_bounded("convert", source, "--target-frame", "f3").status == 0
    assert run_bounded("tf", source).status == 0


#: Stamps, and the destinations that cannot hold them: ROS 1 has no negative seconds, and ROS 2 none beyond 2038, which
#: nanoseconds can add up to.
STAMPS = {
    (-(2**31), 0): {"out.bag"},
    (2**31 - 1, 2**32 - 1): {"out.mcap", "out"},
    (0, 2**32 - 1): set(),
    (0, 0): set(),
}


@pytest.mark.parametrize("stamp", STAMPS)
@pytest.mark.parametrize("destination", ["out.bag", "out.mcap", "out"])
def test_stamps_that_cannot_be(stamp: tuple[int, int], destination: str, tmp_path: Path) -> None:
    data = bytearray(cloud(points_of(1), 2))
    struct.pack_into("<iI", data, 4, *stamp)
    source = write_mcap(tmp_path / "a.mcap", Recording((POINTS,), (Item(POINTS, T0, {2: bytes(data)}),)))
    done = run_bounded("convert", source, "-o", tmp_path / destination)
    if destination in STAMPS[stamp]:
        assert (done.status, (tmp_path / destination).exists()) == (1, False)
        assert "does not fit into ROS" in done.stderr
    else:
        assert done.status == 0, done.stderr
        assert len(opened(tmp_path / destination).scans()) == 1


@pytest.mark.parametrize("log_time_ns", [0, 2**63 - 1, 2**63, 2**64 - 1])
@pytest.mark.parametrize("destination", ["out.bag", "out.mcap", "out", "sqlite3"])
def test_log_times_that_cannot_be(log_time_ns: int, destination: str, tmp_path: Path) -> None:
    data = cloud(points_of(1), 2)
    late = Item(POINTS, max(log_time_ns, 1_001), {2: data})
    source = write_mcap(tmp_path / "a.mcap", Recording((POINTS,), (late, Item(POINTS, T0, {2: data}))))
    storage = ("--storage", "sqlite3") if destination == "sqlite3" else ()
    done = run_bounded("convert", source, "-o", tmp_path / destination, *storage)
    assert done.status in (0, 1, 3), done.stderr
    assert (tmp_path / destination).exists() == (done.status != 1)
    assert run_bounded("info", source).status in (0, 1)


VALUES = (np.nan, np.inf, -np.inf, 3.4e38, -3.4e38, 1e-45, 0.0)


def test_clouds_of_values_that_are_no_places(tmp_path: Path) -> None:
    grid = np.array([(x, y, z) for x in VALUES for y in VALUES for z in VALUES], np.float32)
    items = [item(POINTS, T0, lambda g, _: cloud(grid, g)), item(POINTS, T0 + 1, lambda g, _: cloud(grid[::-1], g))]
    source = write_mcap(tmp_path / "a.mcap", Recording((POINTS,), tuple(items)))
    done = run_bounded("convert", source, "-o", tmp_path / "out.mcap", "--min-height=-inf")
    assert done.status == 0, done.stderr
    first, second = (found.ranges for found in opened(tmp_path / "out.mcap").scans())
    assert not np.isnan(first).any()
    np.testing.assert_array_equal(first, second)
    assert run_bounded("info", source).status == 0


@pytest.mark.parametrize("heights", [(1e20, 1e20), (3.4e38, -3.4e38), (1e20, float(np.nextafter(1e20, 2e20)))])
def test_heights_that_are_too_large_for_a_histogram(heights: tuple[float, ...], tmp_path: Path) -> None:
    grid = np.array([(1, 0, z) for z in heights], np.float32)
    items = [item(POINTS, T0 + n, lambda g, _: cloud(grid, g)) for n in range(2)]
    source = write_mcap(tmp_path / "a.mcap", Recording((POINTS,), tuple(items)))
    for path in (source, FILES / "one_height.mcap"):
        done = run_bounded("info", path)
        assert done.status == 0
        # The stamps of the file are far from its log times.
        assert (path != source) == ("its clock counts from its start" in done.stderr)
        assert not done.stderr or len(done.stderr.splitlines()) == 1
        assert "heights (z)" in done.stdout


def test_float64_heights_whose_difference_is_no_number(tmp_path: Path) -> None:
    points = np.array([(1, 0, 1.7e308), (1, 0, -1.7e308), (1, 0, 2)], np.float64)
    data = encode_pointcloud2(
        serialization="cdr",
        sequence=0,
        stamp_ns=T0,
        frame_id="lidar",
        fields=[PointField(name, 8 * place, 8) for place, name in enumerate("xyz")],
        point_step=24,
        data=points.tobytes(),
    )
    source = write_mcap(tmp_path / "a.mcap", Recording((POINTS,), (Item(POINTS, T0, {2: data}),)))
    done = run_bounded("info", source, "--json")
    assert done.status == 0
    assert not {"Infinity", "NaN"} & set(re.findall(r"\w+", done.stdout))


def test_scans_of_values_that_are_no_distances(tmp_path: Path) -> None:
    laser = Stream("/laser", "sensor_msgs/msg/LaserScan")
    made = item(laser, T0, lambda g, _: scan(np.array(VALUES, np.float32), g))
    data = bytearray(made.data[2])
    # Angles and times too: all seven.
    struct.pack_into("<7f", data, 4 + 20, *VALUES)
    source = write_mcap(tmp_path / "a.mcap", Recording((laser,), (made, Item(laser, T0 + 1, {2: bytes(data)}))))
    # The clouds have no point at all where all numbers are impossible.
    assert run_bounded("convert", source, "--reverse").status in (0, 3, 4)


def test_transforms_of_values_that_are_no_places(tmp_path: Path) -> None:
    poses = [(value,) * 7 for value in VALUES] + [(0, 0, 1, 0, 0, 0, value) for value in VALUES]
    rows = b"".join(
        struct.pack("<4I", 0, 5 + n, 0, 4) + b"base" + struct.pack("<I", 5) + b"lidar" + struct.pack("<7d", *pose)
        for n, pose in enumerate(poses)
    )
    transforms = Item(MOUNT, T0, {1: struct.pack("<I", len(poses)) + rows})
    points = Item(POINTS, T0 + 1, {1: cloud(points_of(1), 1, stamp_ns=12 * 10**9)})
    source = write_rosbag1(tmp_path / "a.bag", Recording((MOUNT, POINTS), (transforms, points)))
    done = run_bounded("convert", source, "--target-frame", "base")
    assert done.status == 1, done.stderr
    assert "TF_NAN_INPUT" in done.stderr
    assert run_bounded("tf", source).status == 0


@pytest.mark.parametrize(
    "parameter",
    ["angle_increment:=.nan", "angle_increment:=1e-300", "range_max:=.nan", "angle_max:=.inf", "scan_time:=-.inf"],
)
def test_parameters_that_cannot_be(parameter: str, tmp_path: Path) -> None:
    source = write_mcap(
        tmp_path / "a.mcap", Recording((POINTS,), (item(POINTS, T0, lambda g, _: cloud(points_of(1), g)),))
    )
    assert run_bounded("convert", source, "--param", parameter).status in (0, 2)
