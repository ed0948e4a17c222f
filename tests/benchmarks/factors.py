"""Print how much longer hostile recordings take than sound ones of the same size, as Markdown.

Run it with ``python tests/benchmarks/factors.py``, or with ``--write`` to put the table into ``docs/benchmarks.md``.
"""

from __future__ import annotations

import argparse
import os
import random
import statistics
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from mcap.records import Channel, Schema
from mcap.writer import Writer

from support import mcap_files, rosbag1_files

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

ROOT = Path(__file__).resolve().parents[2]
CLOUD = "sensor_msgs/msg/PointCloud2"
MEGABYTE = 1_000_000
BEGIN, END = "<!-- factors -->", "<!-- end of factors -->"


def sound_mcap(path: Path, size: int) -> None:
    """Messages of 100 random bytes."""
    rng = random.Random(1)
    _write_mcap(path, [("/t", rng.randbytes(100)) for _ in range(size // 150)])


def sound_bag(path: Path, size: int) -> None:
    rng = random.Random(1)
    rows = [(0, number + 1, rng.randbytes(100)) for number in range(size // 150)]
    rosbag1_files.write(path, [rosbag1_files.connection()], rows, "none")


def many_topics(path: Path, size: int) -> None:
    """A topic for every message."""
    _write_mcap(path, [(f"/t{number}", bytes(8)) for number in range(size // 240)])


def impossible_chunk(path: Path, size: int) -> None:
    """Chunks whose messages alternate with those of one that declares an impossible size."""
    head = mcap_files.encoded(Schema(id=1, name=CLOUD, encoding="ros2msg", data=b""))
    head += mcap_files.encoded(Channel(id=1, schema_id=1, topic="/t", message_encoding="cdr", metadata={}))
    count = size // 2 // 131
    liar = b"".join(mcap_files.raw_message(log_time=10 + 2 * n, data=bytes(100)) for n in range(count))
    chunks = [mcap_files.raw_chunk(head + liar, uncompressed_size=1 << 60)]
    for first in range(0, count, 100):
        times = range(first, min(first + 100, count))
        messages = b"".join(mcap_files.raw_message(log_time=11 + 2 * n, data=bytes(100)) for n in times)
        chunks.append(mcap_files.raw_chunk(messages))
    mcap_files.raw_file(path, *chunks)


def long_profiles(path: Path, size: int) -> None:
    """QoS profiles that are brackets without end, 100 kB a topic; compressed to next to nothing."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "x")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        for number in range(max(1, size // 100_000)):
            metadata = {"offered_qos_profiles": "[" * 100_000}
            channel = writer.register_channel(f"/t{number}", "cdr", schema, metadata)
            writer.add_message(channel, number + 1, b"\0\1\0\0\1\0\0\0\0", number + 1)
        writer.finish()  # type: ignore[no-untyped-call]


def one_byte_records(path: Path, size: int) -> None:
    """A bag without an index, behind whose chunk are records of one byte."""
    junk = rosbag1_files.uint32(1) + b"x" + rosbag1_files.uint32(1) + b"y"
    chunk = rosbag1_files.chunk(rosbag1_files.message(5))
    body = rosbag1_files.bag_header(0, 0, 0) + rosbag1_files.connection_record() + chunk
    path.write_bytes(body + junk * (size // len(junk)))


def loose_messages(path: Path, size: int) -> None:
    """A bag without chunks and index."""
    messages = b"".join(rosbag1_files.message(number + 1, b"x") for number in range(size // 48))
    path.write_bytes(rosbag1_files.bag_header(0, 0, 0) + rosbag1_files.connection_record() + messages)


#: What is made, by what it is called; what it is compared with; and the commands.
KINDS: tuple[tuple[str, Callable[[Path, int], None], str, tuple[str, ...]], ...] = (
    ("a topic for every message", many_topics, ".mcap", ("info", "repair", "diff")),
    ("chunks overlap one of an impossible size", impossible_chunk, ".mcap", ("info", "repair")),
    ("QoS profiles of 100 kB", long_profiles, ".mcap", ("info", "repair into a folder")),
    ("no index, records of one byte", one_byte_records, ".bag", ("info", "repair")),
    ("no index, no chunks", loose_messages, ".bag", ("info", "repair")),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mb", type=float, nargs=2, default=(2, 8), help="sizes of the recordings (default: 2 8)")
    parser.add_argument("--repeat", type=int, default=3, help="runs, of which the median is taken (default: 3)")
    parser.add_argument("--write", action="store_true", help="put the table into docs/benchmarks.md")
    asked = parser.parse_args()
    small, large = (int(size * MEGABYTE) for size in asked.mb)
    lines = [
        (
            f"| recording | command | {asked.mb[0]:g} MB | {asked.mb[1]:g} MB "
            f"| {asked.mb[1]:g} MB / {asked.mb[0]:g} MB | compared with a sound recording |"
        ),
        "|---|---|---:|---:|---:|---:|",
    ]
    with TemporaryDirectory() as folder:
        place = Path(folder)
        empty = _seconds(["--version"], asked.repeat)
        for name, make, suffix, commands in KINDS:
            for command in commands:
                sound_one = sound_bag if suffix == ".bag" else sound_mcap
                sound, first, second = (
                    _measured(each, suffix, place, command, of, asked.repeat)
                    for each, of in ((sound_one, large), (make, small), (make, large))
                )
                growth = (second - empty) / max(first - empty, 0.01)
                share = (second - empty) / max(sound - empty, 0.01)
                lines.append(
                    f"| {name} | {command} | {first:.2f} s | {second:.2f} s | {growth:.1f} times | {share:.1f} times |"
                )
                sys.stderr.write(f"{lines[-1]}\n")
    table = "\n".join(lines)
    sys.stdout.write(f"{table}\n")
    if asked.write:
        page = ROOT / "docs" / "benchmarks.md"
        text = page.read_text("utf-8")
        before, rest = text.split(BEGIN)
        page.write_text(f"{before}{BEGIN}\n\n{table}\n\n{END}{rest.split(END)[1]}", "utf-8")


def _measured(
    make: Callable[[Path, int], None], suffix: str, folder: Path, command: str, size: int, repeat: int
) -> float:
    """Seconds of processor time that a command takes for a recording, the interpreter's start included."""
    source = folder / f"source{suffix}"
    source.unlink(missing_ok=True)
    make(source, size)
    out = folder / ("out" if "folder" in command else f"out{suffix}")
    arguments = {
        "info": ["info", source],
        "repair": ["repair", source, "-o", out, "--overwrite", "-q"],
        "repair into a folder": ["repair", source, "-o", out, "--overwrite", "-q"],
        "diff": ["diff", source, source],
    }[command]
    if command == "diff":
        twin = folder / f"twin{suffix}"
        twin.write_bytes(source.read_bytes())
        arguments = ["diff", source, twin, "--all-topics"]
    return _seconds([str(argument) for argument in arguments], repeat)


def _seconds(arguments: Sequence[str], repeat: int) -> float:
    taken = []
    for _ in range(repeat):
        before = os.times()
        done = subprocess.run(
            [sys.executable, "-m", "pc2scan", *arguments], capture_output=True, check=False, timeout=600
        )
        after = os.times()
        if done.returncode not in (0, 3):
            raise SystemExit(f"{arguments[0]} ended with {done.returncode}: {done.stderr.decode()[-500:]}")
        taken.append(after.children_user + after.children_system - before.children_user - before.children_system)
    return statistics.median(taken)


def _write_mcap(path: Path, messages: Sequence[tuple[str, bytes]]) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "x")
        schema = writer.register_schema(CLOUD, "ros2msg", b"string data")
        channels: dict[str, int] = {}
        for number, (topic, data) in enumerate(messages):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], number + 1, data, number + 1)
        writer.finish()  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    main()
