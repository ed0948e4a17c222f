"""Plants faults in a copy of the project, one after the other, and records which of them the tests catch.

By hand::

    PYTHONPATH=tests python tests/planted/campaign.py --count 200 --seed 1 --json planted.json

Beside the extra of tests, it needs setuptools. First, the quick tests are run once, to note which lines each of them
runs. Of each fault, the tests that run its line are run until one fails: those that run the
fewest lines first. ``--again planted.json`` plants the faults of an earlier run, as far as the source still has them: a
fault is found again by its text.
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

from coverage import CoverageData

from planted.faults import Fault, faults_in, plant, sample

ROOT = Path(__file__).resolve().parents[2]

#: How many tests of a line are run, chosen evenly.
_MOST_TESTS = 150


def main() -> None:
    """Plant the faults, and print a table by room."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--again", type=Path, help="the faults of this earlier run")
    parser.add_argument("--json", type=Path, required=True, help="write the result of each fault here; continues a run")
    parser.add_argument("--timeout", type=float, default=300, help="seconds for a fault's tests; a hang is noticed too")
    parser.add_argument("--lines", type=Path, help="which lines each test runs; made if it does not exist")
    arguments = parser.parse_args()
    faults = _again(arguments.again) if arguments.again else sample(ROOT, arguments.count, arguments.seed)
    results = json.loads(arguments.json.read_text()) if arguments.json.exists() else []
    done = {(result["path"], result["start"], result["new"]) for result in results}
    with tempfile.TemporaryDirectory(prefix="pc2scan-planted-") as name:
        copy = _copy(Path(name))
        if not _build(copy):
            sys.exit("the compiled loops cannot be built: setuptools and a C compiler are needed")
        lines, sizes = _lines_of_tests(copy, arguments.lines or Path(name) / "lines")
        for fault in faults:
            if (fault.path, fault.start, fault.new) in done:
                continue
            began = time.monotonic()
            caught = _caught(copy, fault, _tests_of(fault, lines, sizes), arguments.timeout)
            seconds = round(time.monotonic() - began, 1)
            results.append({**fault._asdict(), "room": fault.room, "by": caught, "s": seconds})
            arguments.json.write_text(json.dumps(results, indent=1))
            sys.stdout.write(f"{'caught' if caught else 'MISSED'} {seconds:6.1f} s  {fault}  {caught[:100]}\n")
            sys.stdout.flush()
    _print(results)


def _lines_of_tests(copy: Path, path: Path) -> tuple[CoverageData, Counter[str]]:
    """Return which tests run each line, and how many lines each test runs."""
    if not path.exists():
        env = {**_environment(copy), "COVERAGE_FILE": str(path.resolve())}
        command = [sys.executable, "-m", "pytest", "-q", "--cov=src/pc2scan", "--cov-context=test", "--cov-report="]
        subprocess.run(command, cwd=copy, env=env, check=True)
    lines = CoverageData(str(path))
    lines.read()
    tests = [lines.contexts_by_lineno(module).values() for module in lines.measured_files()]
    return lines, Counter(test for module in tests for line in module for test in line)


def _tests_of(fault: Fault, lines: CoverageData, sizes: Counter[str]) -> list[str]:
    """Return the tests that run a fault's lines; those of its module, if they run as it is imported."""
    if fault.path.endswith(".c"):
        # Lines in C are not noted.
        return ["tests/core", "tests/e2e/test_golden.py"]
    module = next((path for path in lines.measured_files() if path.endswith(fault.path)), "")
    tests = lines.contexts_by_lineno(module)
    last = fault.line + fault.old.count("\n")
    of_lines = {test for line in range(fault.line, last + 1) for test in tests.get(line, ()) if test}
    chosen = of_lines or {test for line in tests.values() for test in line if test}
    names = dict.fromkeys(test.rpartition("|")[0] for test in sorted(chosen, key=lambda test: (sizes[test], test)))
    return list(names)[:: 1 + len(names) // _MOST_TESTS]


def _caught(copy: Path, fault: Fault, tests: list[str], timeout: float) -> str:
    """Return the first test that notices the fault, and that passes without it; empty if none does."""
    if not tests:
        return ""
    path = copy / fault.path
    text = path.read_text("utf-8")
    broken: list[str] = []
    while True:
        path.write_text(plant(text, fault), "utf-8")
        try:
            if path.suffix == ".c" and not _build(copy):
                return "the compiler"
            failed = _failed(copy, [*tests, *broken], timeout)
        except subprocess.TimeoutExpired:
            return "a test that does not end"
        finally:
            path.write_text(text, "utf-8")
            if path.suffix == ".c":
                _build(copy)
        name = failed.partition(" - ")[0]
        if "::" not in name or not _failed(copy, [name], timeout):
            return failed
        broken.append(f"--deselect={name}")


def _failed(copy: Path, tests: list[str], timeout: float) -> str:
    """Return the first test that fails, with what it says; empty if all pass."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider", *tests]
    env = _environment(copy)
    done = subprocess.run(command, cwd=copy, env=env, capture_output=True, text=True, timeout=timeout, check=False)
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    # A crash of the interpreter, or of what pytest needs before it runs a test, is noticed, too.
    return failed[0].partition(" ")[2] if failed else f"pytest's status {done.returncode}" if done.returncode else ""


def _environment(copy: Path) -> dict[str, str]:
    """Return an environment in which the copy's package comes before the installed one."""
    return {**os.environ, "PYTHONPATH": str(copy / "src"), "CI": "true", "PYTHONDONTWRITEBYTECODE": "1"}


def _build(copy: Path) -> bool:
    """Build the compiled loops; returns whether they can be built."""
    command = [sys.executable, "setup.py", "-q", "build_ext", "--inplace", "--force"]
    return subprocess.run(command, cwd=copy, capture_output=True, check=False).returncode == 0


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


def _print(results: list[dict[str, Any]]) -> None:
    rooms = Counter(result["room"] for result in results)
    caught = Counter(result["room"] for result in results if result["by"])
    sys.stdout.write(f"{'room':20} {'planted':>8} {'caught':>8}\n")
    for room in sorted(rooms):
        sys.stdout.write(f"{room:20} {rooms[room]:8} {caught[room]:8}\n")
    sys.stdout.write(f"{'all':20} {rooms.total():8} {caught.total():8}\n")


if __name__ == "__main__":
    main()
