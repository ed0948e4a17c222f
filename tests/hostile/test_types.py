"""Message definitions that take more memory or time to re-encode than the messages have bytes."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest
from mcap.records import Header, Schema

from support import mcap_files, sampled
from support.bounded import run_bounded

if TYPE_CHECKING:
    from pathlib import Path

HEAD = b"\0\1\0\0"


def definition(text: str, **others: str) -> str:
    """A definition, with those of other messages of the package."""
    return text + "".join(f"{'=' * 80}\nMSG: p/{name}\n{fields}" for name, fields in others.items())


def recording(path: Path, definition: str, *messages: bytes) -> Path:
    """A ROS 2 recording of one topic, which becomes a ROS 1 bag only by re-encoding."""
    schema = Schema(id=1, name="p/msg/A", encoding="ros2msg", data=definition.encode())
    stored = (mcap_files.raw_message(1, number, data) for number, data in enumerate(messages, 1))
    path = mcap_files.raw_file(path, mcap_files.encoded(schema), mcap_files.raw_channel(1, "/t", schema=1), *stored)
    before, after = (mcap_files.encoded(Header(*names)) for names in (("", "raw"), ("ros2", "hostile")))
    path.write_bytes(path.read_bytes().replace(before, after))
    return path


def counted(number: int, data: bytes) -> bytes:
    return HEAD + struct.pack("<I", number) + data


#: The definition, messages, and why they cannot be re-encoded.
CASES: dict[str, tuple[str, tuple[bytes, ...], str]] = {
    **{
        f"an array of {kind} that no message could hold": (
            f"{kind}[4000000000] x\n",
            (HEAD + bytes(100),),
            f"of 104 bytes cannot be re-encoded: it needs {4_000_000_000 * size} bytes or more",
        )
        for kind, size in (("int8", 1), ("float64", 8))
    },
    "an array behind a string": (
        definition("B[] x\n", B="string s\nint8[400000000] y\n"),
        (counted(3, struct.pack("<I", 1) + bytes(300)),),
        "of 312 bytes cannot be re-encoded: it needs 400000009 bytes or more",
    ),
    # Two million elements of two thousand fields each, none of which is there.
    "elements that are only counted": (
        definition("C[] x\n", C="".join(f"B b{n}\n" for n in range(40)), B="".join(f"uint8 y{n}\n" for n in range(50))),
        (counted(2_000_000, bytes(2_000_000)),),
        "it needs 2002004 bytes or more",
    ),
    "many short messages of a long type": (
        definition("".join(f"B b{n}\n" for n in range(1_000)), B="".join(f"uint8 y{n}\n" for n in range(90))),
        (HEAD,) * 5_000,
        "it needs 90000 bytes or more",
    ),
    # The fewest that are refused.
    "elements of more fields than bytes": (
        definition("C[] x\n", C="".join(f"E e{n}\n" for n in range(63)) + "uint8 y\n", E=""),
        (counted(1_000, bytes(1_000_000)),),
        "x is a sequence of messages with",
    ),
}


@pytest.mark.parametrize("name", sampled(CASES, 5))
def test_messages_that_unfold_by_their_type_are_skipped(name: str, tmp_path: Path) -> None:
    text, messages, said = CASES[name]
    done = run_bounded("repair", recording(tmp_path / "a.mcap", text, *messages), "-o", tmp_path / "out.bag")
    assert done.status == 3, done.stderr
    assert said in done.stdout + done.stderr
