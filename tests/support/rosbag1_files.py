"""ROS 1 bags for tests: ours, some put together by hand so that they can be wrong, and ROS 1's own tools."""

from __future__ import annotations

import bz2
import json
import os
import struct
import subprocess
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lz4.frame
import pytest

from pc2scan.bags.rosbag1.read import Rosbag1Reader
from pc2scan.bags.rosbag1.write import Rosbag1Writer
from pc2scan.errors import RecordingError
from pc2scan.model import Connection, Definition

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from pc2scan.model import Writer


COMPRESSIONS = ("none", "bz2", "lz4")


STRING = Definition("ros1msg", b"string data\n")


STRING_MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"


SECOND = 1_000_000_000


Row = tuple[int, int, bytes]


def connection(topic: str = "/chatter", **changes: Any) -> Connection:
    """A connection as ROS 1 itself would have it."""
    return replace(Connection(0, topic, "std_msgs/String", "ros1", STRING, STRING_MD5), **changes)


def string(text: str) -> bytes:
    """A serialised std_msgs/String."""
    return struct.pack("<I", len(text)) + text.encode()


def write(
    path: Path,
    connections: Sequence[Connection],
    rows: Iterable[Row],
    compression: str = "lz4",
    chunk_size: int = 768 * 1024,
) -> Path:
    writer: Writer = Rosbag1Writer(path, compression, chunk_size)
    handles = [writer.add_connection(item) for item in connections]
    for index, time_ns, data in rows:
        writer.write(handles[index], time_ns, data, time_ns)
    writer.finish()
    return path


def read_rows(path: Path) -> list[Row]:
    with closing(Rosbag1Reader(path)) as reader:
        return [(item.connection.id, item.log_time_ns, bytes(item.data)) for item in reader.messages()]


def uint32(value: int) -> bytes:
    return struct.pack("<I", value)


def uint64(value: int) -> bytes:
    return struct.pack("<Q", value)


def time(time_ns: int) -> bytes:
    return struct.pack("<II", *divmod(time_ns, SECOND))


def header(**fields: bytes) -> bytes:
    packed = b"".join(
        uint32(len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in fields.items()
    )
    return uint32(len(packed)) + packed


def record(body: bytes = b"", **fields: bytes) -> bytes:
    return header(**fields) + uint32(len(body)) + body


def connection_record(identity: int = 0, **fields: bytes) -> bytes:
    body = {"topic": b"/chatter", "type": b"std_msgs/String", "md5sum": b"*", "message_definition": b"string data\n"}
    inner = header(**{**body, **fields})[4:]
    return record(inner, op=b"\x07", conn=uint32(identity), topic=b"/chatter")


def message(
    time_ns: int, data: bytes = b"data", identity: int = 0, order: Sequence[str] = ("op", "conn", "time")
) -> bytes:
    fields = {"op": b"\x02", "conn": uint32(identity), "time": time(time_ns)}
    return record(data, **{name: fields[name] for name in order})


def chunk(payload: bytes, compression: str = "none", size: int | None = None, stored: bytes | None = None) -> bytes:
    if stored is None:
        pack: dict[str, Callable[[bytes], bytes]] = {"bz2": bz2.compress, "lz4": lz4.frame.compress}
        stored = pack.get(compression, bytes)(payload)
    size = len(payload) if size is None else size
    return record(stored, op=b"\x05", compression=compression.encode(), size=uint32(size))


def chunk_info(
    position: int, start_ns: int, end_ns: int, counts: dict[int, int], *, version: int = 1, count: int | None = None
) -> bytes:
    return record(
        b"".join(uint32(value) for item in counts.items() for value in item),
        op=b"\x06",
        ver=uint32(version),
        chunk_pos=uint64(position),
        start_time=time(start_ns),
        end_time=time(end_ns),
        count=uint32(len(counts) if count is None else count),
    )


def bag_header(index_pos: int, connections: int, chunks: int, **more: bytes) -> bytes:
    fields = {"index_pos": uint64(index_pos), "conn_count": uint32(connections), "chunk_count": uint32(chunks)}
    return b"#ROSBAG V2.0\n" + record(b" " * 50, op=b"\x03", **fields, **more)


FIRST_CHUNK = len(bag_header(0, 0, 0))


def simple_bag(
    path: Path,
    payload: bytes,
    *,
    compression: str = "none",
    times: tuple[int, int] = (1, 9),
    counts: dict[int, int] | None = None,
    connections: Sequence[bytes] = (connection_record(),),
    **chunk_changes: Any,
) -> Path:
    """A bag of one chunk."""
    body = chunk(payload, compression, **chunk_changes)
    info = chunk_info(FIRST_CHUNK, *times, {0: 1} if counts is None else counts)
    index = b"".join(connections) + info
    path.write_bytes(bag_header(FIRST_CHUNK + len(body), len(connections), 1) + body + index)
    return path


def fails(path: Path, *, hint: str = "") -> str:
    """The message of the error that opening and reading a bag raises; it must name the bag."""
    with pytest.raises(RecordingError) as raised, closing(Rosbag1Reader(path, strict=True)) as reader:
        list(reader.messages())
    assert raised.value.path == path
    assert hint in (raised.value.hint or "")
    return raised.value.message


def given_bytes(tmp_path: Path, data: bytes) -> Path:
    path = tmp_path / "given.bag"
    path.write_bytes(data)
    return path


ROS1 = Path("/usr/bin/python3")


ROSBAG = Path("/usr/bin/rosbag")


SCRIPT = Path(__file__).with_name("rosbag1_reader.py")


def ros1(*command: str | Path, stdin: str = "") -> subprocess.CompletedProcess[str]:
    """Run a program of the system's Python, away from this one's environment."""
    hidden = {"VIRTUAL_ENV", "PYTHONPATH", "PYTHONHOME"}
    env = {key: value for key, value in os.environ.items() if key not in hidden}
    return subprocess.run(
        [str(part) for part in command],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**env, "PATH": "/usr/bin:/bin"},
    )


def ros1_missing() -> list[Path]:
    """What is not there; its modules are not imported, because each process of the tests asks."""
    modules = (Path("/usr/lib/python3/dist-packages", name) for name in ("rosbag", "std_msgs"))
    return [path for path in (ROS1, *modules) if not path.exists()]


def ros1_read(path: Path) -> list[list[Any]]:
    done = ros1(ROS1, SCRIPT, "read", path)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]
