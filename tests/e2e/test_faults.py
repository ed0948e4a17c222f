"""Every call that changes the file system may fail or be the last: the destination is absent or complete.

The calls are counted below Python and SQLite, by a library that is loaded in front of the system's (``faults.c``).
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from e2e.fault_driver import CASES
from support.builders import CONTENT, write_mcap
from support.command import environment

if TYPE_CHECKING:
    from collections.abc import Sequence

_HERE = Path(__file__).parent
_KINDS = ["bag", "mcap+over", "rosbag2+over", "sqlite3"]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("cc")
    if sys.platform != "linux" or compiler is None:
        pytest.skip("faults are injected by a library for Linux, which needs a C compiler")
    built = tmp_path_factory.mktemp("faults") / "faults.so"
    command = [compiler, "-shared", "-fPIC", "-Wall", "-Werror", "-o", str(built), str(_HERE / "faults.c"), "-ldl"]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    return built


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mcap(tmp_path_factory.mktemp("source") / "drive.mcap", CONTENT)


def outcomes(
    library: Path, source: Path, folder: Path, kind: str, faults: Sequence[str]
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The run without a fault, and those with one."""
    done = subprocess.run(
        [sys.executable, str(_HERE / "fault_driver.py"), str(library), str(source), str(folder), kind, *faults],
        capture_output=True,
        text=True,
        env={**environment(), "LD_PRELOAD": str(library), "PYTHONPATH": os.pathsep.join(sys.path)},
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr, done.stderr
    sound, *others = map(json.loads, done.stdout.splitlines())
    return sound, others


def assert_sound(sound: dict[str, Any], kind: str) -> None:
    name = CASES[kind.partition("+")[0]][0]
    assert (sound["status"], sound["left"], sound["left_again"]) == (0, [name], [name])
    assert sound["destination"]
    assert sound["destination"] != sound["old"]


def assert_data_are_on_the_disk_before_the_name(sound: dict[str, Any], kind: str) -> None:
    calls = [tuple(call) for call in sound["calls"]]
    partial = f"./{CASES[kind.partition('+')[0]][0]}.pc2scan-partial"
    published = next(n for n, (call, path) in enumerate(calls) if call in ("link", "rename") and path == partial)
    written = {path for call, path in calls if call == "write"}
    assert written
    for path in written:
        last = max(n for n, call in enumerate(calls) if call == ("write", path))
        synced = max((n for n, call in enumerate(calls) if call == ("fsync", path)), default=-1)
        assert last < synced < published, path
    # And the name is on the disk before the run says that it is done, or removes what was there before.
    folder = calls.index(("fsync", "."), published)
    removed = [n for n, (call, path) in enumerate(calls) if call == "unlink" and ".pc2scan-old" in path]
    assert all(folder < n for n in removed)


def assert_absent_or_complete(outcome: dict[str, Any], sound: dict[str, Any], kind: str) -> None:
    """What holds after any fault."""
    name = CASES[kind.partition("+")[0]][0]
    what = {key: outcome[key] for key in ("fault", "at", "status", "left", "again", "left_again")}
    if outcome["at"]:
        what["call"] = outcome["calls"][-1] if outcome["fault"] == "SIGKILL" else outcome["calls"][outcome["at"] - 1]
    partial, aside = f"{name}.pc2scan-partial", f"{name}.pc2scan-old"
    assert set(outcome["left"]) <= {name, partial, f"{partial}.lock", aside}, what
    complete, there = outcome["destination"] == sound["destination"], outcome["destination"]
    # What was there before is there still, or, for the moment between two renames of a directory, beside its place.
    moved = there == "" and aside in outcome["left"] and outcome["status"] < 0
    assert complete or there == ("old" if outcome["old"] else "") or moved, what
    # The exit status shows it.
    assert outcome["status"] in ((-9, 0) if outcome["status"] < 0 else (0, 1)), what
    assert complete or outcome["status"] != 0, what
    # The next run cleans up.
    assert outcome["again"] == 0, what
    if outcome["status"] < 0 or set(outcome["left"]) - {name}:
        assert outcome["left_again"] == [name], what
        assert outcome["destination_again"] == sound["destination"], what


@pytest.mark.slow
@pytest.mark.parametrize("kind", _KINDS)
def test_each_call_may_fail(kind: str, library: Path, source: Path, tmp_path: Path) -> None:
    faults = ["ENOSPC"] if kind.endswith("over") else ["ENOSPC", "EIO"]
    sound, others = outcomes(library, source, tmp_path, kind, faults)
    assert_sound(sound, kind)
    assert_data_are_on_the_disk_before_the_name(sound, kind)
    assert len(others) >= len(faults)
    tried = {tuple(sound["calls"][outcome["at"] - 1]) for outcome in others}
    assert kind.endswith("over") or tried == set(map(tuple, sound["calls"]))
    for outcome in others:
        assert_absent_or_complete(outcome, sound, kind)
        # Nothing is left but what could not be removed, and the old until the new is known to be on the disk.
        failed, _ = outcome["calls"][outcome["at"] - 1]
        left = set(outcome["left"]) - {CASES[kind.partition("+")[0]][0]}
        kept = failed in ("fsync", "close") and all(name.endswith(".pc2scan-old") for name in left)
        assert not left or failed in ("unlink", "open") or kept, (outcome["at"], failed, left)
    assert any(outcome["status"] == 1 for outcome in others)


@pytest.mark.slow
@pytest.mark.parametrize("kind", _KINDS)
def test_each_call_may_be_the_last(kind: str, library: Path, source: Path, tmp_path: Path) -> None:
    sound, others = outcomes(library, source, tmp_path, kind, ["SIGKILL"])
    assert_sound(sound, kind)
    for outcome in others:
        assert outcome["status"] == -9
        assert_absent_or_complete(outcome, sound, kind)
