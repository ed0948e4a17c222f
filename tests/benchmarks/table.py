"""Print docs/benchmarks.md's tables: what pc2scan takes, beside libraries that do the same in the same run.

Run it with ``python tests/benchmarks/table.py`` in an environment that has pc2scan and its tests' packages.
"""

from __future__ import annotations

import argparse
import math
import shutil
import statistics
import subprocess
import sys
import time
import zlib
from collections import deque
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cramjam
import isal.isal_zlib
import lz4.frame
import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapLibraryWriter
from rosbags.highlevel import AnyReader

from benchmarks.clouds import CLOUD_BYTES, FORMS, POINTS, Form, cloud, serialized_clouds, write_recording
from pc2scan import ProjectionParams
from pc2scan.bags.opening import open_recording
from pc2scan.core.project import Projector

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

HEIGHTS = {
    "all": ("--min-height", "-100", "--max-height", "100"),
    "a band": ("--min-height", "-0.5", "--max-height", "1"),
}

#: Runs a command, and prints its processor time and its peak memory. A process begins with the peak of the one that
#: starts it, so a small one stands between.
_MEASURED = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss)
"""

#: Reads every message with a library, as it is stored.
_READ = {
    "mcap": """import sys
from mcap.reader import make_reader
with open(sys.argv[1], "rb") as file:
    for _ in make_reader(file, validate_crcs=True).iter_messages(): pass""",
    "rosbags": """import sys
from pathlib import Path
from rosbags.highlevel import AnyReader
with AnyReader([Path(sys.argv[1])]) as reader:
    for _ in reader.messages(): pass""",
}

#: An application of Typer with one option.
_TYPER = "import typer\ndef main(name: str = ''): pass\nimport sys; sys.argv = ['x']\ntyper.run(main)"


def run(*line: str | Path) -> tuple[float, float]:
    """Run a command; returns its processor time, seconds, and its peak memory, MB."""
    words = [sys.executable, "-S", "-c", _MEASURED, *map(str, line)]
    seconds, peak = subprocess.run(words, check=True, capture_output=True, text=True).stdout.split()
    return float(seconds), float(peak) * 1024 / 1e6


def pc2scan(*words: str | Path) -> tuple[float, float]:
    return run(sys.executable, "-m", "pc2scan", *words)


def in_turn(repeat: int, *works: Callable[[], float]) -> list[float]:
    """The median of each work; they take turns, so that what else the machine does meets all alike."""
    found = [[work() for work in works] for _ in range(repeat + 1)][1:]
    return [statistics.median(column) for column in zip(*found, strict=True)]


def seconds(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def say(line: str) -> None:
    print(line, flush=True)  # noqa: T201  # what it prints is what it is for


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table row by row, as the figures come."""
    for row in (head, ["---", *["---:"] * (len(head) - 1)]):
        say("| " + " | ".join(row) + " |")
    for row in rows:
        say("| " + " | ".join(row) + " |")
    say("")


def compared(name: str, unit: str, scale: float, found: Sequence[float]) -> Sequence[str]:
    ours, library = found
    return name, f"{ours * scale:.3g} {unit}", f"{library * scale:.3g} {unit}", f"{library / ours:.2f}"


def straightforward(x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], params: ProjectionParams) -> NDArray[Any]:
    """The same scan as whole-array NumPy: float64 arctan2 and minimum.at over the cloud."""
    low, high = np.float32(params.angle_min), np.float32(params.angle_max)
    with np.errstate(all="ignore"):
        ranges = np.hypot(x, y)
        angles = np.arctan2(y.astype(np.float64), x.astype(np.float64)).astype(np.float32)
        indices = (angles.astype(np.float64) - np.float64(low)) / np.float64(np.float32(params.angle_increment))
        keep = ~(np.isnan(x) | np.isnan(y) | np.isnan(z)) & (z >= params.min_height) & (z <= params.max_height)
        keep &= (ranges >= params.range_min) & (ranges <= params.range_max)
        keep &= (angles >= low) & (angles <= high) & (indices < params.length)
        scan = np.full(params.length, params.empty_range, np.float32)
        np.minimum.at(scan, indices[keep].astype(np.intp), ranges[keep])
    return scan


def parts(place: Path, size: int, repeat: int) -> Iterable[Sequence[str]]:
    """Each part that pc2scan has of its own, beside a library."""
    x, y, z = cloud(131_072, "ring-major")
    for heights, low, high in (("all heights", -100.0, 100.0), ("a band", -0.5, 1.0)):
        params = ProjectionParams(min_height=low, max_height=high, angle_increment=2 * math.pi / 360)
        project = Projector(params)
        np.testing.assert_array_equal(project(x, y, z).ranges, straightforward(x, y, z, params))
        found = in_turn(
            20 * repeat,
            lambda: seconds(lambda: project(x, y, z)),  # noqa: B023
            lambda: seconds(lambda: straightforward(x, y, z, params)),  # noqa: B023
        )
        yield compared(f"projecting a point, {heights}; NumPy", "ns", 1e9 / x.size, found)
    data = np.random.default_rng(0).integers(0, 16, CLOUD_BYTES, np.uint8).tobytes()
    packed, room = lz4.frame.compress(data), bytearray(len(data))
    found = in_turn(
        20 * repeat,
        lambda: seconds(lambda: cramjam.lz4.decompress_into(packed, room)),
        lambda: seconds(lambda: lz4.frame.decompress(packed)),
    )
    yield compared("decompressing a cloud, lz4, into a buffer; lz4", "ms", 1e3, found)
    found = in_turn(
        20 * repeat, lambda: seconds(lambda: isal.isal_zlib.crc32(data)), lambda: seconds(lambda: zlib.crc32(data))
    )
    yield compared("CRC of a cloud; zlib", "ms", 1e3, found)
    yield from small_messages(place, repeat)
    small = {f"{name}, clouds of 1,000 points": FORMS[name] for name in ("MCAP, none", "sqlite3")}
    for name, form in (FORMS | small).items():
        source = write_recording(place, form, size // 8 if name in small else size, 1_000 if name in small else 131_072)
        library = "mcap" if form.suffix == ".mcap" else "rosbags"
        line = ("-c", _READ[library], source)
        found = in_turn(
            repeat,
            lambda: converted(source, place, 1),  # noqa: B023
            lambda: run(sys.executable, *line)[0],  # noqa: B023
        )
        yield compared(f"{name}: converting; reading with {library}", "s", 1, found)
        if name in _USUAL:
            yield compared(f"{name}: passing on; rosbags-convert", "s", 1, passed_on(source, form, place, repeat))
        remove(source)
    one = write_recording(place, FORMS["MCAP, none"], 1, 1_000)
    found = in_turn(3 * repeat, lambda: converted(one, place, 1), lambda: run(sys.executable, "-c", _TYPER)[0])
    yield compared("start-up, one cloud; a Typer application", "s", 1, found)
    remove(one)


#: Each container with its usual compression.
_USUAL = ("ROS 1, lz4", "sqlite3", "MCAP, zstd")

#: Clouds of four points, some 400 bytes: as many as a robot's transforms and IMU are in an hour.
_MANY = 100_000


def small_messages(place: Path, repeat: int) -> Iterable[Sequence[str]]:
    """Reading and writing in this process, without a conversion."""
    for name in _USUAL:
        source = write_recording(place, FORMS[name], _MANY * 128, 4)
        library, read = ("mcap", _read_by_mcap) if source.suffix == ".mcap" else ("rosbags", _read_by_rosbags)
        found = in_turn(
            repeat,
            lambda: seconds(lambda: deque(open_recording(source).messages(), 0)),  # noqa: B023
            lambda: seconds(lambda: read(source)),  # noqa: B023
        )
        yield compared(f"{name}, {_MANY:,} of 400 bytes: reading; {library}", "s", 1, found)
        remove(source)
    found = in_turn(
        repeat,
        lambda: seconds(lambda: remove(write_recording(place, FORMS["MCAP, zstd"], _MANY * 128, 4))),
        lambda: seconds(lambda: _write_by_mcap(place / "theirs.mcap")),
    )
    yield compared(f"MCAP, zstd, {_MANY:,} of 400 bytes: writing; mcap", "s", 1, found)


def _read_by_mcap(source: Path) -> None:
    with source.open("rb") as file:
        deque(make_reader(file, validate_crcs=True).iter_messages(), 0)


def _read_by_rosbags(source: Path) -> None:
    with AnyReader([source]) as reader:
        deque(reader.messages(), 0)


def _write_by_mcap(path: Path) -> None:
    (data,) = serialized_clouds("cdr", 4, 1)
    with path.open("wb") as file:
        writer: Any = McapLibraryWriter(file, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        writer.start()
        channel = writer.register_channel(POINTS, "cdr", writer.register_schema(POINTS, "ros2msg", b""))
        for time_ns in range(_MANY):
            writer.add_message(channel, time_ns, data, time_ns)
        writer.finish()


def converted(source: Path, place: Path, jobs: int, heights: str = "a band") -> float:
    out = place / "scans.mcap"
    words = ("--topic", POINTS, "--only-scans", "--overwrite", "-q", "--jobs", str(jobs))
    return pc2scan("convert", source, "-o", out, *HEIGHTS[heights], *words)[0]


def passed_on(source: Path, form: Form, place: Path, repeat: int) -> Sequence[float]:
    suffix = "" if form.suffix == ".bag" else ".bag"
    ours, theirs = place / f"ours{form.suffix}", place / f"theirs{suffix}"
    tool = Path(sys.executable).with_name("rosbags-convert")

    def library() -> float:
        remove(theirs)
        return run(tool, "--src", source, "--dst", theirs)[0]

    return in_turn(repeat, lambda: pc2scan("repair", source, "-o", ours, "--overwrite", "-q")[0], library)


def remove(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def conversions(place: Path, size: int, repeat: int) -> Iterable[Sequence[str]]:
    """Clouds a second of processor time, and the peak memory of commands."""
    count = size // CLOUD_BYTES
    for name, form in FORMS.items():
        source = write_recording(place, form, size)
        works = [lambda h=heights, j=jobs: converted(source, place, j, h) for heights in HEIGHTS for jobs in (1, 2)]  # noqa: B023
        speeds = [f"{count / took:,.0f}" for took in in_turn(repeat, *works)]
        kept = ("--keep-clouds", "--compression", "lz4", "--overwrite", "-q")
        peaks = (
            pc2scan("convert", source, "-o", place / "scans.mcap", *HEIGHTS["all"], "--overwrite", "-q")[1],
            pc2scan("convert", source, "-o", place / "scans.mcap", *HEIGHTS["all"], *kept)[1],
            pc2scan("info", source)[1],
            pc2scan("view", source, "-o", place / "page.html", "--overwrite")[1],
        )
        yield name, *speeds, *(f"{peak:.0f}" for peak in peaks)
        remove(source)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gb", type=float, default=1, help="size of the recordings (default: 1)")
    parser.add_argument("--repeat", type=int, default=5, help="rounds, of which the median is taken (default: 5)")
    parser.add_argument("--folder", type=Path, help="where the recordings are written meanwhile")
    asked = parser.parse_args()
    size = max(CLOUD_BYTES, int(asked.gb * 1e9))
    with TemporaryDirectory(dir=asked.folder) as folder:
        place = Path(folder)
        say(f"Clouds of 131,072 points of 32 bytes, {size / 1e9:g} GB of them, processor time.\n")
        table(("part", "pc2scan", "library", "times as fast"), parts(place, size, asked.repeat))
        columns = [f"{heights}, {jobs} job{'s' * (jobs > 1)}" for heights in HEIGHTS for jobs in (1, 2)]
        peaks = ("`convert`", "`--keep-clouds`", "`info`", "`view`")
        head = ("source", *(f"clouds/s, {column}" for column in columns), *(f"{name}, MB" for name in peaks))
        table(head, conversions(place, size, asked.repeat))


if __name__ == "__main__":
    main()
