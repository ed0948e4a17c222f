"""Clouds and recordings for benchmarks: 131,072 points of 32 bytes, as rotating lidars deliver them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.bags.destinations import open_writer, plan_destination
from pc2scan.core.rigid import Rigid
from pc2scan.messages.definitions import definition
from pc2scan.messages.pointcloud2 import POINTCLOUD2, PointField
from pc2scan.messages.tfmessage import encode_transforms
from pc2scan.model import Connection
from support.containers import write_rows
from support.encoded import encode_pointcloud2

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    Columns = tuple[NDArray[Any], NDArray[Any], NDArray[Any]]

#: The topic of the large clouds, and one with a single small cloud, for conversions that let the others pass.
POINTS = "/points"
TRIFLE = "/trifle"

CLOUD_POINTS = 131_072
POINT_BYTES = 32
CLOUD_BYTES = CLOUD_POINTS * POINT_BYTES

_TF = "tf2_msgs/msg/TFMessage"
_PERIOD_NS = 100_000_000
_BEGIN_NS = 1_700_000_000_000_000_000

#: Different clouds in a recording; they repeat after that, far beyond what any compressor here looks back.
_VARIETY = 4

_FIELDS = [
    PointField("x", 0, 7),
    PointField("y", 4, 7),
    PointField("z", 8, 7),
    PointField("intensity", 16, 7),
    PointField("ring", 20, 4),
    PointField("time", 24, 7),
]


class Form(NamedTuple):
    """A way to store a recording."""

    suffix: str
    compression: str
    storage: str | None = None

    @property
    def serialization(self) -> str:
        """How its messages are serialised."""
        return "ros1" if self.suffix == ".bag" else "cdr"


FORMS = {
    "ROS 1, none": Form(".bag", "none"),
    "ROS 1, lz4": Form(".bag", "lz4"),
    "MCAP, none": Form(".mcap", "none"),
    "MCAP, lz4": Form(".mcap", "lz4"),
    "MCAP, zstd": Form(".mcap", "zstd"),
    "sqlite3": Form("", "none", "sqlite3"),
}


def cloud(points: int, layout: str, step: int = 32) -> Columns:
    """A rotating lidar's view of a yard: x, y and z as views of points of ``step`` bytes."""
    rng = np.random.default_rng(0)
    rings = max(1, min(64, points // 256))
    azimuth = np.linspace(-math.pi, math.pi, points // rings, endpoint=False) + 1e-4
    elevation = np.deg2rad(np.linspace(-25, 15, rings))[:, None]
    azimuth = azimuth + rng.normal(0, 2e-4, (rings, azimuth.size))
    walls = np.minimum(20 / np.abs(np.cos(azimuth)), 12 / np.abs(np.sin(azimuth)))
    walls = np.minimum(walls, 8 + 3 * np.sin(7 * azimuth) + 20 * (np.sin(3 * azimuth) > 0))
    ground = np.where(elevation < 0, 1.8 / np.tan(np.maximum(-elevation, 1e-9)), np.inf)
    length = np.minimum(walls, ground) * rng.normal(1, 0.002, azimuth.shape)
    missing = rng.random(azimuth.shape) < 0.05
    length[missing] = np.nan
    scene = np.stack([length * np.cos(azimuth), length * np.sin(azimuth), length * np.tan(elevation)], axis=-1).astype(
        np.float32
    )
    if layout == "column-major":
        scene, missing = scene.swapaxes(0, 1), missing.T
    if layout != "organised":
        # Drivers keep the grid and mark what is missing, or leave both out.
        scene = scene[~missing]
    if layout == "random":
        scene = rng.permutation(scene)
    memory = np.zeros((*scene.shape[:-1], step // 4), np.float32)
    memory[..., :3] = scene
    return memory[..., 0], memory[..., 1], memory[..., 2]


def serialized_clouds(serialization: str, points: int = CLOUD_POINTS, variety: int = _VARIETY) -> list[bytes]:
    """Clouds of one scene, organised in rings, that differ by noise in every coordinate."""
    x, y, z = cloud(points, "organised")
    memory = np.zeros(
        x.size,
        np.dtype(
            {
                "names": [f.name for f in _FIELDS],
                "formats": ["f4"] * 4 + ["u2", "f4"],
                "offsets": [f.offset for f in _FIELDS],
                "itemsize": POINT_BYTES,
            }
        ),
    )
    rng = np.random.default_rng(1)
    rings, columns = x.shape
    memory["ring"] = np.repeat(np.arange(rings), columns)
    memory["time"] = np.tile(np.linspace(0, 0.1, columns), rings)
    made = []
    for number in range(variety):
        length = rng.normal(1, 0.001, x.shape)
        for name, values in zip("xyz", (x, y, z), strict=True):
            memory[name] = (values * length).ravel()
        memory["intensity"] = rng.integers(0, 256, x.size)
        made.append(
            encode_pointcloud2(
                serialization=serialization,
                sequence=number,
                stamp_ns=_BEGIN_NS + number * _PERIOD_NS,
                frame_id="lidar",
                fields=_FIELDS,
                point_step=POINT_BYTES,
                data=memory.tobytes(),
                height=rings,
            )
        )
    return made


def write_recording(folder: Path, form: Form, size_bytes: int, points: int = CLOUD_POINTS) -> Path:
    """Write clouds of a total size, uncompressed, with the project's own writers.

    Returns
    -------
    Path
        The recording: a file, or a rosbag2 directory.
    """
    ros_version = 1 if form.serialization == "ros1" else 2
    target = plan_destination(
        folder / f"clouds-{form.storage or form.compression}{form.suffix}",
        storage=form.storage,
        compression=form.compression,
        source_ros_version=ros_version,
    )
    text, digest = definition(POINTCLOUD2, ros_version)
    writer = open_writer(target, target.path, target.path.name)
    handles = [
        writer.add_connection(Connection(0, topic, POINTCLOUD2, form.serialization, definition=text, digest=digest))
        for topic in (POINTS, TRIFLE)
    ]
    clouds = serialized_clouds(form.serialization, points)
    for number in range(max(1, size_bytes // (points * POINT_BYTES))):
        time_ns = _BEGIN_NS + number * _PERIOD_NS
        writer.write(handles[0], time_ns, clouds[number % len(clouds)], time_ns, number)
    (trifle,) = serialized_clouds(form.serialization, points=1_000, variety=1)
    writer.write(handles[1], time_ns, trifle, time_ns)
    writer.finish()
    return target.path


def write_two(path: Path, clouds: int) -> Path:
    """Two lidars of 131,072 points of 32 bytes at 10 Hz, 37 ms apart, on a robot that drives straight on."""
    x, y, z = cloud(131_072, "organised")
    data = np.zeros((x.size, 8), "<f4")
    for axis, values in enumerate((x, y, z)):
        data[:, axis] = values.ravel()
    points = data.tobytes()
    mounts = {"front": Rigid.from_rpy(0, 0, 0, (0.4, 0, 0.5)), "rear": Rigid.from_rpy(0, 0, 3.1, (-0.4, 0, 0.5))}
    fields = [PointField(name, 4 * place, 7) for place, name in enumerate("xyz")]

    def rows() -> Iterator[tuple[int, str, bytes]]:
        static = [("base_link", frame, _BEGIN_NS, *mount.pose) for frame, mount in mounts.items()]
        yield _BEGIN_NS, "/tf_static", encode_transforms(static, "cdr")
        for tick in range(clouds * 100 + 50):
            time_ns = _BEGIN_NS + tick * 1_000_000
            if tick % 20 == 0:
                moved = Rigid.from_rpy(0, 0, 0, (tick * 0.0015, 0, 0))
                yield time_ns, "/tf", encode_transforms([("odom", "base_link", time_ns, *moved.pose)], "cdr")
            if tick % 100 in (0, 37) and tick < clouds * 100:
                frame = "rear" if tick % 100 else "front"
                cloud_data = encode_pointcloud2(
                    serialization="cdr", sequence=0, stamp_ns=time_ns, frame_id=frame, fields=fields, point_step=32,
                    data=points, height=x.shape[0],
                )  # fmt: skip
                yield time_ns, f"/{frame}", cloud_data

    types = {"/tf_static": _TF, "/tf": _TF, "/front": POINTCLOUD2, "/rear": POINTCLOUD2}
    return write_rows(path, types, rows(), "none")
