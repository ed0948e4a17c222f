"""docs/faults.md names tests for every fault: they are there, under these names."""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path

ROOT = Path(__file__).parents[2]
TESTS = ROOT / "tests"

#: Where the files of a section's tests are, if they are not told from `tests/` on.
FOLDERS = {"Damaged recordings": "bags", "Hostile recordings": "hostile", "Output under faults": "e2e"}


def rows() -> list[tuple[str, str, str]]:
    """Folder, fault and tests of every row of the tables."""
    found = []
    folder = ""
    page = (ROOT / "docs" / "faults.md").read_text("utf-8")
    # What is measured has tables of its own.
    for line in re.sub("<!-- (factors|costs) -->.*?<!-- end of \\1 -->", "", page, flags=re.DOTALL).splitlines():
        if line.startswith("## "):
            folder = FOLDERS[line.removeprefix("## ")]
        elif line.startswith("| ") and not line.startswith("| fault "):
            fault, _, tests = (cell.strip() for cell in line.strip("|").split(" | "))
            found.append((folder, fault, tests))
    return found


def missing(folder: str, tests: str) -> list[str]:
    """The files and tests of a row that are not there."""
    words = re.findall(r"`([^`]+)`", tests)
    if not words or not words[0].endswith(".py"):
        return [f"no tests of a file: {tests}"]
    found: list[str] = []
    texts: list[str] = []
    # Files, then the tests that each of them has.
    for are_files, group in groupby(words, key=lambda word: word.endswith(".py")):
        if are_files:
            files = [next((p for p in (TESTS / name, TESTS / folder / name) if p.is_file()), name) for name in group]
            found += [f"{file} is not there" for file in files if isinstance(file, str)]
            texts = [file.read_text("utf-8") for file in files if isinstance(file, Path)]
        else:
            found += [name for name in group for text in texts if f"def {name}(" not in text]
    return found


def test_the_tests_of_every_fault_are_there() -> None:
    found = rows()
    assert {fault: missing(folder, tests) for folder, fault, tests in found if missing(folder, tests)} == {}
    assert {folder for folder, _, _ in found} == set(FOLDERS.values())
