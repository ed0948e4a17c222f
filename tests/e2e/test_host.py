"""A call of the library changes nothing of the process that it runs in."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from benchmarks.clouds import FORMS, write_recording
from support import ROOT
from support.command import environment

if TYPE_CHECKING:
    from pathlib import Path

#: Everything of a process that a library could change and that others would notice.
HOST = r"""
import gc, logging, os, random, signal, sys, tempfile, threading, time, warnings
import numpy
from pathlib import Path


def state():
    umask = os.umask(0o22)
    os.umask(umask)
    return {
        "signals": {str(number): signal.getsignal(number) for number in signal.valid_signals()},
        "wake-up descriptor": signal.set_wakeup_fd(-1),
        "environment": (dict(os.environ), os.getcwd(), umask, os.sched_getaffinity(0)),
        "threads": (len(os.listdir("/proc/self/task")), threading.active_count()),
        "descriptors": {name: os.readlink(f"/proc/self/fd/{name}") for name in os.listdir("/proc/self/fd")[:-1]},
        # A library that is loaded for YAML brings filters for warnings of its own alone.
        "warnings": ([each for each in warnings.filters if "ruamel" not in each[2].__module__], warnings.showwarning),
        "logging": (logging.root.level, list(logging.root.handlers), logging.root.manager.disable),
        "garbage collector": (gc.get_threshold(), gc.isenabled(), gc.get_freeze_count()),
        "interpreter": (sys.excepthook, sys.stdin, sys.stdout, sys.stderr, sys.getrecursionlimit(), sys.path[:]),
        "numbers": (numpy.geterr(), random.getstate(), str(numpy.random.get_state())),
        "temporary": tempfile.gettempdir(),
    }


# A host with settings of its own.
signal.signal(signal.SIGTERM, lambda *args: None)
os.umask(0o27)
logging.getLogger().setLevel(logging.ERROR)
warnings.simplefilter("always")
gc.set_threshold(701)
import pc2scan

source, folder = Path(sys.argv[1]), Path(sys.argv[2])
before = state()


def compare(what):
    # The system lists a thread a moment longer than Python.
    wait_until = time.monotonic() + 10
    while len(os.listdir("/proc/self/task")) > before["threads"][0] and time.monotonic() < wait_until:
        time.sleep(0.01)
    for name, value in state().items():
        assert value == before[name], f"{what}: {name}\n{before[name]}\n{value}"


for jobs in (1, 2):
    assert pc2scan.convert(source, folder / "scans.mcap", overwrite=True, jobs=jobs).exit_status == 0
    compare("convert")
assert pc2scan.diff(folder / "scans.mcap", folder / "scans.mcap").same
compare("diff")
pc2scan.info([source])
compare("info")
pc2scan.check(folder / "scans.mcap")
compare("check")
for cloud in pc2scan.clouds(source, "/points"):
    cloud.xyz()
    break
compare("clouds, left")
assert pc2scan.golden(sys.argv[3]).exit_status == 0
compare("golden")
try:
    pc2scan.convert(source, folder / "none.mcap", topics=["/none"])
except Exception:
    compare("an error")
else:
    raise AssertionError("there is no such topic")
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="what the system does about signals is looked at as Linux has it")
def test_a_host_finds_everything_as_it_was(tmp_path: Path) -> None:
    source = write_recording(tmp_path, FORMS["MCAP, zstd"], 10_000_000)
    command = [sys.executable, "-c", HOST, str(source), str(tmp_path), str(ROOT / "fixtures" / "golden" / "tf_static")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment(), check=False)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
