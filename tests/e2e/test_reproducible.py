"""The same input, parameters and version make the same bytes: whenever, wherever, on any number of jobs."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

from e2e.test_containers import ATTACHMENTS, KINDS, METADATA
from support.builders import CONTENT, POINTS, SECOND, SOURCES, T0, Mcap, Recording, cloud, item, points_of, write_mcap
from support.command import environment

if TYPE_CHECKING:
    from pathlib import Path

#: Converts several times in one process, under another clock, host and user than the real ones.
SCRIPT = """
import getpass, json, os, platform, socket, sys, time, uuid
epoch, host, jobs = float(sys.argv[1]), sys.argv[2], sys.argv[3]
real = time.time
shift = epoch - real()
time.time = lambda: real() + shift
time.time_ns = lambda: int(time.time() * 1e9)
socket.gethostname = platform.node = lambda: host
getpass.getuser = lambda: host
uuid.getnode = lambda: len(host)
from pc2scan.cli.in_process import run_command
for arguments in json.load(sys.stdin):
    status, messages = run_command([*arguments, "--jobs", jobs])
    assert status == 0, messages
"""

RUNS = (
    {"epoch": "1e9", "host": "robot", "jobs": "1", "TZ": "UTC", "PYTHONHASHSEED": "1", "LC_ALL": "C", "USER": "alice"},
    {"epoch": "2e9", "host": "ci-7", "jobs": "2", "TZ": "Asia/Tokyo", "PYTHONHASHSEED": "77", "USER": "bob"},
)


def digests(path: Path) -> dict[str, str]:
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def large() -> Recording:
    """Beside the usual content enough large clouds for several chunks, and for every job."""
    clouds = [
        item(
            POINTS,
            T0 + SECOND + step,
            lambda ros_version, seq: cloud(points_of(seq, 15_000), ros_version, seq=seq, stamp_ns=T0 + SECOND),
            step,
        )
        for step in range(8)
    ]
    return Recording(CONTENT.streams, (*CONTENT.items, *clouds))


def converted(commands: list[list[str]], run: dict[str, str]) -> None:
    own = {key: value for key, value in run.items() if key.isupper()}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, run["epoch"], run["host"], run["jobs"]],
        input=json.dumps(commands),
        capture_output=True,
        text=True,
        env={**environment(), **own},
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[dict[str, str]]]:
    """Digests of every kind of destination, of the two ROS versions of sources, from each of the runs."""
    folder = tmp_path_factory.mktemp("sources")
    form = Mcap(attachments=ATTACHMENTS, metadata=METADATA)
    sources = {1: SOURCES["bag-lz4"](folder, large()), 2: write_mcap(folder / "source.mcap", large(), form)}
    found: dict[str, list[dict[str, str]]] = {}
    for number, run in enumerate(RUNS):
        # Another place, of another length, too.
        place = tmp_path_factory.mktemp("x" * (number + 1))
        commands, destinations = [], {}
        for ros_version, source in sources.items():
            for kind, chosen in KINDS.items():
                destination = place / f"{ros_version}-{kind}" / chosen.name
                destination.parent.mkdir()
                destinations[f"{ros_version}-{kind}"] = destination
                heights = ["--min-height", "-2", "--max-height", "2"]
                added = ["--static-tf", "lidar cup 0 0 1 0 0 0", "--write-static-tf", "--keep-clouds"]
                commands.append(["convert", str(source), "-o", str(destination), *heights, *added, *chosen.arguments()])
        converted(commands, run)
        for name, destination in destinations.items():
            found.setdefault(name, []).append(digests(destination))
    return found


@pytest.mark.parametrize("ros_version", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_the_bytes_are_the_same(kind: str, ros_version: int, outputs: dict[str, list[dict[str, str]]]) -> None:
    first, *others = outputs[f"{ros_version}-{kind}"]
    assert len(others) == len(RUNS) - 1
    for other in others:
        assert other == first


def test_other_parameters_make_other_bytes(tmp_path: Path) -> None:
    # The comparison could not fail if digests were of nothing.
    source = str(SOURCES["bag-lz4"](tmp_path, CONTENT))
    made: list[Any] = []
    for number, height in enumerate(("2", "3")):
        destination = tmp_path / str(number) / "out.mcap"
        destination.parent.mkdir()
        arguments = ["convert", source, "-o", str(destination), "--min-height", "-2", "--max-height", height]
        converted([arguments], RUNS[0])
        made.append(digests(destination))
    assert made[0].keys() == made[1].keys()
    assert made[0] != made[1]
