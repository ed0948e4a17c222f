"""Plants faults in the source, one after the other, and records which of them the tests catch.

By hand; the first command records which tests run which lines, the second plants the faults in a copy of the project::

    python -m pytest -q -m "" --cov --cov-context=test --cov-report=
    PYTHONPATH=tests python tests/planted/campaign.py --count 200 --seed 1 --lines .coverage --json planted.json

Of each fault the tests that run its line are run, those that run the fewest lines first, until one fails. A fault that
none of them notices is missed. A fault whose line no test runs is missed without a run. Faults in C and at the level of
modules, which no test is recorded for, are held against all the tests that run a line of the same module, for C of
the modules that call the compiled loops.

Without ``--lines``, the tests are chosen by their place: those named like the module, then all quick ones of its room,
then those of the command. Nothing is recorded before, which takes as long as all tests. What only other rooms catch is
missed.

``--again planted.json`` plants the faults of an earlier run, as far as the source still has them: a fault is found
again by its text.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from coverage import CoverageData

from planted.faults import Fault, faults_in, plant, sample

ROOT = Path(__file__).resolve().parents[2]

#: Tests that run most modules, by the command and by the public functions.
_EVERYWHERE = ("transcripts", "e2e/test_golden.py", "test_api.py")

#: The beginning of what pytest says if it does not find tests.
_UNKNOWN = "tests are not found"

#: The modules that call the loops in C, which choose between them and NumPy's when they are imported.
_CALLS_C = ("core/project.py", "core/occupancy.py", "transforms/many.py", "conversion/stages/deskew.py")

#: Tests that call the loops in C without these modules.
_OF_C = ("core/test_loops.py", "core/test_fdlibm.py")


def main() -> None:
    """Plant the faults, and print a table by room."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--again", type=Path, help="the faults of this earlier run")
    parser.add_argument("--lines", type=Path, help="coverage's data, recorded with --cov-context=test")
    parser.add_argument("--json", type=Path, required=True, help="write the result of each fault here; continues a run")
    parser.add_argument("--most", type=int, default=400, help="run at most this many tests for a fault")
    parser.add_argument(
        "--timeout", type=float, default=300, help="seconds for a fault's tests; a hang is noticed, too"
    )
    parser.add_argument("--workers", default="0", help="pytest-xdist's -n")
    arguments = parser.parse_args()
    faults = _again(arguments.again) if arguments.again else sample(ROOT, arguments.count, arguments.seed)
    tests = _Tests(arguments.lines) if arguments.lines else _Neighbours()
    results = json.loads(arguments.json.read_text()) if arguments.json.exists() else []
    done = {_key(result) for result in results}
    with tempfile.TemporaryDirectory(prefix="pc2scan-planted-") as name:
        copy = _copy(Path(name))
        if (built := _build(copy)).returncode:
            raise SystemExit(f"the compiled loops cannot be built: {built.stderr.strip()}")
        for fault in faults:
            if _key(fault._asdict()) in done:
                continue
            chosen = tests.of(fault)[: arguments.most]
            began = time.monotonic()
            caught = _caught(copy, fault, chosen, arguments.timeout, arguments.workers) if chosen else ""
            seconds = round(time.monotonic() - began, 1)
            results.append({**fault._asdict(), "room": fault.room, "tests": len(chosen), "by": caught, "s": seconds})
            arguments.json.write_text(json.dumps(results, indent=1))
            sys.stdout.write(f"{'caught' if caught else 'MISSED'} {seconds:6.1f} s  {fault}  {caught[:100]}\n")
            sys.stdout.flush()
    _print(results)


class _Tests:
    """Which tests run which lines."""

    def __init__(self, path: Path) -> None:
        data = CoverageData(str(path))
        data.read()
        self._data = data
        self._files = {Path(name).as_posix().rpartition("/src/")[2]: name for name in data.measured_files()}
        self._lines: dict[str, int] = Counter()
        self._by_file: dict[str, dict[int, list[str]]] = {}
        for name in data.measured_files():
            for contexts in data.contexts_by_lineno(name).values():
                self._lines.update(contexts)

    def _of(self, path: str) -> dict[int, list[str]]:
        """Return the tests that run each line of a module; empty for a module that no test runs."""
        if path not in self._by_file:
            self._by_file[path] = self._data.contexts_by_lineno(self._files[path]) if path in self._files else {}
        return self._by_file[path]

    def of(self, fault: Fault) -> list[str]:
        """Return the tests to run for a fault, those that run the fewest lines of the package first."""
        if fault.path.endswith(".c"):
            here = {test for module in _CALLS_C for tests in self._of(f"pc2scan/{module}").values() for test in tests}
            here |= {test for test in self._lines if any(name in test for name in _OF_C)}
        else:
            lines = self._of(fault.path.removeprefix("src/"))
            last = fault.line + fault.old.count("\n")
            here = {test for line in range(fault.line, last + 1) for test in lines.get(line, ())}
            if here == {""}:
                # Run when the module is loaded.
                here = {test for tests in lines.values() for test in tests}
        here.discard("")
        named = {test.rpartition("|")[0] or test for test in here}
        ordered = sorted(named, key=lambda test: (self._lines[f"{test}|run"] or self._lines[test], test))
        if fault.path.endswith(".c"):
            ordered.sort(key=lambda test: not any(name in test for name in _OF_C))
        return ordered


class _Neighbours:
    """Which tests stand where a module stands."""

    def of(self, fault: Fault) -> list[str]:
        """Return the files and folders of tests to run for a fault, the nearest first."""
        module = Path(fault.path).relative_to("src/pc2scan").with_suffix("")
        tests, room = ROOT / "tests", ROOT / "tests" / module.parent
        words = [word for word in module.name.split("_") if word not in {"", "init"}]
        named = [path for word in words for path in sorted(tests.rglob(f"test_*{word.rstrip('s')}*.py"))]
        named.sort(key=lambda path: path.parent != room)
        rooms = [each for each in (room, *room.parents) if each.is_dir() and tests in each.parents]
        return [str(path) for path in dict.fromkeys([*named, *rooms, *(tests / name for name in _EVERYWHERE)])]


def _caught(copy: Path, fault: Fault, tests: list[str], timeout: float, workers: str) -> str:
    """Return the first test that notices the fault, and that passes without it; empty if none does."""
    path = copy / fault.path
    text = path.read_text("utf-8")
    left = [test.replace(str(ROOT), str(copy)) for test in tests]
    while left:
        path.write_text(plant(text, fault), "utf-8")
        try:
            if path.suffix == ".c" and _build(copy).returncode:
                return "the compiler"
            failed = _failed(copy, left, timeout, workers)
        except subprocess.TimeoutExpired:
            return "a test that does not end"
        finally:
            path.write_text(text, "utf-8")
            if path.suffix == ".c":
                _build(copy)
        if failed.startswith(_UNKNOWN):
            # A fault may keep a module of tests from being imported, and so its tests from being found.
            if (unknown := _failed(copy, ["--collect-only", *left], timeout, "0")).startswith(_UNKNOWN):
                raise SystemExit(f"these tests are not those of the recorded lines: {unknown}")
            return "a module of tests cannot be imported"
        name = failed.partition(" - ")[0]
        # A whole file or folder is not taken up again behind a test that fails without the fault, too.
        if name not in left or not _failed(copy, [name], timeout, "0"):
            return failed
        left = left[left.index(name) + 1 :]
    return ""


def _failed(copy: Path, tests: list[str], timeout: float, workers: str) -> str:
    """Return the first test that fails, with what it says; empty if all pass."""
    env = {**os.environ, "PYTHONPATH": str(copy / "src"), "CI": "true", "PYTHONDONTWRITEBYTECODE": "1"}
    ids = copy / "tests.txt"
    ids.write_text("".join(f"{test}\n" for test in tests), "utf-8")
    # Single tests are run whatever their marks, files and folders without their long tests.
    marks = "" if all("::" in test for test in tests) else "not slow"
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", workers, "-m", marks]
    command += ["-p", "no:cacheprovider", f"@{ids}"]
    done = subprocess.run(command, cwd=copy, env=env, capture_output=True, text=True, timeout=timeout, check=False)
    if done.returncode == pytest.ExitCode.USAGE_ERROR:
        return f"{_UNKNOWN}: {done.stderr.strip()}"
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    # A crash of the interpreter, or of what pytest needs before it runs a test, is noticed, too.
    return failed[0].partition(" ")[2] if failed else f"pytest's status {done.returncode}" if done.returncode else ""


def _build(copy: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "setup.py", "-q", "build_ext", "--inplace", "--force"]
    return subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)


def _copy(folder: Path) -> Path:
    """Copy the project, with its compiled loops; the shared recordings stay where they are."""
    copy = folder / "pc2scan"
    shutil.copytree(ROOT, copy, symlinks=True, ignore=shutil.ignore_patterns(".git", ".venv", "__pycache__", "build"))
    if (ROOT.parent / "shared").is_dir():
        (folder / "shared").symlink_to((ROOT.parent / "shared").resolve())
    return copy


def _again(path: Path) -> list[Fault]:
    """Return the faults of an earlier run that the source still has, wherever in their modules they are now."""
    found: list[Fault] = []
    for result in json.loads(path.read_text()):
        module = ROOT / result["path"]
        if not module.is_file():
            continue
        same = [
            fault
            for fault in faults_in(result["path"], module.read_text("utf-8"))
            if (fault.old, fault.new, fault.kind) == (result["old"], result["new"], result["kind"])
        ]
        if same:
            found.append(min(same, key=lambda fault: abs(fault.line - result["line"])))
    return found


def _key(fault: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(fault[name] for name in ("path", "start", "end", "new"))


def _print(results: list[dict[str, Any]]) -> None:
    rooms = Counter(result["room"] for result in results)
    caught = Counter(result["room"] for result in results if result["by"])
    sys.stdout.write(f"{'room':20} {'planted':>8} {'caught':>8}\n")
    for room in sorted(rooms):
        sys.stdout.write(f"{room:20} {rooms[room]:8} {caught[room]:8}\n")
    sys.stdout.write(f"{'all':20} {rooms.total():8} {caught.total():8}\n")


if __name__ == "__main__":
    main()
