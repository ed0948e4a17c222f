"""Which LZ4 frames ROS 1's own reader takes."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING, Any

import lz4.frame
import pytest

from pc2scan.bags.rosbag1.lz4_frames import packed, ros1_reads
from support.rosbag1_files import ROS1, ros1, ros1_missing

if TYPE_CHECKING:
    from pathlib import Path

DATA = bytes(range(256)) * 1000 + random.Random(1).randbytes(300_000)
ACCEPTED: dict[str, Any] = {"block_linked": False, "store_size": False, "content_checksum": True}

ROS1_UNPACKS = """
import sys, roslz4
with open(sys.argv[1], "rb") as file:
    sys.stdout.write(str(len(roslz4.decompress(file.read()))))
"""


def frames() -> dict[str, bytes]:
    made = {f"of {size} blocks": lz4.frame.compress(DATA, block_size=size, **ACCEPTED) for size in (4, 5, 6, 7)}
    for name, value in (
        ("block_linked", True),
        ("store_size", True),
        ("content_checksum", False),
        ("block_checksum", True),
    ):
        made[name] = lz4.frame.compress(DATA, **{**ACCEPTED, name: value})
    made["empty"] = packed(b"")
    made["ours"] = packed(DATA)
    made["cut off"] = made["ours"][:-1]
    made["with more behind"] = made["ours"] + b"more"
    made["twice"] = made["ours"] * 2
    made["no frame"] = b"data" * 10
    return made


REFUSED = {
    "block_linked",
    "store_size",
    "content_checksum",
    "block_checksum",
    "cut off",
    "with more behind",
    "twice",
    "no frame",
}


@pytest.mark.parametrize("name", sorted(frames()))
def test_frames(name: str) -> None:
    assert ros1_reads(frames()[name]) is (name not in REFUSED)


@pytest.mark.parametrize("name", sorted(frames().keys() - REFUSED))
def test_ros1_itself_agrees(name: str, tmp_path: Path) -> None:
    if ros1_missing():
        pytest.skip(ros1_missing())
    frame = tmp_path / "frame"
    frame.write_bytes(frames()[name])
    done = ros1(ROS1, "-c", ROS1_UNPACKS, frame)
    assert done.stdout == str(0 if name == "empty" else len(DATA)), done.stderr
