"""Messages of all kinds of clouds with given points, as rosbags serialises them."""

from __future__ import annotations

import gzip
import math
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
import zstandard

from support import ROOT, builders
from support.builders import CLOUD, T0

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

LIVOX = ("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg")
COMPRESSED = "point_cloud_interfaces/msg/CompressedPointCloud2"
OLD_CLOUD = "sensor_msgs/msg/PointCloud"
VELODYNE = "velodyne_msgs/msg/VelodyneScan"

#: What point_cloud_transport's plugins write, and what their subscribers read too: a zlib header.
COMPRESSORS: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "zlib": ("zlib", lambda data: gzip.compress(data, 6, mtime=0)),
    "zlib header": ("zlib", zlib.compress),
    "zstd": ("zstd", lambda data: zstandard.ZstdCompressor().compress(data)),
    "zstd stream": ("zstd", lambda data: zstandard.ZstdCompressor(write_content_size=False).compress(data)),
}

#: The points that ``draco.cpp`` encoded, and the result: points as they were, merged, and rounded to 14 bits.
DRACO = ROOT / "tests" / "messages" / "draco.txt"

MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"
ECHO_RANGES: tuple[list[float], ...] = ([1.0], [2.0, 4.0], [], [3.0, 5.0, 6.0], [7.0, math.inf], [8.0, 9.0])
ECHO_INTENSITIES: tuple[list[float], ...] = ([10.0], [20.0, 50.0], [], [30.0, 90.0, 40.0], [1.0, 2.0], [5.0, 5.0])


_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def lidar_points(step: int, count: int = 300) -> NDArray[Any]:
    """A lidar's points with an intensity and a ring, some of them NaN; with bytes between the fields."""
    random = np.random.default_rng(step)
    names, kinds = ["x", "y", "z", "intensity", "ring"], ["<f4", "<f4", "<f4", "<f4", "<u2"]
    dtype = np.dtype({"names": names, "formats": kinds, "offsets": [0, 4, 8, 16, 20], "itemsize": 24})
    points = np.zeros(count, dtype)
    for axis in "xyz":
        points[axis] = random.uniform(-8, 8, count)
    points["x"][::31] = np.nan
    points["intensity"] = random.integers(0, 256, count)
    points["ring"] = np.arange(count) % 16
    return points


def _description(
    points: NDArray[Any], ros_version: int, seq: int, stamp_ns: int, frame_id: str = "lidar"
) -> dict[str, Any]:
    store = builders.typestore(ros_version)
    field = store.types["sensor_msgs/msg/PointField"]
    dtype = points.dtype
    fields = [field(name, dtype.fields[name][1], _CODES[dtype[name].str[1:]], 1) for name in dtype.names or ()]  # type: ignore[index]
    return {
        "header": builders.header(store, ros_version, seq, stamp_ns, frame_id),
        "height": 1,
        "width": len(points),
        "fields": fields,
        "is_bigendian": False,
        "point_step": dtype.itemsize,
        "row_step": dtype.itemsize * len(points),
    }


def structured(
    points: NDArray[Any],
    ros_version: int,
    *,
    seq: int = 0,
    stamp_ns: int = T0,
    frame_id: str = "lidar",
) -> bytes:
    """A PointCloud2."""
    store = builders.typestore(ros_version)
    data = np.frombuffer(points.tobytes(), np.uint8)
    described = _description(points, ros_version, seq, stamp_ns, frame_id)
    message = store.types[CLOUD](**described, data=data, is_dense=False)
    return builders.serialized(store, message, CLOUD, ros_version)


def compressed(
    points: NDArray[Any],
    ros_version: int,
    compressor: str = "zstd",
    *,
    seq: int = 0,
    stamp_ns: int = T0,
    data: bytes | None = None,
    form: str | None = None,
) -> bytes:
    """A CompressedPointCloud2; ``data`` and ``form`` are what its message has instead."""
    store = builders.typestore(ros_version)
    name, compress = COMPRESSORS[compressor]
    message = store.types[COMPRESSED](
        **_description(points, ros_version, seq, stamp_ns),
        compressed_data=np.frombuffer(compress(points.tobytes()) if data is None else data, np.uint8),
        is_dense=False,
        format=name if form is None else form,
    )
    return builders.serialized(store, message, COMPRESSED, ros_version)


def old_cloud(points: NDArray[Any], ros_version: int, *, stamp_ns: int = T0) -> bytes:
    """A PointCloud: all fields but x, y and z are channels of float32."""
    store = builders.typestore(ros_version)
    types = store.types
    point, channel = types["geometry_msgs/msg/Point32"], types["sensor_msgs/msg/ChannelFloat32"]
    message = types[OLD_CLOUD](
        header=builders.header(store, ros_version, 0, stamp_ns, "lidar"),
        points=[point(*map(float, each)) for each in zip(points["x"], points["y"], points["z"], strict=True)],
        channels=[
            channel(name, points[name].astype(np.float32)) for name in points.dtype.names or () if name not in "xyz"
        ],
    )
    return builders.serialized(store, message, OLD_CLOUD, ros_version)


def livox_points(step: int, count: int = 300, tags: Sequence[int] = (0,)) -> NDArray[Any]:
    """A Livox cloud's points, some at the origin."""
    random = np.random.default_rng(step)
    kind = [("offset_time", "<u4"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    points = np.zeros(count, [*kind, ("reflectivity", "u1"), ("tag", "u1"), ("line", "u1")])
    for axis in "xyz":
        points[axis] = random.uniform(-8, 8, count)
    points["offset_time"] = np.arange(count) * 100_000_000 // max(count, 1)
    points["reflectivity"] = random.integers(0, 256, count)
    points["tag"] = random.choice(tags, count)
    points["line"] = np.arange(count) % 4
    for axis in "xyz":
        points[axis][::17] = 0
    return points


def livox(
    points: NDArray[Any],
    ros_version: int,
    kind: str = LIVOX[1],
    *,
    seq: int = 0,
    stamp_ns: int = T0,
    more: int = 0,
) -> bytes:
    """A CustomMsg; its ``point_num`` has some ``more`` than there are."""
    store = builders.typestore(ros_version)
    point = store.types[kind.replace("CustomMsg", "CustomPoint")]
    message = store.types[kind](
        header=builders.header(store, ros_version, seq, stamp_ns, "livox_frame"),
        timebase=stamp_ns,
        point_num=len(points) + more,
        lidar_id=3,
        rsvd=np.zeros(3, np.uint8),
        points=[point(*each) for each in points.tolist()],
    )
    return builders.serialized(store, message, kind, ros_version)


def packet(azimuth: int, distances: Sequence[int], microseconds: int) -> bytes:
    """A packet of a VLP-16 as its manual has it: 12 blocks of an azimuth (0.01 degrees) and 32 returns (2 mm)."""
    blocks = b""
    for block in range(12):
        returns = b"".join(int(distance).to_bytes(2, "little") + bytes([50 + block]) for distance in distances)
        blocks += b"\xff\xee" + ((azimuth + 40 * block) % 36_000).to_bytes(2, "little") + returns
    return blocks + microseconds.to_bytes(4, "little") + bytes([0x37, 0x22])


def velodyne(packets: Sequence[tuple[int, bytes]], ros_version: int) -> bytes:
    """A VelodyneScan of packets with their times, nanoseconds."""
    store = builders.typestore(ros_version)
    time, kind = store.types["builtin_interfaces/msg/Time"], store.types["velodyne_msgs/msg/VelodynePacket"]
    message = store.types[VELODYNE](
        header=builders.header(store, ros_version, 0, T0, "velodyne"),
        packets=[kind(time(*divmod(at, builders.SECOND)), np.frombuffer(data, np.uint8)) for at, data in packets],
    )
    return builders.serialized(store, message, VELODYNE, ros_version)


def draco_points() -> NDArray[Any]:
    """Points as ``draco.cpp`` reads them, some of them twice."""
    names, kinds = ["x", "y", "z", "ring", "tag"], ["<f4", "<f4", "<f4", "<u2", "u1"]
    dtype = np.dtype({"names": names, "formats": kinds, "offsets": [0, 4, 8, 12, 14], "itemsize": 16})
    points = np.zeros(60, dtype)
    for place, axis in enumerate("xyz"):
        points[axis] = np.sin(np.arange(60) * (place + 1.7)) * (9 - 4 * place)
    points["ring"] = np.arange(60) % 7 * 300
    points["tag"] = np.arange(60) * 4
    points[5::10] = points[4::10]
    return points


def multi_echo(
    ros_version: int,
    ranges: Sequence[Sequence[float]] = ECHO_RANGES,
    intensities: Sequence[Sequence[float]] = ECHO_INTENSITIES,
    *,
    seq: int = 0,
) -> bytes:
    """A MultiEchoLaserScan."""
    store = builders.typestore(ros_version)
    echo = store.types["sensor_msgs/msg/LaserEcho"]
    made = store.types[MULTI_ECHO](
        header=builders.header(store, ros_version, seq, T0, "laser"),
        angle_min=-1.0,
        angle_max=1.0,
        angle_increment=0.4,
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.5,
        range_max=20.0,
        ranges=[echo(np.array(each, np.float32)) for each in ranges],
        intensities=[echo(np.array(each, np.float32)) for each in intensities],
    )
    return builders.serialized(store, made, MULTI_ECHO, ros_version)
