"""The same input, parameters and version make the same bytes: whenever, wherever, on any number of jobs."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from support import sampled
from support.builders import CONTENT, POINTS, SECOND, SOURCES, T0, Mcap, Recording, cloud, item, points_of, write_mcap
from support.command import environment
from support.containers import ATTACHMENTS, FORMATS, METADATA

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
    (("1e9", "robot", "1"), {"TZ": "UTC", "PYTHONHASHSEED": "1", "LC_ALL": "C", "USER": "alice"}),
    (("2e9", "ci-7", "2"), {"TZ": "Asia/Tokyo", "PYTHONHASHSEED": "77", "USER": "bob"}),
)


def digests(path: Path) -> dict[str, str]:
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def converted(commands: list[list[str]], run: int) -> None:
    words, variables = RUNS[run]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *words],
        input=json.dumps(commands),
        capture_output=True,
        text=True,
        env={**environment(), **variables},
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("part", sampled([0, 1], 1))
def test_the_bytes_are_the_same_whenever_and_wherever(part: int, tmp_path: Path) -> None:
    # Beside the usual content enough large clouds for several chunks, and for every job.
    stamp = T0 + SECOND
    clouds = [
        item(POINTS, stamp + n, lambda g, s: cloud(points_of(s, 8_000), g, seq=s, stamp_ns=stamp), n) for n in range(8)
    ]
    recording = Recording(CONTENT.streams, (*CONTENT.items, *clouds))
    form = Mcap(attachments=ATTACHMENTS, metadata=METADATA)
    sources = (SOURCES["bag-lz4"](tmp_path, recording), write_mcap(tmp_path / "source.mcap", recording, form))
    found: list[dict[str, dict[str, str]]] = []
    for run in range(len(RUNS)):
        # Another place, of another length, too.
        place = tmp_path / ("x" * (run + 1))
        commands, destinations = [], {}
        # Each kind from one of the sources, the ROS versions in turn.
        for number, (name, kind) in enumerate([*FORMATS.items()][part::2]):
            destinations[name] = place / name / kind.name
            destinations[name].parent.mkdir(parents=True)
            words = ["convert", str(sources[(number + number // 3) % 2]), "-o", str(destinations[name])]
            added = ["--static-tf", "lidar cup 0 0 1 0 0 0", "--write-static-tf", "--keep-clouds"]
            commands.append([*words, "--min-height", "-2", "--max-height", "2", *added, *kind.arguments()])
        converted(commands, run)
        found.append({name: digests(destination) for name, destination in destinations.items()})
    assert found[0] == found[1]
