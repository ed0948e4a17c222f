"""Which LZ4 frames ROS 1's own reader takes."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING, Any

import lz4.frame
import pytest

from pc2scan.bags.rosbag1.read import is_readable_lz4
from pc2scan.bags.rosbag1.write import compress_lz4
from support.rosbag1_files import ROS1, ros1, ros1_missing

if TYPE_CHECKING:
    from pathlib import Path

DATA = bytes(range(256)) * 1000 + random.Random(1).randbytes(300_000)
OPTIONS: dict[str, Any] = {"block_linked": False, "store_size": False, "content_checksum": True}
OURS = compress_lz4(DATA)

ACCEPTED = {
    **{f"of {size} blocks": lz4.frame.compress(DATA, block_size=size, **OPTIONS) for size in (4, 5, 6, 7)},
    "empty": compress_lz4(b""),
    "ours": OURS,
}
OTHERS = {"block_linked": True, "store_size": True, "content_checksum": False, "block_checksum": True}
REFUSED = {
    **{name: lz4.frame.compress(DATA, **{**OPTIONS, name: value}) for name, value in OTHERS.items()},
    "no frame": b"data" * 10,
}


def test_frames_that_ros1_reads_are_known() -> None:
    assert {name: is_readable_lz4(frame) for name, frame in (ACCEPTED | REFUSED).items()} == {
        name: name in ACCEPTED for name in ACCEPTED | REFUSED
    }


ROS1_UNPACKS = """
import sys, roslz4
for path in sys.argv[1:]:
    with open(path, "rb") as file:
        print(len(roslz4.decompress(file.read())))
"""


@pytest.mark.skipif(bool(ros1_missing()), reason="needs ROS 1's rosbag (Debian: python3-rosbag)")
def test_ros1_itself_agrees(tmp_path: Path) -> None:
    for name, frame in ACCEPTED.items():
        (tmp_path / name).write_bytes(frame)
    done = ros1(ROS1, "-c", ROS1_UNPACKS, *(tmp_path / name for name in ACCEPTED))
    assert done.stdout.split() == ["0" if name == "empty" else str(len(DATA)) for name in ACCEPTED], done.stderr
