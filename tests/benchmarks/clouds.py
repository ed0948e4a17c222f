"""Recordings for benchmarks: clouds of 131,072 points of 32 bytes, as rotating lidars deliver them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from benchmarks.test_projection import cloud
from pc2scan.bags.destinations import open_writer, plan_destination
from pc2scan.messages.definitions import definition
from pc2scan.messages.pointcloud2 import POINTCLOUD2, PointField, encode_pointcloud2
from pc2scan.model import Connection

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["CLOUD_BYTES", "FORMS", "POINTS", "POINT_BYTES", "TRIFLE", "Form", "serialized_clouds", "write_recording"]

#: The topic of the large clouds, and one with a single small cloud, for conversions that let the others pass.
POINTS = "/points"
TRIFLE = "/trifle"

CLOUD_POINTS = 131_072
POINT_BYTES = 32
CLOUD_BYTES = CLOUD_POINTS * POINT_BYTES

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
