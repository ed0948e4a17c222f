"""Long recordings, of which the disk holds little: the points of a cloud are holes of a sparse file but for the first.

A hole is read as zeros: points at the origin, which are no returns. All else is as recorders write it: chunks, their
indexes and checksums, and the summary. What points cost is measured with shorter recordings of scanned ones. Run it
with ``python tests/benchmarks/long.py`` to print memory, time, and how true the progress is.
"""

from __future__ import annotations

import argparse
import os
import re
import struct
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from pathlib import Path
from shutil import rmtree
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple
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
from pc2scan.threads import keep_freed_memory
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


_ZSTD, _NONE = Long(_CLOUDS, compression="zstd"), Long(_CLOUDS)
_ODOM = {"target_frame": "base_link"}

#: What is converted to see whether the time left is true: the recording of a gigabyte, and the options. ``start`` is a
#: share. Scanned points and databases take room: at most `_LARGEST` gigabytes.
_PROGRESSES: dict[str, tuple[str, Long, dict[str, Any]]] = {
    "MCAP, zstd": ("long.mcap", _ZSTD, {}),
    "MCAP, zstd, the second half, `--start`": ("long.mcap", _ZSTD, {"start": 0.5}),
    "MCAP, zstd, `--target-frame`": ("long.mcap", _ZSTD, _ODOM),
    "MCAP, zstd, no clouds in the first half": ("long.mcap", replace(_ZSTD, quiet=_CLOUDS // 2), {}),
    "MCAP, zstd, clouds of 1 MB, `--target-frame`": (
        "long.mcap",
        replace(_ZSTD, clouds=4 * _CLOUDS, points=32_768),
        _ODOM,
    ),
    "MCAP, lz4, clouds of 1 MB, `--target-frame`": (
        "long.mcap",
        replace(_ZSTD, clouds=4 * _CLOUDS, points=32_768, compression="lz4"),
        _ODOM,
    ),
    "MCAP, none": ("long.mcap", _NONE, {}),
    "MCAP, none, `--target-frame`": ("long.mcap", _NONE, _ODOM),
    "MCAP, none, clouds of 0.5 MB, `--target-frame`": (
        "long.mcap",
        replace(_NONE, clouds=8 * _CLOUDS, points=16_384),
        _ODOM,
    ),
    "ROS 1, none, no clouds in the first half": ("long.bag", replace(_NONE, quiet=_CLOUDS // 2), {}),
    "sqlite3, clouds of 0.5 MB, `--target-frame`": ("long", replace(_NONE, clouds=8 * _CLOUDS, points=16_384), _ODOM),
    "MCAP, zstd, to ROS 1": ("long.mcap", _ZSTD, {"destination": "scans.bag"}),
    "MCAP, zstd, scanned, `--target-frame`": ("long.mcap", replace(_ZSTD, scanned=True), _ODOM),
    "MCAP, zstd, scanned, no clouds in the first half": (
        "long.mcap",
        replace(_ZSTD, scanned=True, quiet=_CLOUDS // 2),
        {},
    ),
    "MCAP, zstd, scanned, clouds of 1 MB, `--target-frame`": (
        "long.mcap",
        replace(_ZSTD, scanned=True, clouds=4 * _CLOUDS, points=32_768),
        _ODOM,
    ),
    "MCAP, zstd, scanned, clouds of 0.5 MB, `--target-frame`": (
        "long.mcap",
        replace(_ZSTD, scanned=True, clouds=8 * _CLOUDS, points=16_384),
        _ODOM,
    ),
    "MCAP, lz4, scanned, clouds of 0.5 MB, `--target-frame`": (
        "long.mcap",
        replace(_ZSTD, scanned=True, clouds=8 * _CLOUDS, points=16_384, compression="lz4"),
        _ODOM,
    ),
    "ROS 1, lz4, scanned, `--target-frame`": (
        "long.bag",
        replace(_NONE, scanned=True, compression="lz4"),
        _ODOM,
    ),
    "MCAP, lz4, scanned, clouds of 0.5 MB, `--target-frame --keep-clouds`": (
        "long.mcap",
        replace(_ZSTD, scanned=True, clouds=8 * _CLOUDS, points=16_384, compression="lz4"),
        {**_ODOM, "keep_clouds": True},
    ),
}

_LARGEST = 4


class Step(NamedTuple):
    """A report of the progress, and the processor time at which it came, seconds."""

    done: int
    total: int
    messages: int
    time: float


def progress_of(source: Path, destination: Path, **options: Any) -> list[Step]:
    """Convert on one thread, and return what is reported; the last step has the time of the end."""
    steps: list[Step] = []

    def progress(done: int, total: int, messages: int) -> None:
        steps.append(Step(done, total, messages, time.process_time()))

    convert(source, destination, min_height=-2, jobs=1, overwrite=True, progress=progress, **options)
    return [*steps, steps[-1]._replace(time=time.process_time())]


def steady(steps: Sequence[Step]) -> list[Step]:
    """Return the steps with the times of a machine on which equal work always takes as long: its mean time here."""
    pairs = [
        (before, after, (after.messages > 0, f"{after.done - before.done:.1e}")) for before, after in pairwise(steps)
    ]
    times: dict[object, list[float]] = {}
    for before, after, kind in pairs:
        times.setdefault(kind, []).append(after.time - before.time)
    ends = accumulate((fmean(times[kind]) for _, _, kind in pairs), initial=steps[0].time)
    return [step._replace(time=end) for step, end in zip(steps, ends, strict=True)]


def largest_errors(steps: Sequence[Step]) -> tuple[float, float]:
    """Return the largest errors of the progress after a tenth of the time.

    Returns
    -------
    share, end : float
        Of the share that is done, and of the time at which the run is said to end, as shares of the whole time.
    """
    left, found = TimeLeft(), []
    begin, length = steps[0].time, steps[-1].time - steps[0].time
    for done, total, _, now in steps:
        passed = (now - begin) / length
        seconds = left.seconds(done, total, now) or 0
        if passed > 0.1:  # a tenth
            found.append((done / total - passed, passed + seconds / length - 1))
    share, end = (max(errors, key=abs) for errors in zip(*found, strict=True))
    return share, end


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gb", type=int, nargs="*", default=[1, 10, 100], help="sizes (default: 1 10 100)")
    parser.add_argument("--only", choices=["memory", "progress"], help="one of the tables")
    parser.add_argument("--repeat", type=int, default=2, help="how often the progress is measured (default: 2)")
    parser.add_argument("--folder", type=Path, help="where the recordings are written meanwhile")
    asked = parser.parse_args()
    # As the command does: else half of the time of lz4 is spent on pages of memory that malloc gives back.
    keep_freed_memory()
    with TemporaryDirectory(dir=asked.folder) as folder:
        if asked.only != "progress":
            _print_memory(Path(folder), asked.gb)
        if asked.only != "memory":
            _print_progress(Path(folder), max(asked.gb), asked.repeat)


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


def _print_progress(folder: Path, gigabytes: int, repeat: int) -> None:
    print("\n| converted | share done | predicted end | as steady: share done | predicted end |")  # noqa: T201
    print("|---|---:|---:|---:|---:|")  # noqa: T201
    for what, (name, short, asked) in _PROGRESSES.items():
        size = min(gigabytes, _LARGEST) if short.scanned or name == "long" else gigabytes
        long, options = short.times(size), dict(asked)
        if "start" in options:
            options["start"] *= long.clouds / 10  # seconds
        destination = folder / options.pop("destination", "scans.mcap")
        source = long.write(folder / name)
        # What else the machine does only adds errors.
        runs = [progress_of(source, destination, **options) for _ in range(repeat)]
        best = min(runs, key=lambda steps: max(map(abs, largest_errors(steps))))
        cells = [f"{error:+.1%}" for steps in (best, steady(best)) for error in largest_errors(steps)]
        print(f"| {what}, {size} GB |", " | ".join(cells), "|", flush=True)  # noqa: T201
        if source.is_dir():
            rmtree(source)
        else:
            source.unlink()


if __name__ == "__main__":
    main()
