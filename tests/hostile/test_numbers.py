"""Stamps and values that cannot be, and frame trees that no robot has."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np
import pytest

from support.bounded import run_bounded
from support.builders import MOUNT, POINTS, T0, Item, Recording, cloud, item, points_of, write_mcap, write_rosbag1
from support.outputs import opened

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


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


@pytest.mark.slow
def test_a_frame_tree_of_very_many_nodes(tmp_path: Path) -> None:
    done = run_bounded("convert", tree(tmp_path / "a.bag", 101_000), "--target-frame", "f0")
    assert done.status == 1
    assert "more than 100,000 frames" in done.stderr


def test_frames_that_form_a_loop(tmp_path: Path) -> None:
    source = tree(tmp_path / "a.bag", 2_000, loop=True)
    # The walk up from the cloud's frame ends at f3, as in tf2.
    assert run_bounded("convert", source, "--target-frame", "f3").status == 0
    assert run_bounded("tf", source).status == 0


#: Stamps, and the destinations that cannot hold them: ROS 1 has no negative seconds, and ROS 2 none beyond 2038, which
#: nanoseconds can add up to.
STAMPS = {(-(2**31), 0): {"out.bag"}, (2**31 - 1, 2**32 - 1): {"out.mcap", "out"}, (0, 2**32 - 1): set(), (0, 0): set()}


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
