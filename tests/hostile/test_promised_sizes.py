"""Lengths and counts that promise more than there is, and compressed data that unfold to more than anybody has."""

from __future__ import annotations

import io
import struct
from typing import TYPE_CHECKING

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.records import Schema

from pc2scan.bags.mcap.records import MAGIC
from support import mcap_files, rosbag1_files
from support.bounded import run_bounded
from support.builders import (
    CLOUD,
    POINTS,
    T0,
    Item,
    Recording,
    cloud,
    points_of,
    write_mcap,
    write_rosbag1,
    write_rosbag2,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

#: More than the bounds allow, and of zeros: a few kilobytes when compressed.
HUGE = 300_000_000

#: A channel of clouds without a definition.
DECLARED: bytes = mcap_files.encoded(Schema(id=1, name=CLOUD, encoding="ros2msg", data=b"")) + mcap_files.raw_channel(
    topic="/points", schema=1
)


def zero_cloud(size: int, ros_version: int) -> bytes:
    """A cloud whose points are ``size`` bytes of zeros."""
    empty = cloud(np.empty((0, 3), np.float32), ros_version)
    # Width, row_step and the length of the data are the numbers of points; is_dense is the last byte.
    head, tail = bytearray(empty[:-1]), empty[-1:]
    head[-8:] = struct.pack("<II", size, size)
    # ROS 1: seq, stamp, length and text. CDR: stamp, length, text and NUL, counted from behind its own header.
    at = 16 + 5 if ros_version == 1 else 4 + (12 + 6 + 2)
    struct.pack_into("<II", head, at, 1, size // 12)
    return b"".join((head, bytes(size), tail))


def mcap_of(path: Path, message: bytes, compression: str) -> Path:
    """An MCAP file of one chunk with one cloud."""
    body = bytes(DECLARED + mcap_files.raw_message(data=message))
    return mcap_files.raw_file(
        path, mcap_files.raw_chunk(body, compression=compression, packed=PACK[compression](body))
    )


def bag_of(path: Path, message: bytes, compression: str) -> Path:
    """A ROS 1 bag of one chunk with one cloud."""
    payload = rosbag1_files.message(5, message)
    connection = rosbag1_files.connection_record(type=b"sensor_msgs/PointCloud2")
    stored = PACK[compression](payload)
    return rosbag1_files.simple_bag(path, payload, compression=compression, stored=stored, connections=(connection,))


PACK: dict[str, Callable[[bytes], bytes]] = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}


@pytest.mark.slow
@pytest.mark.parametrize(("container", "compression"), [("mcap", "zstd"), ("bag", "lz4")])
def test_a_chunk_that_unfolds_to_more_than_may_be(container: str, compression: str, tmp_path: Path) -> None:
    made, ros_version = (bag_of, 1) if container == "bag" else (mcap_of, 2)
    source = made(tmp_path / f"a.{container}", zero_cloud(HUGE, ros_version), compression)
    assert source.stat().st_size < 5_000_000
    for command in ("repair", "convert"):
        done = run_bounded(command, source)
        # The front of the chunk is kept, and no message of it is whole.
        assert "possible in a file of this size" in done.stdout + done.stderr
        assert command != "repair" or done.status == 3


@pytest.mark.slow
@pytest.mark.parametrize(("storage", "told"), [("mcap", True), ("sqlite3", False)])
def test_a_message_that_unfolds_to_more_than_may_be(storage: str, told: bool, tmp_path: Path) -> None:
    packed = zstandard.ZstdCompressor(write_content_size=told).compress(zero_cloud(HUGE, 2))
    stored = Recording((POINTS,), (Item(POINTS, T0, {2: packed}),))
    source = write_rosbag2(tmp_path / "drive", stored, storage=storage, version=5)
    text = (source / "metadata.yaml").read_text().replace('mode: ""', "mode: MESSAGE")
    (source / "metadata.yaml").write_text(text.replace('format: ""', "format: zstd"))
    done = run_bounded("convert", source, margin=250_000_000)
    assert done.status in (1, 3)
    assert "cannot be decompressed" in done.stderr


def test_a_file_that_unfolds_to_more_than_may_be(tmp_path: Path) -> None:
    packed = io.BytesIO()
    with zstandard.ZstdCompressor().stream_writer(packed, closefd=False) as writer:
        writer.write(MAGIC)
        for _ in range(300):
            writer.write(bytes(1_000_000))
    (tmp_path / "a.mcap.zst").write_bytes(packed.getvalue())
    done = run_bounded("convert", tmp_path / "a.mcap.zst")
    assert done.status == 1
    assert "1000 times its size" in done.stderr


@pytest.mark.parametrize("ros_version", [1, 2])
def test_every_number_of_a_cloud_may_be_the_largest(ros_version: int, tmp_path: Path) -> None:
    """Frame's length, height, width, fields, their names, offsets and counts, point_step, row_step, data's length."""
    sound = cloud(points_of(0), ros_version)
    head = len(sound) - 12 * 60 - 1
    payloads = [
        sound[:place] + struct.pack("<I", value) + sound[place + 4 :]
        for place in range(4 if ros_version == 2 else 0, head - 3)
        for value in (0, 1 << 31, 0xFFFF_FFFF)
    ]
    recording = Recording((POINTS,), tuple(Item(POINTS, T0 + n, {ros_version: d}) for n, d in enumerate(payloads)))
    made = write_rosbag1 if ros_version == 1 else write_mcap
    source = made(tmp_path / ("a.bag" if ros_version == 1 else "a.mcap"), recording)
    for command in (("info",), ("convert", "--min-height", "-9")):
        done = run_bounded(command[0], source, *command[1:])
        assert done.status in (0, 3), done.stderr


@pytest.mark.slow
def test_many_chunks_that_overlap_in_time(tmp_path: Path) -> None:
    """Each may be held until its last message is due; together they must not be."""
    data = zero_cloud(15_600_000, 2)
    chunks = []
    for number in range(12):
        body = mcap_files.raw_message(1, number, data) + mcap_files.raw_message(1, 1_000 + number, data)
        times = {"message_start_time": number, "message_end_time": 1_000 + number}
        chunks.append(mcap_files.raw_chunk(body, compression="zstd", packed=zstandard.compress(body), **times))
    source = mcap_files.raw_file(tmp_path / "a.mcap", DECLARED, *chunks)
    done = run_bounded("convert", source, "--keep-clouds")
    assert done.status == 4, done.stderr
    assert "24 of 24 scans" in done.stderr
