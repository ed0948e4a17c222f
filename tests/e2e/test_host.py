"""A call of the library changes nothing of the process that it runs in."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from benchmarks.clouds import FORMS, write_recording
from support import ROOT, sampled
from support.command import environment

if TYPE_CHECKING:
    from pathlib import Path

#: Everything of a process that a library could change and that others would notice.
HOST = r'''
import ctypes, decimal, faulthandler, gc, json, locale, logging, os, random, resource, signal, socket, sys, tempfile
import threading, time, warnings
import numpy
from pathlib import Path

library = ctypes.CDLL(None)


def signals():
    """What the system would do about every signal, and which are blocked."""
    found = {}
    for number in range(1, 65):
        action = ctypes.create_string_buffer(512)
        library.sigaction(number, None, action)
        # The handler and the signals that it blocks; behind room for 1024 of them, the flags.
        found[number] = (action.raw[:16], action.raw[136:140])
    return found, sorted(map(str, signal.pthread_sigmask(signal.SIG_BLOCK, []))), str(signal.getitimer(0))


def descriptors():
    return {name: os.readlink(f"/proc/self/fd/{name}") for name in os.listdir("/proc/self/fd")[:-1]}


def state():
    umask = os.umask(0o22)
    os.umask(umask)
    named = logging.root.manager.loggerDict.items()
    loggers = {name: (str(logger), getattr(logger, "handlers", [])) for name, logger in named}
    return {
        "signals": signals(),
        "Python's handlers": {str(number): signal.getsignal(number) for number in signal.valid_signals()},
        "wake-up descriptor": signal.set_wakeup_fd(-1),
        "faulthandler": faulthandler.is_enabled(),
        "environment": dict(os.environ),
        "folder": os.getcwd(),
        "umask": umask,
        "priority": os.getpriority(os.PRIO_PROCESS, 0),
        "processors": os.sched_getaffinity(0),
        "limits": {name: resource.getrlimit(getattr(resource, name)) for name in dir(resource) if "RLIMIT_" in name},
        "threads": (len(os.listdir("/proc/self/task")), threading.active_count()),
        "children": Path("/proc/self/task", str(os.getpid()), "children").read_text(),
        "descriptors": descriptors(),
        # A library that is loaded for YAML brings filters for warnings of its own alone.
        "warnings": ([each for each in warnings.filters if "ruamel" not in each[2].__module__], warnings.showwarning),
        "logging": (logging.root.level, list(logging.root.handlers), logging.root.manager.disable, loggers),
        "garbage collector": (gc.get_threshold(), gc.isenabled(), gc.get_freeze_count()),
        "hooks": (sys.excepthook, sys.unraisablehook, threading.excepthook, sys.displayhook, sys.gettrace()),
        "streams": (sys.stdin, sys.stdout, sys.stderr),
        "interpreter": (sys.getswitchinterval(), sys.getrecursionlimit(), sys.get_int_max_str_digits(), sys.path[:]),
        "numbers": (str(decimal.getcontext()), numpy.geterr(), random.getstate(), str(numpy.random.get_state())),
        "locale": locale.setlocale(locale.LC_ALL),
        "others": (tempfile.tempdir, socket.getdefaulttimeout()),
    }


def told(*args):
    print("bus error", args)


# A host with settings of its own.
signal.signal(signal.SIGBUS, told)
signal.signal(signal.SIGTERM, told)
# The default, with the flags that Python gives it when it is set again.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
faulthandler.enable()
os.umask(0o27)
logging.getLogger().setLevel(logging.ERROR)
warnings.simplefilter("always")
gc.set_threshold(701)
# Python remembers the folder once anybody asks.
tempfile.gettempdir()
import pc2scan

source, folder = Path(sys.argv[1]), Path(sys.argv[2])
before = state()


def compare(what):
    # The system lists a thread a moment longer than Python.
    wait_until = time.monotonic() + 10
    while len(os.listdir("/proc/self/task")) > before["threads"][0] and time.monotonic() < wait_until:
        time.sleep(0.01)
    after = state()
    # Names of loggers come with modules that are loaded; what the host has made of its own must stay.
    *rest, old = before["logging"]
    *now, new = after.pop("logging")
    assert rest == now, (what, rest, now)
    assert old.items() <= new.items() and not any(handlers for _, handlers in new.values()), (what, old, new)
    for name, value in after.items():
        assert value == before[name], f"{what}: {name}\n{before[name]}\n{value}"


for jobs in (1, 2):
    report = pc2scan.convert(source, folder / "scans.mcap", overwrite=True, jobs=jobs)
    assert report.exit_status == 0, report
    compare("convert")
assert pc2scan.convert(source, folder / "copy.bag", keep_clouds=True).exit_status == 0
compare("convert to ROS 1")
pc2scan.diff(folder / "scans.mcap", folder / "scans.mcap")
compare("diff")
pc2scan.info([source])
compare("info")
pc2scan.check(folder / "scans.mcap")
compare("check")
print(pc2scan.tf(source), file=sys.stderr)
compare("tf")
pc2scan.repair(source, folder / "sound.bag" if source.suffix == ".bag" else folder / "sound.mcap", compression="none")
compare("repair")
for scan in pc2scan.scans(source, "/points", min_height=-100):
    scan.xy()
compare("scans")
for cloud in pc2scan.clouds(source, "/points"):
    cloud.xyz()
    break
compare("clouds, left")
pc2scan.clouds(source, "/trifle")
compare("clouds, forgotten")
assert pc2scan.golden(sys.argv[3]).exit_status == 0
compare("golden")
try:
    pc2scan.convert(source, folder / "none.mcap", topics=["/none"])
except Exception:
    compare("an error")
else:
    raise AssertionError("there is no such topic")
'''


@pytest.mark.skipif(sys.platform != "linux", reason="what the system does about signals is looked at as Linux has it")
@pytest.mark.parametrize("form", sampled(FORMS, 1))
def test_a_host_finds_everything_as_it_was(form: str, tmp_path: Path) -> None:
    source = write_recording(tmp_path, FORMS[form], 10_000_000)
    command = [sys.executable, "-c", HOST, str(source), str(tmp_path), str(ROOT / "fixtures" / "golden" / "tf_static")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment(), check=False)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
