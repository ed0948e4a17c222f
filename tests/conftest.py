"""Settings of every test."""

from __future__ import annotations

import gc
import os
import signal

from hypothesis import settings

# No time limits, because machines are shared. CI draws the same examples each time, so that failures are repeatable.
settings.register_profile("pc2scan", deadline=None, derandomize="CI" in os.environ, max_examples=25)
# Of the long tests, which are those of hypothesis again, with more examples.
settings.register_profile("thorough", settings.get_profile("pc2scan"), max_examples=75)
settings.load_profile("pc2scan")

# As in the command: several threads for small matrices wait for each other most of the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# With it, each of the thousands of commands that tests start would compile the whole package again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def pytest_xdist_auto_num_workers() -> int:
    """Return one worker more than there are processors: many tests wait for clusters, stores and pages."""
    return (os.cpu_count() or 1) + 1


# What a power failure leaves is tested in e2e/test_faults.py; all other tests would wait for disks.
os.fsync = lambda fd: None  # noqa: ARG005
# While thousands of tests are collected, nothing becomes garbage.
gc.disable()


def pytest_collection_finish() -> None:
    """Keep what stays until the end, such as thousands of tests, out of each collection of garbage."""
    gc.enable()
    gc.collect()
    gc.freeze()


def pytest_runtest_setup() -> None:
    """Make interrupts reach the commands that tests start, which inherit what this process ignores.

    Shells start background jobs with SIGINT ignored, and the command, which some tests call in this process, ignores it
    at its end.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
