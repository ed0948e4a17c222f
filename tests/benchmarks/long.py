"""Long recordings, of which the disk holds little: the points of a cloud are holes of a sparse file but for the first.

A hole is read as zeros: points at the origin, which are no returns. All else is as recorders write it: chunks, their
indexes and checksums, and the summary. Run it with ``python tests/benchmarks/long.py`` to print memory and time.
"""

from __future__ import annotations

import argparse
import os
import struct
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.clouds import POINT_BYTES, serialized_clouds
from pc2scan import convert
from pc2scan.bags.destinations import open_writer, plan_destination
from pc2scan.cli.time_left import TimeLeft
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
    """

    clouds: int
    points: int = 131_072
    compression: str = "none"
    quiet: int = 0
    others: bool = True

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
        (message,) = serialized_clouds(serialization, self.points, 1)
        # Behind its points, a cloud has one more byte, in CDR or without.
        cloud, hole = bytearray(message), (self.points - _REAL_POINTS) * POINT_BYTES
        cloud[-1 - hole : -1] = bytes(hole)
        pose = bytearray(transforms([("odom", "base_link", 0, (1.0, 0.0, 0.0))], version))
        turn = bytearray(imu_message(version))
        mount = transforms([("base_link", "lidar", 0, (0.0, 0.0, 0.5))], version)
        writer.write(static, BEGIN_NS, mount, BEGIN_NS)
        write = writer.write
        clouds, poses, turns = memoryview(cloud), memoryview(pose), memoryview(turn)
        for number in range(self.clouds * 10):
            now = BEGIN_NS + number * TICK_NS
            stamp = divmod(now, 1_000_000_000)
            if self.others:
                _STAMP.pack_into(pose, 8, *stamp)
                write(tf, now, poses, now, number)
                for half in (now + 1_000_000, now + 6_000_000):
                    _STAMP.pack_into(turn, 4, *divmod(half, 1_000_000_000))
                    write(imu, half, turns, half, number)
            if number % 10 == 0 and number >= 10 * self.quiet:
                _STAMP.pack_into(cloud, 4, *stamp)
                write(points, now + 7_000_000, clouds, now + 7_000_000, number)
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
    "MCAP, zstd, clouds of 1 MB": ("long.mcap", Long(4 * _CLOUDS, points=32_768, compression="zstd")),
}

_CONVERT = ("convert", "--min-height", "-2", "--overwrite")
_COMMANDS = {
    "`convert`, 1 job": (*_CONVERT, "--jobs", "1"),
    "`convert`, 2 jobs": (*_CONVERT, "--jobs", "2"),
    "`convert --target-frame base_link`, 2 jobs": (*_CONVERT, "--target-frame", "base_link", "--jobs", "2"),
    "`info`": ("info",),
}


#: What is converted to see whether the time left is true: the whole, half of it, with transforms that are read before,
#: and a recording in which the lidar is off for half of the time.
_PROGRESSES: dict[str, tuple[float, dict[str, Any]]] = {
    "all": (0, {}),
    "the second half, `--start`": (0, {"start": 0.5}),
    "`--target-frame base_link`": (0, {"target_frame": "base_link"}),
    "`--keep-clouds`": (0, {"keep_clouds": True}),
    "no clouds in the first half": (0.5, {}),
}


def progress_errors(source: Path, **options: Any) -> tuple[float, float]:
    """Convert on one thread, in processor time; after a tenth of it, return the largest errors of the progress.

    Returns
    -------
    share, end : float
        Of the share that is done, and of the time at which the run is said to end, as shares of the whole time.
    """
    steps: list[tuple[float, float, float]] = []
    left = TimeLeft()

    def progress(done: int, total: int, _: int) -> None:
        now = time.process_time()
        steps.append((now, done / total, now + (left.seconds(done, total, now) or 0)))

    convert(source, source.with_name("scans.mcap"), min_height=-2, jobs=1, overwrite=True, progress=progress, **options)
    begin, length = steps[0][0], time.process_time() - steps[0][0]
    later = [
        (share - (now - begin) / length, (end - begin) / length - 1)
        for now, share, end in steps
        if now - begin > length / 10
    ]
    share, end = (max(errors, key=abs) for errors in zip(*later, strict=True))
    return share, end


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gb", type=int, nargs="*", default=[1, 10, 100], help="sizes (default: 1 10 100)")
    parser.add_argument("--folder", type=Path, help="where the recordings are written meanwhile")
    asked = parser.parse_args()
    columns = [f"{size} GB" for size in asked.gb]
    print("| recording | command |", " | ".join(columns), "|")  # noqa: T201  # what it prints is what it is for
    print("|---|---" + "|---:" * len(columns) + "|")  # noqa: T201
    with TemporaryDirectory(dir=asked.folder) as folder:
        for form, (name, short) in _RECORDINGS.items():
            cells: dict[str, list[str]] = {command: [] for command in _COMMANDS}
            for size in asked.gb:
                source = replace(short, clouds=short.clouds * size).write(Path(folder) / name)
                for command, words in _COMMANDS.items():
                    further: list[str | Path] = ["-o", source.with_name("scans.mcap")] if words[0] == "convert" else []
                    peak, seconds = measured([*words, source, *further])
                    cells[command].append(f"{peak / 1024:.0f} MB, {seconds:.1f} s")
                source.unlink()
            for command, own in cells.items():
                print(f"| {form} | {command} |", " | ".join(own), "|", flush=True)  # noqa: T201
        size = max(asked.gb)
        print(f"\n| {size} GB | share done | predicted end |\n|---|---:|---:|")  # noqa: T201
        for what, (quiet, options) in _PROGRESSES.items():
            clouds = _CLOUDS * size
            long = Long(clouds, compression="zstd", quiet=round(quiet * clouds))
            if "start" in options:
                options = {"start": options["start"] * clouds / 10}  # noqa: PLW2901  # seconds
            source = long.write(Path(folder) / "long.mcap")
            share, end = progress_errors(source, **options)
            print(f"| {what} | {share:+.1%} | {end:+.1%} |", flush=True)  # noqa: T201
            source.unlink()


if __name__ == "__main__":
    main()
