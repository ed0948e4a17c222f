"""A small recording in every kind of container."""

from __future__ import annotations

from pathlib import Path

from pc2scan.bags.destinations import open_writer, plan_destination
from pc2scan.model import Connection, Definition

CONNECTIONS = {
    1: Connection(1, "/a", "std_msgs/String", "ros1", Definition("ros1msg", b"string data\n"), "0" * 32),
    2: Connection(1, "/a", "std_msgs/msg/String", "cdr", Definition("ros2msg", b"string data\n")),
}
KINDS = {
    "rosbag1": ("x.bag", None),
    "mcap": ("x.mcap", None),
    "rosbag2": ("x", "mcap"),
    "sqlite3": ("x", "sqlite3"),
}


def names(folder: str | Path) -> list[str]:
    return sorted(entry.name for entry in Path(folder).iterdir())


def make(folder: Path, kind: str) -> Path:
    """Write a recording with one message; ``sqlite3`` gives the bare file."""
    name, storage = KINDS[kind]
    destination = plan_destination(folder / name, storage=storage, source_ros_version=None)
    writer = open_writer(destination, destination.path, destination.path.stem)
    handle = writer.add_connection(CONNECTIONS[destination.ros_version])
    writer.write(handle, 5, b"\0\1\0\0\2\0\0\0x\0", 5)
    writer.finish()
    return destination.path / "x_0.db3" if kind == "sqlite3" else destination.path
