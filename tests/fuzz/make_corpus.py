"""Make the corpus: small sound inputs of every decoder, for the fuzzer to begin with.

``PYTHONPATH=src:tests python tests/fuzz/make_corpus.py``
"""

from __future__ import annotations

import base64
import bz2
import struct
from typing import TYPE_CHECKING

import lz4.frame
import numpy as np
import zstandard

from fuzz import clouds, rays
from fuzz.decoders import CORPUS
from pc2scan.compare.scan_text import render_scans
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.model import Connection, RawMessage
from support import GOLDEN
from support.builders import (
    BATTERY,
    CONTENT,
    IDL,
    POINTS,
    T0,
    cloud,
    definition,
    imu_message,
    points_of,
    qos_text,
    scan,
)
from support.clouds import (
    COMPRESSORS,
    DRACO,
    compressed,
    draco_points,
    lidar_points,
    livox,
    livox_points,
    multi_echo,
    old_cloud,
    packet,
    velodyne,
)
from support.worlds import posed

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


_MODEL = b"""<robot name="r">
  <joint name="a" type="fixed"><parent link="b"/><child link="c"/><origin xyz="1 2 3" rpy="0 .1 0"/></joint>
  <joint name="d" type="revolute"><parent link="b"/><child link="e"/><axis xyz="0 0 1"/></joint>
</robot>
"""


def inputs() -> Iterator[tuple[str, str, bytes]]:
    """Decoder, name and content."""
    first = {"ros1": (1, b"\0"), "cdr": (2, b"\xff")}
    for word, (ros_version, lead) in first.items():
        points = points_of(1, 3)
        yield "cloud", word, lead + cloud(points, ros_version)
        yield "wire", word, lead + cloud(points, ros_version)
        yield "stamps", word, lead + cloud(points, ros_version, names=("x", "y", "t"))
        for kind in ("odometry", "pose"):
            pose = posed.message(kind, ros_version, 0, T0, ("odom", "base_link"), posed.pose_at(T0))
            yield "poses", f"{word}-{kind}", lead + pose
        few = lidar_points(1, 4)
        for name in COMPRESSORS:
            yield "compressed", f"{word} {name}".replace(" ", "-"), lead + compressed(few, ros_version, name)
        for line in DRACO.read_text("ascii").splitlines():
            name, _, encoded = line.partition(" ")
            packed = compressed(draco_points(), ros_version, data=base64.b64decode(encoded), form="draco")
            yield "compressed", f"{word}-draco-{name}", lead + packed
        yield "pointcloud", word, lead + old_cloud(few, ros_version)
        yield "livox", word, lead + livox(livox_points(1, 4), ros_version)
        yield "velodyne", word, lead + velodyne([(T0, packet(0, range(400, 432), 7))] * 2, ros_version)
        yield "multi-echo", word, lead + multi_echo(ros_version)
        yield "scan", word, lead + scan(points[:, 0], ros_version)
        yield "transforms", word, lead + CONTENT.of("/tf")[0].data[ros_version]
        yield "imu", word, lead + b"".join(imu_message(ros_version, stamp_ns=T0 + place * 10**7) for place in range(4))
        text = struct.pack("<I", 2) + (b"\0" if ros_version == 1 else b"a\0\0\0") * 4
        yield "transcoding", word, lead + (b"" if ros_version == 1 else b"\0\1\0\0") + text + bytes(60)
        yield "schema", word, bytes([ros_version - 1]) + definition(BATTERY, ros_version).encode()
    yield "schema", "idl", b"\x02" + IDL[BATTERY].encode()
    text = b"some text that repeats, some text that repeats"
    yield "salvage", "bz2", b"\0" + bz2.compress(text)[3:]
    yield "salvage", "lz4", b"\1" + lz4.frame.compress(text)[4:]
    yield "salvage", "zstd", b"\2" + zstandard.compress(text)[4:]
    yield (
        "ros1-frames",
        "text",
        lz4.frame.compress(text, block_linked=False, store_size=False, content_checksum=True)[4:],
    )
    yield from _clouds()
    yield from _moving()
    fan = [((20, 10, 40 * (n % 2), n), n) for n in range(20)]
    yield "rays", "fan", rays.written(40, 19, 3, fan)
    yield "rays", "line", rays.written(200, 0, 0, [((0, 0, n, 0), n) for n in range(9)])
    yield "rays", "outside", rays.written(5, 5, 1, [((0, 0, 5, 5), 1), ((6, 0, 0, -1), 1), ((2**31 - 1, 0, 0, 0), 0)])
    yield "scan-text", "messages", _scan_text().encode()
    yield "model", "fixed", _MODEL
    yield "trajectory", "tum", b"# stamp x y z qx qy qz qw\n1.5 0 1 2 0 0 0 1\n2.5 0 1 2 0.5 0.5 0.5 0.5\n"
    yield "qos", "profile", qos_text((POINTS,)).encode()
    yield "parameters", "ros2", (GOLDEN / "launch_sample" / "params.yaml").read_bytes()
    yield "parameters", "ros1", b"min_height: -0.5\nangle_min: rad(-pi/2)\nuse_inf: 1\n"


def _clouds() -> Iterator[tuple[str, str, bytes]]:
    """Points packed, strided, in rows with a gap, and of other datatypes."""
    points = points_of(1, 12)
    floats = ((0, 7), (4, 7), (8, 7), (8, 7))
    yield "clouds", "floats", clouds.written(floats, points.tobytes(), step=12)
    padded = np.zeros((12, 16), np.uint8)
    padded[:, :12] = points.view(np.uint8).reshape(12, 12)
    yield "clouds", "rows", clouds.written(floats, padded.tobytes(), step=12, height=4, row_step=48, flags=4)
    doubles = ((0, 8), (8, 8), (16, 8), (16, 8))
    yield "clouds", "doubles", clouds.written(doubles, points.astype(">f8").tobytes(), step=24, flags=3)
    mixed = ((0, 3), (2, 6), (6, 1), (7, 2))
    yield "clouds", "mixed", clouds.written(mixed, bytes(range(96)), step=8, flags=6)


def _moving() -> Iterator[tuple[str, str, bytes]]:
    """Points with times of several datatypes, on the way through a turn; for a while no transform is known."""
    record = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4")])
    sweep = np.zeros(24, record)
    angles = np.linspace(-3.0, 3.0, 24)
    sweep["x"], sweep["y"], sweep["z"] = 5 * np.cos(angles), 5 * np.sin(angles), 0.5
    sweep["t"] = np.linspace(0, 200_000, 24)
    turns = np.linspace(0, 0.5, 9)
    rows = np.zeros((9, 12), np.float32)
    rows[:, 0], rows[:, 1], rows[:, 3], rows[:, 4] = np.cos(turns), -np.sin(turns), np.sin(turns), np.cos(turns)
    rows[:, 8], rows[:, 9] = 1, turns
    gap = rows.copy()
    gap[4] = np.nan
    floats = ((0, 7), (4, 7), (8, 7))
    whole = clouds.written((*floats, (12, 6)), sweep.tobytes(), step=16)
    yield "moving", "microseconds", clouds.motion_written(b"\4\4\4", rows, whole, offset=0.0, unit=1e-6)
    yield "moving", "gap", clouds.motion_written(b"\4\0\4", gap, whole, offset=1000.0, unit=1e-6)
    seconds = sweep.astype([(name, "<f8" if name == "t" else "<f4") for name in "xyzt"])
    seconds["t"] *= 1e-6
    lit = clouds.written((*floats, (12, 8)), seconds.tobytes(), step=20, height=4, flags=4)
    yield "moving", "rows", clouds.motion_written(b"\3\3\3", rows, lit, offset=0.0, unit=1.0)
    wild = rows.copy()
    wild[::2, 0], wild[1::2, 0], wild[:, 11] = 3e38, -3e38, -50
    yield "moving", "overflow", clouds.motion_written(b"\4\4\4", wild, whole, offset=0.0, unit=1e-6)
    mixed = clouds.written(((0, 3), (2, 6), (6, 1), (7, 2)), bytes(range(96)), step=8, flags=5)
    yield "moving", "mixed", clouds.motion_written(b"\1\2\3", rows, mixed, offset=80.0, unit=0.01)


def _scan_text() -> str:
    ranges, messages = points_of(1, 3)[:, 0], []
    for number, serialization in enumerate(("ros1", "cdr")):
        connection = Connection(number, f"/t{number}", LASERSCAN, serialization)
        messages.append(RawMessage(connection, T0, scan(ranges, number + 1), T0))
    return render_scans(messages)


def main(folder: Path = CORPUS) -> None:
    """Write one file for each."""
    for decoder, name, data in inputs():
        (folder / decoder).mkdir(parents=True, exist_ok=True)
        (folder / decoder / name).write_bytes(data)


if __name__ == "__main__":
    main()
