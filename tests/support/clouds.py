"""Messages of all kinds of clouds with given points, as rosbags serialises them."""

from __future__ import annotations

import gzip
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
import zstandard

from support import builders
from support.builders import CLOUD, T0

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

__all__ = [
    "COMPRESSED",
    "COMPRESSORS",
    "LIVOX",
    "OLD_CLOUD",
    "VELODYNE",
    "compressed",
    "lidar_points",
    "livox",
    "livox_points",
    "old_cloud",
    "packet",
    "structured",
    "velodyne",
]

LIVOX = ("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg")
COMPRESSED = "point_cloud_interfaces/msg/CompressedPointCloud2"
OLD_CLOUD = "sensor_msgs/msg/PointCloud"
VELODYNE = "velodyne_msgs/msg/VelodyneScan"

#: What point_cloud_transport's plugins write, and what their subscribers read too: a zlib header.
COMPRESSORS: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "zlib": ("zlib", lambda data: gzip.compress(data, 6)),
    "zlib header": ("zlib", zlib.compress),
    "zstd": ("zstd", lambda data: zstandard.ZstdCompressor().compress(data)),
    "zstd stream": ("zstd", lambda data: zstandard.ZstdCompressor(write_content_size=False).compress(data)),
}

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


def _description(points: NDArray[Any], ros_version: int, seq: int, stamp_ns: int) -> dict[str, Any]:
    store = builders.typestore(ros_version)
    field = store.types["sensor_msgs/msg/PointField"]
    dtype = points.dtype
    fields = [field(name, dtype.fields[name][1], _CODES[dtype[name].str[1:]], 1) for name in dtype.names or ()]  # type: ignore[index]
    return {
        "header": builders.header(store, ros_version, seq, stamp_ns, "lidar"),
        "height": 1,
        "width": len(points),
        "fields": fields,
        "is_bigendian": False,
        "point_step": dtype.itemsize,
        "row_step": dtype.itemsize * len(points),
    }


def structured(
    points: NDArray[Any], ros_version: int, *, seq: int = 0, stamp_ns: int = T0, dense: bool = False
) -> bytes:
    """A PointCloud2."""
    store = builders.typestore(ros_version)
    data = np.frombuffer(points.tobytes(), np.uint8)
    message = store.types[CLOUD](**_description(points, ros_version, seq, stamp_ns), data=data, is_dense=dense)
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


def old_cloud(points: NDArray[Any], ros_version: int, *, seq: int = 0, stamp_ns: int = T0) -> bytes:
    """A PointCloud: all fields but x, y and z are channels of float32."""
    store = builders.typestore(ros_version)
    types = store.types
    point, channel = types["geometry_msgs/msg/Point32"], types["sensor_msgs/msg/ChannelFloat32"]
    message = types[OLD_CLOUD](
        header=builders.header(store, ros_version, seq, stamp_ns, "lidar"),
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
    points: NDArray[Any], ros_version: int, kind: str = LIVOX[1], *, seq: int = 0, stamp_ns: int = T0, lidar_id: int = 3
) -> bytes:
    """A CustomMsg; ``point_num`` is wrong."""
    store = builders.typestore(ros_version)
    point = store.types[kind.replace("CustomMsg", "CustomPoint")]
    message = store.types[kind](
        header=builders.header(store, ros_version, seq, stamp_ns, "livox_frame"),
        timebase=stamp_ns,
        point_num=len(points) + 7,
        lidar_id=lidar_id,
        rsvd=np.zeros(3, np.uint8),
        points=[point(*each) for each in points.tolist()],
    )
    return builders.serialized(store, message, kind, ros_version)


def packet(azimuth: int, distances: Sequence[int], microseconds: int, *, model: int = 0x22) -> bytes:
    """A packet of a VLP-16 as its manual has it: 12 blocks of an azimuth (0.01 degrees) and 32 returns (2 mm)."""
    blocks = b""
    for block in range(12):
        returns = b"".join(int(distance).to_bytes(2, "little") + bytes([50 + block]) for distance in distances)
        blocks += b"\xff\xee" + ((azimuth + 40 * block) % 36_000).to_bytes(2, "little") + returns
    return blocks + microseconds.to_bytes(4, "little") + bytes([0x37, model])


def velodyne(packets: Sequence[tuple[int, bytes]], ros_version: int, *, seq: int = 0, stamp_ns: int = T0) -> bytes:
    """A VelodyneScan of packets with their times, nanoseconds."""
    store = builders.typestore(ros_version)
    time, kind = store.types["builtin_interfaces/msg/Time"], store.types["velodyne_msgs/msg/VelodynePacket"]
    message = store.types[VELODYNE](
        header=builders.header(store, ros_version, seq, stamp_ns, "velodyne"),
        packets=[kind(time(*divmod(at, builders.SECOND)), np.frombuffer(data, np.uint8)) for at, data in packets],
    )
    return builders.serialized(store, message, VELODYNE, ros_version)
