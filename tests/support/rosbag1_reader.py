"""Reads and writes bags with ROS 1's own `rosbag`, for tests; run by the Python that has it.

``rosbag1_reader.py read BAG`` prints a JSON line a message: topic, time in ns, type, md5sum, connection
header and data in base64. ``rosbag1_reader.py write BAG COMPRESSION CHUNK_SIZE`` writes ``std_msgs/String``
messages from JSON lines of topic, time in ns and text. ``rosbag1_reader.py reindexed BAG...`` does what
``rosbag reindex`` does to each bag, and prints a JSON list of how many messages it then has (0 if that failed).
"""

from __future__ import annotations

import base64
import json
import sys

import genpy
import genpy.message
import rosbag


def read(path: str) -> None:
    with rosbag.Bag(path) as bag:
        for message in bag.read_messages(raw=True, return_connection_header=True):
            msgtype, data, md5sum = message.message[:3]
            header = {key: _text(value) for key, value in message.connection_header.items()}
            line = [message.topic, message.timestamp.to_nsec(), msgtype, md5sum, header]
            sys.stdout.write(json.dumps([*line, base64.b64encode(data).decode()]) + "\n")


def write(path: str, compression: str, chunk_size: str) -> None:
    string = genpy.message.get_message_class("std_msgs/String")
    with rosbag.Bag(path, "w", compression=compression, chunk_threshold=int(chunk_size)) as bag:
        for line in sys.stdin:
            topic, time_ns, text = json.loads(line)
            bag.write(topic, string(text), genpy.Time(*divmod(time_ns, 1_000_000_000)))


def reindexed(paths: list[str]) -> None:
    counts = []
    for path in paths:
        count = 0
        try:
            with rosbag.Bag(path, "a", allow_unindexed=True) as bag:
                for _ in bag.reindex():
                    pass
            with rosbag.Bag(path) as bag:
                for _ in bag.read_messages(raw=True):
                    count += 1
        except Exception as err:  # noqa: BLE001  # it raises whatever comes up, and what it read before counts
            sys.stderr.write(f"{path}: {err!r}\n")
        counts.append(count)
    sys.stdout.write(json.dumps(counts) + "\n")


def _text(value: bytes | str) -> str:
    return value if isinstance(value, str) else value.decode("utf-8", "replace")


if __name__ == "__main__":
    if sys.argv[1] == "read":
        read(sys.argv[2])
    elif sys.argv[1] == "reindexed":
        reindexed(sys.argv[2:])
    else:
        write(*sys.argv[2:])
