"""Mutated recordings in every container, through ``info``, ``tf``, ``convert``, ``repair``, ``check`` and ``diff``.

By hand, for as long as it takes::

    PYTHONPATH=src:tests python tests/fuzz/recordings.py --seconds 600 --seed 1

A finding is kept in the folder that is named, with the seed that makes it again.
"""

from __future__ import annotations

import argparse
import random
import shutil
import struct
import sys
import tempfile
import time
import traceback
import warnings
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import pc2scan
from fuzz.watch import watched
from pc2scan.bags.opening import open_recording
from pc2scan.inspect.check import check
from pc2scan.inspect.info import info
from pc2scan.inspect.tf import frame_tree
from pc2scan.pipeline.options import ConvertOptions
from pc2scan.pipeline.run import OutputOptions, run
from pc2scan.tf.options import FrameOptions
from support.bounded import size_of
from support.builders import CONTENT, SOURCES, Recording

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["attempt", "make_seeds", "mutated"]

#: Values that lengths, counts, times and places go wrong at.
_NUMBERS = (
    0,
    1,
    0x7F,
    0xFF,
    0x7FA0_0000,
    0x7FFF_FFFF,
    0x8000_0000,
    0xFFFF_FFFF,
    1 << 40,
    (1 << 63) - 1,
    1 << 63,
    (1 << 64) - 1,
)

#: Shares of attempts, messages and times.
_SOUND_CONTAINER, _WITH_METADATA, _MUTATED_SHARE, _TIMELY_SHARE = 0.4, 0.15, 0.4, 0.95

_DESTINATIONS = ("out.bag", "out.mcap", "out", "out-sqlite3")


def make_seeds(folder: Path) -> dict[str, Path]:
    """One small recording with everything in it, in every container."""
    seeds = {}
    for name, build in SOURCES.items():
        (folder / name).mkdir(parents=True)
        seeds[name] = build(folder / name, CONTENT)
    return seeds


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Damage bytes as disks, networks and people do."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        if not changed:
            break
        _MUTATIONS[rng.randrange(len(_MUTATIONS))](changed, rng)
    return bytes(changed)


def _flip(data: bytearray, rng: random.Random) -> None:
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _replace(data: bytearray, rng: random.Random) -> None:
    data[rng.randrange(len(data))] = rng.choice((0, 1, 0x22, 0x2E, 0x3D, 0x7F, 0x80, 0xFF, rng.randrange(256)))


def _number(data: bytearray, rng: random.Random) -> None:
    code, size = rng.choice((("<H", 2), ("<I", 4), ("<I", 4), ("<Q", 8), (">I", 4)))
    if len(data) >= size:
        place = rng.randrange(len(data) - size + 1)
        near = struct.unpack_from(code, data, place)[0] + rng.choice((-1, 1, 8, 256))
        value = rng.choice((*_NUMBERS, near, len(data), rng.randrange(1 << 16)))
        struct.pack_into(code, data, place, value % (1 << 8 * size))


def _truncate(data: bytearray, rng: random.Random) -> None:
    del data[rng.randrange(len(data)) :]


def _cut_out(data: bytearray, rng: random.Random) -> None:
    place = rng.randrange(len(data))
    del data[place : place + rng.choice((1, 4, 50, 1000))]


def _splice(data: bytearray, rng: random.Random) -> None:
    place, origin = rng.randrange(len(data)), rng.randrange(len(data))
    piece = data[origin : origin + rng.choice((1, 4, 50, 1000))]
    data[place : place + rng.choice((0, len(piece)))] = piece


def _blank(data: bytearray, rng: random.Random) -> None:
    place = rng.randrange(len(data))
    size = min(rng.choice((8, 512, 4096)), len(data) - place)
    data[place : place + size] = bytes([rng.choice((0, 0xFF))]) * size


_MUTATIONS: tuple[Callable[[bytearray, random.Random], None], ...] = (
    _flip,
    _replace,
    _number,
    _number,
    _truncate,
    _cut_out,
    _splice,
    _blank,
)


def attempt(seed: int, seeds: dict[str, Path], folder: Path) -> Path:
    """Mutate a recording as the seed says, look into it, convert it and repair it; returns it.

    Raises
    ------
    Exception
        Whatever is not an error of pc2scan's own: a bug.
    """
    rng = random.Random(seed)
    kind = rng.choice(sorted(seeds))
    source = folder / seeds[kind].name
    if rng.random() < _SOUND_CONTAINER:
        source = SOURCES[kind](folder, _with_mutated_messages(rng))
        files = []
    elif seeds[kind].is_dir():
        shutil.copytree(seeds[kind], source)
        files = sorted(path for path in source.iterdir() if path.is_file())
    else:
        shutil.copy(seeds[kind], source)
        files = [source]
    # One mutation of metadata.yaml, and nothing behind it is reached.
    storage = [file for file in files if file.name != "metadata.yaml"]
    files = files if rng.random() < _WITH_METADATA else storage
    for file in rng.sample(files, rng.randint(min(1, len(files)), len(files))):
        file.write_bytes(mutated(file.read_bytes(), rng))
    size = size_of(source)
    with watched(size):
        info([source], samples=rng.choice((1, 10))).as_dict()
    with watched(size):
        frame_tree([source], FrameOptions()).as_dict()
    _convert(rng, source, folder, size)
    _repair(rng, source, folder, size)
    with watched(size):
        check([source], base_frame=rng.choice(("", "base_link"))).as_dict()
    with watched(size + size_of(seeds[kind])):
        pc2scan.diff(seeds[kind], source, all_topics=rng.random() < 0.5, rtol=rng.choice((0.0, 1e-5))).as_dict()
    return source


def _with_mutated_messages(rng: random.Random) -> Recording:
    """The same recording with damage in its messages, and times that cannot be."""
    items = []
    for entry in CONTENT.items:
        data = entry.data
        if rng.random() < _MUTATED_SHARE:
            data = {ros_version: mutated(content, rng) for ros_version, content in data.items()}
        log_time_ns = entry.log_time_ns if rng.random() < _TIMELY_SHARE else rng.randrange(2_000, 1 << 61)
        items.append(replace(entry, data=data, log_time_ns=log_time_ns))
    return replace(CONTENT, items=tuple(items))


def _convert(rng: random.Random, source: Path, folder: Path, size: int) -> None:
    name, options = _form(rng)
    reduce = rng.choice(("min", "min", "max", "mean", "median"))
    params = pc2scan.ProjectionParams(
        target_frame=rng.choice(("", "", "base_link", "odom")),
        min_height=-9.0,
        reduce=cast("Any", reduce),
        intensity_field=rng.choice(("", "", "x", "intensity")),
        scan_time=rng.choice(("auto", 0.1)),
    )
    if rng.random() < 0.3:
        options["keep_clouds"] = True
    if rng.random() < 0.2:
        options["start"] = "0.05"
    jobs, verify = rng.choice((1, 2)), rng.random() < 0.5
    destination = folder / "output" / name
    destination.parent.mkdir()
    with watched(size):
        pc2scan.convert(source, destination, params=params, jobs=jobs, verify=verify, **options)
    if _whole(destination):
        with watched(size_of(destination)):
            check([destination]).as_dict()


def _repair(rng: random.Random, source: Path, folder: Path, size: int) -> None:
    name, form = _form(rng)
    destination = folder / "repaired" / name
    destination.parent.mkdir()
    with watched(size):
        run([source], destination, ConvertOptions(repair=True, verify=rng.random() < 0.5), OutputOptions(**form))
    _whole(destination)


def _form(rng: random.Random) -> tuple[str, dict[str, Any]]:
    name = rng.choice(_DESTINATIONS)
    return name, {"storage": "sqlite3"} if name == "out-sqlite3" else {}


def _whole(destination: Path) -> bool:
    """See that what was written is whole, every message of it, and alone; tell whether it was written."""
    left = [path.name for path in destination.parent.iterdir()]
    assert left in ([], [destination.name]), left
    if left:
        with closing(open_recording(destination, strict=True)) as reader:
            for message in reader.messages():
                bytes(message.data)
    return bool(left)


def main() -> None:
    """Run until the time is over."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    warnings.simplefilter("error")
    folder = Path(tempfile.mkdtemp(prefix="pc2scan-fuzz-"))
    seeds = make_seeds(folder / "seeds")
    began, seed, findings = time.monotonic(), arguments.seed, 0
    while time.monotonic() - began < arguments.seconds:
        place = folder / f"seed-{seed}"
        place.mkdir()
        try:
            attempt(seed, seeds, place)
            shutil.rmtree(place)
        except BaseException as err:
            if isinstance(err, KeyboardInterrupt):
                raise
            findings += 1
            sys.stdout.write(f"seed {seed}: {place}\n{traceback.format_exc()}")
            sys.stdout.flush()
        seed += 1
    seconds, count = time.monotonic() - began, seed - arguments.seed
    sys.stdout.write(f"{count} recordings in {seconds:.0f} s from seed {arguments.seed} on, {findings} findings\n")


if __name__ == "__main__":
    main()
