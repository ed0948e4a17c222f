"""Long recordings, of which the disk holds little: the points of a cloud are holes of a sparse file but for the first.

A hole is read as zeros: points at the origin, which are no returns. All else is as recorders write it: chunks, their
indexes and checksums, and the summary.
"""

from __future__ import annotations

import os
import re
import struct
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING
from unittest import mock

from benchmarks.clouds import POINT_BYTES, serialized_clouds
from pc2scan.bags.destinations import open_writer, plan_destination
from pc2scan.files.new_file import NewFile
from pc2scan.model import Connection, Definition
from support.builders import CLOUD, IMU, TF, definition, imu_message, transforms

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence
    from pathlib import Path

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
    joints
        How many frames move besides the robot, each as often.
    """

    clouds: int
    points: int = 131_072
    compression: str = "none"
    joints: int = 0

    def write(self, path: Path) -> Path:
        """Write an MCAP file."""
        with _holes():
            self._write(path)
        return path

    def _write(self, path: Path) -> None:
        writer = open_writer(
            plan_destination(path, compression=self.compression, source_ros_version=2), path, path.name
        )
        topics = {"/points": CLOUD, "/tf": TF, "/imu": IMU, "/tf_static": TF}
        points, tf, imu, static = (
            writer.add_connection(
                Connection(0, topic, kind, "cdr", Definition("ros2msg", definition(kind, 2).encode()))
            )
            for topic, kind in topics.items()
        )
        cloud = bytearray(serialized_clouds("cdr", self.points, 1)[0])
        # Behind its points, a cloud has one more byte, in CDR or without.
        hole = (self.points - _REAL_POINTS) * POINT_BYTES
        cloud[-1 - hole : -1] = bytes(hole)
        moving = [("odom", "base_link"), *(("base_link", f"joint_{number}") for number in range(self.joints))]
        pose = bytearray(transforms([(*pair, _ANY_NS, (1.0, 0.0, 0.0)) for pair in moving], 2))
        stamps = [each.start() for each in re.finditer(re.escape(_STAMP.pack(*divmod(_ANY_NS, 1_000_000_000))), pose)]
        turn = bytearray(imu_message(2))
        mount = transforms([("base_link", "lidar", 0, (0.0, 0.0, 0.5))], 2)
        writer.write(static, BEGIN_NS, mount, BEGIN_NS)
        write = writer.write
        poses, turns = memoryview(pose), memoryview(turn)
        for number in range(self.clouds * 10):
            now = BEGIN_NS + number * TICK_NS
            stamp = divmod(now, 1_000_000_000)
            for at in stamps:
                _STAMP.pack_into(pose, at, *stamp)
            write(tf, now, poses, now, number)
            for half in (now + 1_000_000, now + 6_000_000):
                _STAMP.pack_into(turn, 4, *divmod(half, 1_000_000_000))
                write(imu, half, turns, half, number)
            if number % 10 == 0:
                _STAMP.pack_into(cloud, 4, *stamp)
                write(points, now + 7_000_000, memoryview(cloud), now + 7_000_000, number)
        writer.finish()


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
