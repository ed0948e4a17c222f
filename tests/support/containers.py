"""The table of containers that can be written, and what the contract of all readers and writers is held to.

`KINDS` is every container with every compression that it has. `recorded` writes messages into one with pc2scan's own
writers, through the same door as a conversion; `support.outputs.opened` reads it with somebody else's reader.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from pc2scan.bags.destinations import open_writer, plan_destination
from pc2scan.bags.opening import open_recording
from pc2scan.model import LATCHED_QOS, Attachment, Connection, Definition
from support import rosbag1_files, rosbag2_files
from support.builders import definition

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from pc2scan.model import Metadata, Writer

#: Topic, log time and data of a message.
Row = tuple[str, int, bytes]

#: As `support.builders.Mcap` takes them: name, media type, log time, creation time and data; and name and entries.
ATTACHMENTS = [("map.pgm", "image/x-portable-graymap", 5, 7, bytes(range(256))), ("notes.txt", "text/plain", 9, 0, b"")]
METADATA = [("calibration", {"lidar": "2023-11-14", "by": "hand"}), ("empty", {})]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of destination: its name, and what `pc2scan.convert` takes for it."""

    name: str
    ros_version: int
    options: dict[str, Any]

    def arguments(self) -> list[str]:
        return [part for key, value in self.options.items() for part in (f"--{key.replace('_', '-')}", str(value))]

    @property
    def container(self) -> str:
        """What readers call it."""
        return {"out.bag": "rosbag1", "out.mcap": "mcap"}.get(self.name, "rosbag2")

    def writer(self, folder: Path) -> Writer:
        plan = plan_destination(folder / self.name, source_ros_version=None, **self.options)
        return open_writer(plan, plan.path, plan.path.stem)


KINDS = {
    **{f"bag-{c}": Kind("out.bag", 1, {"compression": c}) for c in ("none", "lz4", "bz2")},
    **{
        f"mcap-{profile}-{c}": Kind("out.mcap", int(profile[-1]), {"compression": c, "profile": profile})
        for profile in ("ros1", "ros2")
        for c in ("none", "lz4", "zstd")
    },
    **{f"rosbag2-mcap-{c}": Kind("out", 2, {"storage": "mcap", "compression": c}) for c in ("none", "lz4", "zstd")},
    **{f"rosbag2-sqlite3-{c}": Kind("out", 2, {"storage": "sqlite3", "compression": c}) for c in ("none", "zstd")},
}

#: One of each container and storage.
FORMATS = {
    "bag": KINDS["bag-none"],
    "mcap": KINDS["mcap-ros2-none"],
    "rosbag2-mcap": KINDS["rosbag2-mcap-none"],
    "rosbag2-sqlite3": KINDS["rosbag2-sqlite3-none"],
}


def connection_for(ros_version: int, topic: str = "/a", **changes: Any) -> Connection:
    """Make a connection of std_msgs/String as ROS 1 or ROS 2 records it."""
    made = rosbag1_files.connection(topic) if ros_version == 1 else rosbag2_files.topic(topic)
    return replace(made, **changes)


def recorded(
    kind: Kind,
    folder: Path,
    rows: Iterable[Row],
    connections: Sequence[Connection] = (),
    extras: Iterable[Attachment | Metadata] = (),
) -> Path:
    """Write messages with pc2scan's writer; topics without a connection get one."""
    writer = kind.writer(folder)
    handles = {each.topic: writer.add_connection(each) for each in connections}
    for topic, time_ns, data in rows:
        if topic not in handles:
            handles[topic] = writer.add_connection(connection_for(kind.ros_version, topic))
        writer.write(handles[topic], time_ns, data, time_ns)
    for each in extras:
        if isinstance(each, Attachment):
            writer.add_attachment(each)
        else:
            writer.add_metadata(each)
    writer.finish()
    return folder / kind.name


def write_rows(
    path: Path, types: Mapping[str, str], rows: Iterable[tuple[int, str, bytes]], compression: str | None = None
) -> Path:
    """Write log times, topics and data of ROS 2 with pc2scan's writer; ``types`` are those of the topics."""
    writer = open_writer(plan_destination(path, compression=compression, source_ros_version=2), path, path.name)
    handles = {}
    for topic, kind in types.items():
        text, qos = Definition("ros2msg", definition(kind, 2).encode()), LATCHED_QOS if topic == "/tf_static" else ""
        handles[topic] = writer.add_connection(Connection(0, topic, kind, "cdr", text, qos=qos))
    for log_time_ns, topic, data in rows:
        writer.write(handles[topic], log_time_ns, data, log_time_ns)
    writer.finish()
    return path


def read(path: Path, **options: Any) -> list[Row]:
    """Read messages with pc2scan's reader, in its order."""
    with closing(open_recording(path, **options)) as reader:
        return [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages()]
