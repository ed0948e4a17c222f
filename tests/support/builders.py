"""Recordings for tests, in every container that pc2scan reads, made without pc2scan.

Messages are serialised by rosbags, ROS 1 bags written by rosbags, MCAP by the mcap library, and SQLite by the
standard library, so that pc2scan's own encoders and writers never check themselves. `CONTENT` is one small
recording with everything that a conversion must keep; `build` puts it into any container.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import zstandard
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapLibraryWriter
from rosbags.rosbag1 import Writer as Rosbag1LibraryWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from ruamel.yaml import YAML
from ruamel.yaml.scalarstring import DoubleQuotedScalarString

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

T0 = 1_700_000_000_123_456_789
"""Log time of the first message, ns: with digits that a float of seconds would lose."""

SECOND = 1_000_000_000
CLOUD, SCAN = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan"
TF, STRING, IMU = "tf2_msgs/msg/TFMessage", "std_msgs/msg/String", "sensor_msgs/msg/Imu"
BATTERY = "custom_msgs/msg/Battery"
NEW = "custom_msgs/msg/NewCloud"

_RULE = "=" * 80
_TF_TEXT = "geometry_msgs/TransformStamped[] transforms\n"
_BATTERY_TEXTS = {
    1: "# Charge of the pack,\n#   as its controller reports it.\n"
    "Header header\nfloat64 voltage  # V\nuint8[] cells\nduration uptime\n",
    2: "# Charge of the pack,\n#   as its controller reports it.\n"
    "std_msgs/Header header\nfloat64 voltage  # V\nuint8[] cells\nbuiltin_interfaces/Duration uptime\n",
}


#: Livox's point and cloud, as its drivers' definitions have them; without `Header`, whose name differs.
_LIVOX_POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"
_LIVOX_CLOUD = "uint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nCustomPoint[] points\n"

#: CompressedPointCloud2 of point_cloud_interfaces, as its definition has it.
_COMPRESSED_CLOUD = (
    "uint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\nuint32 point_step\n"
    "uint32 row_step\nuint8[] compressed_data\nbool is_dense\nstring format\n"
)

# --- Messages ---


@cache
def typestore(ros_version: int) -> Any:
    """The message types of a ROS version, with those that rosbags lacks."""
    store = get_typestore(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_HUMBLE)
    added = get_types_from_msg(_BATTERY_TEXTS[ros_version], BATTERY)
    if ros_version == 1:
        added |= get_types_from_msg(_TF_TEXT, TF) | get_types_from_msg(_TF_TEXT, "tf/msg/tfMessage")
    for package in ("livox_ros_driver", "livox_ros_driver2"):
        added |= get_types_from_msg(_LIVOX_POINT, f"{package}/msg/CustomPoint")
        head = "Header header\n" if ros_version == 1 else "std_msgs/Header header\n"
        added |= get_types_from_msg(head + _LIVOX_CLOUD, f"{package}/msg/CustomMsg")
    head = "Header header\n" if ros_version == 1 else "std_msgs/Header header\n"
    added |= get_types_from_msg(head + _COMPRESSED_CLOUD, "point_cloud_interfaces/msg/CompressedPointCloud2")
    added |= get_types_from_msg(head + "uint8[] data\n", NEW)
    stamp = "time" if ros_version == 1 else "builtin_interfaces/Time"
    added |= get_types_from_msg(f"{stamp} stamp\nuint8[1206] data\n", "velodyne_msgs/msg/VelodynePacket")
    added |= get_types_from_msg(head + "VelodynePacket[] packets\n", "velodyne_msgs/msg/VelodyneScan")
    store.register(added)
    return store


def serialized(store: Any, message: Any, msgtype: str, ros_version: int) -> bytes:
    """A message's bytes: ROS 1's, or little-endian CDR."""
    if ros_version == 1:
        return bytes(store.serialize_ros1(message, msgtype))
    return bytes(store.serialize_cdr(message, msgtype))


def deserialized(data: bytes, msgtype: str, ros_version: int) -> Any:
    """A message as rosbags decodes it."""
    store = typestore(ros_version)
    return (store.deserialize_ros1 if ros_version == 1 else store.deserialize_cdr)(data, msgtype)


def header(store: Any, ros_version: int, seq: int, stamp_ns: int, frame_id: str) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, SECOND))
    kind = store.types["std_msgs/msg/Header"]
    return kind(seq, stamp, frame_id) if ros_version == 1 else kind(stamp, frame_id)


def cloud(
    points: NDArray[np.float32],
    ros_version: int,
    *,
    seq: int = 0,
    stamp_ns: int = T0,
    frame_id: str = "lidar",
    names: Sequence[str] = ("x", "y", "z"),
    cut: int = 0,
) -> bytes:
    """A serialised PointCloud2 of float32 columns; ``cut`` bytes of its data are missing."""
    store = typestore(ros_version)
    fields = [store.types["sensor_msgs/msg/PointField"](name, 4 * index, 7, 1) for index, name in enumerate(names)]
    data = np.ascontiguousarray(points, "<f4").tobytes()
    message = store.types[CLOUD](
        header=header(store, ros_version, seq, stamp_ns, frame_id),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=4 * len(names),
        row_step=4 * len(names) * len(points),
        data=np.frombuffer(data[: len(data) - cut], np.uint8),
        is_dense=False,
    )
    return serialized(store, message, CLOUD, ros_version)


def scan(
    ranges: NDArray[np.float32], ros_version: int, *, seq: int = 0, stamp_ns: int = T0, frame_id: str = "laser"
) -> bytes:
    """A serialised LaserScan over a half circle."""
    store = typestore(ros_version)
    message = store.types[SCAN](
        header=header(store, ros_version, seq, stamp_ns, frame_id),
        angle_min=-1.5,
        angle_max=1.5,
        angle_increment=3.0 / max(1, len(ranges) - 1),
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.1,
        range_max=30.0,
        ranges=np.ascontiguousarray(ranges, np.float32),
        intensities=np.empty(0, np.float32),
    )
    return serialized(store, message, SCAN, ros_version)


def string(text: str, ros_version: int) -> bytes:
    store = typestore(ros_version)
    return serialized(store, store.types[STRING](text), STRING, ros_version)


def transforms(
    rows: Iterable[tuple[str, str, int, tuple[float, float, float]]], ros_version: int, seq: int = 0, msgtype: str = TF
) -> bytes:
    """A serialised TFMessage of (parent, child, stamp in ns, translation) without rotations."""
    store = typestore(ros_version)
    types = store.types
    stamped = [
        types["geometry_msgs/msg/TransformStamped"](
            header(store, ros_version, seq, stamp_ns, parent),
            child,
            types["geometry_msgs/msg/Transform"](
                types["geometry_msgs/msg/Vector3"](*translation),
                types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            ),
        )
        for parent, child, stamp_ns, translation in rows
    ]
    return serialized(store, types[msgtype](stamped), msgtype, ros_version)


def imu_message(
    ros_version: int,
    orientation: Any = (0.0, 0.6, 0.0, 0.8),
    first: tuple[float, float, float] = (0.01, 0.02, 0.03),
    frame_id: str = "imu_link",
    turning: Any = (1.0, 2.0, 3.0),
    acceleration: Any = (0.1, 0.2, 9.8),
    stamp_ns: int = T0,
    seq: int = 7,
) -> bytes:
    """A serialised message; ``first`` are the first numbers of its covariances."""
    store = typestore(ros_version)
    types = store.types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    covariances = [np.array([each, *[0.5] * 8]) for each in first]
    message = types[IMU](
        header(store, ros_version, seq, stamp_ns, frame_id),
        quaternion(*orientation), covariances[0],
        vector(*turning), covariances[1],
        vector(*acceleration), covariances[2],
    )  # fmt: skip
    return serialized(store, message, IMU, ros_version)


def battery(ros_version: int, *, seq: int, stamp_ns: int) -> bytes:
    store = typestore(ros_version)
    message = store.types[BATTERY](
        header(store, ros_version, seq, stamp_ns, "base_link"),
        24.5 + seq,
        np.array([1, 2, 3], np.uint8),
        store.types["builtin_interfaces/msg/Duration"](12, 345_678_901),
    )
    return serialized(store, message, BATTERY, ros_version)


# --- Content ---


@dataclass(frozen=True, slots=True)
class Stream:
    """One publisher of one topic. ``ros1_type`` is spelled as ROS 2 does, like ``msgtype``."""

    topic: str
    msgtype: str
    publisher: str = "/robot"
    latched: bool = False
    ros1_type: str = ""

    def type_in(self, ros_version: int) -> str:
        """The type in ROS 2's spelling."""
        return self.ros1_type if ros_version == 1 and self.ros1_type else self.msgtype


@dataclass(frozen=True, slots=True)
class Item:
    """One message: ``data`` by ROS version."""

    stream: Stream
    log_time_ns: int
    data: dict[int, bytes]

    @property
    def publish_time_ns(self) -> int:
        return self.log_time_ns - 1_001

    def expected(self, source: int, target: int) -> bytes:
        """The payload after a conversion from one ROS version to another; ROS 2 has no ``seq``."""
        return unnumbered(self.data[1], self.stream.type_in(1)) if (source, target) == (2, 1) else self.data[target]


@dataclass(frozen=True, slots=True)
class Recording:
    streams: tuple[Stream, ...]
    items: tuple[Item, ...]

    def of(self, topic: str) -> list[Item]:
        return [item for item in self.items if item.stream.topic == topic]

    def halves(self) -> tuple[Recording, Recording]:
        middle = len(self.items) // 2
        return replace(self, items=self.items[:middle]), replace(self, items=self.items[middle:])

    def parts(self, number: int) -> tuple[Recording, ...]:
        return self.halves() if number == 2 else (self,)


def item(stream: Stream, log_time_ns: int, make: Callable[[int, int], bytes], seq: int = 0) -> Item:
    """Serialise a message for both ROS versions; ``make`` takes the ROS version and the sequence number."""
    return Item(stream, log_time_ns, {1: make(1, seq), 2: make(2, seq)})


def unnumbered(data: bytes, msgtype: str) -> bytes:
    """A ROS 1 message with every header's ``seq`` set to 0."""
    message = deserialized(data, msgtype, 1)
    for part in (message, *getattr(message, "transforms", ())):
        if hasattr(part, "header"):
            object.__setattr__(part.header, "seq", 0)
    return serialized(typestore(1), message, msgtype, 1)


def points_of(step: int, count: int = 60) -> NDArray[np.float32]:
    """The x, y, z of a made-up cloud, some points NaN, some below the floor."""
    random = np.random.default_rng(step)
    points = random.uniform(-8, 8, (count, 3)).astype(np.float32)
    points[3:4] = np.nan
    return points


MOUNT = Stream("/tf_static", TF, "/mount", latched=True)
BODY = Stream("/tf_static", TF, "/body", latched=True)
ODOMETRY = Stream("/tf", TF, "/odometry", ros1_type="tf/msg/tfMessage")
POINTS = Stream("/points", CLOUD, "/lidar_driver")
CHATTER = Stream("/chatter", STRING)
INERTIA = Stream("/imu", IMU)
CHARGE = Stream("/battery", BATTERY)


def fixed(stream: Stream, log_time_ns: int, child: str, height: float) -> Item:
    """The static transform of a frame above base_link."""
    rows = [("base_link", child, T0, (0.0, 0.0, height))]
    return item(stream, log_time_ns, lambda version, seq: transforms(rows, version, seq))


def odometry(log_time_ns: int, stamp_ns: int, x: float, seq: int, stream: Stream = ODOMETRY) -> Item:
    """The transform of a robot that has driven straight ahead, metres."""
    rows = [("odom", "base_link", stamp_ns, (x, 0.0, 0.0))]
    return item(stream, log_time_ns, lambda version, seq: transforms(rows, version, seq, stream.type_in(version)), seq)


def points(log_time_ns: int, stamp_ns: int, seq: int, stream: Stream = POINTS) -> Item:
    """A made-up cloud."""
    return item(
        stream, log_time_ns, lambda version, seq: cloud(points_of(seq), version, seq=seq, stamp_ns=stamp_ns), seq
    )


def _content() -> Recording:
    def at(step: int) -> int:
        return T0 + step * SECOND // 10

    items = [fixed(MOUNT, T0, "lidar", 0.5), fixed(BODY, T0 + 1, "imu", 0.5)]
    for step in range(3):
        items += [
            odometry(at(step) + 2, at(step), 0.5 * step, step),
            points(at(step) + 5_000_003, at(step), step),
            # Equal log times: the order of the file decides.
            item(
                INERTIA, at(step) + 6_000_000, lambda g, s: imu_message(g, frame_id="imu", seq=s, stamp_ns=at(s)), step
            ),
            item(CHATTER, at(step) + 6_000_000, lambda g, s: string(f"hello {s}", g), step),
            item(CHARGE, at(step) + 6_000_000, lambda g, s: battery(g, seq=s, stamp_ns=at(s)), step),
        ]
    return Recording((MOUNT, BODY, ODOMETRY, POINTS, CHATTER, INERTIA, CHARGE), tuple(items))


CONTENT = _content()


# --- Definitions ---


@cache
def definition(msgtype: str, ros_version: int) -> str:
    """The definition as a recorder stores it; the custom type's carries comments."""
    store = typestore(ros_version)
    text: str = store.generate_msgdef(msgtype, ros_version=ros_version)[0]
    if msgtype == BATTERY:
        # What rosbags makes anew has no comments: the first part is the author's own.
        text = _BATTERY_TEXTS[ros_version] + text[text.index(_RULE) :]
    return text


def md5sum(msgtype: str) -> str:
    return str(typestore(1).generate_msgdef(msgtype, ros_version=1)[1])


def ros1_name(msgtype: str) -> str:
    return msgtype.replace("/msg/", "/")


# --- QoS ---

_PROFILE: dict[str, Any] = {
    "history": 1,
    "depth": 10,
    "reliability": 1,
    "durability": 2,
    "deadline": {"sec": 9223372036, "nsec": 854775807},
    "lifespan": {"sec": 9223372036, "nsec": 854775807},
    "liveliness": 1,
    "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
    "avoid_ros_namespace_conventions": False,
}
_NAMES = {"history": "keep_last", "reliability": "reliable", "liveliness": "automatic"}


def profiles(streams: Sequence[Stream], *, by_name: bool = False) -> list[dict[str, Any]]:
    """One offered QoS profile a publisher; enumerations as numbers, or by name as from metadata version 9 on."""
    found = []
    for stream in streams:
        profile = {**_PROFILE, "durability": 1 if stream.latched else 2}
        if by_name:
            profile |= _NAMES | {"durability": "transient_local" if stream.latched else "volatile"}
        found.append(profile)
    return found


def qos_text(streams: Sequence[Stream], *, by_name: bool = False) -> str:
    """Profiles as the YAML text that rosbag2 stores, in its own layout."""
    lines = []
    for profile in profiles(streams, by_name=by_name):
        for number, (key, value) in enumerate(profile.items()):
            lead = "- " if number == 0 else "  "
            if isinstance(value, dict):
                lines += [f"{lead}{key}:", *(f"    {name}: {part}" for name, part in value.items())]
            else:
                lines.append(f"{lead}{key}: {str(value).lower() if isinstance(value, bool) else value}")
    return "\n".join(lines)


# --- Containers ---


def write_rosbag1(
    path: Path, recording: Recording, compression: str = "none", *, chunk_size: int | None = None
) -> Path:
    writer = Rosbag1LibraryWriter(path)
    writer.chunk_threshold = chunk_size or writer.chunk_threshold
    if compression != "none":
        writer.set_compression(Rosbag1LibraryWriter.CompressionFormat[compression.upper()])
    with writer:
        connections = {
            stream: writer.add_connection(
                stream.topic,
                stream.type_in(1),
                msgdef=definition(stream.type_in(1), 1),
                md5sum=md5sum(stream.type_in(1)),
                callerid=stream.publisher,
                latching=int(stream.latched),
            )
            for stream in recording.streams
        }
        for entry in recording.items:
            writer.write(connections[entry.stream], entry.log_time_ns, entry.data[1])
    return path


@dataclass(frozen=True, slots=True, kw_only=True)
class Mcap:
    """How an MCAP file is written."""

    ros_version: int = 2
    profile: str = "ros2"
    compression: str = "zstd"
    chunked: bool = True
    pack: Callable[[bytes], bytes] = bytes
    joined: bool = False
    by_name: bool = False
    chunk_size: int = 2_000
    crcs: bool = True
    summary: bool = True
    attachments: Sequence[tuple[str, str, int, int, bytes]] = field(default=())
    metadata: Sequence[tuple[str, dict[str, str]]] = field(default=())


def write_mcap(path: Path, recording: Recording, form: Mcap = Mcap()) -> Path:
    """Write an MCAP file; ``joined`` has one channel a topic, as rosbag2 does, otherwise one a publisher."""
    with path.open("wb") as file:
        writer = McapLibraryWriter(
            file,
            chunk_size=form.chunk_size,
            compression=CompressionType[form.compression.upper()],
            use_chunking=form.chunked,
            enable_crcs=form.crcs,
            index_types=IndexType.ALL if form.summary else IndexType.MESSAGE,
            repeat_channels=form.summary,
            repeat_schemas=form.summary,
            use_statistics=form.summary,
            use_summary_offsets=form.summary,
        )
        writer.start(profile=form.profile, library="tests")
        schemas: dict[str, int] = {}
        channels: dict[Any, int] = {}
        sequences: dict[int, int] = {}
        for stream in recording.streams:
            key: Any = stream.topic if form.joined else stream
            if key in channels:
                continue
            kind = stream.type_in(form.ros_version)
            if kind not in schemas:
                schemas[kind] = _schema(writer, kind, form)
            channels[key] = writer.register_channel(
                stream.topic,
                "ros1" if form.ros_version == 1 else "cdr",
                schemas[kind],
                _channel_metadata(stream, recording, form),
            )
        for entry in recording.items:
            channel = channels[entry.stream.topic if form.joined else entry.stream]
            sequences[channel] = sequences.get(channel, 40) + 1
            writer.add_message(
                channel,
                entry.log_time_ns,
                form.pack(entry.data[form.ros_version]),
                entry.publish_time_ns,
                sequences[channel],
            )
        for name, media_type, log_time_ns, create_time_ns, data in form.attachments:
            writer.add_attachment(create_time_ns, log_time_ns, name, media_type, data)
        for name, entries in form.metadata:
            writer.add_metadata(name, entries)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _schema(writer: McapLibraryWriter, msgtype: str, form: Mcap) -> int:
    name, encoding = msgtype, f"ros{form.ros_version}msg"
    if form.ros_version == 1:
        name, text = ros1_name(msgtype), definition(msgtype, 1)
    else:
        text = definition(msgtype, 2)
    return int(writer.register_schema(name, encoding, text.encode()))


def _channel_metadata(stream: Stream, recording: Recording, form: Mcap) -> dict[str, str]:
    if form.ros_version == 1:
        latching = {"latching": "1"} if stream.latched else {}
        return {"callerid": stream.publisher, "md5sum": md5sum(stream.type_in(1)), **latching}
    same = [other for other in recording.streams if other.topic == stream.topic] if form.joined else [stream]
    own = {} if form.joined else {"publisher": stream.publisher}
    return {"offered_qos_profiles": qos_text(same, by_name=form.by_name), **own}


def write_db3(
    path: Path, recording: Recording, *, schema: int = 4, pack: Callable[[bytes], bytes] = bytes, by_name: bool = False
) -> Path:
    """Write rosbag2's SQLite storage: schema 4 carries definitions, 3 QoS profiles, 2 neither."""
    kinds = dict.fromkeys(stream.msgtype for stream in recording.streams)
    columns = ["name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash"]
    columns = columns[: {2: 3, 3: 4, 4: 5}[schema]]
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(
            f"CREATE TABLE topics(id INTEGER PRIMARY KEY, {', '.join(f'{c} TEXT NOT NULL' for c in columns)})"
        )
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
            " data BLOB NOT NULL)"
        )
        database.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        if schema >= 3:
            database.execute("CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL)")
            database.execute("INSERT INTO schema VALUES (?, 'humble')", (schema,))
        if schema >= 4:
            database.execute(
                "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT"
                " NULL, encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL)"
            )
            database.executemany(
                "INSERT INTO message_definitions VALUES (NULL, ?, 'ros2msg', ?, '')",
                [(kind, definition(kind, 2)) for kind in kinds],
            )
        ids: dict[str, int] = {}
        for topic, streams in _by_topic(recording).items():
            ids[topic] = len(ids) + 1
            values = [topic, streams[0].msgtype, "cdr", qos_text(streams, by_name=by_name), ""][: len(columns)]
            marks = ", ".join("?" * len(columns))
            database.execute(f"INSERT INTO topics VALUES ({ids[topic]}, {marks})", values)
        database.executemany(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
            [(ids[entry.stream.topic], entry.log_time_ns, pack(entry.data[2])) for entry in recording.items],
        )
    return path


def _by_topic(recording: Recording) -> dict[str, list[Stream]]:
    topics: dict[str, list[Stream]] = {}
    for stream in recording.streams:
        topics.setdefault(stream.topic, []).append(stream)
    return topics


def write_rosbag2(
    folder: Path,
    recording: Recording,
    *,
    storage: str = "sqlite3",
    version: int = 8,
    mode: str = "",
    parts: int = 1,
    metadata: bool = True,
) -> Path:
    """Write a rosbag2 directory; ``mode`` is ``file`` or ``message`` for compression by zstd."""
    folder.mkdir()
    pack = zstandard.ZstdCompressor().compress
    by_name = version >= 9
    names = []
    for number, part in enumerate(recording.parts(parts)):
        path = folder / f"{folder.name}_{number}.{'db3' if storage == 'sqlite3' else 'mcap'}"
        packer = pack if mode == "message" else bytes
        if storage == "sqlite3":
            # Definitions came into the storage about when metadata.yaml reached version 6, QoS with version 4.
            schema = 4 if version >= 6 else 3 if version >= 4 else 2
            write_db3(path, part, schema=schema, pack=packer, by_name=by_name)
        else:
            write_mcap(path, part, Mcap(pack=packer, joined=True, by_name=by_name))
        if mode == "file":
            packed = path.with_name(f"{path.name}.zstd")
            packed.write_bytes(pack(path.read_bytes()))
            path.unlink()
            path = packed
        names.append(path.name)
    if metadata:
        times = span_of(recording)
        spans = [{"path": name, **span_of(part)} for name, part in zip(names, recording.parts(parts), strict=True)]
        topics = [
            listed(topic, version, len(recording.of(topic)), streams) for topic, streams in _by_topic(recording).items()
        ]
        more: dict[str, Any] = {} if version < 5 else {"files": spans}
        if mode:
            more |= {"compression_format": "zstd", "compression_mode": mode.upper()}
        write_metadata(folder, version, names, storage, topics_with_message_count=topics, **times, **more)
    return folder


def span_of(recording: Recording) -> dict[str, Any]:
    """What metadata.yaml says of the messages of a recording, or of one of its files."""
    times = [entry.log_time_ns for entry in recording.items]
    return {
        "starting_time": {"nanoseconds_since_epoch": min(times)},
        "duration": {"nanoseconds": max(times) - min(times)},
        "message_count": len(times),
    }


#: A text that rosbag2 writes with quotes.
_QUOTED = DoubleQuotedScalarString("")


def listed(topic: str, version: int, count: int, streams: Sequence[Stream], digest: str = _QUOTED) -> dict[str, Any]:
    """What metadata.yaml says of a topic."""
    entry: dict[str, Any] = {"name": topic, "type": streams[0].msgtype, "serialization_format": "cdr"}
    if version >= 4:
        entry["offered_qos_profiles"] = profiles(streams, by_name=True) if version >= 9 else qos_text(streams)
    if version >= 7:
        entry["type_description_hash"] = digest
    return {"topic_metadata": entry, "message_count": count}


def write_metadata(folder: Path, version: int, files: Sequence[str], storage: str, /, **more: Any) -> None:
    """metadata.yaml as the versions of rosbag2 write it; what is ``...`` is left out."""
    info: dict[str, Any] = {"version": version, "storage_identifier": storage}
    info["relative_file_paths"] = [f"{folder.name}/{file}" if version < 4 else file for file in files]
    if version >= 3:
        info |= {"compression_format": _QUOTED, "compression_mode": _QUOTED}
    if version >= 5:
        info["files"] = []
    if version >= 6:
        info["custom_data"] = None
    if version >= 8:
        info["ros_distro"] = "humble"
    info = {key: value for key, value in (info | more).items() if value is not ...}
    yaml = YAML()
    yaml.representer.ignore_aliases = lambda *_: True
    yaml.indent(sequence=4, offset=2)
    with (folder / "metadata.yaml").open("w") as stream:
        yaml.dump({"rosbag2_bagfile_information": info}, stream)


Build = Callable[[Path, Recording], Path]


def _bag(compression: str) -> Build:
    return lambda folder, recording: write_rosbag1(folder / "drive.bag", recording, compression)


def _mcap(**form: Any) -> Build:
    return lambda folder, recording: write_mcap(folder / "drive.mcap", recording, Mcap(**form))


def _rosbag2(**form: Any) -> Build:
    return lambda folder, recording: write_rosbag2(folder / "drive", recording, **form)


SOURCES: dict[str, Build] = {
    **{f"bag-{name}": _bag(name) for name in ("none", "bz2", "lz4")},
    **{f"rosbag2-sqlite3-v{version}": _rosbag2(version=version) for version in (2, 4, 5, 8, 9)},
    **{f"rosbag2-mcap-v{version}": _rosbag2(storage="mcap", version=version) for version in (5, 8, 9)},
    **{
        f"rosbag2-{storage}-zstd-{mode}": _rosbag2(storage=storage, mode=mode)
        for storage in ("sqlite3", "mcap")
        for mode in ("file", "message")
    },
    **{f"rosbag2-{storage}-split": _rosbag2(storage=storage, parts=2) for storage in ("sqlite3", "mcap")},
    "rosbag2-without-metadata": _rosbag2(metadata=False),
    "db3": lambda folder, recording: write_db3(folder / "drive.db3", recording),
    "mcap-unchunked": _mcap(chunked=False),
    "mcap-none": _mcap(compression="none"),
    "mcap-lz4": _mcap(compression="lz4"),
    "mcap-zstd": _mcap(),
    "mcap-ros1": _mcap(ros_version=1, profile="ros1"),
    "mcap-ros1-unchunked-no-profile": _mcap(ros_version=1, profile="", chunked=False),
    "mcap-no-profile": _mcap(profile=""),
}
"""Every kind of source, by name: takes a folder and the recording, returns the source's path."""


def ros_version_of(source: str) -> int:
    """The ROS version of a kind of source."""
    return 1 if source.startswith(("bag", "mcap-ros1")) else 2
