"""Long recordings, of which the disk holds little: the points of a cloud are holes of a sparse file but for the first.

A hole is read as zeros: points at the origin, which are no returns. All else is as recorders write it: chunks, their
indexes and checksums, and the summary. What points cost is measured with shorter recordings of scanned ones. Run it
with ``python tests/benchmarks/long.py`` to print memory and time.
"""

from __future__ import annotations

import argparse
import os
import re
import struct
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.clouds import POINT_BYTES, serialized_clouds
from pc2scan.bags.destinations import open_writer, plan_destination
from pc2scan.files.new_file import NewFile
from pc2scan.messages.definitions import TYPES, definition
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from pc2scan.model import Connection, Definition
from support.builders import IMU, TF, imu_message, transforms, typestore

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from pc2scan.model import Buffer

#: Log time of the first message, and the time between two transforms, ns.
BEGIN_NS = 1_700_000_000_000_000_000
TICK_NS = 10_000_000

_REAL_POINTS = 64
_STAMP = struct.Struct("<II")
_ANY_NS = 1_234_567_890_987_654_321


@dataclass(frozen=True)
class Long:
    """A recording of a lidar at 10 Hz, transforms of a robot's odometry at 100 Hz, and an IMU at 200 Hz.

    Attributes
    ----------
    clouds, points
        How many clouds it has, each of about so many points of 32 bytes.
    compression
        ``none`` for a sparse file.
    quiet
        For how many clouds at the beginning the lidar is off.
    others
        Whether it has transforms and an IMU.
    joints
        How many frames move besides the robot, each as often.
    scanned
        Whether all points are what a lidar would measure, which takes the room of a usual recording.
    """

    clouds: int
    points: int = 131_072
    compression: str = "none"
    quiet: int = 0
    others: bool = True
    joints: int = 0
    scanned: bool = False

    def times(self, size: float) -> Long:
        """Return a recording that is so many times as long."""
        return replace(self, clouds=round(self.clouds * size), quiet=round(self.quiet * size))

    def write(self, path: Path) -> Path:
        """Write it; the name says the format: a folder has a database."""
        with _holes():
            self._write(path)
        return path

    def _write(self, path: Path) -> None:
        version = 1 if path.suffix == ".bag" else 2
        serialization = "ros1" if version == 1 else "cdr"
        storage = None if path.suffix else "sqlite3"
        target = plan_destination(path, storage=storage, compression=self.compression, source_ros_version=version)
        writer = open_writer(target, path, path.name)
        topics = {"/points": POINTCLOUD2, "/tf": TF, "/imu": IMU, "/tf_static": TF}
        points, tf, imu, static = (
            writer.add_connection(Connection(0, topic, kind, serialization, *_definition(kind, version)))
            for topic, kind in topics.items()
        )
        scans = list(map(bytearray, serialized_clouds(serialization, self.points, 4 if self.scanned else 1)))
        if not self.scanned:
            # Behind its points, a cloud has one more byte, in CDR or without.
            hole = (self.points - _REAL_POINTS) * POINT_BYTES
            scans[0][-1 - hole : -1] = bytes(hole)
        moving = [("odom", "base_link"), *(("base_link", f"joint_{number}") for number in range(self.joints))]
        pose = bytearray(transforms([(*pair, _ANY_NS, (1.0, 0.0, 0.0)) for pair in moving], version))
        stamps = [each.start() for each in re.finditer(re.escape(_STAMP.pack(*divmod(_ANY_NS, 1_000_000_000))), pose)]
        turn = bytearray(imu_message(version))
        mount = transforms([("base_link", "lidar", 0, (0.0, 0.0, 0.5))], version)
        writer.write(static, BEGIN_NS, mount, BEGIN_NS)
        write = writer.write
        poses, turns = memoryview(pose), memoryview(turn)
        for number in range(self.clouds * 10):
            now = BEGIN_NS + number * TICK_NS
            stamp = divmod(now, 1_000_000_000)
            if self.others:
                for at in stamps:
                    _STAMP.pack_into(pose, at, *stamp)
                write(tf, now, poses, now, number)
                for half in (now + 1_000_000, now + 6_000_000):
                    _STAMP.pack_into(turn, 4, *divmod(half, 1_000_000_000))
                    write(imu, half, turns, half, number)
            if number % 10 == 0 and number >= 10 * self.quiet:
                cloud = scans[number // 10 % len(scans)]
                _STAMP.pack_into(cloud, 4, *stamp)
                write(points, now + 7_000_000, memoryview(cloud), now + 7_000_000, number)
        writer.finish()


def _definition(msgtype: str, version: int) -> tuple[Definition, str]:
    if msgtype in TYPES:
        return definition(msgtype, version)
    text, digest = typestore(version).generate_msgdef(msgtype, ros_version=version)
    return Definition(f"ros{version}msg", text.encode()), digest if version == 1 else ""


@contextmanager
def _holes() -> Generator[None]:
    """Make holes of the zeros in what is written."""
    put, nothing = NewFile.put, bytes(1 << 16)

    def put_sparsely(self: NewFile, *parts: Buffer) -> int:
        start = self.position
        for part in parts:
            view = memoryview(part)
            for at in range(0, len(view), len(nothing)):
                piece = view[at : at + len(nothing)]
                if piece == nothing:
                    self._file.seek(len(piece), os.SEEK_CUR)
                    self.position += len(piece)
                else:
                    put(self, piece)
        return start

    with mock.patch.object(NewFile, "put", put_sparsely):
        yield


#: Runs a command, and prints its peak memory, KiB, and its processor time, seconds. What `getrusage` says of the peak
#: includes the process that began this one.
_MEASURED = """
import sys, time
from pc2scan.cli import main
try:
    main()
finally:
    with open("/proc/self/status") as file:
        (peak,) = (line.split()[1] for line in file if line.startswith("VmHWM:"))
    print(peak, time.process_time(), file=sys.stderr)
"""


def measured(words: Sequence[str | Path]) -> tuple[int, float]:
    """Run a command; return its peak memory in KiB, and its processor time in seconds."""
    done = subprocess.run(
        [sys.executable, "-c", _MEASURED, *map(str, words)], capture_output=True, text=True, timeout=3600, check=True
    )
    peak, seconds = done.stderr.splitlines()[-1].split()
    return int(peak), float(seconds)


#: Clouds in a gigabyte.
_CLOUDS = 238

_RECORDINGS = {
    "MCAP, none": ("long.mcap", Long(_CLOUDS)),
    "MCAP, zstd": ("long.mcap", Long(_CLOUDS, compression="zstd")),
    "ROS 1, none": ("long.bag", Long(_CLOUDS)),
    "MCAP, lz4": ("long.mcap", Long(_CLOUDS, compression="lz4")),
    "MCAP, none, clouds of 1 MB": ("long.mcap", Long(4 * _CLOUDS, points=32_768)),
}

_CONVERT = ("convert", "--min-height", "-2", "--overwrite")
_COMMANDS = {
    "`convert`, 1 job": (*_CONVERT, "--jobs", "1"),
    "`convert`, 2 jobs": (*_CONVERT, "--jobs", "2"),
    "`convert --target-frame base_link`, 2 jobs": (*_CONVERT, "--target-frame", "base_link", "--jobs", "2"),
    "`info`": ("info",),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gb", type=int, nargs="*", default=[1, 10, 100], help="sizes (default: 1 10 100)")
    parser.add_argument("--folder", type=Path, help="where the recordings are written meanwhile")
    asked = parser.parse_args()
    # As the command does: else half of the time of lz4 is spent on pages of memory that malloc gives back.
    with TemporaryDirectory(dir=asked.folder) as folder:
        _print_memory(Path(folder), asked.gb)


def _print_memory(folder: Path, sizes: Sequence[int]) -> None:
    columns = [f"{size} GB" for size in sizes]
    print("| recording | command |", " | ".join(columns), "|")  # noqa: T201  # what it prints is what it is for
    print("|---|---" + "|---:" * len(columns) + "|")  # noqa: T201
    for form, (name, short) in _RECORDINGS.items():
        cells: dict[str, list[str]] = {command: [] for command in _COMMANDS}
        for size in sizes:
            source = short.times(size).write(folder / name)
            for command, words in _COMMANDS.items():
                further: list[str | Path] = ["-o", folder / "scans.mcap"] if words[0] == "convert" else []
                peak, seconds = measured([*words, source, *further])
                cells[command].append(f"{peak / 1024:.0f} MB, {seconds:.1f} s")
            source.unlink()
        for command, own in cells.items():
            print(f"| {form} | {command} |", " | ".join(own), "|", flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
