"""Message definitions that take more memory or time to re-encode than the messages have bytes."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest
from mcap.records import Channel, Header, Message, Schema

from support import mcap_files
from support.bounded import run_bounded

if TYPE_CHECKING:
    from pathlib import Path

SEPARATOR = "=" * 80


def recording(path: Path, definition: str, *messages: bytes) -> Path:
    """A ROS 2 recording of one topic, which becomes a ROS 1 bag only by re-encoding."""
    schema = Schema(id=1, name="p/msg/A", encoding="ros2msg", data=definition.encode())
    channel = Channel(id=1, topic="/t", message_encoding="cdr", metadata={}, schema_id=1)
    stored = [
        mcap_files.encoded(Message(channel_id=1, log_time=n + 1, data=data, publish_time=1, sequence=0))
        for n, data in enumerate(messages)
    ]
    header = mcap_files.encoded(Header("ros2", "hostile"))
    made = mcap_files.raw_file(path, mcap_files.encoded(schema), mcap_files.encoded(channel), *stored)
    data = made.read_bytes().replace(mcap_files.encoded(Header("", "raw")), header)
    made.write_bytes(data)
    return made


def refused(folder: Path, source: Path) -> str:
    done = run_bounded("repair", source, "-o", folder / "out.bag")
    assert done.status == 3, done.stderr
    return done.stdout + done.stderr


HEAD = b"\0\1\0\0"


@pytest.mark.parametrize("kind", ["int8", "float64"])
def test_an_array_that_no_message_could_hold(kind: str, tmp_path: Path) -> None:
    source = recording(tmp_path / "a.mcap", f"{kind}[4000000000] x\n", HEAD + bytes(100))
    size = 4_000_000_000 * {"int8": 1, "float64": 8}[kind]
    assert f"of 104 bytes cannot be re-encoded: its fields take {size + 4} or more" in refused(tmp_path, source)


def test_an_array_behind_a_string(tmp_path: Path) -> None:
    definition = f"B[] x\n{SEPARATOR}\nMSG: p/B\nstring s\nint8[400000000] y\n"
    data = HEAD + struct.pack("<II", 3, 1) + bytes(300)
    text = refused(tmp_path, recording(tmp_path / "a.mcap", definition, data))
    assert "of 312 bytes cannot be re-encoded: it ends inside a sequence" in text


def test_elements_that_are_only_counted(tmp_path: Path) -> None:
    """Two million elements of two thousand fields each, none of which is there."""
    inner = "".join(f"B b{n}\n" for n in range(40))
    definition = (
        f"C[] x\n{SEPARATOR}\nMSG: p/C\n{inner}{SEPARATOR}\nMSG: p/B\n"
        + "".join(f"uint8 y{n}\n" for n in range(50))
        + ""
    )
    data = HEAD + struct.pack("<I", 2_000_000) + bytes(2_000_000)
    text = refused(tmp_path, recording(tmp_path / "a.mcap", definition, data))
    assert "it ends inside a sequence" in text


def test_many_short_messages_of_a_long_type(tmp_path: Path) -> None:
    inner = "".join(f"B b{n}\n" for n in range(1_000))
    definition = f"{inner}{SEPARATOR}\nMSG: p/B\n" + "".join(f"uint8 y{n}\n" for n in range(90))
    source = recording(tmp_path / "a.mcap", definition, *[HEAD] * 20_000)
    assert "its fields take 90004 or more" in refused(tmp_path, source)


def test_elements_of_more_fields_than_bytes(tmp_path: Path) -> None:
    definition = (
        f"C[] x\n{SEPARATOR}\nMSG: p/C\n"
        + "".join(f"E e{n}\n" for n in range(500))
        + f"uint8 y\n{SEPARATOR}\nMSG: p/E\n"
    )
    source = recording(tmp_path / "a.mcap", definition, HEAD + struct.pack("<I", 1_000) + bytes(1_000_000))
    assert "x is a sequence of messages with" in refused(tmp_path, source)


def test_many_objects_of_a_big_endian_message(tmp_path: Path) -> None:
    definition = f"B[] x\n{SEPARATOR}\nMSG: p/B\nuint8 y\n"
    data = bytes(4) + struct.pack(">I", 9_000_000) + bytes(9_000_000)
    assert "it is big-endian, and longer than" in refused(tmp_path, recording(tmp_path / "a.mcap", definition, data))
    short = bytes(4) + struct.pack(">I", 1_000) + bytes(1_000)
    source = recording(tmp_path / "b.mcap", definition, short)
    assert run_bounded("repair", source, "-o", tmp_path / "b.bag").status == 0
