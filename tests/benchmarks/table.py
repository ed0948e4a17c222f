"""Print how fast pc2scan is, as Markdown, every figure beside a baseline that ran between the same two.

Run it with ``python tests/benchmarks/table.py`` in an environment that has pc2scan and its tests' packages.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import statistics
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import lz4.frame
import numpy as np
import zstandard

import pc2scan
from benchmarks.clouds import (
    CLOUD_BYTES,
    FORMS,
    POINT_BYTES,
    POINTS,
    TRIFLE,
    Form,
    cloud,
    serialized_clouds,
    write_recording,
    write_two,
)
from benchmarks.work import LAYOUTS, convert_two, deskewing_tasks, params_of, straightforward
from pc2scan.bags.mcap.read import McapReader
from pc2scan.bags.rosbag1.read import Rosbag1Reader
from pc2scan.core.kernel import COMPILED
from pc2scan.core.project import Projector
from pc2scan.datasets.processes import run_jobs
from pc2scan.datasets.run import BatchOptions, run_batch
from pc2scan.files.compression import decompress_within
from pc2scan.messages.livox import decode_livox
from pc2scan.messages.pointcloud2 import as_pointcloud2, decode_pointcloud2
from support.builders import CLOUD, T0, Item, Mcap, Recording, Stream, write_mcap
from support.clouds import (
    COMPRESSED,
    COMPRESSORS,
    LIVOX,
    OLD_CLOUD,
    compressed,
    livox,
    livox_points,
    old_cloud,
    structured,
)
from support.worlds.drives import drive_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Sequence

    from pc2scan.datasets.jobs import Event, Job

HEIGHTS = ("--min-height", "-0.5", "--max-height", "1")
PARAMS = pc2scan.ProjectionParams(min_height=-0.5, max_height=1.0)
MEGABYTE = 1_000_000
#: Of each of two lidars: enough that the start of a conversion takes at most a twentieth of the time.
CLOUDS = 160


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gb", type=float, default=2, help="size of the recordings (default: 2), to pass: a quarter")
    parser.add_argument("--repeat", type=int, default=5, help="rounds, of which the median is taken (default: 5)")
    parser.add_argument("--memory", type=float, nargs="*", metavar="GB", help="peak memory too; default: 0.5 2 8")
    parser.add_argument("--folder", type=Path, help="where the recordings are written meanwhile")
    parser.add_argument("--small-mcap", metavar="PYTHON", help="beside a Python with small-mcap and its ROS 2 decoder")
    parser.add_argument("--only", choices=(*TABLES, "memory", "small-mcap"), help="one table")
    asked = parser.parse_args()
    # Installed packages have bytecode. Here the first round, which does not count, writes it; without it, every process
    # would first compile pc2scan's sources, which takes 0.15 s.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    with TemporaryDirectory(dir=asked.folder) as folder:
        say(f"{len(os.sched_getaffinity(0))} cores, Python {sys.version.split()[0]}.\n")
        for name, print_table in TABLES.items():
            if asked.only in (None, name):
                print_table(Path(folder), int(asked.gb * 1e9), asked.repeat)
        if asked.small_mcap is not None and asked.only in (None, "small-mcap"):
            small_mcap(Path(folder), int(asked.gb * 1e9), asked.repeat, asked.small_mcap)
        if asked.only == "memory" or asked.memory is not None:
            memory(Path(folder), asked.memory or [0.5, 2, 8])


def say(line: str) -> None:
    print(line, flush=True)  # noqa: T201  # what it prints is what it is for


def table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table row by row, as the figures come."""
    say(f"**{title}\n")
    say("| " + " | ".join(head) + " |")
    say("|---" + "|---:" * (len(head) - 1) + "|")
    for row in rows:
        say("| " + " | ".join(row) + " |")
    say("")


def seconds(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """How long work takes, and its processor time on all threads."""
    before = time.process_time()
    return seconds(work), time.process_time() - before


def rounds(repeat: int, *works: Callable[[], float]) -> list[list[float]]:
    """Take turns, so that what else the machine does meets all alike; the first round warms up."""
    return [[work() for work in works] for _ in range(repeat + 1)][1:]


def median(values: Iterable[float]) -> float:
    return statistics.median(values)


# --- Projection ---


def projection(_place: Path, _size: int, repeat: int) -> None:
    def compared(points: int, layout: str, beams: int, heights: str) -> Sequence[str]:
        x, y, z = cloud(points, layout)
        params = params_of(beams, heights)
        project = Projector(params)
        np.testing.assert_array_equal(project(x, y, z).ranges, straightforward(x, y, z, params))
        found = rounds(
            4 * repeat,
            lambda: seconds(lambda: project(x, y, z)),
            lambda: seconds(lambda: straightforward(x, y, z, params)),
        )
        ours, plain = (median(column) / x.size * 1e9 for column in zip(*found, strict=True))
        return f"{ours:.1f}", f"{plain:.1f}", f"{plain / ours:.1f}"

    columns = ("pc2scan", "straightforward NumPy", "times as fast")
    loops = "compiled" if COMPILED else "not compiled"
    table(
        f"Projection** of 131,072 points, every height accepted, one thread, ns a point ({loops})",
        ("layout", "beams", *columns),
        (
            (layout, f"{beams:,}", *compared(131_072, layout, beams, "all"))
            for layout in LAYOUTS
            for beams in (90, 360, 3_600, 36_000)
        ),
    )
    table(
        "Projection** to 360 beams by the number of points, and with a height band, ns a point",
        ("points", "heights", *columns),
        (
            (f"{points:,}", "all" if heights == "all" else "a band", *compared(points, "ring-major", 360, heights))
            for points in (1_000, 16_384, 131_072, 2_000_000)
            for heights in ("all", "band")
        ),
    )


# --- Deskewing ---


def deskewing(_place: Path, _size: int, repeat: int) -> None:
    def rows() -> Iterable[Sequence[str]]:
        for layout in ("organised", "ring-major", "column-major"):
            for heights in ("all", "band"):
                plain, deskewed = deskewing_tasks(layout, heights)
                found = rounds(20 * repeat, partial(seconds, plain), partial(seconds, deskewed))
                once, moved = (median(column) * 1e3 for column in zip(*found, strict=True))
                ratio = median(row[1] / row[0] for row in found)
                yield layout, "all" if heights == "all" else "a band", f"{once:.2f}", f"{moved:.2f}", f"{ratio:.2f}"

    table(
        "Deskewing** 131,072 points with times to 360 beams, one thread, ms a cloud: a transform for all points, and "
        "one for each, with its lookups",
        ("layout", "heights", "one transform", "deskewed", "a multiple"),
        rows(),
    )


# --- Conversions ---

_MEASURED = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def peak_of(*args: str | Path) -> int:
    """Run ``pc2scan`` in a process of its own; returns its peak memory, bytes."""
    line = [sys.executable, "-m", "pc2scan", *map(str, args)]
    # A process begins with the peak of the one that starts it: a small one stands between.
    done = subprocess.run([sys.executable, "-S", "-c", _MEASURED, *line], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(line)} failed:\n{done.stderr}")
    return int(done.stdout) * 1024


def command(*args: str | Path) -> dict[str, Any]:
    """Run ``pc2scan convert`` in a process of its own; returns its report."""
    report = Path(args[args.index("-o") + 1]).with_suffix(".json")
    peak_of("convert", *args, *HEIGHTS, "--overwrite", "--quiet", "--report", report)
    found: dict[str, Any] = json.loads(report.read_text())
    return found


def converted(source: Path, destination: Path, jobs: int, *more: str) -> float:
    return float(
        command(source, "-o", destination, "--topic", POINTS, "--only-scans", "--jobs", str(jobs), *more)["seconds"]
    )


def read_plainly(source: Path) -> None:
    """Read a recording into one buffer, over and over."""
    buffer = bytearray(4 << 20)
    for path in [source] if source.is_file() else source.glob("*.db3"):
        with path.open("rb", buffering=0) as file:
            while file.readinto(buffer):
                pass


def stored_chunks(source: Path, form: Form) -> list[bytes]:
    if form.compression == "none":
        return []
    reader: Any = Rosbag1Reader(source) if form.suffix == ".bag" else McapReader(source)
    with source.open("rb") as file:
        chunks = []
        for segment in reader._index.segments:
            file.seek(segment.offset)
            chunks.append(file.read(segment.length))
    reader.close()
    return chunks


def decompress(chunks: list[bytes], compression: str, threads: int) -> None:
    def work(chunk: bytes) -> int:
        if compression == "lz4":
            return len(lz4.frame.decompress(chunk))
        return len(zstandard.ZstdDecompressor().decompress(chunk))

    if threads == 1:
        sum(map(work, chunks))
        return
    with ThreadPoolExecutor(threads) as pool:
        sum(pool.map(work, chunks))


def conversions(place: Path, size: int, repeat: int) -> None:
    count = max(1, size // CLOUD_BYTES)
    clouds = [decode_pointcloud2(data, "cdr").xyz() for data in serialized_clouds("cdr")]
    project = Projector(PARAMS)

    def projected() -> None:
        for number in range(count):
            project(*clouds[number % len(clouds)])

    def rows() -> Iterable[Sequence[str]]:
        for name, form in FORMS.items():
            source = write_recording(place, form, size)
            chunks: list[bytes] = stored_chunks(source, form)
            found = rounds(
                repeat,
                lambda: seconds(lambda: read_plainly(source)),  # noqa: B023
                lambda: seconds(lambda: decompress(chunks, form.compression, 1)),  # noqa: B023
                lambda: seconds(lambda: decompress(chunks, form.compression, 2)),  # noqa: B023
                lambda: seconds(projected),
                lambda: converted(source, place / "scans.mcap", 1),  # noqa: B023
                lambda: converted(source, place / "scans.mcap", 2),  # noqa: B023
            )
            columns = list(zip(*found, strict=True))
            yield (
                name,
                *(speed(count, median(column)) for column in columns[4:]),
                f"{median(row[5] / (row[0] + row[3]) for row in found):.2f}",
                *((f"{median(2 * row[5] / row[1] for row in found):.2f}",
                   f"{median(row[5] / row[2] for row in found):.2f}") if chunks else ("", "")),
            )  # fmt: skip
            chunks.clear()
            remove(source)

    table(
        f"Converting** {count} clouds of 131,072 points of 32 bytes from a warm cache: uncompressed bytes and clouds "
        "a second, and the time at 2 jobs as a multiple",
        (
            "source",
            "1 job",
            "2 jobs",
            "of plain reading + projecting (1 thread)",
            "of decompressing alone / 2",
            "of decompressing alone on 2 threads",
        ),
        rows(),
    )


def smaller_clouds(place: Path, size: int, repeat: int) -> None:
    size //= 4
    form = FORMS["MCAP, none"]

    def rows() -> Iterable[Sequence[str]]:
        for points in (1_000, 4_096, 16_384, 65_536):
            source = write_recording(place, form, size, points)
            count = size // (points * POINT_BYTES)
            clouds = [decode_pointcloud2(data, "cdr").xyz() for data in serialized_clouds("cdr", points)]
            project = Projector(PARAMS)

            def projected() -> None:
                for number in range(count):  # noqa: B023
                    project(*clouds[number % len(clouds)])  # noqa: B023

            found = rounds(
                repeat,
                lambda: seconds(lambda: read_plainly(source)),  # noqa: B023
                lambda: seconds(projected),
                lambda: converted(source, place / "scans.mcap", 1),  # noqa: B023
                lambda: converted(source, place / "scans.mcap", 2),  # noqa: B023
            )
            yield (
                f"{points:,}",
                *(f"{count / median(row[i] for row in found):,.0f}" for i in (2, 3)),
                *(f"{median(row[i] / (row[0] + row[1]) for row in found):.1f}" for i in (2, 3)),
            )
            source.unlink()

    table(
        f"Converting** smaller clouds, {size / 1e9:g} GB of them (MCAP, none): clouds a second, and the time as a "
        "multiple of plain reading + projecting",
        ("points", "1 job", "2 jobs", "1 job, a multiple", "2 jobs, a multiple"),
        rows(),
    )


# --- Python ---


def in_python(place: Path, size: int, repeat: int) -> None:
    """`pc2scan.scans` beside `pc2scan.convert`, both called in this process."""
    size //= 4
    count = max(1, size // CLOUD_BYTES)
    heights = {"min_height": -0.5, "max_height": 1.0}

    def convert(source: Path, jobs: int) -> None:
        to = place / "scans.mcap"
        pc2scan.convert(source, to, topics=POINTS, only_scans=True, overwrite=True, jobs=jobs, **heights)  # type: ignore[arg-type]

    def iterate(source: Path) -> None:
        returns = [np.isfinite(scan.ranges).any() for scan in pc2scan.scans(source, POINTS, **heights)]  # type: ignore[arg-type]
        assert returns == [True] * count

    def rows() -> Iterable[Sequence[str]]:
        for name in ("ROS 1, lz4", "MCAP, none", "MCAP, zstd"):
            source = write_recording(place, FORMS[name], size)
            works = partial(convert, source, 1), partial(convert, source, 2), partial(iterate, source)
            found = [[timed(work) for work in works] for _ in range(repeat + 1)][1:]
            speeds = (f"{count / median(took for took, _ in column):,.0f}" for column in zip(*found, strict=True))
            ratios = (f"{median(row[2][0] / row[i][0] for row in found):.2f}" for i in (0, 1))
            yield name, *speeds, *ratios, f"{median(row[2][1] / row[0][1] for row in found):.2f}"
            source.unlink()

    table(
        f"Python's `scans()`** of {count} clouds of 131,072 points, beside `convert()` of the same recording: clouds a "
        "second, and the time of `scans()` as a multiple of `convert()`'s",
        (
            "source",
            "`convert()`, 1 job",
            "`convert()`, 2 jobs",
            "`scans()`",
            "of 1 job's",
            "of 2 jobs'",
            "processor time, of 1 job's",
        ),
        rows(),
    )


#: Programs that read a recording over and over, for some seconds. They print the user time of one loop.
_READ = """
import resource, sys, time

path = sys.argv[1]
{read}
read()
before, began, rounds = resource.getrusage(resource.RUSAGE_SELF).ru_utime, time.perf_counter(), 0
while time.perf_counter() - began < 2:
    read()
    rounds += 1
print((resource.getrusage(resource.RUSAGE_SELF).ru_utime - before) / rounds)
"""
_CLOUDS = """
import pc2scan

def read():
    for cloud in pc2scan.clouds(path, topics="/points"):
        pass
"""
_SMALL_MCAP = """
from small_mcap import read_message

def read():
    with open(path, "rb") as file:
        for schema, channel, message in read_message(file, validate_crc=True):
            pass
"""
_SMALL_MCAP_DECODED = """
from mcap_ros2_support_fast.decoder import DecoderFactory
from small_mcap import read_message_decoded

def read():
    with open(path, "rb") as file:
        for message in read_message_decoded(file, decoder_factories=[DecoderFactory()], validate_crc=True):
            message.decoded_message
"""


def small_mcap(place: Path, size: int, repeat: int, python: str) -> None:
    """`pc2scan.clouds` beside the package small-mcap, which another Python has."""
    size //= 8

    def user_time(interpreter: str, read: str, source: Path) -> float:
        line = [interpreter, "-c", _READ.format(read=read), str(source)]
        return float(subprocess.run(line, check=True, capture_output=True, text=True).stdout)

    def rows() -> Iterable[Sequence[str]]:
        for points in (1_000, 16_384, 131_072):
            source = write_recording(place, FORMS["MCAP, none"], size, points)
            count = max(1, size // (points * POINT_BYTES))
            found = rounds(
                repeat,
                lambda: user_time(python, _SMALL_MCAP, source),  # noqa: B023
                lambda: user_time(python, _SMALL_MCAP_DECODED, source),  # noqa: B023
                lambda: user_time(sys.executable, _CLOUDS, source),  # noqa: B023
            )
            times = (f"{median(column) / count * 1e6:,.1f}" for column in zip(*found, strict=True))
            yield f"{points:,}", *times, f"{median(row[2] / row[1] for row in found):.2f}"
            source.unlink()

    table(
        f"Python's `clouds()`** of {size / 1e9:g} GB of uncompressed MCAP, beside small-mcap, which decodes with "
        "mcap-ros2-support-fast: user time in µs a cloud, and as a multiple of small-mcap's with decoding; "
        "both compare CRCs",
        ("points", "small-mcap, messages alone", "small-mcap, decoded", "`clouds()`", "a multiple"),
        rows(),
    )


# --- Several outputs ---

FOUR = """\
scans:
  /scan: {}
  /near: {range_max: 20.0, angle_increment: 0.5deg}
  /slam: {geometry: centered, beams: 720, angle_min: 0, angle_max: 2*pi}
  /fine: {geometry: centered, beams: 1800, angle_min: 0, angle_max: 2*pi}
"""


def outputs(place: Path, size: int, repeat: int) -> None:
    size //= 4
    count = max(1, size // CLOUD_BYTES)
    four = place / "four.yaml"
    four.write_text(FOUR)

    def several(source: Path, jobs: int) -> float:
        words = (source, "-o", place / "scans.mcap", "--only-scans", "--drop", TRIFLE, "--jobs", str(jobs))
        return float(command(*words, "--scans", four)["seconds"])

    def rows() -> Iterable[Sequence[str]]:
        for name in ("MCAP, none", "MCAP, zstd"):
            source = write_recording(place, FORMS[name], size)
            for jobs in (1, 2):
                found = rounds(
                    repeat,
                    lambda: converted(source, place / "scans.mcap", jobs),  # noqa: B023
                    lambda: several(source, jobs),  # noqa: B023
                    lambda: converted(source, place / "scans.mcap", jobs, "--keep-used", "/used"),  # noqa: B023
                )
                times = (f"{count / median(row[i] for row in found):,.0f}" for i in range(3))
                ratios = (f"{median(row[i] / row[0] for row in found):.2f}" for i in (1, 2))
                yield name, str(jobs), *times, *ratios
            source.unlink()

    table(
        f"Several outputs** of {count} clouds of 131,072 points: clouds a second, and the time as a multiple of one "
        "output's",
        ("source", "jobs", "one", "four (`--scans`)", "one, `--keep-used`", "four, a multiple", "kept, a multiple"),
        rows(),
    )


# --- Several sources ---


def combining(place: Path, _size: int, repeat: int) -> None:
    source = write_two(place / "two.mcap", CLOUDS)

    def rows() -> Iterable[Sequence[str]]:
        for heights in ("all", "a band"):
            for jobs in (1, 2):
                works = [
                    partial(seconds, partial(convert_two, source, place / "scans.mcap", how, heights, jobs))
                    for how in ("a scan of each", "one scan", "one scan, fixed frame")
                ]
                found = rounds(repeat, *works)
                times = (f"{median(column):.3f}" for column in zip(*found, strict=True))
                ratios = (f"{median(row[i] / row[0] for row in found):.2f}" for i in (1, 2))
                yield heights, str(jobs), *times, *ratios

    table(
        f"Several sources:** {CLOUDS} clouds of 131,072 points of each of two lidars in one scan, uncompressed MCAP, "
        "seconds, and as a multiple of a scan of each",
        ("heights", "jobs", "a scan of each", "one scan", "one, fixed frame", "one, a multiple", "fixed, a multiple"),
        rows(),
    )


# --- Kinds of clouds ---

#: Points of a message of a Livox Mid-360 at 10 Hz, and of each how many messages are converted.
LIVOX_POINTS, LIVOX_CLOUDS = 20_000, 1_000


def kinds(place: Path, _size: int, repeat: int) -> None:
    made = list(map(livox_yard, range(4)))
    sound = [livox_yard(number, lost=0.0) for number in range(4)]
    driver = [as_pointcloud2(decode_livox(livox(points, 2), "cdr")) for points in made]
    tables = [cloud.structured_points() for cloud in driver]
    messages = {
        "PointCloud2 of Livox's driver, 26 bytes": (CLOUD, [structured(each, 2, dense=True) for each in tables]),
        "Livox CustomMsg, 5 % at the origin": (LIVOX[1], [livox(each, 2) for each in made]),
        "Livox CustomMsg, all points sound": (LIVOX[1], [livox(each, 2) for each in sound]),
        "CompressedPointCloud2, zstd": (COMPRESSED, [compressed(each, 2, "zstd") for each in tables]),
        "CompressedPointCloud2, zlib": (COMPRESSED, [compressed(each, 2, "zlib") for each in tables]),
        "PointCloud": (OLD_CLOUD, [old_cloud(each, 2) for each in tables]),
    }
    sources = {}
    for number, (name, (kind, each)) in enumerate(messages.items()):
        stream = Stream("/points", kind)
        items = [Item(stream, T0 + step * 100_000_000, {2: each[step % len(each)]}) for step in range(LIVOX_CLOUDS)]
        sources[name] = write_mcap(
            place / f"kind{number}.mcap",
            Recording((stream,), tuple(items)),
            Mcap(compression="none", chunk_size=1 << 20),
        )

    def used(work: Callable[[], object]) -> float:
        return timed(work)[1] / LIVOX_CLOUDS * 1000

    options: dict[str, Any] = {"params": PARAMS, "jobs": 1, "only_scans": True, "overwrite": True}

    def conversion(name: str) -> float:
        return used(lambda: pc2scan.convert(sources[name], place / "out.mcap", **options))

    def decompression(name: str) -> float:
        word = name.rpartition(" ")[2]
        if word not in ("zstd", "zlib"):
            return 0.0
        packed = COMPRESSORS[word][1](tables[0].tobytes())
        return used(lambda: [decompress_within(word, packed, 1 << 20) for _ in range(LIVOX_CLOUDS)])

    def rows() -> Iterable[Sequence[str]]:
        found = rounds(repeat, *(partial(work, name) for name in sources for work in (conversion, decompression)))
        for place_of, name in enumerate(sources):
            whole, alone = (median(row[2 * place_of + part] for row in found) for part in (0, 1))
            multiple = median((row[2 * place_of] - row[2 * place_of + 1]) / row[0] for row in found)
            yield name, f"{whole:.3f}", f"{alone:.3f}" if alone else "", f"{multiple:.2f}"

    table(
        f"Kinds of clouds:** {LIVOX_CLOUDS:,} clouds of {LIVOX_POINTS:,} points, uncompressed MCAP, one thread, "
        "processor time of a conversion in ms a cloud, and as a multiple of PointCloud2's without the decompression",
        ("message", "conversion", "decompression alone", "a multiple"),
        rows(),
    )


def livox_yard(number: int, lost: float = 0.05) -> Any:
    """A Livox's points in a yard, some at the origin: without a return."""
    rng = np.random.default_rng(number)
    points = livox_points(number, LIVOX_POINTS)
    for axis, far in zip("xyz", (20, 12, 3), strict=True):
        points[axis] = rng.uniform(-far, far, LIVOX_POINTS)
        points[axis][:: round(1 / lost) if lost else LIVOX_POINTS + 1] *= 0
    points["tag"] = rng.choice((0, 0x10), LIVOX_POINTS)
    return points


# --- Datasets ---


def batched(sources: Path, out: Path, workers: int, cores: int) -> tuple[float, float]:
    """How long a batch takes, with the start of its processes, and its processor time."""
    shutil.rmtree(out, ignore_errors=True)

    def executor(jobs: Sequence[Job], *, lock: int | None, **_: object) -> Generator[Event]:
        return run_jobs(jobs, workers=workers, cores=cores, lock=lock)

    words = {"params": PARAMS, "topics": (POINTS,), "only_scans": True}
    before = os.times()
    took = seconds(lambda: run_batch([str(sources)], out, words, BatchOptions(), executor=executor))
    # User and system time of this process, and of those that have ended.
    used = sum(os.times()[:4]) - sum(before[:4])
    assert len(list(out.iterdir())) == len(list(sources.iterdir())) + 1
    return took, used


def datasets(place: Path, size: int, repeat: int) -> None:
    sources = place / "sources"

    def rows() -> Iterable[Sequence[str]]:
        for name, count in (("MCAP, zstd", 16), ("MCAP, none", 16), ("ROS 1, lz4", 16), ("MCAP, zstd", 4)):
            sources.mkdir()
            first = write_recording(sources, FORMS[name], size // count)
            for number in range(1, count):
                shutil.copyfile(first, first.with_name(f"{number}{first.suffix}"))
            runs = ((1, 1), (1, 2), (2, 2))
            found = [
                [batched(sources, place / "out", workers, cores) for workers, cores in runs] for _ in range(repeat + 1)
            ][1:]
            clouds = count * max(1, size // count // CLOUD_BYTES)
            yield (
                f"{count} x {name}",
                *(speed(clouds, median(took for took, _ in column)) for column in zip(*found, strict=True)),
                f"{median(row[0][0] / row[2][0] for row in found):.2f}",
                f"{median(row[0][0] for row in found):.1f} s",
                f"{median(row[2][1] / row[0][1] for row in found):.2f}",
                f"{median(row[2][1] / row[2][0] for row in found):.2f}",
            )
            shutil.rmtree(sources)

    table(
        f"Batch:** one and two workers, {size / 1e9:g} GB of clouds of 131,072 points of 32 bytes in several "
        "recordings, from the start of the processes to the last line of the manifest",
        (
            *("recordings", "1 worker, 1 thread", "1 worker, 2 threads", "2 workers", "2 workers, times as fast as 1"),
            *("1 worker takes", "processor time of 2 workers, times that of 1", "cores that 2 workers use"),
        ),
        rows(),
    )


def speed(count: int, duration: float) -> str:
    """A number of clouds, and the seconds that they took."""
    return f"{count * CLOUD_BYTES / MEGABYTE / duration:,.0f} MB/s, {count / duration:,.0f}/s"


# --- Passing through ---


def passing(place: Path, size: int, repeat: int) -> None:
    size //= 4

    def rows() -> Iterable[Sequence[str]]:
        for name, form in FORMS.items():
            source = write_recording(place, form, size)
            yield passed(name, source, form, place, repeat, max(1, size // CLOUD_BYTES))
            remove(source)

    table(
        "Passing through** clouds of 131,072 points of 32 bytes, written uncompressed or, by pc2scan, compressed as "
        "they were: whole processes, until everything is on the disk",
        (
            "source",
            "pc2scan",
            "`rosbags-convert`",
            "times as fast",
            "pc2scan, compression kept",
        ),
        rows(),
    )


def to_disk(path: Path) -> None:
    """Wait until a recording is on the disk, as pc2scan does before it ends."""
    for file in [path] if path.is_file() else path.iterdir():
        with file.open("rb") as written:
            os.fsync(written.fileno())


def remove(path: Path) -> None:
    """Remove a recording, if it is there."""
    shutil.rmtree(path, ignore_errors=True)
    path.unlink(missing_ok=True)


def passed(name: str, source: Path, form: Form, place: Path, repeat: int, count: int) -> tuple[str, ...]:
    """A row of the table of pass-through."""
    ours, theirs = place / f"ours{form.suffix}", place / f"theirs{'.bag' if form.suffix == '.bag' else ''}"
    storage = form.storage or "mcap"
    more = ["--storage", storage] if not form.suffix else []

    def pc2scan_passes(compression: str, *options: str) -> float:
        # Removing what the last round wrote is in neither time.
        remove(ours)
        return seconds(
            lambda: command(source, "-o", ours, "--topic", TRIFLE, "--compression", compression, *more, *options)
        )

    def rosbags_passes() -> float:
        remove(theirs)
        theirs_converts = [sys.executable, "-m", "rosbags.convert"]
        line = [*theirs_converts, "--src", str(source), "--dst", str(theirs), "--dst-storage", storage]

        def work() -> None:
            subprocess.run(line, check=True, stdout=subprocess.DEVNULL)
            to_disk(theirs)

        return seconds(work)

    found = rounds(
        min(repeat, 3),
        lambda: pc2scan_passes("none"),
        rosbags_passes,
        lambda: pc2scan_passes(form.compression),
    )
    remove(ours)
    remove(theirs)
    mine, other, *kept = (median(column) for column in zip(*found, strict=True))
    # Of the medians, as the columns beside it: the median of each round's ratio may say the opposite.
    return name, speed(count, mine), speed(count, other), f"{other / mine:.1f}", *(speed(count, each) for each in kept)


# --- Maps ---


def maps(place: Path, _size: int, repeat: int) -> None:
    """How many times faster than the robot maps are drawn, of recordings that are read, too."""

    def rows() -> Iterable[Sequence[str]]:
        for metres in (4, 8, 16, 24):
            source = write_mcap(
                place / f"{metres}.mcap", drive_recording(rate=40.0, beams=1080, measure=around(metres))
            )
            for what, increment in (("", None), (", each beam at its own time", 0.02 / 1080)):
                told = source
                if increment:
                    recording = drive_recording(rate=40.0, beams=1080, measure=around(metres), said=increment)
                    told = write_mcap(place / "timed.mcap", recording)
                times = [seconds(lambda path=told: pc2scan.map(path)) for _ in range(repeat + 1)][1:]  # type: ignore[misc]
                yield f"{metres} m{what}", f"{8 / median(times):.0f}"
            source.unlink()

    title = "Maps** of 40 scans a second of 1,080 beams, cells of 5 cm, reading included, one thread"
    table(title, ("mean range", "times real time"), rows())


def around(metres: float) -> Callable[[float, float, float], float]:
    """Ranges of all lengths from three quarters to five quarters of a mean."""
    return lambda _x, _y, angle: metres * (1 + 0.25 * math.sin(7 * angle))


# --- Start-up and memory ---


def start_up(place: Path, _size: int, repeat: int) -> None:
    hall = Path(__file__).resolve().parents[2] / "fixtures" / "hall.bag"

    def process(*args: str | Path) -> Callable[[], float]:
        line = [sys.executable, *map(str, args)]
        return lambda: seconds(lambda: subprocess.run(line, check=True, stdout=subprocess.DEVNULL))

    found = rounds(
        2 * repeat,
        process("-c", "import numpy, typer"),
        process("-m", "pc2scan", "--help"),
        process("-m", "pc2scan", "convert", hall, "-o", place / "hall.mcap", *HEIGHTS, "--overwrite", "--quiet"),
    )
    times = [median(column) for column in zip(*found, strict=True)]
    names = ("`import numpy, typer`", "`pc2scan --help`", "`pc2scan convert fixtures/hall.bag`")
    table(
        "Start-up** of a process",
        ("", "ms", "of the first"),
        ((name, f"{each * 1e3:.0f}", f"{each / times[0]:.2f}") for name, each in zip(names, times, strict=True)),
    )


def memory(place: Path, sizes: Sequence[float]) -> None:
    forms = ("ROS 1, lz4", "MCAP, none", "MCAP, zstd", "sqlite3")
    scans = ("-o", str(place / "scans.mcap"), "--overwrite", "--quiet", "--jobs", "2")
    commands = {
        "`convert`": ("convert", *scans, "--topic", POINTS, *HEIGHTS),
        "`convert --keep-clouds --compression lz4`": ("convert", *scans, "--keep-clouds", "--compression", "lz4"),
        "`info`": ("info",),
        "`view`": ("view", "-o", str(place / "page.html"), "--overwrite"),
    }

    def rows() -> Iterable[Sequence[str]]:
        for gigabytes in sizes:
            peaks: dict[str, list[str]] = {name: [] for name in commands}
            for form in forms:
                source = write_recording(place, FORMS[form], int(gigabytes * 1e9))
                for name, (verb, *options) in commands.items():
                    peaks[name].append(f"{peak_of(verb, source, *options) / MEGABYTE:.0f}")
                remove(source)
            yield from ((name, f"{gigabytes:g}", *found) for name, found in peaks.items())

    title = "Peak memory** of commands with clouds of 131,072 points of 32 bytes, conversions on 2 jobs, MB"
    table(title, ("command", "GB of clouds", *forms), rows())


#: What is printed, unless one of them is asked for.
TABLES: dict[str, Callable[[Path, int, int], None]] = {
    "projection": projection,
    "deskewing": deskewing,
    "conversions": conversions,
    "smaller clouds": smaller_clouds,
    "python": in_python,
    "outputs": outputs,
    "combining": combining,
    "kinds": kinds,
    "batch": datasets,
    "passing": passing,
    "maps": maps,
    "start-up": start_up,
}


if __name__ == "__main__":
    main()
