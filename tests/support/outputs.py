"""What a destination holds, as readers that are not pc2scan's see it."""

from __future__ import annotations

import sqlite3
from collections import Counter
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import zstandard
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from rosbags.rosbag1 import Reader as Rosbag1LibraryReader
from rosbags.rosbag2 import Reader as Rosbag2LibraryReader
from ruamel.yaml import YAML

from support.builders import CLOUD, SCAN, deserialized

if TYPE_CHECKING:
    from pathlib import Path


class Found(NamedTuple):
    """A message in the order of log time."""

    topic: str
    log_time_ns: int
    data: bytes
    publish_time_ns: int = 0
    sequence: int = 0


class Publisher(NamedTuple):
    """A connection, topic or channel; types in ROS 2's spelling."""

    topic: str
    msgtype: str
    latched: bool
    definition: str = ""
    callerid: str = ""
    encoding: str = ""


@dataclass(frozen=True, slots=True)
class Output:
    ros_version: int
    publishers: list[Publisher]
    messages: list[Found]

    def of(self, topic: str) -> list[Found]:
        return [found for found in self.messages if found.topic == topic]

    def topics(self) -> set[str]:
        return {found.topic for found in self.messages}

    def scans(self, topic: str = "/scan") -> list[Any]:
        return [deserialized(found.data, SCAN, self.ros_version) for found in self.of(topic)]

    def clouds(self, topic: str = "/cloud") -> list[Any]:
        return [deserialized(found.data, CLOUD, self.ros_version) for found in self.of(topic)]


def opened(path: Path) -> Output:
    """Read a ROS 1 bag with rosbags, MCAP with the mcap library, SQLite with the standard library."""
    if path.suffix == ".bag":
        return _rosbag1(path)
    if path.suffix == ".mcap":
        return _mcap(path)
    return _rosbag2(path)


def physical_order(path: Path) -> list[tuple[str, int]]:
    """Topics and log times of an MCAP file in the order of its bytes."""
    topics: dict[int, str] = {}
    order = []
    with path.open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                order.append((topics[record.channel_id], record.log_time))
    return order


def _rosbag1(path: Path) -> Output:
    with Rosbag1LibraryReader(path) as reader:
        publishers = []
        for each in reader.connections:
            ext: Any = each.ext
            head = each.topic, each.msgtype, bool(ext.latching)
            publishers.append(Publisher(*head, each.msgdef.data, ext.callerid or "", "ros1msg"))
        messages = [Found(each.topic, log_time_ns, bytes(data)) for each, log_time_ns, data in reader.messages()]
    return Output(1, publishers, messages)


def _latches(qos: str) -> bool:
    return "durability: 1" in qos or "durability: transient_local" in qos


def _mcap(path: Path) -> Output:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        publishers = []
        for channel in summary.channels.values():
            schema, more = summary.schemas[channel.schema_id], channel.metadata
            package, *_, name = schema.name.split("/")
            latched = more.get("latching") == "1" or _latches(more.get("offered_qos_profiles", ""))
            head = channel.topic, f"{package}/msg/{name}", latched, schema.data.decode()
            publishers.append(Publisher(*head, more.get("callerid", more.get("publisher", "")), schema.encoding))
        messages = [
            Found(channel.topic, message.log_time, message.data, message.publish_time, message.sequence)
            for _, channel, message in reader.iter_messages()
        ]
        encodings = {channel.message_encoding for channel in summary.channels.values()}
    assert len(encodings) == 1, encodings
    return Output(1 if encodings == {"ros1"} else 2, publishers, messages)


def _rosbag2(folder: Path) -> Output:
    info = YAML(typ="safe").load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    storage = folder / info["relative_file_paths"][0]
    found = (
        _sqlite3(storage, packed=info["compression_mode"] == "MESSAGE") if storage.suffix == ".db3" else _mcap(storage)
    )
    # metadata.yaml speaks the truth about the storage.
    assert info["message_count"] == len(found.messages)
    listed = [(entry["topic_metadata"], entry["message_count"]) for entry in info["topics_with_message_count"]]
    assert len({(topic["name"], topic["type"]) for topic, _ in listed}) == len(listed) == len(found.publishers)
    counts = Counter(message.topic for message in found.messages)
    assert sum((Counter({topic["name"]: count}) for topic, count in listed), Counter()) == counts
    if found.messages:
        assert info["starting_time"]["nanoseconds_since_epoch"] == found.messages[0].log_time_ns
        span = found.messages[-1].log_time_ns - found.messages[0].log_time_ns
        assert info["duration"]["nanoseconds"] == span
    # A second opinion: rosbags' own reader of rosbag2 directories.
    with Rosbag2LibraryReader(folder) as reader:
        again = [(connection.topic, time_ns, bytes(data)) for connection, time_ns, data in reader.messages()]
    assert sorted(again) == sorted((m.topic, m.log_time_ns, m.data) for m in found.messages)
    return found


def _sqlite3(path: Path, *, packed: bool) -> Output:
    unpack = zstandard.ZstdDecompressor().decompress if packed else bytes
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        rows = database.execute("SELECT topic_type, encoded_message_definition, encoding FROM message_definitions")
        texts = {kind: (text, "", encoding) for kind, text, encoding in rows}
        rows = database.execute("SELECT name, type, offered_qos_profiles FROM topics ORDER BY id")
        publishers = [
            Publisher(name, kind, _latches(qos), *texts.get(kind, ("", "", ""))) for name, kind, qos in rows.fetchall()
        ]
        messages = [
            Found(topic, log_time_ns, unpack(data))
            for topic, log_time_ns, data in database.execute(
                "SELECT topics.name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id"
                " ORDER BY timestamp, messages.id"
            )
        ]
    return Output(2, publishers, messages)
